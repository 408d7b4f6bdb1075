"""What the fits share: the rigid arm of the robot that bags come from, its zeros, estimates of parameters."""

__all__ = ["arm_layout", "estimates", "options", "rigid_arm", "robot", "zeros"]
