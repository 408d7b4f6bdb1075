"""The closed loop without ROS: the same plant step and control law, tick by tick, in one process."""

__all__ = ["application", "catalogue", "closed_loop", "line", "result", "setup", "trajectory_file"]
