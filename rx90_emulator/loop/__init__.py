"""The closed loop without ROS: the same plant step and control law, tick by tick, in one process."""

__all__ = ["closed_loop", "job", "run_bag", "setup", "task_run"]
