"""What nature does: friction, manipulator, drives and the plant they make; and the simulation node."""

__all__ = ["drives", "manipulator", "plant", "plant_step"]
