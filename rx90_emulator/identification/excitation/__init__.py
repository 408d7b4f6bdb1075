"""From excitation runs, which need no plateaus of constant velocity, to the parameters of the arm's torque.

filtering (runs at an even rate, differentiated) -> columns and base_groups (what is linear in the torque) ->
problem (the stacked rows) -> least_squares, instruments (values), covariance (their deviations); gains.
"""

__all__ = [
    "base_groups",
    "columns",
    "elements",
    "filtering",
    "identify",
    "least_squares",
    "problem",
    "result",
    "standstill",
    "torques",
]
