"""The limits that set-points must keep."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from rx90_common.base.arrays import Array
from rx90_common.base.errors import ConfigError, TrajectoryError


@dataclass(frozen=True)
class JointLimits:
    """Limits of six joints, each of shape (6,): positions in rad, speeds in rad/s.

    Attributes:
        start_tolerance: how far, rad, a trajectory may start from the set-point that is held.
    """

    names: tuple[str, ...]
    lower: Array
    upper: Array
    velocity: Array
    start_tolerance: float

    def __post_init__(self) -> None:
        if np.any(self.lower >= self.upper) or np.any(self.velocity <= 0):
            raise ConfigError(
                f"joint limits {self.lower.tolist()}, {self.upper.tolist()}, {self.velocity.tolist()}; "
                "accepted: lower < upper, velocity > 0"
            )

    def outside(self, position: Array) -> Array:
        """Return how far positions, rad, shape (..., 6), lie beyond the limits; 0 within."""
        return np.asarray(np.maximum(np.maximum(self.lower - position, position - self.upper), 0.0))

    def check(self, setpoints: Array, times: Array, knots: Array, allowed: Array) -> Array:
        """Check every set-point that will be sent, and the steps from one to the next.

        Points closer to each other than two set-points can hide a jump from every sampled velocity.

        Args:
            setpoints: position, velocity, acceleration, shape (m, 3, 6).
            times: their times from the start of the trajectory, s, shape (m,).
            knots: times of the trajectory's points, s, shape (n,), to say which one is meant.
            allowed: how far beyond the limits the first set-point may lie, rad, shape (6,); none may lie further
                beyond than the one before.

        Returns:
            How far beyond the limits the next set-point may lie, rad, shape (6,).

        Raises:
            TrajectoryError: naming joint, point, time, amount and limit of the first one outside.
        """
        position, velocity = setpoints[:, 0], setpoints[:, 1]
        mean = np.diff(position, axis=0) / np.diff(times)[:, None]
        limit = self.velocity
        last = knots.size - 1
        point = np.minimum(np.searchsorted(knots, times), last)
        reach = np.minimum.accumulate(np.vstack([allowed, self.outside(position)]), axis=0)
        self._refuse(position, times, point, "position", "rad", self.lower - reach[:-1], self.upper + reach[:-1])
        # At a knot the velocity is already that of the way to the next point.
        after = np.minimum(np.searchsorted(knots, times, side="right"), last)
        self._refuse(velocity, times, after, "velocity", "rad/s", -limit, limit)
        self._refuse(mean, times[1:], point[1:], "step of", "rad/s", -limit, limit)
        return np.asarray(reach[-1])

    def _refuse(
        self,
        values: Array,
        times: Array,
        points: NDArray[np.intp],
        what: str,
        unit: str,
        low: Array,
        high: Array,
    ) -> None:
        # A spline that should end exactly on a limit may miss it by rounding.
        slack = 1e-9
        bad = (values < low - slack) | (values > high + slack)
        if not bad.any():
            return
        row, joint = np.argwhere(bad)[0]
        low, high = (np.broadcast_to(bound, values.shape)[row] for bound in (low, high))
        raise TrajectoryError(
            f"point {points[row]}: {self.names[joint]} gets a set-point {what} {values[row, joint]:.6g} {unit} "
            f"on the way there, at {times[row]:.3f} s; accepted: [{low[joint]:.6g}, {high[joint]:.6g}]"
        )
