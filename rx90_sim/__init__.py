"""What nature does: drives and the plant they make; and the simulation node."""
