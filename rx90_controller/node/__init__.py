"""The controller node: parameters, topics and services around one control law."""

__all__ = ["control", "controller_node", "parameters", "trajectory_client"]
