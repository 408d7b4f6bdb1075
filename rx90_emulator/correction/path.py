"""Correctable motions: a joint trajectory, its counted part, and the distance of a tip from its path."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import TypeAlias

import numpy as np

from rx90_common.base.arrays import Array, Mask
from rx90_common.base.errors import ConfigError
from rx90_common.description.kinematics import forward, polyline_error
from rx90_controller.lines.plan import LinePlan
from rx90_controller.trajectory import TrajectoryPoints
from rx90_emulator.loop.learned_motion import required_setpoints
from rx90_emulator.loop.setup import Setup

_AT_REST_STEP = 1e-9  # m from one set-point to the next, up to which the tip is at rest


@dataclass(frozen=True, eq=False)
class TrajectoryPath:
    """A joint trajectory in the controller's set-points, and the tip's line along these.

    For a planned path these are set-points 0, 1, ... that it requires.

    Attributes:
        points: the trajectory.
        counted: begin and end of the time in which the path error counts, s from its start.
        setpoints: position rad, velocity rad/s, acceleration rad/s^2, shape (n, 3, joints).
        tip: m, shape (n, 3).
        counts: whether the path error counts, shape (n,).
        period: of the set-points, s.
    """

    points: TrajectoryPoints
    counted: tuple[float, float]
    setpoints: Array
    tip: Array
    counts: Mask
    period: float

    @classmethod
    def of(
        cls, setup: Setup, points: TrajectoryPoints, counted: tuple[float, float] | None = None
    ) -> TrajectoryPath:
        """Return it for the controller of a setup; all of it counts unless `counted` states a part.

        Raises:
            ConfigError: if no part of the trajectory counts, or the tip does not move in the counted part.
            TrajectoryError: if the controller would refuse the trajectory.
        """
        last = float(points.times[-1])
        period = setup.rates.position_period
        begin, end = counted = counted or (0.0, last)
        if not 0.0 <= begin < end <= last + 1e-9:
            raise ConfigError(
                f"the path error counts from {begin:g} to {end:g} s; accepted: a part of the trajectory, from 0 to "
                f"{last:g} s"
            )
        setpoints = required_setpoints(setup, points)
        times = np.arange(len(setpoints)) * period
        tip = forward(setup.robot.chain, setpoints[:, 0]).position
        path = cls(points, counted, setpoints, tip, (times >= begin) & (times <= end), period)
        if len(path._corners) < 2:
            raise ConfigError(
                "the tip does not move along the trajectory; accepted: a path of the tip"
            )
        return path

    @cached_property
    def counted_times(self) -> Array:
        """Return the times of the set-points at which the path error counts, s from the trajectory's start."""
        return np.asarray(np.flatnonzero(self.counts) * self.period, dtype=np.float64)

    @cached_property
    def _moves(self) -> Mask:
        """Return at which of the counted set-points the tip has moved on, the first of them included."""
        steps = np.linalg.norm(np.diff(self.tip[self.counts], axis=0), axis=1)
        return np.append(True, steps > _AT_REST_STEP)

    @cached_property
    def _corners(self) -> Array:
        return self.tip[self.counts][self._moves]

    def distance(self, tip: Array, times: Array | None = None) -> Array:
        """Return the distance of the tip's positions, m, shape (n, 3), from the path, m, shape (n,).

        Straight lines extend the path at its ends: a tip that comes to rest past the end is still on it. With the
        `times` of the positions, s from the trajectory's start, a path that crosses itself or ends where it began is
        searched only around where the tip should be.
        """
        near = None
        if times is not None:
            rows = np.rint(times / self.period).astype(np.int64) - int(np.argmax(self.counts))
            near = (np.cumsum(self._moves) - 1)[np.clip(rows, 0, len(self._moves) - 1)]
        return polyline_error(tip, self._corners, near).perpendicular


CorrectablePath: TypeAlias = LinePlan | TrajectoryPath
"""A motion that a correction is learned for."""
