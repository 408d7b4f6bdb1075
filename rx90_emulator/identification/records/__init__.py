"""Bags of any robot, read as joint-side records: position, velocity and drive torque of each joint."""
