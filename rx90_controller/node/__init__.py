"""The controller node: parameters, topics and services around one control law."""

__all__ = ["control", "trajectory_client"]
