"""The friction rig's node: a rig on ROS topics and services."""
