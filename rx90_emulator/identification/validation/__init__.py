"""Validation by bags that were not used: torques along them, and the closed loop along their path."""
