"""From excitation runs, which need no plateaus of constant velocity, to the parameters of the arm's torque.

filtering (runs at an even rate, differentiated) -> columns and base_groups (what is linear in the torque) ->
problem (the stacked rows) -> least_squares, instruments (values), covariance (their deviations); gains, load_parts.
"""

__all__ = [
    "base_groups",
    "closed_loop",
    "columns",
    "coulomb_viscous",
    "elements",
    "filtering",
    "fit_quality",
    "gains",
    "identify",
    "least_squares",
    "load_parts",
    "payload",
    "prior",
    "problem",
    "result",
    "standstill",
    "torques",
]
