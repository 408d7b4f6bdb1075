"""Joint trajectories: points, paths through them, limits, the 1 kHz set-point generator, and requests of clients."""

from rx90_controller.trajectory.generator import TrajectoryGenerator
from rx90_controller.trajectory.paths import JointLimits
from rx90_controller.trajectory.points import TrajectoryPoints

__all__ = ["JointLimits", "TrajectoryGenerator", "TrajectoryPoints"]
