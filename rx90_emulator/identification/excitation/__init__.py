"""From excitation runs, which need no plateaus of constant velocity, to the parameters of the arm's torque.

filtering (runs at an even rate, differentiated) -> linear_parameters (what is linear in the torque) -> problem (the
stacked rows) -> least_squares, instruments (values and their deviations); gains, load_parts (from known payloads);
friction/ (which parts each element has) -> bodies, consistency (links that can exist) -> torques, result.
"""
