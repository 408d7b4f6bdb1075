"""The rig as a program sees it: its file, its client, and the emulated one that runs the firmware's core."""
