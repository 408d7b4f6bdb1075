"""Straight Cartesian lines and other paths, and moves to their start, for a controller that interpolates with quintics.

The acceleration along the line jumps at the corners of the trapezoidal profile. A quintic segment that ended
in a corner could only have one of the two accelerations there and would miss the other over its whole
length. Each corner therefore lies between two knots one set-point period apart, half a period before and half
a period after it: both have exact values, and the blend between them lasts one period and stays within
0.0023·Δa·T² of the line (2.3 nm for 1 m/s² and 1 ms). Elsewhere the knots are set closer until the tip error
between them is small enough.

The joint-space image of a line, with exact derivatives, is examined against the arm's limits first.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from rx90_common.base.arrays import Array, Mask
from rx90_common.base.errors import LineError, TrajectoryError
from rx90_common.description.inverse import nearest_turn, singularity_margins
from rx90_common.description.kinematics import forward
from rx90_common.description.robot import RobotModel
from rx90_common.description.rotations import length
from rx90_controller.lines.postures import Postures
from rx90_controller.lines.task import TipTask
from rx90_controller.paths.path import Path
from rx90_controller.trajectory import JointLimits, TrajectoryGenerator, TrajectoryPoints
from rx90_controller.trajectory.motion import move_duration
from rx90_controller.trajectory.spline import interpolate

APPROACH_SPEED = 0.25
APPROACH_ACCELERATION = 2.0
"""With which the joints move to the start of a line, all together: a share of their speed limits, and rad/s²."""
TIP_TOLERANCE = 1e-7  # m
_WIDEST_SPACING = 0.064  # s
_REFINEMENTS = 6
_PROBES = 8  # between two knots
# The line is examined at points at most this far apart, m, and at this many at least.
_EXAMINED_STEP = 1e-3
_MIN_EXAMINED = 200
# Between two examined points a joint may differ from its own slope by so much, rad; a change of branch is larger.
_MAX_JUMP = 0.05
# A joint that turns less than this over the whole line, rad, is held still: the rounding of the inverse kinematics
# would otherwise reach the friction compensation as a velocity of changing sign.
_STILL = 1e-10


@dataclass(frozen=True, eq=False)
class JointPath:
    """Joint angles as functions of the distance along a path.

    Attributes:
        robot: the arm, of n joints.
        task: the path.
        distance: (k,) examined distances, m.
        angles: (k, m) angles there, rad: of the joints, and behind them those that `Postures` adds.
        margins: smallest distance from each kind of singularity, and where on the line in m.
        postures: how the arm follows the line.
    """

    robot: RobotModel
    task: TipTask
    distance: Array
    angles: Array
    margins: dict[str, tuple[float, float]]
    postures: Postures

    @property
    def position(self) -> Array:
        """Return the joint angles (k, n) at the examined distances, rad."""
        return self.angles[:, : len(self.robot.joint_names)]

    def at(self, distance: Array) -> tuple[Array, Array, Array]:
        """Return joint angles (k, n) in rad, and their first and second derivative in rad/m and rad/m²."""
        q = self.postures.between(distance, self.distance, self.angles)
        slope, bend = self.postures.derivatives(distance, q)
        joints = len(self.robot.joint_names)
        still = np.ptp(self.position, axis=0) == 0.0
        return (
            np.where(still, self.position[0], q[:, :joints]),
            np.where(still, 0.0, slope[:, :joints]),
            np.where(still, 0.0, bend[:, :joints]),
        )


def _follow(postures: Postures, distance: Array) -> tuple[Array, str]:
    """Return `Postures.from_start`, unwound, in the middle of the limits."""
    robot = postures.robot
    q, missed = postures.from_start(distance)
    q = np.unwrap(q, axis=0)
    if len(q):  # whole joints by whole turns
        middle = (q.min(axis=0) + q.max(axis=0)) / 2.0
        q = q + (nearest_turn(middle, (robot.lower + robot.upper) / 2.0) - middle)
    return np.asarray(q), missed


def _joint_path(robot: RobotModel, task: TipTask, acceleration: Array | None) -> JointPath:
    """Find the joint path of a path of the tip and examine it from start to end.

    A path that is not a line is travelled more slowly where a joint's limits require it.

    Raises:
        LineError: naming place, joint or singularity, value and limit.
    """
    joints = len(robot.joint_names)
    distance = task.places(_EXAMINED_STEP, _MIN_EXAMINED)
    # the first reason, by the place
    postures = Postures.of(robot, task)
    faults = dict[int, str]()
    q, missed = _follow(postures, distance)
    if missed:
        faults[len(q)] = missed
    for j, name in enumerate(robot.joint_names):
        at = _first((q[:, j] < robot.lower[j]) | (q[:, j] > robot.upper[j]))
        if at < len(q):
            accepted = f"[{robot.lower[j]:.4f}, {robot.upper[j]:.4f}]"
            faults.setdefault(at, f"{name} at {q[at, j]:.4f} rad; accepted: {accepted}")
    margins = singularity_margins(postures.robot.chain, q)
    for kind, values in margins.items():
        at = _first(values < task.singularity_margin)
        if at < len(values):
            accepted = f">= {task.singularity_margin:g}"
            faults.setdefault(
                at, f"{kind} singularity, margin {values[at]:.4f}; accepted: {accepted}"
            )
    q = q[: min(faults, default=len(q))]
    slope, bend = postures.derivatives(distance[: len(q)], q)
    gap = np.abs(
        np.diff(q, axis=0) - 0.5 * (slope[1:] + slope[:-1]) * np.diff(distance[: len(q)])[:, None]
    )
    jumps = np.argwhere(gap[:, :joints] > _MAX_JUMP)
    if jumps.size:
        k, j = jumps[0].tolist()
        jump = q[k + 1, j] - q[k, j]
        faults[k + 1] = (
            f"{robot.joint_names[j]} jumps by {jump:.3f} rad to another branch; accepted: no jump"
        )
    if not faults and isinstance(task, Path):
        limit = np.full(joints, np.inf) if acceleration is None else acceleration
        task = task.within_limits(
            robot.joint_names,
            distance,
            slope[:, :joints],
            bend[:, :joints],
            robot.max_velocity,
            limit,
        )
        postures = replace(postures, task=task)
    elif not faults:
        # What no speed can mend came first: near a singularity the joint speeds grow, whatever the line's speed.
        rate = np.abs(slope) * task.profile().speed_at(distance)[:, None]
        for j, name in enumerate(robot.joint_names):
            at = _first(rate[:, j] > robot.max_velocity[j])
            if at < len(rate):
                most = task.speed * robot.max_velocity[j] / rate[:, j].max()
                accepted = (
                    f"<= {robot.max_velocity[j]:.3f} rad/s (a line speed of about {most:.3g} m/s)"
                )
                faults.setdefault(
                    at, f"{name} would turn at {rate[at, j]:.3f} rad/s; accepted: {accepted}"
                )
    if faults:
        first = min(faults)
        at_m = float(distance[first])
        raise LineError(
            f"the {task.what} cannot be travelled at {at_m:.3f} m from its start ({at_m / task.length:.0%}): "
            f"{faults[first]}"
        )
    q = np.where(np.ptp(q, axis=0) < _STILL, np.round(q[0], 12), q)
    worst = {kind: int(np.argmin(values)) for kind, values in margins.items()}
    where = {kind: (float(margins[kind][k]), float(distance[k])) for kind, k in worst.items()}
    return JointPath(robot, task, distance, q, where, postures)


def _first(rows: Mask) -> int:
    """Return the number of the first row that is true; how many rows there are if none is."""
    return int(np.argmax(rows)) if rows.any() else len(rows)


@dataclass(frozen=True, eq=False)
class LinePlan:
    """A line, or another path, as a joint trajectory.

    Attributes:
        path: the joint path it follows.
        times: (n,) s from the start of the rest before the line.
        position: (n, joints) rad; velocity and acceleration likewise.
        velocity: rad/s.
        acceleration: rad/s².
        tip_error: largest distance of the interpolated tip from where the profile has it, m.
    """

    path: JointPath
    times: Array
    position: Array
    velocity: Array
    acceleration: Array
    tip_error: float

    @property
    def task(self) -> TipTask:
        """Return the task with rests of at least half a set-point period, and with speeds within the joints' limits."""
        return self.path.task

    @property
    def joint_names(self) -> tuple[str, ...]:
        """Return the joints in the order of the columns."""
        return self.path.robot.joint_names

    @property
    def start_pose(self) -> Array:
        """Return the joint angles (joints,) at which the trajectory begins, rad."""
        start: Array = self.position[0]
        return start

    @property
    def points(self) -> TrajectoryPoints:
        """Return the points of the trajectory, as the controller takes them."""
        motion = (self.position.tolist(), self.velocity.tolist(), self.acceleration.tolist())
        return TrajectoryPoints.create(
            self.joint_names, self.joint_names, self.times.tolist(), *motion
        )

    @property
    def duration(self) -> float:
        """Return the time of the last knot, rests included, s."""
        return float(self.times[-1])

    @property
    def motion(self) -> tuple[float, float]:
        """Return when the line's own motion begins and ends, s."""
        begin = self.task.rest_before
        return begin, begin + self.task.profile().duration

    @property
    def counted(self) -> tuple[float, float]:
        """Return the part of its trajectory that counts for the path error, s."""
        return self.task.counted

    def distance(self, tip: Array, times: Array | None = None) -> Array:
        """Return the distance of the tip's positions, m, shape (n, 3), from the path, m, shape (n,).

        With their `times`, s from the trajectory's start, a path that crosses itself or ends where it began is
        searched only around where the tip should be.
        """
        near = (
            None
            if times is None
            else self.task.profile().sample(times - self.task.rest_before).distance
        )
        return self.task.error(tip, near).perpendicular

    def tip(self, times: Array) -> Array:
        """Return the tool centre point (n, 3) of the profile at `times`, s."""
        motion = self.task.profile().sample(times - self.task.rest_before)
        return self.task.poses(motion.distance).position

    def setpoints(self, times: Array) -> Array:
        """Return position, velocity and acceleration at `times`, as the controller's quintics give them.

        Shape (n, 3, joints).
        """
        return interpolate(self.times, self.position, self.velocity, self.acceleration).sample(
            times
        )


def plan_line(
    robot: RobotModel, task: TipTask, period: float = 1e-3, acceleration: Array | None = None
) -> LinePlan:
    """Plan a straight line, or another path.

    Args:
        robot: the arm with its tool.
        task: the line or path.
        period: of the controller's set-points, s. The plan rests at least half of it before and after the
            line, so that the first and the last corner lie between two knots too.
        acceleration: limits of the joints, rad/s², for which a path that is not a line is slowed down; None for none.

    Raises:
        LineError: naming the place on the line that the arm cannot reach, and the reason.
    """
    rest = {name: max(getattr(task, name), period / 2.0) for name in ("rest_before", "rest_after")}
    path = _joint_path(robot, replace(task, **rest), acceleration)  # type: ignore[type-var]
    for step in range(_REFINEMENTS + 1):
        plan = _through(path, _knots(path.task, _WIDEST_SPACING / 2**step, period / 2**step))
        if plan.tip_error <= TIP_TOLERANCE:
            return plan
    probes, error = _tip_errors(plan)
    at = float(
        path.task.profile().sample(probes - path.task.rest_before).distance[int(np.argmax(error))]
    )
    raise LineError(
        f"the tip error between the knots is {plan.tip_error * 1e6:.3g} µm at {at:.3f} m from the start; accepted: <= "
        f"{TIP_TOLERANCE * 1e6:g} µm (a smaller acceleration, or a larger singularity_margin)"
    )


def _knots(task: TipTask, spacing: float, window: float) -> Array:
    """Return the times of the knots, s: around each corner, and in between at most `spacing` apart."""
    corners = task.rest_before + np.array(task.corners())
    end = corners[-1] + task.rest_after
    gaps = np.diff(np.concatenate([[0.0], corners, [end]]))
    # A window never reaches past the middle to the next corner, nor past the trajectory's ends.
    share = np.concatenate([[1.0], np.full(len(gaps) - 2, 0.5), [1.0]]) * gaps
    half = np.minimum(window / 2.0, np.minimum(share[:-1], share[1:]))
    edges = np.sort(np.concatenate([corners - half, corners + half]))
    between = zip(edges[1:-1:2], edges[2:-1:2], strict=True)
    times = [np.linspace(a, b, int(np.ceil((b - a) / spacing)) + 1) for a, b in between]
    times += [np.array([0.0, end]), edges]
    # Messages carry whole nanoseconds; the values must belong to the times that are sent.
    return np.unique(np.round(np.concatenate(times), 9))


def _through(path: JointPath, times: Array) -> LinePlan:
    """Return the plan whose knots are at some times, with its tip error."""
    motion = path.task.profile().sample(times - path.task.rest_before)
    q, slope, bend = path.at(motion.distance)
    speed = motion.speed[:, None]
    acceleration = motion.acceleration[:, None]
    qd = slope * speed + 0.0  # without the signs of zeros
    qdd = slope * acceleration + bend * speed * speed + 0.0
    plan = LinePlan(path, times, q, qd, qdd, 0.0)
    return replace(plan, tip_error=float(_tip_errors(plan)[1].max()))


def _tip_errors(plan: LinePlan) -> tuple[Array, Array]:
    """Return times between the knots, s, and how far the tip then is from where the profile has it, m."""
    probes = np.linspace(plan.times[:-1], plan.times[1:], _PROBES + 2)[1:-1].T.ravel()
    tip = forward(plan.path.robot.chain, plan.setpoints(probes)[:, 0]).position
    return probes, length(tip - plan.tip(probes))


def check_plan(
    plan: LinePlan, limits: JointLimits, period: float, start: Array, delay: float = 0.0
) -> None:
    """Check the set-points of a line as the controller does.

    Args:
        plan: the line.
        limits: the controller's.
        period: of its set-points, s.
        start: the arm's position, rad, shape (n,).
        delay: time of the move to the start of the line, s.

    Raises:
        LineError: if the controller would refuse it, with the reason.
    """
    points = plan.points
    try:
        TrajectoryGenerator(limits, period, start).accept(
            replace(points, times=points.times + delay), 0, None
        )
    except TrajectoryError as error:
        raise LineError(f"the controller would refuse the {plan.task.what}: {error}") from error


def approach_duration(robot: RobotModel, start: Array, end: Array) -> float:
    """Return how long a quintic move between two poses, rad, shape (n,), takes, s."""
    speed = APPROACH_SPEED * robot.max_velocity
    return move_duration(np.abs(end - start), speed, APPROACH_ACCELERATION)


class ApproachedLine(NamedTuple):
    """A plan with the move to its start, ready to be sent.

    Attributes:
        points: of the line; the first one comes after the time of the approach.
        approach: that time, s; 0 if the arm is at the start.
        duration: of both, s.
        farthest: the joint with the longest way to the start.
        way: the length of that way, rad.
    """

    points: TrajectoryPoints
    approach: float
    duration: float
    farthest: str
    way: float


def approached(
    plan: LinePlan, here: Array, limits: JointLimits, period: float, approach: bool
) -> ApproachedLine:
    """Return a line with the move to its start, checked as the controller does.

    Args:
        plan: the line.
        here: the arm's position, rad, shape (n,).
        limits: the controller's.
        period: of its set-points, s.
        approach: whether the arm moves there; else it must be at the start already.

    Raises:
        LineError: if the arm is elsewhere and there is no approach, or if the controller would refuse the approach.
    """
    gap = np.abs(here - plan.start_pose)
    joint = int(np.argmax(gap))
    name = plan.joint_names[joint]
    way = float(gap[joint])
    if way <= limits.start_tolerance:
        return ApproachedLine(plan.points, 0.0, plan.duration, name, way)
    if not approach:
        raise LineError(
            f"{name} is at {here[joint]:.4f} rad, the {plan.task.what} starts at {plan.start_pose[joint]:.4f} rad; "
            f"accepted: within {limits.start_tolerance:g} rad, or --approach"
        )
    duration = math.ceil(approach_duration(plan.path.robot, here, plan.start_pose) * 1e3) / 1e3
    check_plan(plan, limits, period, here, duration)
    points = replace(plan.points, times=plan.times + duration)
    return ApproachedLine(points, duration, plan.duration + duration, name, way)


def describe_line(plan: LinePlan) -> str:
    """Return a table of the plan for a person."""
    task = plan.task
    profile = plan.task.profile()
    begin, end = plan.motion
    lines = [
        f"{task.what:<10}{task.length:.4f} m at {profile.peak_speed:.4g} m/s, {task.acceleration:.4g} m/s^2",
        f"time      {plan.duration:.3f} s, moving from {begin:.3f} s to {end:.3f} s",
        f"knots     {len(plan.times)}, tip error between them {plan.tip_error * 1e6:.3g} µm",
        f"posture   {_posture_text(plan.path)}",
    ]
    lines += [
        f"margin    distance from the {kind} singularity {margin:.3f} (1 is farthest), {_place_text(at)}; accepted: "
        f"from {task.singularity_margin:g} on"
        for kind, (margin, at) in plan.path.margins.items()
    ]
    lines += task.notes()
    lines.append(
        f"{'joint':<10}{'start':>9}{'lowest':>9}{'highest':>9} deg{'peak':>9} deg/s{'of limit':>10}"
    )
    peak = np.abs(plan.velocity).max(axis=0)
    columns = (plan.start_pose, plan.position.min(axis=0), plan.position.max(axis=0), peak)
    share = peak / plan.path.robot.max_velocity
    for name, *values, part in zip(
        plan.joint_names, *(np.degrees(column) for column in columns), share, strict=True
    ):
        start, low, high, fast = values
        lines.append(
            f"{name:<10}{start:9.2f}{low:9.2f}{high:9.2f}    {fast:9.2f}      {part:10.1%}"
        )
    return "\n".join(lines)


def _place_text(at: float) -> str:
    return f"at {at:.3f} m" if at else "at the start"


def _posture_text(path: JointPath) -> str:
    postures = path.postures
    if postures.closed_form is not None:
        return str(path.task.branch)
    if postures.least_speed is not None:
        return "from the first on with the least joint speed: no motion in the null space"
    free = (
        ""
        if path.angles.shape[1] == path.position.shape[1]
        else "; the tool turns about its z axis as the arm does"
    )
    return f"each next to the one before{free}"
