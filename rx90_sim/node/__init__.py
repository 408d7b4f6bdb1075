"""The simulation node: parameters, topics and services around one plant step."""
