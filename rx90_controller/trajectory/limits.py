"""The limits that set-points must keep."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from rx90_common.base.arrays import Array
from rx90_common.base.errors import ConfigError, TrajectoryError

# A spline that should run exactly at a limit, or end on it, may miss it by rounding.
_SLACK = 1e-9
_POSITION_SLACK = 1e-6  # rad; planners clip to limits that were printed, or were held as angles of their own
# Times in messages are whole nanoseconds, which changes an acceleration over some milliseconds by some millionths.
_ACCELERATION_SLACK = 1e-5  # of the limit


@dataclass(frozen=True)
class JointLimits:
    """Limits of six joints, each of shape (6,): positions in rad, speeds in rad/s, accelerations in rad/s^2.

    Attributes:
        start_tolerance: how far, rad, a trajectory may start from the set-point that is held.
    """

    names: tuple[str, ...]
    lower: Array
    upper: Array
    velocity: Array
    acceleration: Array
    start_tolerance: float

    def __post_init__(self) -> None:
        if np.any(self.lower >= self.upper) or np.any(self.velocity <= 0) or np.any(self.acceleration <= 0):
            raise ConfigError(
                f"joint limits {self.lower.tolist()}, {self.upper.tolist()}, {self.velocity.tolist()}, "
                f"{self.acceleration.tolist()}; accepted: lower < upper, velocity > 0, acceleration > 0"
            )

    def outside(self, position: Array) -> Array:
        """Return how far positions, rad, shape (..., 6), lie beyond the limits; 0 within."""
        return np.asarray(np.maximum(np.maximum(self.lower - position, position - self.upper), 0.0))

    def contain(self, low: Array, high: Array) -> bool:
        """Return whether all between two bounds of position, velocity and acceleration, shape (3, 6), is within."""
        quantities = self._quantities(self.lower, self.upper)
        pairs = np.stack([low, high], axis=1)
        return all(each.first_outside(pair) is None for each, pair in zip(quantities, pairs, strict=True))

    def check_points(self, tables: tuple[Array, Array | None, Array | None], allowed: Array, number: int = 0) -> None:
        """Check the points themselves: a spline through points within the limits has finite coefficients.

        Args:
            tables: positions, velocities and accelerations of n points, each of shape (n, 6) or None.
            allowed: how far beyond the position limits a point may lie, rad, shape (6,).
            number: of the first point, for refusals.

        Raises:
            TrajectoryError: naming point, joint, value and limit of the first one outside.
        """
        for quantity, table in zip(self._quantities(self.lower - allowed, self.upper + allowed), tables, strict=True):
            found = None if table is None else quantity.first_outside(table)
            if table is not None and found is not None:
                row, joint = found
                raise TrajectoryError(
                    f"point {number + row}: {self.names[joint]} has the {quantity.what} {table[row, joint]:.6g} "
                    f"{quantity.unit}; accepted: {quantity.accepted(row, joint)}"
                )

    def check_start(self, held: Array, first: Array, period: float, number: int = 0) -> None:
        """Check that the velocity of the first set-point, shape (3, 6), follows on the one that is `held` there.

        `number` is that of the first point.

        Raises:
            TrajectoryError: naming the joint whose velocity would jump, both velocities and what is accepted.
        """
        allowed = self.acceleration * period
        found = _first(first[None, 1], held[1] - allowed - _SLACK, held[1] + allowed + _SLACK)
        if found is not None:
            joint = found[1]
            raise TrajectoryError(
                f"point {number}: {self.names[joint]} starts at {first[1, joint]:.6g} rad/s, the set-point there moves "
                f"at {held[1, joint]:.6g} rad/s; accepted: within {allowed[joint]:.6g} rad/s, or a first point later "
                "than the start"
            )

    def check(self, setpoints: Array, times: Array, knots: Array, allowed: Array, number: int = 0) -> Array:
        """Check every set-point that will be sent, and the steps from one to the next.

        Points closer to each other than two set-points can hide a jump from every sampled derivative. What passes
        ends within the position limits, and
        therefore could, wherever it is, be braked to rest before it reaches them.

        Args:
            setpoints: position, velocity, acceleration, shape (m, 3, 6).
            times: their times from the start of the trajectory, s, shape (m,).
            knots: times of the trajectory's points, s, shape (n,), to say which one is meant.
            allowed: how far beyond the limits the first set-point may lie, rad, shape (6,); none may lie further
                beyond than the one before.
            number: of the first point, for refusals.

        Returns:
            How far beyond the limits the next set-point may lie, rad, shape (6,).

        Raises:
            TrajectoryError: naming joint, point, time, amount and limit of the first one outside.
        """
        q, v, a = setpoints[:, 0], setpoints[:, 1], setpoints[:, 2]
        step = np.diff(times)[:, None]
        last = knots.size - 1
        point = number + np.minimum(np.searchsorted(knots, times), last)
        # At a knot the derivatives are already those of the way to the next point.
        after = number + np.minimum(np.searchsorted(knots, times, side="right"), last)
        reach = np.minimum.accumulate(np.vstack([allowed, self.outside(q)]), axis=0)
        position, velocity, acceleration = self._quantities(self.lower - reach[:-1], self.upper + reach[:-1])
        self._refuse(position, q, times, point)
        self._refuse(velocity, v, times, after)
        self._refuse(acceleration, a, times, after)
        self._refuse(
            acceleration._replace(what="step of the velocity of"), np.diff(v, axis=0) / step, times[1:], point[1:]
        )
        # With accelerations up to a, the way between velocities v0 and v1 is (v0 + v1) T/2, within a (T/2)^2.
        most = self.acceleration * (step / 2.0) ** 2
        jump = _Quantity("jump of", "rad", -most, most)
        self._refuse(jump, np.diff(q, axis=0) - step * (v[1:] + v[:-1]) / 2.0, times[1:], point[1:])
        return np.asarray(reach[-1])

    def _quantities(self, lower: Array, upper: Array) -> tuple[_Quantity, _Quantity, _Quantity]:
        """Return position, velocity and acceleration with their limits; those of the position are given."""
        v, a = self.velocity, self.acceleration
        return (
            _Quantity("position", "rad", lower, upper, _POSITION_SLACK),
            _Quantity("velocity", "rad/s", -v, v),
            _Quantity("acceleration", "rad/s^2", -a, a, _ACCELERATION_SLACK * a),
        )

    def _refuse(self, quantity: _Quantity, values: Array, times: Array, points: NDArray[np.intp]) -> None:
        found = quantity.first_outside(values)
        if found is None:
            return
        row, joint = found
        raise TrajectoryError(
            f"point {points[row]}: {self.names[joint]} gets a set-point {quantity.what} {values[row, joint]:.6g} "
            f"{quantity.unit} on the way there, at {times[row]:.3f} s; accepted: {quantity.accepted(row, joint)}"
        )


class _Quantity(NamedTuple):
    """A quantity with its limits, of shape (6,) or with a row for each value."""

    what: str
    unit: str
    low: Array
    high: Array
    slack: Array | float = _SLACK

    def first_outside(self, values: Array) -> tuple[int, int] | None:
        """Return row and joint of the first value, of shape (m, 6), that is not within the limits."""
        return _first(values, self.low - self.slack, self.high + self.slack)

    def accepted(self, row: int, joint: int) -> str:
        """Return the limits of a joint in a row."""
        low, high = (bound if bound.ndim == 1 else bound[row] for bound in (self.low, self.high))
        return f"[{low[joint]:.6g}, {high[joint]:.6g}]"


def _first(values: Array, low: Array, high: Array) -> tuple[int, int] | None:
    # So that what is not a number is outside, too.
    within = (values >= low) & (values <= high)
    if within.all():
        return None
    row, joint = np.argwhere(~within)[0]
    return int(row), int(joint)
