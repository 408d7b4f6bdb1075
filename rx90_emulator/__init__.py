"""What people use: the closed loop, sweeps, identification, the demonstration and the commands."""
