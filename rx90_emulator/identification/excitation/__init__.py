"""From excitation runs, which need no plateaus of constant velocity, to the parameters of the arm's torque.

filtering (runs at an even rate, differentiated) -> problem (the stacked rows and their linear parameters) -> fit
(values and deviations) -> bandwidths (filters, by the simplest friction) -> law, choice (the parts of each element, by
cross-validation) -> final_fit, friction (their values, with the effect of neglected parts) -> bodies (links that can
exist) -> result; identify runs all of them.
"""
