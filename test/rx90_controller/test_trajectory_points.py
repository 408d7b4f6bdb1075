"""The points of trajectories and the paths through them: against SciPy, and refused by point, joint and reason."""

import itertools
import math
from typing import Any

import numpy as np
import pytest
from joint_moves import NAMES, ZERO
from scipy.interpolate import BPoly

from rx90_common.base.arrays import Array
from rx90_common.base.errors import Rx90Error, TrajectoryError
from rx90_controller.trajectory import JointLimits, TrajectoryPoints
from rx90_controller.trajectory.paths import straight
from rx90_controller.trajectory.spline import interpolate

ROW = [0.1, 0.2, 0.3, 0.4, 0.5, 0.6]
REST = [0.0] * 6


def create(**changed: Any) -> TrajectoryPoints:
    given: dict[str, Any] = {
        "robot_joints": NAMES,
        "joint_names": NAMES,
        "times": [1.0, 2.0, 3.0],
        "position": [ROW, ROW, ROW],
        "velocity": [REST, REST, REST],
        "acceleration": [REST, REST, REST],
    }
    return TrajectoryPoints.create(**(given | changed))


def test_joints_may_come_in_any_order() -> None:
    plain = create(position=[ROW, REST, ROW], velocity=[ROW, ROW, REST], acceleration=[ROW, REST, ROW])
    for order in itertools.islice(itertools.permutations(range(6)), 0, 720, 7):
        shuffled = create(
            joint_names=[NAMES[i] for i in order],
            position=[[row[i] for i in order] for row in (ROW, REST, ROW)],
            velocity=[[row[i] for i in order] for row in (ROW, ROW, REST)],
            acceleration=[[row[i] for i in order] for row in (ROW, REST, ROW)],
        )
        for table in ("times", "position", "velocity", "acceleration"):
            assert np.array_equal(getattr(shuffled, table), getattr(plain, table))


NAN_ROW = [0.1, 0.2, math.nan, 0.4, 0.5, 0.6]
REFUSALS: list[tuple[dict[str, Any], str]] = [
    ({"joint_names": (*NAMES[:5], "joint_9")}, "unknown joint 'joint_9'; accepted: joint_1, joint_2"),
    ({"joint_names": (*NAMES[:5], "joint_1")}, "joint 'joint_1' stands 2 times; accepted: once"),
    ({"joint_names": (), "partial": True}, "no joints; accepted: joint_1, joint_2"),
    ({"times": [], "position": [], "velocity": [], "acceleration": []}, "no points; accepted: at least one"),
    ({"times": [1.0, 1.0, 2.0]}, "point 1: time_from_start 1 s after 1 s; accepted: increasing"),
    ({"position": [ROW, ROW[:5], ROW]}, "point 1: 5 positions; accepted: 6"),
    ({"velocity": [REST, [], REST]}, "point 1: accelerations without velocities; accepted: velocities too"),
    ({"position": [ROW, ROW, NAN_ROW]}, "point 2: positions of joint_3: nan; accepted: a finite number"),
    ({"velocity": [REST, REST, [0, 0, 0, 0, -0.1, 0]]}, "point 2: joint_5 ends at -0.1 rad/s; accepted: 0"),
]


@pytest.mark.parametrize(("changed", "words"), REFUSALS, ids=[words[:40] for _, words in REFUSALS])
def test_a_bad_trajectory_is_refused_by_point_joint_and_reason(changed: dict[str, Any], words: str) -> None:
    with pytest.raises(TrajectoryError) as caught:
        create(**changed)
    assert words in str(caught.value)
    assert "\n" not in str(caught.value)
    assert isinstance(caught.value, Rx90Error)


@pytest.mark.parametrize("later", [0.0, 5e-17, 2e-9, 0.9e-3])
def test_a_last_point_that_says_the_one_before_again_takes_its_place(later: float) -> None:
    """A plan sampled each 0.1 s whose duration is 0.2 s and little more has its end twice, and is taken once."""
    again = {"times": [0.1, 0.2, 0.2 + later], "position": [ROW, REST, [1e-16] * 6]}
    got = create(**again, velocity=[REST, [1e-10] * 6, REST])
    assert got.times.tolist() == [0.1, 0.2 + later]
    assert got.position.tolist() == [ROW, [1e-16] * 6]
    for other in ({"position": [ROW, REST, [2e-4] * 6]}, {"velocity": [REST, [0.1] * 6, REST]}):
        if later < 1e-9:
            with pytest.raises(TrajectoryError, match=r"point 2: time_from_start 0\.2 s after 0\.2 s"):
                create(**(again | other))
        else:
            assert len(create(**(again | other)).times) == 3
    for apart in (0.999999999e-3, 1e-3):
        assert len(create(**(again | {"times": [0.1, 0.2, 0.2 + apart]})).times) == 3
    with pytest.raises(TrajectoryError, match=r"point 2: time_from_start 0\.1999 s after 0\.2 s"):
        create(**(again | {"times": [0.1, 0.2, 0.1999]}))


def test_rest_is_what_joint_trajectory_controller_takes_for_it() -> None:
    """Up to float's epsilon the velocity at the end is 0; the next number is refused, and allowed as what it is."""
    epsilon = 2.0**-23
    for value in (5e-17, -1e-15, epsilon, -epsilon):
        assert not create(velocity=[REST, REST, [value] * 6]).velocity[-1].any()
    beyond = [0.0, float(np.nextafter(epsilon, 1.0)), 0.0, 0.0, 0.0, 0.0]
    with pytest.raises(TrajectoryError, match=r"joint_2 ends at 1\.19209e-07 rad/s; accepted: 0 within 1\.19e-07"):
        create(velocity=[REST, REST, beyond])
    assert create(velocity=[REST, REST, beyond], moving_end=True).velocity[-1].tolist() == beyond


TIMES = np.array([0.0, 0.13, 0.5, 0.51, 1.7, 2.0])
RNG = np.random.default_rng(11)
POSITION = RNG.uniform(-1.0, 1.0, (6, 6))
VELOCITY = RNG.uniform(-2.0, 2.0, (6, 6))
ACCELERATION = RNG.uniform(-9.0, 9.0, (6, 6))
INSIDE = np.sort(RNG.uniform(0.0, 2.0, 500))


@pytest.mark.parametrize("acceleration", [None, ACCELERATION], ids=["cubic", "quintic"])
def test_set_points_are_those_of_scipy_s_splines(acceleration: Array | None) -> None:
    """With velocities they are the cubic's and its two derivatives, with accelerations the quintic's."""
    got = interpolate(TIMES, POSITION, VELOCITY, acceleration).sample(INSIDE)
    given = [POSITION, VELOCITY] if acceleration is None else [POSITION, VELOCITY, acceleration]
    spline = BPoly.from_derivatives(TIMES, np.stack(given, axis=1))
    for order in range(3):
        want = spline(INSIDE, order)
        assert got[:, order] == pytest.approx(want, abs=1e-10 * np.abs(want).max())


MOST = np.array([8.0, 10.0, 12.0, 8.0, 20.0, 30.0])
LIMITS = JointLimits(NAMES, np.full(6, -9.0), np.full(6, 9.0), np.full(6, 99.0), MOST, 1e-3)
WAY = np.array([0.5, -0.4, 0.3, 0.0, 0.2, -0.1])


def averaged(times: Array, position: Array, at: Array, half: Array) -> Array:
    """Return the mean of the straight lines over `at` - `half` to `at` + `half`, shape (len(at), 6)."""
    share = np.linspace(-1.0, 1.0, 2001)
    weight = np.full(2001, 1.0)
    weight[[0, -1]] = 0.5
    windows = at[:, None] + half[:, None] * share
    return np.stack(
        [np.interp(windows, times, position[:, j]) @ weight / weight.sum() for j in range(6)], axis=1
    )  # the trapezoidal rule is exact to (half/1000)^2 at the corner


def test_one_line_from_rest_to_rest_is_a_trapezoid_of_the_velocity() -> None:
    """The way is v (T - tau), v = a tau in the joint that needs most, and every joint at the same share of its way."""
    got = straight(np.array([0.0, 1.0]), np.stack([ZERO, WAY]), ZERO, LIMITS)
    tau = (1.0 - np.sqrt(1.0 - 4.0 * np.abs(WAY) / MOST)).max() / 2.0
    peak = WAY / (1.0 - tau)
    assert np.abs(peak / tau / MOST).max() == pytest.approx(1.0)
    sampled = got.sample(np.linspace(0.0, 1.0, 401))
    t = np.linspace(0.0, 1.0, 401)[:, None]
    np.testing.assert_allclose(sampled[:, 1], peak * np.clip(np.minimum(t, 1.0 - t) / tau, 0.0, 1.0), atol=1e-12)
    share = sampled[:, 0, 0] / WAY[0]
    np.testing.assert_allclose(sampled[:, 0], share[:, None] * WAY, atol=1e-13)
    assert np.all(got.sample(np.array([1.0, 2.0]))[:, 0] == WAY)


def test_between_its_ends_it_is_the_mean_of_the_lines_over_each_ramp() -> None:
    """Around a point in between, a ramp of duration 2h gives the lines averaged over 2h, and misses it by dv^2/8a."""
    times = np.array([0.0, 0.8, 1.5, 2.4])
    position = np.stack([ZERO, WAY, WAY + np.array([0.1, 0.2, -0.3, 0.4, 0.0, 0.0]), ZERO])
    got = straight(times, position, ZERO, LIMITS)
    slope = np.diff(position, axis=0) / np.diff(times)[:, None]
    at = np.linspace(0.8, 1.5, 41)
    inner = got.sample(at)
    # The first and the last line are faster than their slope, by what their ramps at rest lose.
    fast = [got.sample(np.array([t]))[0, 1] for t in (0.5, 1.9)]
    half = [(np.abs(a - b) / MOST / 2.0).max() for a, b in ((fast[0], slope[1]), (slope[1], fast[1]))]
    lines = np.stack([position[1] - 0.8 * fast[0], position[1], position[2], position[2] + 0.9 * fast[1]])
    width = np.where(at < 1.15, half[0], half[1])
    width = np.where((at > 0.8 + half[0]) & (at < 1.5 - half[1]), 1e-9, width)
    assert inner[:, 0] == pytest.approx(averaged(times, lines, at, width), abs=1e-7)
    blend_error = np.abs(got.sample(np.array([0.8, 1.5]))[:, 0] - position[1:3]).max()
    assert got.blend_error == pytest.approx(blend_error)
    assert got.sample(np.array([np.nextafter(2.4, 0.0)]))[0, 0] == pytest.approx(position[3], abs=1e-12)


@pytest.mark.parametrize("count", [1, 2, 3])
def test_it_ends_with_a_velocity_as_it_begins_with_one_backwards(count: int) -> None:
    """Seen backwards in time, lines from one velocity to another are those from the other, reversed, to the one."""
    begin, end = np.array([0.3, -0.2, 0.1, 0.0, 0.5, 0.2]), np.array([0.2, -0.3, 0.4, 0.1, 0.0, -1.0])
    times, position = np.arange(count + 1.0), np.stack([ZERO, WAY, 0.5 * WAY, WAY])[: count + 1]
    at = np.linspace(1e-4, count - 1e-4, 301)
    for first, last in ((ZERO, end), (begin, end)):
        got = straight(times, position, first, LIMITS, end_velocity=last).sample(at)
        back = straight(times, position[::-1], -last, LIMITS, end_velocity=-first).sample(count - at)
        np.testing.assert_allclose(got[:, 0], back[:, 0], atol=1e-12)
        np.testing.assert_allclose(got[:, 1], -back[:, 1], atol=1e-11)
        assert (np.abs(got[-1, 1] - last) <= MOST * 1e-4 * (1 + 1e-9)).all()
        assert (np.abs(np.diff(got[:, 1], axis=0)) <= MOST * np.diff(at)[:, None] * (1 + 1e-9) + 1e-12).all()


@pytest.mark.parametrize(
    ("times", "said"),
    [
        ([0.0, 0.4], r"^point 1: joint_1 cannot go 0.5 rad in 0.4 s with its ramps of 8 rad/s\^2; accepted: a later"),
        ([0.0, 1.0, 1.05, 2.0], r"^point 2: 0.05 s after the point before, the ramps of the velocity take 1.3\d+ s;"),
        ([0.0, 0.2, 1.0], "^point 1: joint_1 cannot go 0.5 rad in 0.2 s"),
        ([0.0, 1.0, 1.2], "^point 2: joint_1 cannot go -0.5 rad in 0.2 s"),
    ],
)
def test_points_that_come_too_early_are_refused(times: list[float], said: str) -> None:
    position = np.stack([ZERO, WAY, ZERO, WAY])[: len(times)]
    with pytest.raises(TrajectoryError, match=said):
        straight(np.array(times), position, ZERO, LIMITS)
