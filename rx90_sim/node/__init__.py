"""The simulation node: parameters, topics and services around one plant step."""

__all__ = ["parameters", "simulation", "simulation_client"]
