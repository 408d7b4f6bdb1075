"""Functions of the CS7B: trajectories, Cartesian lines, the servo law; and the controller node."""
