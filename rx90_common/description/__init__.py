"""The robot as data: URDF and tool file to constants, kinematics of the tool centre point."""

__all__ = [
    "branch",
    "chain",
    "cogging",
    "current_sensor",
    "drives",
    "elasticity",
    "inverse",
    "kinematics",
    "link_transforms",
    "provenance",
    "rigid_torque",
    "robot",
    "robot_files",
    "rotations",
    "shapes",
    "tip",
    "tool",
    "urdf",
    "winding",
    "wrist",
]
