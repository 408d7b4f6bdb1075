"""What can be corrected: a joint trajectory, the part of it that counts, and the distance of a tip from its path."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np

from rx90_common.base.arrays import Array, Mask
from rx90_common.base.errors import ConfigError
from rx90_common.description.kinematics import forward, polyline_error
from rx90_controller.trajectory import TrajectoryGenerator, TrajectoryPoints
from rx90_emulator.loop.setup import Setup

_STANDS = 1e-9  # m from one set-point to the next: the tip stands


class CorrectablePath(Protocol):
    """A motion that a correction is learned for; a planned line (LinePlan) is one."""

    @property
    def points(self) -> TrajectoryPoints:
        """Return the trajectory, from its first point on; it begins and ends at rest."""

    @property
    def counted(self) -> tuple[float, float]:
        """Return from when to when the path error counts, s from the trajectory's start."""

    def distance(self, tip: Array) -> Array:
        """Return the distance of the tip's positions, m, shape (n, 3), from the path, m, shape (n,)."""


@dataclass(frozen=True, eq=False)
class Nominal:
    """What a path asks for on set-points 0, 1, ... of its trajectory.

    Attributes:
        setpoints: position rad, velocity rad/s, acceleration rad/s^2, shape (n, 3, joints).
        tip: m, shape (n, 3).
        counts: whether the path error counts, shape (n,).
        period: of the set-points, s.
    """

    setpoints: Array
    tip: Array
    counts: Mask
    period: float

    @classmethod
    def of(cls, setup: Setup, points: TrajectoryPoints, counted: tuple[float, float]) -> Nominal:
        """Return it for the controller of a setup.

        Raises:
            ConfigError: if nothing of the trajectory counts.
            TrajectoryError: if the controller would refuse the trajectory.
        """
        (begin, end), last, period = counted, float(points.times[-1]), setup.rates.position_period
        if not 0.0 <= begin < end <= last + 1e-9:
            raise ConfigError(
                f"the path error counts from {begin:g} to {end:g} s; accepted: a part of the trajectory, from 0 to "
                f"{last:g} s"
            )
        generator = TrajectoryGenerator(setup.controller.limits(setup.robot), period, points.position[0])
        setpoints = generator.setpoints(0, generator.accept(points, 0, None).end)
        times = np.arange(len(setpoints)) * period
        tip = forward(setup.robot.chain, setpoints[:, 0]).position
        return cls(setpoints, tip, (times >= begin) & (times <= end), period)


@dataclass(frozen=True, eq=False)
class TrajectoryPath:
    """Any joint trajectory as a path: the line that the tip describes by its set-points.

    Attributes:
        points: the trajectory.
        counted: from when to when the path error counts, s from its start.
        tip: the tip's positions on the set-points that count and at which it moves, m, shape (n, 3).
    """

    points: TrajectoryPoints
    counted: tuple[float, float]
    tip: Array

    @classmethod
    def of(cls, setup: Setup, points: TrajectoryPoints, counted: tuple[float, float] | None = None) -> TrajectoryPath:
        """Return the path of a trajectory; all of it counts unless `counted` says what.

        Raises:
            ConfigError: if the tip does not move, or nothing of the trajectory counts.
            TrajectoryError: if the controller would refuse the trajectory.
        """
        counted = counted or (0.0, float(points.times[-1]))
        nominal = Nominal.of(setup, points, counted)
        tip = nominal.tip[nominal.counts]
        moves = np.linalg.norm(np.diff(tip, axis=0), axis=1) > _STANDS
        if not moves.any():
            raise ConfigError("the tip does not move along the trajectory; accepted: a path of the tip")
        return cls(points, counted, tip[np.concatenate([[True], moves])])

    def distance(self, tip: Array) -> Array:
        """Return the distance of the tip's positions, m, shape (n, 3), from the path, m, shape (n,).

        Straight lines lengthen the path at its ends: what comes to rest past the end is still on it.
        """
        return polyline_error(tip, self.tip).perpendicular
