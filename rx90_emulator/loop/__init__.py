"""The closed loop without ROS: the same plant step and control law, tick by tick, in one process."""

__all__ = [
    "application",
    "catalogue",
    "closed_loop",
    "line",
    "recorded_run",
    "result",
    "setup",
    "trajectory_file",
    "working_day",
]
