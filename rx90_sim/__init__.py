"""The simulated hardware: drives and the plant that they move; and the simulation node."""
