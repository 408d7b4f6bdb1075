"""Goals at random, many of them damaged: refused with a reason, or followed within the limits."""

from __future__ import annotations

import copy
from types import SimpleNamespace
from typing import Any
from unittest import mock

import numpy as np
from goal_arm import LIMITS
from joint_moves import NAMES, PERIOD, stamp, trajectory
from numpy.random import Generator
from numpy.typing import NDArray

from rx90_common.base.errors import TrajectoryError
from rx90_common.base.rates import Rates
from rx90_controller.node.servo_loop import ServoLoop
from rx90_controller.servo.events import Cancel, Offer
from rx90_controller.servo.states import Holding
from rx90_controller.trajectory import TrajectoryGenerator
from rx90_controller.trajectory.request import (
    GoalOptions,
    GoalTolerances,
    JoinedAhead,
    TrajectoryRequest,
    check_request,
)

GOALS = 500


def random_goal(generator: Generator, now: float, options: GoalOptions) -> SimpleNamespace:
    """Return a goal that may or may not be one."""
    names = list(generator.permutation(NAMES))
    if options.allow_partial_joints_goal and generator.random() < 0.4:
        names = names[: generator.integers(1, 6)]
    n, kind = len(names), generator.integers(0, 3)
    times = np.cumsum(generator.uniform(0.02, 0.6, generator.integers(1, 7)))
    scale = generator.choice([0.02, 0.1, 0.5])
    speeds = list(generator.uniform(-scale, scale, (len(times), n))) if kind > 0 else []
    bends = list(generator.uniform(-1.0, 1.0, (len(times), n))) if kind > 1 else []
    if kind > 0 and not (options.allow_nonzero_velocity_at_trajectory_end and generator.random() < 0.5):
        speeds[-1] = np.zeros(n)
    start = now + generator.uniform(-0.5, 0.5) if generator.random() < 0.4 else 0.0
    places = generator.uniform(-scale, scale, (len(times), n))
    sent = trajectory(times, places, speeds, bends, start=max(start, 0.0), names=names)
    if generator.random() < 0.3:
        damage(generator, sent)
    several = SimpleNamespace(joint_names=[], points=[])
    return SimpleNamespace(
        trajectory=sent, multi_dof_trajectory=several, path_tolerance=[], goal_tolerance=[],
        component_path_tolerance=[], component_goal_tolerance=[], goal_time_tolerance=stamp(0.0),
    )  # fmt: skip


def damage(generator: Generator, sent: Any) -> None:
    """Break one thing."""
    point = sent.points[generator.integers(len(sent.points))]
    strange = [np.nan, np.inf, -np.inf, 1e300, -1e300, 1e-300]
    match generator.integers(0, 6):
        case 0:
            point.positions[0] = generator.choice(strange)
        case 1:
            point.velocities = [generator.choice(strange)] * len(sent.joint_names)
        case 2:
            point.positions.append(0.0)
        case 3:
            sent.joint_names[0] = generator.choice(["", "elbow", NAMES[0], "\0"])
        case 4:
            sent.points.append(copy.deepcopy(point))
        case _:
            point.time_from_start = stamp(generator.choice([-1.0, 0.0, 1e-9, 3e9]))


def test_goals_at_random_are_refused_with_a_reason_or_followed_within_the_limits() -> None:
    """Each of 500 goals is refused in one line, or followed; no set-point leaves the limits of any quantity."""
    generator = np.random.default_rng(20)
    follower = TrajectoryGenerator(LIMITS, PERIOD, np.zeros(6))
    cs7b: Any = SimpleNamespace(
        trajectory=follower, joint_names=NAMES, rates=Rates(), position_tick=1000, command=np.zeros(6)
    )
    outputs: Any = mock.Mock()
    loop = ServoLoop(cs7b, outputs, 60.0, 1)
    loop.state = Holding()
    tolerances = GoalTolerances.of_parameters(NAMES)
    active: TrajectoryRequest | None = None
    now, handed_over, reasons, path = 1000, 0, [], []
    for _ in range(GOALS):
        options = GoalOptions(**{name: bool(generator.integers(0, 2)) for name in GoalOptions.model_fields})
        try:
            message = random_goal(generator, now * PERIOD, options)
            goal = check_request(message.trajectory, tolerances, options, 1000, message)
            goal.on_result, plan = mock.Mock(), None
            if generator.random() < 0.5:
                plan = JoinedAhead(goal, follower, now)
                plan.compute()
                if generator.random() < 0.3:
                    follower.halt(now)
                path.append(follower.setpoints(now, meanwhile := int(generator.integers(0, 40))))
                now += meanwhile
                follower.ended(now)
            cs7b.position_tick = now
            plan = plan if plan is not None and plan.fits(now) else None
            with mock.patch.object(follower, "join", wraps=follower.join) as joined:
                loop.post(Offer(goal, plan))
            if not goal.reason:
                handed_over += not joined.called
                assert active is None or active.reason
                active = goal
            else:
                reasons.append(goal.reason)
                assert active is None or not active.reason or active.reason.startswith("cancelled")
        except TrajectoryError as error:
            reasons.append(str(error))
        count = int(generator.integers(0, 400))
        cs7b.position_tick = now
        if generator.random() < 0.1 and active is not None:
            loop.post(Cancel(active))
        if generator.random() < 0.1:
            follower.set_speed_scaling(float(generator.choice([0.0, 0.3, 1.0, 1.0])), now)
        path.append(follower.setpoints(now, count))
        now += count
    assert 0.2 * GOALS < len(reasons) < 0.8 * GOALS
    assert all(reason and "\n" not in reason for reason in reasons)
    assert handed_over > 0.02 * GOALS
    check(np.concatenate(path))


def check(path: NDArray[np.float64]) -> None:
    """Check set-points, shape (n, 3, 6), against the limits, and against each other."""
    position, velocity, _ = path.transpose(1, 0, 2)
    slack = 1.0 + 2e-3
    assert np.isfinite(path).all()
    assert (position <= LIMITS.upper).all()
    assert (position >= LIMITS.lower).all()
    assert (np.abs(velocity) <= LIMITS.velocity * slack).all()
    assert (np.abs(np.diff(velocity, axis=0)) <= LIMITS.acceleration * PERIOD * slack).all()
    moved = np.diff(position, axis=0) - 0.5 * PERIOD * (velocity[1:] + velocity[:-1])
    assert (np.abs(moved) <= 0.25 * LIMITS.acceleration * PERIOD**2 * slack).all()
    assert (np.abs(np.diff(position, 2, axis=0)) <= LIMITS.acceleration * PERIOD**2 * slack).all()
