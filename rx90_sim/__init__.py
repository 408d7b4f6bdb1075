"""What nature does: drives and the plant they make; and the simulation node."""

__all__ = ["drives", "plant", "plant_step", "winding"]
