"""The simulation node: parameters, topics and services around one plant step."""

__all__ = ["sim_node", "simulation_client"]
