"""The friction rig: protocol, emulated rig, ramp experiment, identification, node and commands."""
