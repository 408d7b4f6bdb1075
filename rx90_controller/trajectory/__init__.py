"""Joint trajectories: splines through the given points, checks, and the 1 kHz set-point generator."""

from rx90_controller.trajectory.generator import Schedule, TrajectoryGenerator
from rx90_controller.trajectory.limits import JointLimits
from rx90_controller.trajectory.points import TrajectoryPoints

__all__ = ["JointLimits", "Schedule", "TrajectoryGenerator", "TrajectoryPoints", "message", "spline"]
