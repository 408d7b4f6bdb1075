"""From excitation runs, which need no plateaus of constant velocity, to the parameters of the arm's torque.

filtering (runs at an even rate, differentiated) -> problem (the stacked rows and what they are linear in) ->
least_squares (values and deviations) -> checks (signs, zeros) -> law, fit, choice, unmodelled, friction (which parts
each element has by cross_validation, and their values) -> known_payload (drive gains, load parts) -> instruments
(closed loops) -> prior, physical, consistency (links that can exist) -> torques, result; identify does all this.
"""
