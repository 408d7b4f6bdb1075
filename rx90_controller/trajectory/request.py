"""One trajectory request, received by topic or as a goal of FollowJointTrajectory, from check to end.

A request is checked by itself, on the thread that received it; joined to the motion, outside the ticks if that may
take long; followed, and compared with its tolerances tick by tick; and ended, with a result code and a reason. The
rules are those of ros2_controllers' joint_trajectory_controller (docs/howto/action.md). No call reads a clock.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from enum import Enum, IntEnum
from functools import cached_property
from typing import Annotated, Any, NamedTuple

import numpy as np
from pydantic import ConfigDict, Field

from rx90_common.base.arrays import Array
from rx90_common.base.errors import TrajectoryError
from rx90_common.base.models import Model, quantity
from rx90_common.base.quoting import counted, quoted
from rx90_common.base.rates import NANOSECONDS, message_time_ns
from rx90_controller.trajectory.correction import Correction
from rx90_controller.trajectory.generator import PastError, Schedule, TrajectoryGenerator
from rx90_controller.trajectory.points import TrajectoryPoints, check_joints, points_from_message

# the rows of tolerances
_QUANTITIES = (("position", "rad"), ("velocity", "rad/s"), ("acceleration", "rad/s^2"))
_ERASE = 1.2e-7  # float's epsilon: how near to -1 a tolerance erases the default
# points, s: of a trajectory that can be joined between two ticks
_SHORT_POINTS = 20
_SHORT_S = 20.0
# A long trajectory whose start is "now" begins so much later: s, for each point, and for each second of it, in which a
# thousand set-points may have to be checked.
_LEAD = 5e-3
_LEAD_PER_POINT = 1e-4
_LEAD_PER_SECOND = 5e-4
_LEAD_GROWTH = 4  # at each further attempt


class ResultCode(IntEnum):
    """The codes of a FollowJointTrajectory result (control_msgs) that are used here."""

    SUCCESSFUL = 0
    INVALID_GOAL = -1
    OLD_HEADER_TIMESTAMP = -3
    PATH_TOLERANCE_VIOLATED = -4
    GOAL_TOLERANCE_VIOLATED = -5


class GoalOptions(Model):
    """What else is accepted, each option a parameter of the node; the first three are joint_trajectory_controller's.

    Joints that a request does not name brake to rest if they move, or with `allow_trajectory_replacement` go on along
    their trajectory. Behind a last point with a velocity each joint brakes, unless another trajectory follows.
    """

    allow_partial_joints_goal: Annotated[
        bool,
        Field(description="Whether a trajectory may name some of the joints; the others hold."),
    ] = False
    allow_nonzero_velocity_at_trajectory_end: Annotated[
        bool, Field(description="Whether the last point may have a velocity; then the arm brakes.")
    ] = False
    allow_trajectory_replacement: Annotated[
        bool,
        Field(
            description="Whether points may be left out that are not later than the start, which leads on from where "
            "the path is then."
        ),
    ] = False
    velocities_from_positions: Annotated[
        bool,
        Field(
            description="Whether velocities between the first and the last point are computed from the positions; for "
            "points whose velocities do not belong to these."
        ),
    ] = False


_LARGEST = 1e6  # rad, rad/s, s


class JointConstraints(Model):
    """Tolerances of a joint."""

    trajectory: Annotated[
        float, quantity("rad", "How far <joint> may be off the path; 0: any.", ge=0.0, le=_LARGEST)
    ] = 0.0
    goal: Annotated[
        float,
        quantity("rad", "How far <joint> may be off at the goal; 0: any.", ge=0.0, le=_LARGEST),
    ] = 0.0


class Constraints(Model):
    """joint_trajectory_controller's parameters of tolerances, and those of each joint by its name; 0 is for none."""

    model_config = ConfigDict(extra="allow")
    __pydantic_extra__: dict[str, JointConstraints] = Field(init=False)

    goal_time: Annotated[
        float,
        quantity(
            "s",
            "How long after its end a motion may take to be at its goal; 0: for ever.",
            ge=0.0,
            le=_LARGEST,
        ),
    ] = 0.0
    stopped_velocity_tolerance: Annotated[
        float,
        quantity(
            "rad/s",
            "Velocity at the goal; without effect, as in joint_trajectory_controller with commands of position.",
            ge=0.0,
            le=_LARGEST,
        ),
    ] = 0.01

    @property
    def joints(self) -> dict[str, JointConstraints]:
        """Return those of the joints."""
        return self.__pydantic_extra__


@dataclass(frozen=True)
class GoalTolerances:
    """Tolerances of j joints; infinite where there is none.

    Attributes:
        names: of the joints.
        path: of position along the path, rad, shape (j,).
        goal: likewise at its end.
        goal_time: how long after its end the goal may take to be reached, s; infinite for "for ever".
    """

    names: tuple[str, ...]
    path: Array
    goal: Array
    goal_time: float

    @classmethod
    def of_parameters(
        cls, names: Sequence[str], constraints: Constraints | None = None
    ) -> GoalTolerances:
        """Return the tolerances of the node's parameters, by default those that it has if none are given."""
        constraints = constraints or Constraints()
        joints = [constraints.joints.get(name, JointConstraints()) for name in names]
        path = np.array([joint.trajectory or math.inf for joint in joints])
        goal = np.array([joint.goal or math.inf for joint in joints])
        return cls(tuple(names), path, goal, constraints.goal_time or math.inf)

    @cached_property
    def end_motions(self) -> bool:
        """Return whether they can end a motion before it reaches its goal."""
        return math.isfinite(self.goal_time) or bool(np.isfinite(self.path).any())

    def of_goal(self, path: Sequence[Any], goal: Sequence[Any], goal_time: float) -> GoalTolerances:
        """Return these with those of a goal in their place, as joint_trajectory_controller reads them.

        0, and what is no number, keeps the default, -1 erases it; of several for a joint the last one counts.

        Args:
            path: control_msgs/JointTolerance: name, position, velocity, acceleration.
            goal: likewise.
            goal_time: goal_time_tolerance, s; 0 keeps the default, -1 is "for ever".

        Raises:
            TrajectoryError: for an unknown joint, and another negative number.
        """
        tables = []
        for what, given, defaults in (
            ("path_tolerance", path, self.path),
            ("goal_tolerance", goal, self.goal),
        ):
            table = defaults.copy()
            for tolerance in given:
                name = str(tolerance.name)
                if name not in self.names:
                    accepted = ", ".join(self.names)
                    raise TrajectoryError(
                        f"{what}: joint {quoted(name)} is unknown; accepted: {accepted}"
                    )
                joint = self.names.index(name)
                # Those of velocity and acceleration are checked alone: with commands of position they are always kept.
                resolved = [
                    _resolved(
                        f"{what}: {field} of {name}",
                        unit,
                        float(getattr(tolerance, field)),
                        defaults[joint],
                    )
                    for field, unit in _QUANTITIES
                ]
                table[joint] = resolved[0]
            tables.append(table)
        most = _resolved("goal_time_tolerance", "s", goal_time, self.goal_time)
        return GoalTolerances(self.names, tables[0], tables[1], most)

    def worst(self, error: Array, accepted: Array) -> str | None:
        """Return the relatively largest violation of a tolerance of position, in words; None without one.

        joint_trajectory_controller leaves the errors of velocity and acceleration at 0 where it commands positions.

        Args:
            error: of position, rad, shape (j,).
            accepted: one of `path` and `goal`.
        """
        beyond = ~(np.abs(error) <= accepted) & np.isfinite(accepted)
        if not beyond.any():
            return None
        share = np.where(beyond, np.nan_to_num(np.abs(error) / accepted, nan=np.inf), -1.0)
        joint = int(np.argmax(share))
        return f"{self.names[joint]}: position error {error[joint]:.4g} rad, accepted up to {accepted[joint]:.4g} rad"


def _resolved(what: str, unit: str, value: float, default: float) -> float:
    """Return the meaning of a goal's tolerance value."""
    if value > 0.0:
        return value
    if abs(value + 1.0) < _ERASE:
        return math.inf
    if value < 0.0:
        raise TrajectoryError(
            f"{what} is {value:g} {unit}; accepted: a number > 0, 0 for the default, -1 for none"
        )
    return default


class State(Enum):
    """Where a request is."""

    RECEIVED = "received"  # and checked by itself
    WAITING = "waiting"  # for the first states of the simulation, or for its start
    FOLLOWED = "followed"
    SUCCEEDED = "succeeded"
    ABORTED = "aborted"
    CANCELED = "canceled"


class Feedback(NamedTuple):
    """The progress of a request at a position tick.

    Attributes:
        tick: position tick.
        desired: set-point: position rad, velocity rad/s, acceleration rad/s^2, shape (3, j).
        actual: measured, shape (3, j); the acceleration is the difference of the velocities over a tick.
        desired_time: time on the trajectory, s from its start; slower than `actual_time` if speed is scaled.
        actual_time: time since its start, s.
    """

    tick: int
    desired: Array
    actual: Array
    desired_time: float
    actual_time: float


@dataclass(eq=False)
class TrajectoryRequest:
    """A received trajectory, with its state.

    Attributes:
        message: trajectory_msgs/JointTrajectory, as received.
        points: times from the stamp on. None stops the arm.
        start: its stamp in position ticks; None for now.
        tolerances: that apply to it.
        options: permitted exceptions at its arrival.
        remark: what was not taken of it, one line; empty for nothing.
        correction: offsets of the position set-points, played along.
        is_goal: whether it was received as a goal: the way to its points then starts on the running path. A point at
            the start of a topic's trajectory is followed to the bit, unless the start is past.
        on_feedback: of a goal, called by the executor's thread now and then while it is followed.
        on_result: likewise, called once it has ended.
        state: of the request; once it has ended SUCCEEDED, ABORTED or CANCELED.
        code: of the result, once it has ended.
        reason: of the end, one line, error_string of the result; empty before.
        feedback: of the last step; None before the first.
    """

    message: Any
    points: TrajectoryPoints | None
    start: int | None
    tolerances: GoalTolerances
    options: GoalOptions
    is_goal: bool = False
    remark: str = ""
    correction: Correction | None = None
    on_feedback: Callable[[Feedback], None] | None = None
    on_result: Callable[[], None] | None = None
    state: State = State.RECEIVED
    code: ResultCode = ResultCode.SUCCESSFUL
    reason: str = ""
    feedback: Feedback | None = None
    _began: int = 0  # tick of the first step
    _settling: int | None = None  # tick in which the last point was reached

    @property
    def kind(self) -> str:
        """Return "goal" or "trajectory", for messages to users."""
        return "goal" if self.is_goal else "trajectory"

    @property
    def replaces(self) -> str:
        """Return why what it replaces ends."""
        return (
            "pre-empted by a new goal" if self.is_goal else "replaced by a trajectory on the topic"
        )

    @property
    def watched(self) -> bool:
        """Return whether it is compared with its tolerances: as goals are, and trajectories that these can end."""
        return self.is_goal or self.tolerances.end_motions

    @property
    def long(self) -> bool:
        """Return whether to check it against the limits may take longer than a tick."""
        points = self.points
        return points is not None and (
            len(points.times) > _SHORT_POINTS or bool(points.times[-1] > _SHORT_S)
        )

    def enter(self, generator: TrajectoryGenerator, now: int) -> Schedule:
        """Let a generator follow it, or stop; `now` is the first tick that may still be changed.

        Raises:
            PastError: if all its points lie in the past.
            TrajectoryError: if it starts elsewhere than the arm is, or breaks a limit.
        """
        if self.points is None:
            return generator.stop(now, self.start)
        anywhere = self.options.allow_trajectory_replacement
        late = self.start is not None and self.start < now
        if self.is_goal or anywhere or late:
            return generator.join(self.points, now, self.start, self.correction, anywhere=anywhere)
        return generator.accept(self.points, now, self.start, self.correction)

    def step(
        self, tick: int, desired: Array, actual: Array, trajectory: TrajectoryGenerator
    ) -> None:
        """Compare the set-point of a position tick with the measured state; end the request where that decides it.

        Along the path its tolerances hold, from the first sample to the last one before the last point. From the last
        point on the goal is reached as soon as its tolerances hold, and missed once `goal_time` is over.

        Args:
            tick: the position tick.
            desired: set-point: position rad, velocity rad/s, acceleration rad/s^2, shape (3, j).
            actual: measured, likewise.
            trajectory: generator that follows it.
        """
        (time, last) = trajectory.progress(tick)
        period = trajectory.period
        tolerances = self.tolerances
        if self.state is State.WAITING and time < 0.0:
            return
        first = self.feedback is None
        if first:
            self.state = State.FOLLOWED
            self._began = tick
        error = desired[0] - actual[0]
        self.feedback = Feedback(tick, desired, actual, time, (tick - self._began) * period)
        reached = time >= last
        now = f"{tick * period:.6g} s"
        where = f"at {now}, {time:.6g} s on the trajectory"
        if (first or not reached) and (
            worst := tolerances.worst(error, tolerances.path)
        ) is not None:
            self.end(
                State.ABORTED,
                ResultCode.PATH_TOLERANCE_VIOLATED,
                f"{worst} along the path, {where}",
            )
        elif reached:
            self._settling = tick if self._settling is None else self._settling
            worst = tolerances.worst(error, tolerances.goal)
            late = (tick - self._settling) * period
            after = f"{late:.6g} s after the last point"
            if worst is None:
                self.end(State.SUCCEEDED, ResultCode.SUCCESSFUL, f"goal reached at {now}, {after}")
            elif late > tolerances.goal_time:
                self.end(
                    State.ABORTED,
                    ResultCode.GOAL_TOLERANCE_VIOLATED,
                    f"{worst} at the goal, {after}, {where}",
                )

    def end(self, state: State, code: ResultCode, reason: str) -> None:
        """End it, once."""
        self.state = state
        self.code = code
        self.reason = reason


def check_request(
    message: Any, defaults: GoalTolerances, options: GoalOptions, position_hz: int, goal: Any = None
) -> TrajectoryRequest:
    """Check a received trajectory; one of the topic without points stops the arm.

    Needs no state of the controller and may run in any thread.

    Args:
        message: trajectory_msgs/JointTrajectory.
        defaults: tolerances for a goal without its own, with the names of the robot's joints.
        options: permitted exceptions from the checks.
        position_hz: rate of the position loop, Hz.
        goal: control_msgs/action/FollowJointTrajectory goal that contains the trajectory, or anything with its
            attributes. If one of its tolerances cannot be taken, the defaults hold, as `remark` says.

    Raises:
        TrajectoryError: naming joint, index of the point or field, and reason.
    """
    tolerances = defaults
    points = None
    remark = ""
    if goal is not None:
        if goal.multi_dof_trajectory.joint_names or goal.multi_dof_trajectory.points:
            raise TrajectoryError("multi_dof_trajectory is given; accepted: an empty one")
        for name in ("component_path_tolerance", "component_goal_tolerance"):
            if given := getattr(goal, name):
                raise TrajectoryError(f"{name} of {counted(len(given), 'joint')}; accepted: none")
        goal_time = message_time_ns(goal.goal_time_tolerance) / NANOSECONDS
        try:
            tolerances = defaults.of_goal(goal.path_tolerance, goal.goal_tolerance, goal_time)
        except TrajectoryError as error:
            remark = f"{error}; the default tolerances hold"
    if goal is not None or len(message.points) > 0:
        moving_end = options.allow_nonzero_velocity_at_trajectory_end
        partial = options.allow_partial_joints_goal
        points = points_from_message(
            defaults.names, message, partial=partial, moving_end=moving_end
        )
        points = points.smoothed() if options.velocities_from_positions else points
    elif message.joint_names:
        check_joints(defaults.names, list(message.joint_names))
    stamp_ns = message_time_ns(message.header.stamp)
    # the first tick not before it
    start = int(-(-stamp_ns * position_hz // NANOSECONDS)) if stamp_ns else None
    return TrajectoryRequest(
        message, points, start, tolerances, options, is_goal=goal is not None, remark=remark
    )


class JoinedAhead:
    """A request that is joined to a fork of the generator, while that goes on.

    To be made between two ticks; then `compute`, outside the ticks; then, between two ticks again, `adopt` if it
    `fits`.
    A trajectory whose start is not in the future begins some ticks later, when it should have been joined, at each
    attempt with more time; from rest the beginning makes no difference, and it begins as soon as it has been joined.

    Args:
        request: with points.
        generator: that will follow it.
        now: its first tick that may still be changed.
        attempt: from 0 on.
    """

    def __init__(
        self, request: TrajectoryRequest, generator: TrajectoryGenerator, now: int, attempt: int = 0
    ) -> None:
        points = request.points
        start = request.start
        assert points is not None
        self._request = request
        self._generator = generator
        self._fork = generator.fork(now)
        self._may_be_late = start is None and self._fork is not None and not self._fork.moving(now)
        self._now = self._earliest = now
        if not self._may_be_late and (start is None or start < now):
            lead = (
                _LEAD
                + _LEAD_PER_POINT * len(points.times)
                + _LEAD_PER_SECOND * float(points.times[-1])
            )
            self._earliest += round(lead / generator.period) * _LEAD_GROWTH**attempt
        self._schedule: Schedule | None = None
        self._error: TrajectoryError | None = None

    def compute(self) -> None:
        """Compute the motion, as the generator would."""
        try:
            if self._fork is not None:
                self._schedule = self._request.enter(self._fork, self._earliest)
        except TrajectoryError as error:
            # All points may lie in the past by then, but perhaps not yet.
            if not isinstance(error, PastError) or self._earliest == self._now:
                self._error = error

    def fits(self, now: int) -> bool:
        """Return whether `adopt` may be called at this tick.

        Not so where other motions have come in between, or the computation took longer than there was time for.
        """
        if self._fork is None or not self._generator.continues(self._fork, now):
            return False
        in_time = self._schedule is not None and (self._schedule.begin >= now or self._may_be_late)
        return self._error is not None or in_time

    def adopt(self, now: int) -> Schedule:
        """Let the generator follow the request; return when it runs.

        Raises:
            TrajectoryError: why the trajectory cannot be followed.
        """
        if self._error is not None:
            raise self._error
        schedule = self._schedule
        fork = self._fork
        assert schedule is not None
        assert fork is not None
        late = max(0, now - schedule.begin)
        self._generator.adopt(fork, late)
        return Schedule(schedule.begin + late, schedule.end + late, schedule.blend_error)
