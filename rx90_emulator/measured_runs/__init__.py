"""A measured bag against the closed loop along the same set-points, and the path error of a recorded arm."""
