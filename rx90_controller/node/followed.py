"""Whether a trajectory that was sent has come to its end, from what the controller and the arm publish."""

from __future__ import annotations

import math

import numpy as np

from rx90_common.base.arrays import Array
from rx90_common.base.errors import ExchangeError
from rx90_common.exchange.client_node import POLL
from rx90_controller.trajectory import TrajectoryPoints

PATIENCE = 5.0
"""How long an arm may take to its place after a trajectory has ended, s of the wall clock."""


class FollowedTrajectory:
    """Determines from samples of the arm whether a trajectory that was sent to start now has ended.

    Args:
        points: of the trajectory.
        tolerance: how far from the last point an arm may be that has arrived, rad.
        timeout: longest that time may stand still, s of the wall clock.

    Attributes:
        elapsed: part of its duration that has passed, s.
        end: when it is due to end, s; infinite before the first sample.
        done: whether it has ended, and the arm is there.
    """

    def __init__(self, points: TrajectoryPoints, tolerance: float, timeout: float) -> None:
        self._target = points.position[-1]
        self._duration = float(points.times[-1])
        self._tolerance = tolerance
        self._timeout = timeout
        self._newest = (-math.inf, 0.0)  # time, and when it came by the wall clock
        self._due = math.inf  # of the wall clock, s
        self.elapsed = 0.0
        self.end = math.inf
        self.done = False

    def began(self, time: float) -> None:
        """Take the start that the controller announces, s; without one it is the time of the first sample."""
        self.end = time + self._duration

    def see(self, now: float, position: Array, clock: float) -> None:
        """Evaluate the newest sample of the arm.

        Args:
            now: its time, s.
            position: rad, shape (n,).
            clock: wall clock, s.

        Raises:
            ExchangeError: if time stands still, or the arm does not arrive.
        """
        if self.end == math.inf:
            self.began(now)
        if now > self._newest[0]:
            self._newest = (now, clock)
        elif clock - self._newest[1] > self._timeout:
            raise ExchangeError(
                f"the arm's time stood still at {now:.3f} s for {self._timeout:g} s"
            )
        self.elapsed = min(max(0.0, now - self.end + self._duration), self._duration)
        if now <= self.end + POLL:
            self._due = clock + PATIENCE
            return
        gap = float(np.abs(position - self._target).max())
        self.done = gap <= self._tolerance
        if not self.done and clock > self._due:
            raise ExchangeError(
                f"a joint is {gap:.4f} rad from the trajectory's end, {PATIENCE:g} s after it; accepted: within "
                f"{self._tolerance:g} rad; the controller says why on its terminal"
            )
