"""Determines when a trajectory that was sent has ended, from what a controller and its arm tell."""

from __future__ import annotations

import math

import numpy as np
from trajectory_msgs.msg import JointTrajectory

from rx90_common.base.arrays import Array
from rx90_common.base.rates import NANOSECONDS, message_time_ns
from rx90_controller.trajectory import TrajectoryPoints

_DROPPED = "trajectory aborted", "trajectory dropped", "stopped at", "is dropped", "stream begins"
"""What the lines of a controller contain that say that a trajectory does not come to its end."""
_REFUSED = "trajectory rejected"
_OVER = "trajectory ended at"
_PATIENCE = 5.0  # s of the wall clock, that an arm may rest away from its place after a trajectory was due to end
# the same where the controller has accepted it: speed scaling stretches its rests
_SLOWED_PATIENCE = 60.0
_RESTS = 1e-3  # rad: an arm whose joints all stay within it rests
_MARGIN = 0.1  # s, beyond the time at which it is due


class SentTrajectory:
    """A trajectory from its sending to its end.

    Args:
        message: as it was sent, to start at once.
        points: of it.
        tolerance: how far from its last point the arm, or its set-points, may be when it has ended, rad.

    Attributes:
        begin: when it begins as the controller says, else when the arm was seen first, s.
        end: when it has ended, s; infinite before.
        fault: why it will not come to its end; empty if it may.
    """

    def __init__(
        self, message: JointTrajectory, points: TrajectoryPoints, tolerance: float
    ) -> None:
        self.begin = math.nan
        self.end = math.inf
        self.fault = ""
        self.duration = float(points.times[-1])
        self._message = message
        self._goal = points.position[-1]
        self._tolerance = tolerance
        self._is_accepted = False
        self._is_over = False  # as the controller says: its set-points are at the end
        # An arm that comes back to where it began must have been away.
        self._away = 0.5 * float(np.abs(points.position - self._goal).max())
        self._has_been_away = self._away <= tolerance
        self._is_late = False
        self._place = np.full_like(self._goal, np.inf)
        self._moved = 0.0

    def take_acceptance(self, accepted: JointTrajectory) -> None:
        """Take what the controller says that it follows: this trajectory, or another one instead."""
        if self._is_accepted:
            other = "another trajectory" if accepted.points else "a stop"
            self.fault = f"{other} has replaced the one that was sent"
        elif (accepted.joint_names, accepted.points) == (
            self._message.joint_names,
            self._message.points,
        ):
            self._is_accepted = True
            self.fault = ""  # what was said before concerned others
            self.begin = message_time_ns(accepted.header.stamp) / NANOSECONDS

    def take_line(self, line: str) -> None:
        """Take a line of the controller's log; refusals are others' once this trajectory was accepted."""
        if any(word in line for word in _DROPPED) or (_REFUSED in line and not self._is_accepted):
            self.fault = line
        self._is_over |= _OVER in line and self._is_accepted

    def see(self, now: float, position: Array, clock: float) -> None:
        """Take the newest sample.

        Args:
            now: its time, s.
            position: of the arm, or of its set-points, rad, shape (n,).
            clock: wall clock, s.
        """
        if math.isnan(self.begin):
            self.begin = now
        gap = float(np.abs(position - self._goal).max())
        self._has_been_away |= gap > self._away or self._is_over
        is_due = now > self.begin + self.duration + _MARGIN
        if is_due and self._has_been_away and gap <= self._tolerance:
            self.end = now if self._is_late else self.begin + self.duration
        self._is_late = is_due
        if not is_due or np.abs(position - self._place).max() > _RESTS:
            self._place = position
            self._moved = clock
        may_go_on = self._is_accepted and not self._is_over
        patience = _SLOWED_PATIENCE if may_go_on else _PATIENCE
        if clock > self._moved + patience:
            where = (
                f"rests {gap:.4f} rad from the trajectory's end (accepted: {self._tolerance:g})"
                if self._has_been_away
                else f"rests within {self._away:.4f} rad of where it began, and has not been farther"
            )
            self.fault = f"the arm {where}, {patience:g} s after it was due or came to rest"
