"""The controller node: parameters, topics and services around one control law."""
