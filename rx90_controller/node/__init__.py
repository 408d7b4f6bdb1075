"""The controller node: parameters, topics and services around one control law."""

__all__ = ["controller_node", "trajectory_client"]
