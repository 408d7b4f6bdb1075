"""Speed along the path: slower, faster, held, stopped, without leaving it and within the accelerations."""

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st
from joint_moves import HOME, NAMES, PERIOD, ZERO, points, within_limits
from scipy.interpolate import CubicHermiteSpline
from scipy.spatial import cKDTree

from rx90_common.base.arrays import Array
from rx90_common.base.errors import TrajectoryError
from rx90_controller.trajectory import JointLimits, TrajectoryGenerator

MOST = np.array([18.0, 6.0, 12.0, 40.0, 40.0, 60.0])
LIMITS = JointLimits(NAMES, np.full(6, -3.0), np.full(6, 3.0), np.full(6, 4.0), MOST, 1e-3)
TIMES = np.array([0.0, 0.4, 0.9, 1.3])
WAY = HOME + np.array([ZERO, [0.3, -0.1, 0.2, 0.4, -0.2, 0.1], [0.2, 0.1, 0.3, -0.2, 0.2, 0.3], ZERO])
SPEED = np.array([ZERO, [0.3, 0.2, 0.3, -0.4, 0.5, 0.5], [-0.5, 0.1, -0.3, -0.5, 0.4, -0.2], ZERO])
CURVE = CubicHermiteSpline(TIMES, WAY, SPEED)  # what SciPy makes of the trajectory that most tests follow


def following() -> TrajectoryGenerator:
    generator = TrajectoryGenerator(LIMITS, PERIOD, HOME)
    generator.accept(points(TIMES, WAY, SPEED), 0, None)
    return generator


@pytest.fixture
def generator() -> TrajectoryGenerator:
    return following()


def followed_within_limits(setpoints: Array) -> None:
    within_limits(setpoints, MOST)
    assert (np.abs(setpoints[:, 2]) <= MOST * (1 + 1e-3)).all()


def off_the_path(position: Array, curve: CubicHermiteSpline = CURVE) -> float:
    """Return how far positions are from a curve at most, rad: from the chord between its nearest samples."""
    samples = curve(np.linspace(curve.x[0], curve.x[-1], 4001))
    nearest = np.clip(cKDTree(samples).query(position)[1], 1, len(samples) - 2)
    distances = []
    for begin, end in ((samples[nearest - 1], samples[nearest]), (samples[nearest], samples[nearest + 1])):
        chord = end - begin
        share = np.clip(((position - begin) * chord).sum(1) / np.maximum((chord * chord).sum(1), 1e-300), 0.0, 1.0)
        distances.append(np.linalg.norm(position - begin - share[:, None] * chord, axis=1))
    return float(np.min(distances, axis=0).max())


def test_at_full_speed_not_a_bit_changes(generator: TrajectoryGenerator) -> None:
    """Told to follow at full speed, a running, a waiting and the next trajectory are those of a generator not told."""
    twin = following()
    generator.set_speed_scaling(1.0, 100)
    for each in (generator, twin):
        each.accept(points(np.array([0.7]), HOME[None], ZERO[None]), 100, 500)
    generator.set_speed_scaling(1.0, 200)
    assert np.array_equal(generator.setpoints(100, 1500), twin.setpoints(100, 1500))


@pytest.mark.parametrize("factor", [0.5, 0.3, 1e-3])
def test_a_trajectory_from_rest_is_that_of_a_slower_clock(factor: float) -> None:
    """With a constant scaling f, q(t) is that of the trajectory at f t, with f and f^2 times its derivatives."""
    generator = TrajectoryGenerator(LIMITS, PERIOD, HOME)
    generator.set_speed_scaling(factor, 0)
    generator.accept(points(TIMES, WAY, SPEED), 0, 20)
    got = generator.setpoints(0, 3000)
    assert np.all(got[:20, 0] == HOME)
    at = factor * np.arange(2980) * PERIOD
    moving = at < TIMES[-1]
    for row in range(3):
        wanted = factor**row * CURVE(at[moving], row)
        assert np.abs(got[20:][moving, row] - wanted).max() < 1e-9
    assert np.all(got[20:][~moving, 0] == HOME)
    followed_within_limits(got)
    assert [generator.moving(k) for k in (0, 19, 20 + int(1.29 / factor / PERIOD))] == [True] * 3


@given(changes=st.lists(st.tuples(st.integers(1, 250), st.sampled_from([0.0, 0.02, 0.4, 0.9, 1.0])), max_size=8))
@example(changes=[(1, 0.0)])
@settings(max_examples=25)
def test_whenever_the_speed_changes_the_path_and_the_limits_are_kept(changes: list[tuple[int, float]]) -> None:
    """Along a curved path at any scaling, changed at any time, set-points lie on it and step within the limits."""
    generator = following()
    got, tick = [generator.setpoints(0)], 1
    for count, factor in [*changes, (50, 1.0)]:
        generator.set_speed_scaling(factor, tick)
        ahead = generator.setpoints(tick, count)
        # However the ticks are grouped, the set-points are the same to the last bit.
        again = [generator.setpoints(tick + k) for k in range(0, count, 9)]
        assert np.array_equal(ahead[::9], np.concatenate(again))
        got.append(ahead)
        tick += count
    got.append(generator.setpoints(tick, 4000))
    setpoints = np.concatenate(got)
    followed_within_limits(setpoints)
    assert off_the_path(setpoints[::11, 0]) < 1e-6
    assert np.all(setpoints[-1] == [HOME, ZERO, ZERO])
    assert not generator.moving(tick + 4000)


def test_the_change_of_speed_is_as_quick_as_the_accelerations_allow() -> None:
    """On a straight path at constant velocity v the rate changes by a/v a second, a being what the first joint has."""
    generator = TrajectoryGenerator(LIMITS, PERIOD, ZERO)
    way = np.array([2.0, 0.1, 0.1, 0.0, 0.0, 0.0])
    # Cruising at 2 rad/s from 0.5 s on; joint 1 may change that by 18 rad/s^2, within 0.111 s.
    cruise = np.array([-0.75 * way, -0.5 * way, 0.5 * way, 0.75 * way])
    generator.reset(cruise[0])
    generator.accept(points([0.0, 0.5, 1.5, 2.0], cruise, [ZERO, way, way, ZERO]), 0, None)
    generator.set_speed_scaling(0.0, 700)
    got = generator.setpoints(700, 150)
    rest = int(np.argmax(np.all(got[:, 1] == 0.0, axis=1)))
    assert rest == pytest.approx(2.0 / 18.0 / PERIOD, abs=2)
    assert got[5:100, 2, 0] == pytest.approx(-18.0, rel=1e-3)


def test_what_waits_at_rest_starts_in_time_whatever_the_scaling(generator: TrajectoryGenerator) -> None:
    """At rest a change of the scaling moves no start; the trajectory begins in its tick and runs at the new speed."""
    generator.setpoints(0, 1400)
    generator.accept(points(np.array([1.0]), HOME[None] + 0.1, ZERO[None]), 1400, 2000)
    generator.set_speed_scaling(0.25, 1500)
    assert generator.speed_scaling(1500) == 0.25
    got = generator.setpoints(1500, 5000)
    assert np.all(got[:501, 0] == HOME)
    assert got[500 + 2000, 0] == pytest.approx(HOME + 0.05)
    assert np.any(got[499 + 4000, 0] != HOME + 0.1)
    assert np.all(got[501 + 4000, 0] == HOME + 0.1)


def test_what_waits_behind_a_running_one_comes_later_by_as_much(generator: TrajectoryGenerator) -> None:
    """Slowed down while another trajectory waits in mid-motion, both are one path that is followed more slowly."""
    unscaled = following()
    for each in (generator, unscaled):
        each.accept(points(np.array([0.8]), HOME[None], ZERO[None]), 100, 600)
    samples = unscaled.setpoints(0, 1500)
    generator.set_speed_scaling(0.5, 200)
    got = generator.setpoints(200, 4000)
    followed_within_limits(got)
    path = CubicHermiteSpline(np.arange(1500) * PERIOD, samples[:, 0], samples[:, 1])
    assert off_the_path(got[::17, 0], path) < 1e-6
    assert np.all(got[-1, 0] == samples[-1, 0])
    # It begins where the other one is at 0.6 s of its own time.
    progress = [generator.progress(tick)[0] for tick in range(200, 2000)]
    begin = 200 + int(np.argmax(np.array(progress) >= 0.0))
    assert begin > 950
    assert generator.setpoints(begin)[0, 0] == pytest.approx(samples[600, 0], abs=1e-3)
    # A third one takes its place, as it does at full speed: it goes on from the first.
    generator.accept(points(np.array([0.9]), HOME[None], ZERO[None]), 300, 1300)
    third = generator.setpoints(300, 3000)
    followed_within_limits(third)
    assert generator.progress(1300)[0] == pytest.approx(0.0, abs=PERIOD)
    assert off_the_path(third[:1000:17, 0]) < 1e-6
    assert off_the_path(third[900:1000, 0], path) > 1e-3


def test_a_stop_joint_by_joint_begins_with_the_velocity_that_there_is(generator: TrajectoryGenerator) -> None:
    """Slowed down, each joint needs v^2/(2 a) by its real velocity; slower or halted meanwhile, it brakes as before."""
    generator.set_speed_scaling(0.4, 100)
    position, velocity, _ = generator.setpoints(700)[0]
    begin, end, _ = generator.stop(700, None)
    assert end - begin == np.ceil((np.abs(velocity) / MOST).max() / PERIOD)
    got = generator.setpoints(700, 200)
    followed_within_limits(got)
    assert got[-1, 0] == pytest.approx(position + velocity * np.abs(velocity) / (2.0 * MOST), abs=1e-12)
    assert generator.speed_scaling(701) == 1.0
    later = following()
    later.set_speed_scaling(0.4, 100)
    later.stop(300, 700)
    followed_within_limits(later.setpoints(300, 1500))
    assert np.all(later.setpoints(1800)[0, 1:] == 0.0)
    generator.set_speed_scaling(0.1, 703)
    assert generator.halt(705) == (begin, end, 0.0)
    assert np.array_equal(generator.setpoints(705, 195), got[5:])


def test_the_state_is_known_for_every_time(generator: TrajectoryGenerator) -> None:
    """Before, now and later, between ticks as on them: SciPy's curve, at the speed that there is or is to be."""
    generator.set_speed_scaling(0.5, 600)
    settled = 600 + int(np.argmax([generator.speed_scaling(k) == 0.5 for k in range(600, 1200)]))
    past = [CURVE(0.2505, row) for row in range(3)]
    assert generator.state(250.5) == pytest.approx(np.array(past), abs=1e-9)
    assert np.array_equal(generator.state(700), generator.setpoints(700)[0])
    time, later = generator.progress(settled)[0], settled + 300.25
    ahead = [0.5**row * CURVE(time + 0.5 * 0.30025, row) for row in range(3)]
    assert generator.state(later) == pytest.approx(np.array(ahead), abs=1e-9)
    assert np.all(generator.state(1e6) == [HOME, ZERO, ZERO])
    with pytest.raises(TrajectoryError, match=r"time -0.001 s; accepted: from 0 s on"):
        generator.state(-1.0)
    with pytest.raises(TrajectoryError, match=r"time nan s; accepted"):
        generator.state(float("nan"))


@given(at=st.integers(1, 1299), factor=st.sampled_from([1.0, 1.0, 0.4, 0.0]))
@settings(max_examples=25)
def test_a_stop_along_the_path_keeps_to_it_and_to_the_limits(at: int, factor: float) -> None:
    """Halted anywhere at any speed, the arm rests on the path, within three times the time of the quickest stop."""
    generator = following()
    if factor < 1.0:
        generator.set_speed_scaling(factor, 1)
    before = generator.setpoints(0, at)
    quickest = (np.abs(generator.setpoints(at)[0, 1]) / MOST).max() / PERIOD
    begin, end, _ = generator.halt(at)
    assert begin == at
    assert end - begin <= 3 * (quickest + 1) + 2
    after = generator.setpoints(at, end - at + 500)
    whole = np.concatenate([before, after])
    followed_within_limits(whole)
    assert off_the_path(whole[:, 0]) < 1e-6
    assert np.all(after[end - at :] == after[-1])
    assert np.all(after[-1, 1:] == 0.0)
    told = [tick for tick in range(at, end + 100) if generator.ended(tick) is not None]
    assert len(told) == 1


def test_a_stop_leaves_a_path_without_room() -> None:
    """Two joints of which always one brakes as hard as it may leave no way to slow down: each is braked by itself."""
    generator = TrajectoryGenerator(LIMITS, PERIOD, np.full(6, -2.0))
    # Joint 2 accelerates at its 6 rad/s^2 while joint 3 brakes at its 12 rad/s^2, and the other way round, in turn.
    times = np.concatenate([[0.0], 0.5 + 0.2 * np.arange(7), [2.2]])
    speed = np.zeros((9, 6))
    speed[1:-1, 1], speed[1:-1, 2] = 0.3 + 1.2 * (np.arange(7) % 2), 2.7 - 2.4 * (np.arange(7) % 2)
    rise = (speed[1:] + speed[:-1]) * np.diff(times)[:, None] / 2.0
    generator.accept(points(times, -2.0 + np.concatenate([np.zeros((1, 6)), np.cumsum(rise, axis=0)]), speed), 0, None)
    position, velocity, _ = generator.setpoints(510)[0]
    assert generator.halt(510).end - 510 == np.ceil((velocity / MOST).max() / PERIOD)
    got = generator.setpoints(510, 400)
    followed_within_limits(got)
    assert got[-1, 0] == pytest.approx(position + velocity**2 / (2.0 * MOST))
