"""What the fits share: the rigid arm of the robot that bags come from, and estimates of friction parameters."""

__all__ = ["estimates", "options", "rigid_arm", "robot"]
