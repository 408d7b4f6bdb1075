"""Microcontrollers in simulation: the firmware's real binaries behind the emulated rig's Board interface."""
