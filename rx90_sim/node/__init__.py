"""The simulation node: parameters, topics and services around one plant step."""

__all__ = ["simulation", "simulation_client"]
