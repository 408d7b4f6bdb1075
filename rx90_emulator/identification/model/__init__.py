"""What the fits share: the rigid arm of the robot that bags come from, its zeros, estimates of parameters."""
