"""The robot as data: URDF and tool file to constants, kinematics of the tool centre point."""

__all__ = ["branch", "drives", "inverse", "kinematics", "rigid_torque", "robot", "robot_files", "urdf", "wrist"]
