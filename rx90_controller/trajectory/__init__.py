"""Joint trajectories: splines through the given points, checks, and the 1 kHz set-point generator."""

from rx90_controller.trajectory.generator import PastError, Plan, Schedule, TrajectoryGenerator, points_left
from rx90_controller.trajectory.limits import JointLimits
from rx90_controller.trajectory.motions import Progress
from rx90_controller.trajectory.points import TrajectoryPoints

__all__ = [
    "JointLimits",
    "PastError",
    "Plan",
    "Progress",
    "Schedule",
    "TrajectoryGenerator",
    "TrajectoryPoints",
    "message",
    "points_left",
    "spline",
]
