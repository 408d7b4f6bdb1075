"""What a client asks for: a trajectory of the topic or a goal of FollowJointTrajectory, checked; needs no rclpy."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from enum import IntEnum
from typing import Any

import numpy as np

from rx90_common.base.arrays import Array
from rx90_common.base.errors import ConfigError, TrajectoryError
from rx90_common.base.quoting import quoted
from rx90_common.base.rates import NANOSECONDS
from rx90_common.base.stamps import message_time_ns
from rx90_controller.trajectory import Plan, Schedule, TrajectoryGenerator, TrajectoryPoints
from rx90_controller.trajectory.message import check_joint_names, points_from_message, start_tick

QUANTITIES = (("position", "rad"), ("velocity", "rad/s"), ("acceleration", "rad/s^2"))
"""The rows of tolerances and errors, with their units."""
_ERASED = -1.0
_NOT_SERVED = ("component_path_tolerance", "component_goal_tolerance")
_FEW, _SHORT = 20, 20.0  # points, s: of a trajectory that can be checked between two ticks
# Later by so much a long trajectory begins whose start is "now": s, for each point, and for each second of it, in which
# a thousand set-points may have to be checked.
_LEAD, _LEAD_EACH, _LEAD_SECOND = 5e-3, 1e-4, 5e-4
_MORE = 4  # times as much at each further attempt


class ResultCode(IntEnum):
    """The codes of a FollowJointTrajectory result (control_msgs)."""

    SUCCESSFUL = 0
    INVALID_GOAL = -1
    INVALID_JOINTS = -2
    OLD_HEADER_TIMESTAMP = -3
    PATH_TOLERANCE_VIOLATED = -4
    GOAL_TOLERANCE_VIOLATED = -5


class GoalError(TrajectoryError):
    """A goal is refused; the text is one line with the value and what is accepted.

    Attributes:
        code: the result code that says why.
    """

    def __init__(self, code: ResultCode, text: str) -> None:
        """Refuse a goal with a code and a line."""
        super().__init__(text)
        self.code = code


@dataclass(frozen=True)
class GoalOptions:
    """What else is accepted; the first three as the parameters of joint_trajectory_controller.

    Attributes:
        allow_partial_joints_goal: a goal may name some of the joints; the others hold their set-point, and brake to
            rest before if they move (with `allow_trajectory_replacement` they go on along their trajectory).
        allow_nonzero_velocity_at_trajectory_end: the last point may have a velocity; unless another trajectory follows,
            each joint brakes behind it.
        allow_trajectory_replacement: the first point may lie elsewhere than the set-point at the start: points that are
            not later than the start are left out, and the motion goes to the next one from where the path is then.
        velocities_from_positions: velocities between the first and the last point are computed from the positions, as
            `TrajectoryPoints.smoothed` says, in place of those that points carry.
    """

    allow_partial_joints_goal: bool = False
    allow_nonzero_velocity_at_trajectory_end: bool = False
    allow_trajectory_replacement: bool = False
    velocities_from_positions: bool = False


@dataclass(frozen=True)
class GoalTolerances:
    """GoalTolerances of six joints; infinite where there is none.

    Attributes:
        names: of the joints.
        path: of position rad, velocity rad/s and acceleration rad/s^2 along the path, shape (3, 6).
        goal: likewise at its end.
        goal_time: how long after its end the goal may take to be reached, s; infinite for "for ever".
    """

    names: tuple[str, ...]
    path: Array
    goal: Array
    goal_time: float

    @classmethod
    def defaults(
        cls,
        names: Sequence[str],
        *,
        goal_time: float = 0.0,
        stopped_velocity_tolerance: float = 0.01,
        trajectory: Mapping[str, float] | None = None,
        goal: Mapping[str, float] | None = None,
    ) -> GoalTolerances:
        """Return the tolerances that joint_trajectory_controller's parameters `constraints.*` stand for.

        Args:
            names: of the joints.
            goal_time: `constraints.goal_time`, s; 0 for "for ever".
            stopped_velocity_tolerance: `constraints.stopped_velocity_tolerance`, rad/s, of every joint at the goal;
                0 for none.
            trajectory: `constraints.<joint>.trajectory`, rad, of the position along the path; 0 or absent for none.
            goal: `constraints.<joint>.goal`, rad, of the position at the goal; 0 or absent for none.

        Raises:
            ConfigError: for a number that is negative or not finite, or an unknown joint.
        """
        path, at_goal = np.full((3, 6), np.inf), np.full((3, 6), np.inf)
        at_goal[1] = _parameter("stopped_velocity_tolerance", stopped_velocity_tolerance)
        for key, table, given in (("trajectory", path, trajectory), ("goal", at_goal, goal)):
            for joint, value in (given or {}).items():
                if joint not in names:
                    raise ConfigError(f"constraints of unknown joint {quoted(joint)}; accepted: {', '.join(names)}")
                table[0, list(names).index(joint)] = _parameter(f"{joint}.{key}", value)
        return cls(tuple(names), path, at_goal, _parameter("goal_time", goal_time))

    @property
    def end_motions(self) -> bool:
        """Return whether they can end a motion before it reaches its goal."""
        return math.isfinite(self.goal_time) or bool(np.isfinite(self.path).any())

    def of_goal(self, path: Sequence[Any], goal: Sequence[Any], goal_time: float) -> GoalTolerances:
        """Return these with those of a goal in their place: 0 keeps the default, -1 erases it.

        Args:
            path: control_msgs/JointTolerance: name, position, velocity, acceleration.
            goal: likewise.
            goal_time: goal_time_tolerance, s; 0 keeps the default, -1 is "for ever".

        Raises:
            GoalError: INVALID_JOINTS for an unknown or repeated joint, INVALID_GOAL for another negative number or one
                that is not finite.
        """
        return GoalTolerances(
            self.names,
            self._table("path_tolerance", path, self.path),
            self._table("goal_tolerance", goal, self.goal),
            _resolved("goal_time_tolerance", "s", goal_time, self.goal_time),
        )

    def _table(self, what: str, given: Sequence[Any], defaults: Array) -> Array:
        table, seen = defaults.copy(), set()
        for tolerance in given:
            name = str(tolerance.name)
            if name not in self.names or name in seen:
                reason = "stands twice" if name in seen else "is unknown"
                raise GoalError(
                    ResultCode.INVALID_JOINTS,
                    f"{what}: joint {quoted(name)} {reason}; accepted: {', '.join(self.names)}, each at most once",
                )
            seen.add(name)
            joint = self.names.index(name)
            for row, (quantity, unit) in enumerate(QUANTITIES):
                value = float(getattr(tolerance, quantity))
                table[row, joint] = _resolved(f"{what}: {quantity} of {name}", unit, value, table[row, joint])
        return table


def _parameter(key: str, value: float) -> float:
    """Return a default tolerance; infinite for 0."""
    if not 0.0 <= value < math.inf:
        raise ConfigError(f"constraints.{key} is {value}; accepted: a finite number >= 0, 0 for no limit")
    return value or math.inf


def _resolved(what: str, unit: str, value: float, default: float) -> float:
    """Return what a goal's tolerance stands for."""
    if value == 0.0:
        return default
    if value == _ERASED:
        return math.inf
    if not 0.0 < value < math.inf:
        raise GoalError(
            ResultCode.INVALID_GOAL,
            f"{what} is {value:g} {unit}; accepted: a finite number > 0, 0 for the default, -1 for none",
        )
    return value


@dataclass(frozen=True)
class TrajectoryRequest:
    """A trajectory as it was sent, by topic or as a goal, checked as far as that needs no state of the controller.

    Attributes:
        message: trajectory_msgs/JointTrajectory, as it came.
        points: times from the stamp on; prepared, because they are taken between two ticks. None stops the arm.
        start: its stamp in position ticks; None for now.
        tolerances: that hold for it.
        options: what else was accepted when it came.
        is_goal: whether it came as a goal: the way then leads to its points from where the path is. A point of the
            topic's at the start is followed to the bit, unless the start is over.
    """

    message: Any
    points: TrajectoryPoints | None
    start: int | None
    tolerances: GoalTolerances
    options: GoalOptions
    is_goal: bool = False

    @property
    def long(self) -> bool:
        """Return whether to check it against the limits may take longer than a tick."""
        points = self.points
        return points is not None and (len(points.times) > _FEW or bool(points.times[-1] > _SHORT))

    def plan(self, generator: TrajectoryGenerator, now: int, attempt: int = 0) -> Plan:
        """Return a plan to join it beside the ticks; each attempt, from 0 on, has more time than the one before."""
        assert self.points is not None
        count, duration = len(self.points.times), float(self.points.times[-1])
        lead = round((_LEAD + _LEAD_EACH * count + _LEAD_SECOND * duration) / generator.period) * _MORE**attempt
        anywhere = self.options.allow_trajectory_replacement
        return Plan(generator, self.points, self.start, now, lead, anywhere=anywhere, exact=not self.is_goal)

    def enter(self, generator: TrajectoryGenerator, now: int) -> Schedule:
        """Let a generator follow it, or stop; `now` is the first tick that may still be changed.

        Raises:
            PastError: if all its points lie in the past.
            TrajectoryError: if it starts elsewhere than the arm is, or breaks a limit.
        """
        if self.points is None:
            return generator.stop(now, self.start)
        anywhere = self.options.allow_trajectory_replacement
        return generator.enter(self.points, now, self.start, anywhere=anywhere, exact=not self.is_goal)


def check_trajectory(
    message: Any, robot_joints: Sequence[str], tolerances: GoalTolerances, options: GoalOptions, position_hz: int
) -> TrajectoryRequest:
    """Check a trajectory_msgs/JointTrajectory of the topic; one without points stops the arm.

    Needs no state of the controller and may run in any thread. The arguments are those of `check_goal`.

    Raises:
        TrajectoryError: naming joint, index of the point and reason.
    """
    points = None
    if message.points:
        points = _points(message, robot_joints, options)
    elif message.joint_names:
        check_joint_names(robot_joints, message)
    return TrajectoryRequest(message, points, start_tick(message, position_hz), tolerances, options)


def check_goal(
    message: Any, robot_joints: Sequence[str], defaults: GoalTolerances, options: GoalOptions, position_hz: int
) -> TrajectoryRequest:
    """Check a control_msgs/action/FollowJointTrajectory goal, or anything with its attributes.

    Needs no state of the controller and may run in any thread; what depends on it is checked by `GoalRunner.offer`.

    Args:
        message: the goal.
        robot_joints: names of the six joints.
        defaults: tolerances where the goal has none of its own.
        options: what else is accepted.
        position_hz: rate of the position loop, Hz.

    Raises:
        GoalError: INVALID_JOINTS for names that are empty, unknown, repeated or missing, in the trajectory or in
            tolerances; else INVALID_GOAL.
    """
    trajectory = message.trajectory
    if message.multi_dof_trajectory.joint_names or message.multi_dof_trajectory.points:
        raise GoalError(ResultCode.INVALID_GOAL, "multi_dof_trajectory is given; accepted: an empty one")
    for name in _NOT_SERVED:
        if getattr(message, name):
            raise GoalError(ResultCode.INVALID_GOAL, f"{name} of {len(getattr(message, name))} joints; accepted: none")
    try:
        check_joint_names(robot_joints, trajectory, partial=options.allow_partial_joints_goal)
    except TrajectoryError as error:
        raise GoalError(ResultCode.INVALID_JOINTS, str(error)) from error
    goal_time = message_time_ns(message.goal_time_tolerance) / NANOSECONDS
    tolerances = defaults.of_goal(message.path_tolerance, message.goal_tolerance, goal_time)
    try:
        points = _points(trajectory, robot_joints, options)
    except TrajectoryError as error:
        raise GoalError(ResultCode.INVALID_GOAL, str(error)) from error
    start = start_tick(trajectory, position_hz)
    return TrajectoryRequest(trajectory, points, start, tolerances, options, is_goal=True)


def _points(trajectory: Any, robot_joints: Sequence[str], options: GoalOptions) -> TrajectoryPoints:
    return points_from_message(
        robot_joints,
        trajectory,
        partial=options.allow_partial_joints_goal,
        moving_end=options.allow_nonzero_velocity_at_trajectory_end,
        smooth=options.velocities_from_positions,
    ).prepared()
