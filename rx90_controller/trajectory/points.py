"""The points of a trajectory, checked and in the robot's joint order, and the messages that carry them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from rx90_common.base.arrays import Array, Index, Mask, array_digest
from rx90_common.base.errors import TrajectoryError
from rx90_common.base.quoting import counted, quoted
from rx90_common.base.rates import NANOSECONDS, message_time_ns
from rx90_controller.trajectory.correction import Correction

LONGEST = 3600.0
"""The longest trajectory, s: each of its set-points is checked before it may start."""
_SHORTEST_STEP = 0.5e-9  # s; messages have whole nanoseconds
# What joint_trajectory_controller takes for rest: time-optimal plans end at 1e-17 to 1e-15 rad/s.
_REST_VELOCITY = float(np.finfo(np.float32).eps)  # rad/s
# A last point that repeats the one before. MoveIt's time-optimal plans are sampled each 0.1 s and at their end, with
# the velocities at the end of a step of 1 ms: where the end comes less than that later, both points are at rest, apart
# by what was braked.
# s, rad, rad/s
_REPEATED_TIME = 0.999e-3
_REPEATED_POSITION = 1e-4
_REPEATED_VELOCITY = 1e-9


@dataclass(frozen=True)
class TrajectoryPoints:
    """Points of a JointTrajectory in the robot's joint order.

    Attributes:
        times: time from start, s, shape (n,), increasing, first >= 0.
        position: rad, shape (n, j).
        velocity: rad/s, shape (n, j), or None if no point carries velocities.
        acceleration: rad/s^2, shape (n, j), or None if no point carries accelerations.
        named: the joints that the points are for, shape (j,), all by default; the values of the others are 0 and
            without meaning.
        first: number of the first point in the received trajectory.
        smooth: whether only the velocities at both ends count, see `smoothed`.
        degrees: of the way to each point, shape (n,): 1, a straight line, where one of its two ends has no velocities,
            3, or 5 where both have accelerations, too; None where all are alike. Values that are not given are 0.
    """

    times: Array
    position: Array
    velocity: Array | None
    acceleration: Array | None
    named: Mask = field(default_factory=lambda: np.ones(0, dtype=np.bool_))
    first: int = 0
    smooth: bool = False
    degrees: Index | None = None

    def __post_init__(self) -> None:
        if not self.named.size:
            object.__setattr__(self, "named", np.ones(self.position.shape[1], dtype=np.bool_))

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

        Velocities within float's epsilon of 0 at the last point are 0, and a last point that repeats the one before,
        less than a millisecond later, takes its place.

        Args:
            robot_joints: names of the joints.
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
        names = list(joint_names)
        check_joints(robot_joints, names, partial=partial)
        if _last_is_repeated(times, position, velocity):
            times = [*times[:-2], *times[-1:]]
            position = [*position[:-2], *position[-1:]]
            velocity = [*velocity[:-2], *velocity[-1:]]
            acceleration = [*acceleration[:-2], *acceleration[-1:]]
        _check_times(times)
        columns = [list(robot_joints).index(name) for name in names]
        given = (("positions", position), ("velocities", velocity), ("accelerations", acceleration))
        for what, rows in given:
            if len(rows) not in (0, len(times)):
                accepted = f"of {len(times)}, as many as there are times"
                raise TrajectoryError(
                    f"{what} of {counted(len(rows), 'point')}; accepted: {accepted}"
                )
        q, v, a = (
            joint_table(what, rows, columns, robot_joints, whole=what == "positions")
            for what, rows in given
        )
        if q is None:
            raise TrajectoryError(
                "point 0: no positions; accepted: positions of all named joints in every point"
            )
        degrees = _degrees(
            *(rows if len(rows) else [[]] * len(times) for rows in (velocity, acceleration))
        )
        if v is not None:
            v[-1, np.abs(v[-1]) <= _REST_VELOCITY] = 0.0
            fastest = int(np.argmax(np.abs(v[-1])))
            if v[-1, fastest] != 0.0 and not moving_end:
                raise TrajectoryError(
                    f"point {len(v) - 1}: {robot_joints[fastest]} ends at {v[-1, fastest]:g} rad/s; accepted: 0 within "
                    f"{_REST_VELOCITY:.3g} rad/s, the arm rests at the last point"
                )
        return cls(
            np.array(times, dtype=np.float64),
            q,
            v,
            a,
            np.isin(np.arange(len(robot_joints)), columns),
            degrees=degrees,
        )

    def smoothed(self) -> TrajectoryPoints:
        """Return them for the smooth spline through their positions, with their velocities at both ends.

        Points without velocities stay as they are: they mean straight lines.
        """
        if self.velocity is None:
            return self
        velocity = np.zeros_like(self.velocity)
        # A first point that is later than the start is passed like any other.
        ends = [0, -1] if self.times[0] == 0.0 else [-1]
        velocity[ends] = self.velocity[ends]
        return replace(self, velocity=velocity, acceleration=None, smooth=True, degrees=None)

    def after(self, time: float) -> TrajectoryPoints:
        """Return the points later than a time, s, with times from there on."""
        later = self.times > time + _SHORTEST_STEP
        velocity = None if self.velocity is None else self.velocity[later]
        acceleration = None if self.acceleration is None else self.acceleration[later]
        return replace(
            self,
            times=self.times[later] - time,
            position=self.position[later],
            velocity=velocity,
            acceleration=acceleration,
            first=self.first + int(np.count_nonzero(~later)),
            degrees=None if self.degrees is None else self.degrees[later],
        )

    def held_at(self, position: Array) -> TrajectoryPoints:
        """Return points whose joints that are not named hold a position, rad, shape (j,)."""
        if self.named.all():
            return self
        return replace(self, position=np.where(self.named, self.position, position))


def check_joints(
    robot_joints: Sequence[str], joint_names: Sequence[str], *, partial: bool = False
) -> None:
    """Check that names are those of the robot's joints, each once, in any order; all of them unless `partial`.

    Raises:
        TrajectoryError: for a name that is unknown, stands twice or is missing.
    """
    for name in joint_names:
        if name not in robot_joints:
            raise TrajectoryError(
                f"unknown joint {quoted(name)}; accepted: {', '.join(robot_joints)}"
            )
        if joint_names.count(name) > 1:
            raise TrajectoryError(
                f"joint {quoted(name)} stands {joint_names.count(name)} times; accepted: once"
            )
    for name in robot_joints:
        if name not in joint_names and not partial:
            raise TrajectoryError(
                f"joint {quoted(name)} is missing; accepted: all of {', '.join(robot_joints)}"
            )
    if not joint_names:
        raise TrajectoryError(f"no joints; accepted: {', '.join(robot_joints)}")


def _check_times(times: Sequence[float]) -> None:
    if not len(times):
        raise TrajectoryError("no points; accepted: at least one")
    for i, time in enumerate(times):
        if not time <= LONGEST:
            raise TrajectoryError(
                f"point {i}: time_from_start {time:g} s; accepted: a number up to {LONGEST:g} s"
            )
        if i > 0 and not time - times[i - 1] > _SHORTEST_STEP:
            raise TrajectoryError(
                f"point {i}: time_from_start {time:g} s after {times[i - 1]:g} s; accepted: increasing times, a "
                "nanosecond or more apart"
            )
    if times[0] < 0 or 0.0 < times[0] < _SHORTEST_STEP:
        raise TrajectoryError(
            f"point 0: time_from_start {times[0]:g} s; accepted: 0, or a nanosecond and more"
        )


def joint_table(
    what: str,
    rows: Sequence[Sequence[float]],
    columns: Sequence[int],
    robot_joints: Sequence[str],
    where: str = "point {}: ",
    whole: bool = False,
) -> Array | None:
    """Return rows of values in the columns of their joints, shape (n, j), 0 elsewhere; None if all rows are empty.

    Args:
        what: name of the values, for messages.
        rows: values, or none.
        columns: of the joints in the robot's order, one for each value.
        robot_joints: names of the joints.
        where: name of a row, for messages, formatted with its number.
        whole: whether no row may be empty if others are not.

    Raises:
        TrajectoryError: naming row, joint, value and what is accepted.
    """
    if not any(len(row) for row in rows):
        return None
    for i, row in enumerate(rows):
        if len(row) != len(columns) and (len(row) or whole):
            accepted = f"{len(columns)}{'' if whole else ', or none'}"
            raise TrajectoryError(f"{where.format(i)}{len(row)} {what}; accepted: {accepted}")
    table = np.zeros((len(rows), len(robot_joints)))
    table[:, columns] = [row if len(row) else [0.0] * len(columns) for row in rows]
    if not np.isfinite(table).all():
        i, k = np.argwhere(~np.isfinite(table[:, columns]))[0]
        value = table[i, columns[k]]
        name = robot_joints[columns[k]]
        raise TrajectoryError(
            f"{where.format(i)}{what} of {name}: {value}; accepted: a finite number"
        )
    return table


def _degrees(
    velocity: Sequence[Sequence[float]], acceleration: Sequence[Sequence[float]]
) -> Index | None:
    """Return the degrees of the ways to n points from their given values, shape (n,); None if all points are alike."""
    given = np.array([[len(row) > 0 for row in rows] for rows in (velocity, acceleration)])
    lacking = np.flatnonzero(given[1] & ~given[0])
    if lacking.size:
        raise TrajectoryError(
            f"point {lacking[0]}: accelerations without velocities; accepted: velocities too"
        )
    if (given == given[:, :1]).all():
        return None
    # The way to the first point comes from the set-point, which has all.
    curved, quintic = given & np.concatenate([given[:, :1], given[:, :-1]], axis=1)
    return np.asarray(1 + 2 * curved.astype(np.intp) + 2 * quintic)


def _last_is_repeated(
    times: Sequence[float], position: Sequence[Sequence[float]], velocity: Sequence[Sequence[float]]
) -> bool:
    if len(times) < 2 or not -_SHORTEST_STEP <= times[-1] - times[-2] <= _REPEATED_TIME:
        return False
    return all(
        len(rows) == 0
        or (len(rows[-1]) == len(rows[-2]) and np.allclose(rows[-1], rows[-2], rtol=0.0, atol=most))
        for rows, most in ((position, _REPEATED_POSITION), (velocity, _REPEATED_VELOCITY))
    )


# Messages.


def points_from_message(
    robot_joints: Sequence[str], message: Any, *, partial: bool = False, moving_end: bool = False
) -> TrajectoryPoints:
    """Return the points of a JointTrajectory; `partial` and `moving_end` are those of `TrajectoryPoints.create`.

    Raises:
        TrajectoryError: naming joint, index of the point and reason.
    """
    for i, point in enumerate(message.points):
        if len(point.effort) > 0:
            raise TrajectoryError(
                f"point {i}: carries effort; accepted: positions, velocities, accelerations"
            )
    return TrajectoryPoints.create(
        robot_joints,
        message.joint_names,
        # One division: the nearest number to the whole nanoseconds, as the planner has it.
        [message_time_ns(point.time_from_start) / NANOSECONDS for point in message.points],
        [point.positions for point in message.points],
        [point.velocities for point in message.points],
        [point.accelerations for point in message.points],
        partial=partial,
        moving_end=moving_end,
    )


def message_content(joint_names: Sequence[str], points: TrajectoryPoints) -> dict[str, Any]:
    """Return the points as the content of a trajectory_msgs/JointTrajectory, as `ros2 topic pub` takes it in YAML.

    What the points do not carry is an empty list.
    """
    tables = (points.position, points.velocity, points.acceleration)
    columns = [[[]] * len(points.times) if rows is None else rows.tolist() for rows in tables]
    if points.degrees is not None:
        # A value that a point carries counts where the way on one of its sides has the degree for it.
        around = np.maximum(points.degrees, np.append(points.degrees[1:], 1))
        for rows, least in zip(columns[1:], (3, 5), strict=True):
            rows[:] = [
                row if degree >= least else [] for row, degree in zip(rows, around, strict=True)
            ]
    times = [divmod(round(float(time) * NANOSECONDS), NANOSECONDS) for time in points.times]
    return {
        "joint_names": list(joint_names),
        "points": [
            {
                "positions": position,
                "velocities": velocity,
                "accelerations": acceleration,
                "time_from_start": {"sec": sec, "nanosec": nanosec},
            }
            for (sec, nanosec), position, velocity, acceleration in zip(
                times, *columns, strict=True
            )
        ],
    }


# Corrections.


def correction_points(correction: Correction) -> TrajectoryPoints:
    """Return offsets as the points of a message, one for each set-point."""
    times = np.arange(len(correction.offsets), dtype=np.float64) * correction.period
    return TrajectoryPoints(times, correction.offsets, None, None)


def correction_from_points(points: TrajectoryPoints, period: float) -> Correction:
    """Return the offsets that a message carried as points.

    Raises:
        TrajectoryError: for points that are not one for each set-point, and offsets beyond the limits.
    """
    times = np.arange(len(points.times)) * period
    late = np.flatnonzero(np.abs(points.times - times) > 2.0 * _SHORTEST_STEP)
    if len(late):
        raise TrajectoryError(
            f"the correction has point {late[0]} at {points.times[late[0]]:.6g} s; accepted: a point every {period:g} s"
        )
    return Correction(points.position, period)


def trajectory_identity(points: TrajectoryPoints) -> str:
    """Return the identity of a trajectory: a digest of its times, in ns, and of its values."""
    times = np.round(points.times * NANOSECONDS).astype(np.int64)
    return array_digest(times, points.position, points.velocity, points.acceleration)
