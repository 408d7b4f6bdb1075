"""Simulation and controller in one process: both nodes, their ticks exchanged in memory."""
