"""The rig as a program sees it: its file, its client, and the emulated one that runs the firmware's core."""

__all__ = ["client", "emulated", "joint_parts", "line", "link", "pty_rig", "rig_file"]
