"""Corrections: offsets of the position set-points in addition to the trajectory, from its first set-point on.

A correction is no trajectory. It is added to the position error alone: neither velocity and acceleration feed-forward
nor the friction compensation contain it, because there the changes of sign of a small offset would switch the Coulomb
torque. It is played once, tick by tick, faded in at the trajectory's beginning and out after its end. Any other
request meanwhile, a stop, another trajectory, another speed, makes it fade out from there.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from rx90_common.base.arrays import Array
from rx90_common.base.errors import TrajectoryError

FADE = 0.1
"""How long a correction takes to come, and to go, s: seven times the lag of the position loop (1/kp, 14 ms), and so
long that even the largest one changes more slowly than FASTEST."""
LARGEST = 0.01
"""The largest offset, rad: beyond the sag of elastic gears, far below the supervised following error."""
FASTEST = 0.5
"""The fastest change of an offset, rad/s: more than ten times that of the corrections of the shipped tasks, a tenth of
the joints' speed."""


@dataclass(frozen=True)
class LearnedMotion:
    """The motion that a correction was learned on.

    Attributes:
        robot: the robot's name in its URDF.
        identity: digest of the trajectory's points.
        speed: largest speed of the tip, m/s.
        duration: from first to last point, s.
        start: where it begins, rad, of each joint.
    """

    robot: str
    identity: str
    speed: float
    duration: float
    start: tuple[float, ...]

    @property
    def path(self) -> str:
        """Return the path in words."""
        start = ", ".join(f"{angle:.4g}" for angle in self.start)
        speed = f"{1e3 * self.speed:.4g} mm/s"
        return (
            f"a path of {self.duration:.6g} s at {speed} from {start} rad (digest {self.identity})"
        )


@dataclass(frozen=True, eq=False)
class Correction:
    """Offsets of the position set-points along a trajectory.

    Attributes:
        offsets: of the joints on set-points 0, 1, ... of the trajectory, rad, shape (n, j).
        period: of the set-points, s.
        learned_on: the motion that it was learned on, and on no other is played; None for any.

    Raises:
        TrajectoryError: for another shape, values that are no numbers, and offsets beyond LARGEST or faster than
            FASTEST.
    """

    offsets: Array
    period: float
    learned_on: LearnedMotion | None = None

    def __post_init__(self) -> None:
        offsets = self.offsets
        if offsets.ndim != 2 or not offsets.size:
            raise TrajectoryError(
                f"a correction of shape {offsets.shape}; accepted: an offset for each joint and set-point"
            )
        rates = np.diff(offsets, axis=0, prepend=offsets[:1]) / self.period
        for what, values, most, unit in (
            ("offset", offsets, LARGEST, "rad"),
            ("change", rates, FASTEST, "rad/s"),
        ):
            beyond = np.argwhere(~(np.abs(values) <= most))
            if len(beyond):
                row, joint = beyond[0].tolist()
                raise TrajectoryError(
                    f"the correction has the {what} {values[row, joint]:.4g} {unit} in joint {joint + 1} at "
                    f"{row * self.period:.3f} s; accepted: up to {most:g} {unit}"
                )

    def later(self, time: float) -> Correction:
        """Return it for its trajectory behind a move that takes `time`, s, a whole number of set-points."""
        rest = np.zeros((round(time / self.period), self.offsets.shape[1]))
        return replace(self, offsets=np.concatenate([rest, self.offsets]), learned_on=None)


@dataclass(frozen=True, eq=False)
class PlayedCorrection:
    """A correction that starts at a position tick.

    Attributes:
        correction: the correction.
        begin: its first tick.
        cut: the tick at which its fade-out starts.
    """

    correction: Correction
    begin: int
    cut: int

    @classmethod
    def started(cls, correction: Correction, begin: int) -> PlayedCorrection:
        """Return a correction that begins at a tick and fades out behind its end."""
        return cls(correction, begin, begin + len(correction.offsets))

    @property
    def fade(self) -> int:
        """Return how many ticks it takes to come or go."""
        return max(1, math.ceil(FADE / self.correction.period - 1e-6))

    @property
    def over(self) -> int:
        """Return the tick from which on it gives nothing."""
        return self.cut + self.fade

    def shifted(self, count: int) -> PlayedCorrection:
        """Return it so many ticks later."""
        return replace(self, begin=self.begin + count, cut=self.cut + count)

    def at(self, ticks: NDArray[np.int64]) -> Array:
        """Return the offsets at ticks, shape (n, j), rad; 0 before and after.

        Each row takes the same operations, whatever the other ticks: nodes and loop have the same bits.
        """
        row = np.clip(
            np.minimum(ticks, self.cut - 1) - self.begin, 0, len(self.correction.offsets) - 1
        )
        weight = _eased((row + 1.0) / self.fade) * _eased((self.over - ticks) / self.fade)
        weight = np.where(ticks < self.begin, 0.0, weight)
        return np.asarray(self.correction.offsets[row] * weight[:, None])


def _eased(share: Array) -> Array:
    """Return shares that leave 0, and come to 1, without a slope."""
    share = np.clip(share, 0.0, 1.0)
    return share * share * (3.0 - 2.0 * share)


def cut_at(played: list[PlayedCorrection], now: int, begin: int) -> list[PlayedCorrection]:
    """Return the remaining corrections if another motion takes over at tick `begin`, known at tick `now`.

    One that had not begun by then is dropped; one that fades out already continues to do so.
    """
    return [
        replace(
            one,
            cut=one.cut if one.cut <= now else min(one.begin + len(one.correction.offsets), begin),
        )
        for one in played
        if one.begin < now < one.over
    ]
