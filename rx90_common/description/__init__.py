"""The robot as data: URDF and tool file to constants, kinematics of the tool centre point."""
