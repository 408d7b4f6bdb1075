"""From excitation runs, which need no plateaus of constant velocity, to the parameters of the arm's torque.

filtering (runs at an even rate, differentiated) -> problem (the stacked rows and what they are linear in) -> fit
(values and deviations) -> bandwidths, checks (filters, signs, zeros, by the simplest friction) -> law, choice (which
parts each element has by cross-validation) -> final_fit, friction (their values, and what they leave out) ->
known_payload (drive gains, load parts) -> instruments (closed loops) -> bodies (links that can exist) -> result;
identify does all this.
"""
