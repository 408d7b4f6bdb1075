"""What was identified as files of a robot: a URDF, drives, friction and controller that the simulation loads."""

__all__ = ["folder", "marking"]
