"""What bags that were not used say of an arm's friction: torques along them, and the closed loop along their path."""
