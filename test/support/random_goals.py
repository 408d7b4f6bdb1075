"""Goals of a few hundredths of a second at random, many of them damaged, and what has to become of each."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from action_client import goal, point, stamp
from builtin_interfaces.msg import Duration
from control_msgs.msg import JointTolerance
from numpy.random import Generator
from numpy.typing import NDArray
from ros_client import JOINTS

REJECTED, ABORTED, ANY = "rejected", "aborted", "any"
STRANGE = (np.nan, np.inf, -np.inf)


@dataclass(frozen=True)
class Options:
    """What the controller accepts besides, by the names of its parameters."""

    allow_partial_joints_goal: bool
    allow_nonzero_velocity_at_trajectory_end: bool
    allow_trajectory_replacement: bool
    velocities_from_positions: bool

    @classmethod
    def random(cls, generator: Generator) -> Options:
        """Return any of the sixteen."""
        return cls(*(bool(flag) for flag in generator.integers(0, 2, 4)))


@dataclass(frozen=True)
class Scene:
    """What a goal is made for.

    Attributes:
        now: the controller's time, s.
        pose: set-points, rad, shape (6,).
        acceleration: limits, rad/s^2, shape (6,).
        options: of the controller.
    """

    now: float
    pose: NDArray[np.float64]
    acceleration: NDArray[np.float64]
    options: Options


def sound_goal(generator: Generator, scene: Scene) -> Any:
    """Return a goal that is well formed; whether the arm can follow it from where it is, is left to chance."""
    joints = generator.permutation(6)
    if scene.options.allow_partial_joints_goal and generator.random() < 0.4:
        joints = joints[: generator.integers(1, 6)]
    count, kind = len(joints), generator.integers(0, 3)
    spans = generator.uniform(0.03, 0.15) * generator.dirichlet(np.full(generator.integers(1, 4), 5.0))
    # A motion from rest to rest of d in T needs at least 4 d/T^2, and one with a cubic 6 d/T^2.
    share = generator.choice([0.02, 0.1, 0.3, 2.0], p=[0.3, 0.4, 0.2, 0.1])
    points, pose = [], scene.pose[joints]
    for span, time in zip(spans, np.cumsum(spans), strict=True):
        way = share * scene.acceleration[joints] * span**2 / 6.0 * generator.uniform(-1.0, 1.0, count)
        pose = np.clip(pose + way, scene.pose[joints] - 0.1, scene.pose[joints] + 0.1)
        each = point(time, pose.tolist(), (1.5 * way / span).tolist())
        if kind == 0:
            each.velocities = []
        elif kind == 2:
            each.accelerations = (share * scene.acceleration[joints] * generator.uniform(-1.0, 1.0, count)).tolist()
        points.append(each)
    if kind > 0 and not (scene.options.allow_nonzero_velocity_at_trajectory_end and generator.random() < 0.5):
        points[-1].velocities = [0.0] * count
    start = max(0.0, scene.now + generator.uniform(-0.03, 0.03)) if generator.random() < 0.3 else 0.0
    message = goal(*points, names=[JOINTS[j] for j in joints], start=start)
    if generator.random() < 0.2:  # tolerances, also such as cannot be kept
        limit = float(generator.choice([-1.0, 1e-9, 1e-2]))
        tolerances = [JointTolerance(name=JOINTS[generator.integers(6)], position=limit)]
        setattr(message, generator.choice(["path_tolerance", "goal_tolerance"]), tolerances)
        message.goal_time_tolerance = stamp(Duration, 0.02)
    return message


def wrong_name(generator: Generator, message: Any, _: Scene) -> str:
    """Name a joint that there is not."""
    names = list(message.trajectory.joint_names)
    names[0] = str(generator.choice(["", "elbow", "Joint_1", "joint_7", "joint 1\n"]))
    message.trajectory.joint_names = names
    return REJECTED


def repeated_name(_: Generator, message: Any, __: Scene) -> str:
    """Name a joint twice."""
    message.trajectory.joint_names = [*message.trajectory.joint_names, message.trajectory.joint_names[0]]
    return REJECTED


def no_names(_: Generator, message: Any, __: Scene) -> str:
    """Name no joint."""
    message.trajectory.joint_names = []
    return REJECTED


def no_points(_: Generator, message: Any, __: Scene) -> str:
    """Leave out the points."""
    message.trajectory.points = []
    return REJECTED


def no_number(generator: Generator, message: Any, _: Scene) -> str:
    """Give what is no number as a position, a velocity or an acceleration."""
    each = some_point(generator, message)
    field = generator.choice(["positions", "velocities", "accelerations"])
    values = list(getattr(each, field)) or [0.0] * len(each.positions)
    values[generator.integers(len(values))] = float(generator.choice(STRANGE))
    setattr(each, field, values)
    return REJECTED


def wrong_size(generator: Generator, message: Any, _: Scene) -> str:
    """Give a value too many or too few."""
    each = some_point(generator, message)
    field = generator.choice(["positions", "velocities", "accelerations"])
    values = list(getattr(each, field)) or [0.0] * len(each.positions)
    setattr(each, field, [*values, 0.0] if generator.random() < 0.5 or len(values) == 1 else values[:-1])
    return REJECTED


def no_order(generator: Generator, message: Any, _: Scene) -> str:
    """Let time stand still, or go back, from one point to the next."""
    last = message.trajectory.points[-1]
    back = float(generator.choice([0.0, 0.0, 1e-3, 1.0]))
    time = last.time_from_start.sec + last.time_from_start.nanosec * 1e-9
    # Elsewhere: a last point that says the one before again is no fault.
    again = point(time - back, [position + 1e-3 for position in last.positions], list(last.velocities))
    again.velocities, again.accelerations = last.velocities, last.accelerations
    message.trajectory.points = [*message.trajectory.points, again]
    return REJECTED


def wrong_time(generator: Generator, message: Any, _: Scene) -> str:
    """Give a time before the start, or of years."""
    message.trajectory.points[0].time_from_start = stamp(Duration, float(generator.choice([-1.0, -1e-9, 2e9])))
    return REJECTED


def moving_end(generator: Generator, message: Any, scene: Scene) -> str:
    """Let the last point move."""
    for each in message.trajectory.points:
        each.velocities = generator.uniform(0.01, 0.03, len(each.positions)).tolist()
    return ANY if scene.options.allow_nonzero_velocity_at_trajectory_end else REJECTED


def subset(_: Generator, message: Any, scene: Scene) -> str:
    """Name one joint alone."""
    message.trajectory.joint_names = message.trajectory.joint_names[:1]
    for each in message.trajectory.points:
        for field in ("positions", "velocities", "accelerations"):
            setattr(each, field, getattr(each, field)[:1])
    return ANY if scene.options.allow_partial_joints_goal else REJECTED


def effort(generator: Generator, message: Any, _: Scene) -> str:
    """Ask for torques."""
    each = some_point(generator, message)
    each.effort = [0.0] * len(each.positions)
    return REJECTED


def wrong_tolerance(generator: Generator, message: Any, _: Scene) -> str:
    """Give a tolerance of no joint, or one that means nothing."""
    wrong = [
        JointTolerance(name="elbow", position=0.1),
        JointTolerance(name=JOINTS[0], position=-2.0),
        JointTolerance(name=JOINTS[0], velocity=float("nan")),
    ]
    field = str(generator.choice(["path_tolerance", "goal_tolerance"]))
    setattr(message, field, [wrong[generator.integers(len(wrong))]])
    return REJECTED


def the_past(_: Generator, message: Any, scene: Scene) -> str:
    """Begin so early that all is over."""
    message.trajectory = goal(point(0.01, scene.pose.tolist()), start=max(scene.now - 0.1, 1e-9)).trajectory
    return REJECTED


def the_future(generator: Generator, message: Any, scene: Scene) -> str:
    """Begin in an hour or more."""
    start = scene.now + float(generator.choice([3.7e3, 1e9]))
    message.trajectory.header.stamp = goal(start=start).trajectory.header.stamp
    return ABORTED


def beyond_a_limit(generator: Generator, message: Any, _: Scene) -> str:
    """Go where the arm cannot, or faster than it can."""
    each = message.trajectory.points[-1]
    positions = list(each.positions)
    positions[generator.integers(len(positions))] = float(generator.choice([9.0, -9.0, 1e300, -1e300]))
    each.positions = positions
    return ABORTED


def elsewhere(generator: Generator, message: Any, scene: Scene) -> str:
    """Have a point at the start that is not where the arm is."""
    first = message.trajectory.points[0]
    away = point(0.0, (np.array(first.positions) + generator.uniform(0.05, 0.5)).tolist(), list(first.velocities))
    away.velocities, away.accelerations = first.velocities, first.accelerations
    message.trajectory.header.stamp = goal().trajectory.header.stamp
    message.trajectory.points = [away, *message.trajectory.points]
    return ANY if scene.options.allow_trajectory_replacement else ABORTED


Damage = Callable[[Generator, Any, Scene], str]
DAMAGES: tuple[Damage, ...] = (
    wrong_name, repeated_name, no_names, no_points, no_number, wrong_size, no_order, wrong_time, moving_end, subset,
    effort, wrong_tolerance, the_past, the_future, beyond_a_limit, elsewhere,
)  # fmt: skip


def some_point(generator: Generator, message: Any) -> Any:
    """Return one of a goal's points."""
    return message.trajectory.points[generator.integers(len(message.trajectory.points))]


def random_goal(generator: Generator, scene: Scene) -> tuple[Any, str, str]:
    """Return a goal, what has to become of it (REJECTED, ABORTED or ANY), and what is wrong with it, if anything is."""
    message = sound_goal(generator, scene)
    if generator.random() < 0.5:
        return message, ANY, "nothing"
    damage = DAMAGES[generator.integers(len(DAMAGES))]
    return message, damage(generator, message, scene), damage.__name__
