"""The points of a trajectory as they came, checked and sorted into the robot's joint order."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from rx90_common.base.arrays import Array, Mask
from rx90_common.base.errors import TrajectoryError
from rx90_common.base.quoting import quoted
from rx90_controller.trajectory.spline import Bounds, interpolate

LONGEST = 3600.0
"""The longest trajectory, s: each of its set-points is checked before it may start."""
_SHORTEST_STEP = 0.5e-9  # s; messages have whole nanoseconds
# What joint_trajectory_controller takes for rest: time-optimal plans end at 1e-17 to 1e-15 rad/s.
_REST = float(np.finfo(np.float32).eps)  # rad/s
# A last point that says the one before again. MoveIt's time-optimal plans are sampled each 0.1 s and at their end, with
# the velocities at the end of a step of 1 ms: where the end comes less than that later, both points are at rest, apart
# by what was braked.
_SAME_TIME, _SAME_POSITION, _SAME_VELOCITY = 0.999e-3, 1e-4, 1e-9  # s, rad, rad/s


class Way(NamedTuple):
    """The spline between points: coefficients of its pieces, shape (n - 1, 6, 6), and bounds of them."""

    coefficients: Array
    bounds: Bounds


@dataclass(frozen=True)
class TrajectoryPoints:
    """Points of a JointTrajectory in the robot's joint order.

    Attributes:
        times: time from start, s, shape (n,), increasing, first >= 0.
        position: rad, shape (n, 6).
        velocity: rad/s, shape (n, 6), or None if no point carries velocities.
        acceleration: rad/s^2, shape (n, 6), or None if no point carries accelerations.
        named: which joints the points are of, shape (6,); the values of the others are 0 and mean nothing.
        first: number of the first point in the trajectory that was sent.
        way: between the points, if `prepared` has computed it.
        smooth: whether only the velocities at both ends count, see `smoothed`.
        degrees: of the way to each point, shape (n,): 1, a straight line, where one of its two ends has no velocities,
            3, or 5 where both have accelerations, too; None where all are alike. Values that are not given are 0.
    """

    times: Array
    position: Array
    velocity: Array | None
    acceleration: Array | None
    named: Mask = field(default_factory=lambda: np.ones(6, dtype=np.bool_))
    first: int = 0
    way: Way | None = None
    smooth: bool = False
    degrees: NDArray[np.intp] | None = None

    @classmethod
    def create(
        cls,
        robot_joints: Sequence[str],
        joint_names: Sequence[str],
        times: Sequence[float],
        position: Sequence[Sequence[float]],
        velocity: Sequence[Sequence[float]],
        acceleration: Sequence[Sequence[float]],
        *,
        partial: bool = False,
        moving_end: bool = False,
    ) -> TrajectoryPoints:
        """Check raw points, joints in any order; an empty vector, or none at all, means "not given".

        Velocities within float's epsilon of 0 at the last point are 0, and a last point that says the one before again,
        less than a millisecond later, takes its place.

        Args:
            robot_joints: names of the six joints.
            joint_names: in the order of the vectors.
            times: from the start, s.
            position: rad, of each point.
            velocity: rad/s, likewise.
            acceleration: rad/s^2, likewise.
            partial: whether some of the joints may be missing.
            moving_end: whether the last point may have a velocity.

        Raises:
            TrajectoryError: naming joint, index of the point and reason.
        """
        robot_joints, joint_names, times = list(robot_joints), list(joint_names), list(times)
        check_joints(robot_joints, joint_names, partial=partial)
        if _says_again(times, position, velocity):
            times, position, velocity, acceleration = (
                [*rows[:-2], *rows[-1:]] for rows in (times, position, velocity, acceleration)
            )
        _check_times(times)
        columns = [robot_joints.index(name) for name in joint_names]
        tables = {
            what: _table(what, values, len(times), columns, joint_names)
            for what, values in (
                ("positions", position),
                ("velocities", velocity),
                ("accelerations", acceleration),
            )
        }
        if tables["positions"] is None:
            raise TrajectoryError("point 0: no positions; accepted: positions of all named joints in every point")
        degrees = _degrees(*(rows if len(rows) else [[]] * len(times) for rows in (velocity, acceleration)))
        _rest_at_end(tables["velocities"], robot_joints, moving_end=moving_end)
        named = np.isin(np.arange(6), columns)
        return cls(
            np.array(times, dtype=np.float64),
            tables["positions"],
            tables["velocities"],
            tables["accelerations"],
            named,
            degrees=degrees,
        )

    def prepared(self) -> TrajectoryPoints:
        """Return them with the way between them computed, so that to take them needs less time."""
        if self.velocity is None or self.degrees is not None or len(self.times) < 2 or self.smooth:
            return self
        # What overflows is beyond the limits, and refused by them.
        with np.errstate(over="ignore", invalid="ignore"):
            coefficients = interpolate(self.times, self.position, self.velocity, self.acceleration).coefficients
        return replace(self, way=Way(coefficients, Bounds.of(coefficients, np.diff(self.times))))

    def smoothed(self) -> TrajectoryPoints:
        """Return them for the smooth spline through their positions, with their velocities at both ends.

        Points without velocities stay as they are: what they ask for is straight lines.
        """
        if self.velocity is None:
            return self
        velocity = np.zeros_like(self.velocity)
        # A first point that is later than the start is passed like any other.
        ends = [0, -1] if self.times[0] == 0.0 else [-1]
        velocity[ends] = self.velocity[ends]
        return replace(self, velocity=velocity, acceleration=None, way=None, smooth=True, degrees=None)

    def after(self, time: float) -> TrajectoryPoints:
        """Return the points later than a time, s, with times from there on."""
        kept = self.times > time + _SHORTEST_STEP
        velocity, acceleration = (None if t is None else t[kept] for t in (self.velocity, self.acceleration))
        dropped = int(np.count_nonzero(~kept))
        return replace(
            self,
            times=self.times[kept] - time,
            position=self.position[kept],
            velocity=velocity,
            acceleration=acceleration,
            first=self.first + dropped,
            way=None if self.way is None else self.way._replace(coefficients=self.way.coefficients[dropped:]),
            degrees=None if self.degrees is None else self.degrees[kept],
        )

    def held_at(self, position: Array) -> TrajectoryPoints:
        """Return points whose joints that are not named hold a position, rad, shape (6,)."""
        if self.named.all():
            return self
        return replace(self, position=np.where(self.named, self.position, position), way=None)


def check_joints(robot_joints: Sequence[str], joint_names: Sequence[str], *, partial: bool = False) -> None:
    """Check that names are those of the robot's joints, each once, in any order; all of them unless `partial`.

    Raises:
        TrajectoryError: for a name that is unknown, stands twice or is missing.
    """
    for name in joint_names:
        if name not in robot_joints:
            raise TrajectoryError(f"unknown joint {quoted(name)}; accepted: {', '.join(robot_joints)}")
        if joint_names.count(name) > 1:
            raise TrajectoryError(f"joint {quoted(name)} stands {joint_names.count(name)} times; accepted: once")
    for name in robot_joints:
        if name not in joint_names and not partial:
            raise TrajectoryError(f"joint {quoted(name)} is missing; accepted: all of {', '.join(robot_joints)}")
    if not joint_names:
        raise TrajectoryError(f"no joints; accepted: {', '.join(robot_joints)}")


def _check_times(times: Sequence[float]) -> None:
    if not times:
        raise TrajectoryError("no points; accepted: at least one")
    for i, time in enumerate(times):
        if not time <= LONGEST:
            raise TrajectoryError(f"point {i}: time_from_start {time:g} s; accepted: a number up to {LONGEST:g} s")
    if times[0] < 0:
        raise TrajectoryError(f"point 0: time_from_start {times[0]:g} s; accepted: >= 0")
    if 0.0 < times[0] < _SHORTEST_STEP:
        raise TrajectoryError(f"point 0: time_from_start {times[0]:g} s; accepted: 0, or a nanosecond and more")
    for i in range(1, len(times)):
        if not times[i] - times[i - 1] > _SHORTEST_STEP:
            raise TrajectoryError(
                f"point {i}: time_from_start {times[i]:g} s after {times[i - 1]:g} s; accepted: increasing times, a "
                "nanosecond or more apart"
            )


def _table(
    what: str, rows: Sequence[Sequence[float]], points: int, columns: list[int], names: list[str]
) -> Array | None:
    """Return the vectors of all points with their values in the columns of their joints, shape (n, 6)."""
    if len(rows) not in (0, points):
        raise TrajectoryError(f"{what} of {len(rows)} points; accepted: of {points}, as many as there are times")
    if not any(len(row) for row in rows):
        return None
    for i, row in enumerate(rows):
        if len(row) != len(columns) and (len(row) or what == "positions"):
            raise TrajectoryError(
                f"point {i}: {len(row)} {what}; accepted: {len(columns)}{'' if what == 'positions' else ', or none'}"
            )
    values = np.array([row if len(row) else [0.0] * len(columns) for row in rows], dtype=np.float64)
    if not np.isfinite(values).all():
        i, k = np.argwhere(~np.isfinite(values))[0]
        raise TrajectoryError(f"point {i}: {what} of {names[k]} is {values[i, k]}; accepted: a finite number")
    table = np.zeros((points, 6))
    table[:, columns] = values
    return table


def _degrees(velocity: Sequence[Sequence[float]], acceleration: Sequence[Sequence[float]]) -> NDArray[np.intp] | None:
    """Return the degrees of the ways to n points by what these carry, shape (n,); None if all points are alike."""
    moves, bends = ([len(row) > 0 for row in rows] for rows in (velocity, acceleration))
    for i, (move, bend) in enumerate(zip(moves, bends, strict=True)):
        if bend and not move:
            raise TrajectoryError(f"point {i}: accelerations without velocities; accepted: velocities too")
    if len({*moves}) == len({*bends}) == 1:
        return None
    given = np.array([moves, bends])
    # The way to the first point comes from the set-point, which has all.
    curved, quintic = given & np.concatenate([given[:, :1], given[:, :-1]], axis=1)
    return np.asarray(1 + 2 * curved.astype(np.intp) + 2 * quintic)


def _says_again(
    times: Sequence[float], position: Sequence[Sequence[float]], velocity: Sequence[Sequence[float]]
) -> bool:
    """Return whether the last point says the one before again."""
    if len(times) < 2 or not -_SHORTEST_STEP <= times[-1] - times[-2] <= _SAME_TIME:
        return False
    return all(
        len(rows) == 0 or (len(rows[-1]) == len(rows[-2]) and np.allclose(rows[-1], rows[-2], rtol=0.0, atol=most))
        for rows, most in ((position, _SAME_POSITION), (velocity, _SAME_VELOCITY))
    )


def _rest_at_end(velocity: Array | None, names: list[str], *, moving_end: bool) -> None:
    """Check that the last of the velocities, shape (n, 6), are 0, and make them so where they only are by rounding."""
    if velocity is None:
        return
    velocity[-1, np.abs(velocity[-1]) <= _REST] = 0.0
    joint = int(np.argmax(np.abs(velocity[-1])))
    if velocity[-1, joint] != 0.0 and not moving_end:
        raise TrajectoryError(
            f"point {len(velocity) - 1}: {names[joint]} ends at {velocity[-1, joint]:g} rad/s; accepted: 0 within "
            f"{_REST:.3g} rad/s, the arm rests at the last point"
        )
