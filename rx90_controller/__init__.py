"""What the CS7B computes: trajectories, Cartesian lines, the servo law; and the controller node."""
