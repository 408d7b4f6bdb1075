"""Trajectories that are joined to the motion: at once, or beside the ticks."""

from collections.abc import Sequence

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from joint_moves import HOME, NAMES, PERIOD, ZERO, points, within_limits
from scipy.interpolate import BPoly

from rx90_common.base.arrays import Array
from rx90_common.base.errors import TrajectoryError
from rx90_controller.trajectory import JointLimits, TrajectoryGenerator

MOST = np.array([18.0, 12.0, 12.0, 40.0, 40.0, 60.0])
LIMITS = JointLimits(NAMES, np.full(6, -3.0), np.full(6, 3.0), np.full(6, 4.0), MOST, 1e-3)


@pytest.fixture
def generator() -> TrajectoryGenerator:
    generator = TrajectoryGenerator(LIMITS, PERIOD, HOME)
    generator.accept(points([1.0], [HOME + 0.4], [ZERO]), 0, None)
    return generator


def hermite(times: Sequence[float], rows: Sequence[Sequence[Array]]) -> BPoly:
    return BPoly.from_derivatives(times, np.asarray(rows))


@pytest.mark.parametrize(
    ("first", "velocity", "words"),
    [
        (HOME + 0.402, ZERO, "point 0: joint_1 starts at 0.502 rad, the set-point there is 0.5 rad; accepted: within"),
        (HOME + 0.4, ZERO + 0.5, "point 0: joint_1 starts at 0.5 rad/s, the set-point there moves at 0 rad/s"),
    ],
)
def test_points_elsewhere_need_leave(generator: TrajectoryGenerator, first: Array, velocity: Array, words: str) -> None:
    """A point at the begin away from the set-point, or from its velocity, is refused; with leave it is left out."""
    generator.setpoints(0, 1200)
    there = points([0.0, 0.5], [first, HOME], [velocity, ZERO])
    with pytest.raises(TrajectoryError) as caught:
        generator.join(there, 1200, None, anywhere=False)
    assert str(caught.value).startswith(words)
    assert np.all(generator.setpoints(1200, 10)[:, 0] == HOME + 0.4)
    generator.join(there, 1200, None, anywhere=True)
    within_limits(generator.setpoints(1199, 700), MOST)
    assert np.all(generator.setpoints(1800)[0, 0] == HOME)


def test_points_of_the_past_are_left_out(generator: TrajectoryGenerator) -> None:
    """From a stamp in the past the motion goes to the points that are still to come, at their times."""
    way = [HOME + 0.05, HOME + 0.2, HOME + 0.3, HOME + 0.1]
    velocity = [ZERO + 0.2, ZERO + 0.3, ZERO + 0.1, ZERO]
    generator.join(points([0.1, 0.3, 0.8, 1.2], way, velocity), 400, 100, anywhere=False)
    got = generator.setpoints(399, 1500)
    within_limits(got, MOST)
    before = hermite([0.0, 1.0], [[HOME, ZERO], [HOME + 0.4, ZERO]])
    rows = [[before(0.4), before(0.4, 1)], [way[2], velocity[2]], [way[3], ZERO]]
    curve = hermite([0.4, 0.9, 1.3], rows)
    assert got[1:901, 0] == pytest.approx(curve(0.4 + np.arange(900) * PERIOD), abs=1e-9)
    assert np.all(got[902:, 0] == way[3])


REQUESTS = ("join", "join", "accept", "scale", "scale", "halt", "stop", "delay")


@given(seed=st.integers(0, 2**32 - 1))
@settings(max_examples=40)
def test_whatever_is_asked_for_the_accelerations_are_kept(seed: int) -> None:
    """However trajectories, scalings, stops and delays follow each other: taken within the limits, or refused."""
    rng = np.random.default_rng(seed)
    generator, tick, got = TrajectoryGenerator(LIMITS, PERIOD, HOME), 1, []
    got.append(generator.setpoints(0))
    for _ in range(rng.integers(4, 12)):
        what, count = rng.choice(REQUESTS), int(rng.integers(1, 400))
        start = None if rng.random() < 0.5 else tick + int(rng.integers(-100, 500))
        names = rng.permutation(NAMES)[: rng.integers(1, 7)].tolist()
        n, m = int(rng.integers(1, 4)), len(names)
        times = np.cumsum(rng.uniform(0.15, 1.2, n)).tolist()
        rates = list(0.5 * rng.uniform(-1.0, 1.0, (n, m)) * rng.integers(0, 2))
        try:
            some = points(times, list(rng.uniform(-0.4, 0.4, (n, m))), rates, names, moving_end=True)
            if what == "join":
                generator.join(some, tick, start, anywhere=bool(rng.random() < 0.5))
            elif what == "accept":
                generator.accept(some, tick, start)
            elif what == "scale":
                generator.set_speed_scaling(float(rng.choice([0.0, 0.02, 0.5, rng.random(), 1.0])), tick)
            elif what == "halt":
                generator.halt(tick)
            elif what == "stop":
                generator.stop(tick, start)
        except TrajectoryError:
            pass
        if what == "delay":
            tick += count
            generator.delay(count, tick)
        else:
            got.append(generator.setpoints(tick, count))
            tick += count
    within_limits(np.concatenate(got), MOST)


def test_joints_that_are_not_named_hold(generator: TrajectoryGenerator) -> None:
    """At rest they stay to the bit; in motion they brake with their acceleration, and the named ones go their way."""
    other = [0, 2, 3, 5]
    names = ["joint_5", "joint_2"]
    target = np.array([0.3, -0.5])
    generator.join(points([1.0], [target], [np.zeros(2)], names), 500, None, anywhere=False)
    got = generator.setpoints(499, 1600)
    within_limits(got, MOST)
    moving = hermite([0.0, 1.0], [[HOME, ZERO], [HOME + 0.4, ZERO]])
    position, velocity = moving(0.5), moving(0.5, 1)
    assert got[-1, 0, other] == pytest.approx((position + velocity**2 / (2.0 * MOST))[other], abs=1e-9)
    named = hermite([0.0, 1.0], [[position[[4, 1]], velocity[[4, 1]]], [target, np.zeros(2)]])
    assert got[1:1001][:, 0, [4, 1]] == pytest.approx(named(np.arange(1000) * PERIOD), abs=1e-9)
    generator.join(points([1.0], [HOME[:1]], None, NAMES[:1]), 2200, None, anywhere=False)
    still = generator.setpoints(2200, 1200)
    assert np.all(still[:, :, 1:] == still[0, :, 1:])
    assert still[-1, 0, 0] == HOME[0]


def test_joints_that_are_not_named_may_follow_the_running_trajectory(generator: TrajectoryGenerator) -> None:
    """With leave to replace, they go on to where the running trajectory leads them, as it would have."""
    twin = TrajectoryGenerator(LIMITS, PERIOD, HOME)
    twin.accept(points([1.0], [HOME + 0.4], [ZERO]), 0, None)
    generator.join(points([0.6], [HOME[1:2] + 0.3], [np.zeros(1)], NAMES[1:2]), 500, None, anywhere=True)
    got = generator.setpoints(500, 1000)
    within_limits(np.concatenate([twin.setpoints(499), got]), MOST)
    rest = [0, 2, 3, 4, 5]
    assert got[:, 0, rest] == pytest.approx(twin.setpoints(500, 1000)[:, 0, rest], abs=1e-12)
    assert np.all(got[601:, 0, 1] == HOME[1] + 0.3)


def test_a_last_point_with_a_velocity_is_passed_and_braked_behind(generator: TrajectoryGenerator) -> None:
    """Where that is allowed, the last point is met with its velocity, and each joint comes to rest behind it."""
    generator.setpoints(0, 1200)
    velocity = np.array([0.4, -0.3, 0.2, 0.5, -0.5, 0.6])
    last = HOME + 0.5
    with pytest.raises(TrajectoryError, match=r"joint_6 ends at 0\.6 rad/s; accepted: 0 within .*, the arm rests"):
        points([0.6], [last], [velocity])
    generator.accept(points([0.6], [last], [velocity], moving_end=True), 1200, None)
    got = generator.setpoints(1199, 1500)
    within_limits(got, MOST)
    assert got[601, :2] == pytest.approx(np.array([last, velocity]), abs=1e-9)
    assert got[-1, 0] == pytest.approx(last + velocity * np.abs(velocity) / (2.0 * MOST), abs=1e-9)
    assert generator.progress(1800) == pytest.approx((0.6, 0.6))


def test_accelerations_count_between_set_points_too(generator: TrajectoryGenerator) -> None:
    """Points within a tick that no set-point sees are refused: at a lower speed the motion would show them."""
    generator.setpoints(0, 1200)
    aside = HOME + 0.4 + [0, 0, 0, 1e-4, 0, 0]
    way = [HOME + 0.4, aside, HOME + 0.4, HOME + 0.4]
    with pytest.raises(TrajectoryError) as caught:
        generator.accept(points([0.1002, 0.1005, 0.1008, 0.5], way, [ZERO] * 4), 1200, None)
    said = str(caught.value)
    assert said.startswith("point 1: joint_4 gets an acceleration of 6666.67 rad/s^2 on the way there, between two")
    assert "at 0.1002 s; accepted: [-40, 40], or velocities_from_positions" in said
