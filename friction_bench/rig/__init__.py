"""The rig's software: its file, its client, and the emulated rig that runs the firmware's core."""
