"""What nature does: drives and the plant they make; and the simulation node."""

__all__ = ["drives", "joint_temperatures", "plant", "plant_step", "plant_steps", "winding"]
