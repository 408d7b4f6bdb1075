"""What nature does: friction, manipulator, drives and the plant they make; and the simulation node."""
