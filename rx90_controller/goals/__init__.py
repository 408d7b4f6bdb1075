"""The contract of FollowJointTrajectory without ROS: goals checked, tolerances, and what becomes of a goal."""

__all__ = ["execution", "goal", "results", "runner", "tolerances"]
