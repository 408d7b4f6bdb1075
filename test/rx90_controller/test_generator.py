"""The set-point generator: what it follows tick by tick, and what breaks a limit."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from joint_moves import HOME, LIMITS, NAMES, PERIOD, ZERO, move, points
from scipy.interpolate import BPoly

from rx90_common.base.arrays import Array
from rx90_common.base.errors import TrajectoryError
from rx90_controller.trajectory import TrajectoryGenerator, TrajectoryPoints
from rx90_controller.trajectory.points import message_content


def test_each_end_is_told_once(generator: TrajectoryGenerator) -> None:
    """A trajectory that comes to its end tells it in that tick; one that is replaced has none."""
    generator.accept(move(0.4, 0.5), 0, 100)
    generator.accept(move(0.2, 0.5), 0, 50)
    generator.accept(move(0.1, 0.2), 0, 550)
    assert [tick for tick in range(1000) if generator.ended(tick) is not None] == [750]
    generator.accept(move(0.2, 0.5), 1000, 1000)
    told = [generator.ended(tick) for tick in range(1000, 1100)]
    generator.delay(70, 1170)
    assert [tick for tick in range(1170, 1700) if generator.ended(tick) is not None] == [1570]
    assert told == [None] * 100


@pytest.mark.parametrize("seed", range(12))
def test_what_points_do_not_carry_is_interpolated_as_by_joint_trajectory_controller(seed: int) -> None:
    """Quintic if both points have accelerations, cubic if both have velocities, else a line with ramps."""
    random = np.random.default_rng(seed)
    times = np.cumsum(random.uniform(0.8, 1.2, 7)) * (np.arange(7) > 0)
    moves = random.random(7) < 0.6
    bends = moves & (random.random(7) < 0.7)
    q = HOME + np.where(times[:, None] > 0, random.uniform(-0.1, 0.1, (7, 6)), 0.0)
    v, a = (random.uniform(-0.1, 0.1, (7, 6)) * given[:, None] for given in (moves, bends))
    v[[0, -1]] = a[0] = 0.0
    tables = [
        q.tolist(),
        *([r if m else [] for r, m in zip(t.tolist(), g, strict=True)] for t, g in ((v, moves), (a, bends))),
    ]
    sent = TrajectoryPoints.create(NAMES, NAMES, times.tolist(), *tables)
    generator = TrajectoryGenerator(LIMITS, PERIOD, HOME)
    end = generator.accept(sent, 0, None).end
    got = generator.setpoints(0, end + 1)
    assert np.abs(np.diff(got[:, 1], axis=0)).max() <= 60.0 * PERIOD * (1 + 1e-9)
    assert got[-1, 0] == pytest.approx(q[-1], abs=1e-12)
    t = np.arange(end + 1) * PERIOD
    for k in range(6):
        inside = (t >= times[k]) & (t < times[k + 1])
        most = 2 if bends[k] and bends[k + 1] else 1 if moves[k] and moves[k + 1] else 0
        knots = [np.stack([table[i] for table in (q, v, a)[: most + 1]]) for i in (k, k + 1)]
        want = BPoly.from_derivatives(times[k : k + 2], knots)
        if most:
            np.testing.assert_allclose(got[inside, 0], want(t[inside]), rtol=0, atol=1e-9)
        else:
            # A ramp is centred on its point, or beside a curve: there half of it is missed at most.
            middle = np.flatnonzero(inside)[300:-300]
            assert not got[middle, 2].any()
            assert np.abs(got[middle, 0] - want(t[middle])).max() < 2e-3
    messages = message_content(NAMES, sent)["points"]
    again = ([message[name] for message in messages] for name in ("positions", "velocities", "accelerations"))
    stamps = [message["time_from_start"] for message in messages]
    again_times = [each["sec"] + each["nanosec"] * 1e-9 for each in stamps]
    twin = TrajectoryGenerator(LIMITS, PERIOD, HOME)
    twin.accept(TrajectoryPoints.create(NAMES, NAMES, again_times, *again), 0, None)
    np.testing.assert_allclose(twin.setpoints(0, end + 1)[:, :2], got[:, :2], rtol=0, atol=1e-6)


class Reference:
    """The generator's rules tick by tick, each set-point sampled from a generator that has one trajectory only."""

    def __init__(self) -> None:
        self.begin(HOME)

    def begin(self, hold: Array) -> None:
        self.running, self.start = TrajectoryGenerator(LIMITS, PERIOD, hold), 0
        self.length = 0
        self.waiting: tuple[int, int, TrajectoryGenerator] | None = None

    def setpoint(self, tick: int) -> Array:
        if self.waiting is not None and tick >= self.waiting[0]:
            (self.start, self.length, self.running), self.waiting = self.waiting, None
        return self.running.setpoints(tick - self.start)[0]

    def accept(self, to: Array, seconds: float, now: int, begin: int) -> None:
        if self.waiting is not None and self.waiting[0] < now:
            self.setpoint(now)
        position, velocity, acceleration = self.running.setpoints(begin - self.start)[0]
        both = TrajectoryPoints.create(
            NAMES, NAMES, [0.0, seconds], [position, to], [velocity, ZERO], [acceleration, ZERO]
        )
        alone = TrajectoryGenerator(replace(LIMITS, acceleration=np.full(6, np.inf)), PERIOD, position)
        alone.accept(both, 0, 0)
        self.waiting = begin, round(seconds / PERIOD), alone

    def delay(self, count: int, tick: int) -> None:
        if self.waiting is not None and self.waiting[0] < tick:
            self.setpoint(tick)
        resting = tick - self.start >= self.length
        self.start += count
        if self.waiting is not None:
            begin, length, alone = self.waiting
            self.waiting = max(begin, tick + count) if resting else begin + count, length, alone


@settings(max_examples=80)
@given(st.data())
def test_random_requests_give_what_the_rules_say(data: st.DataObject) -> None:
    """However trajectories, delays, resets and blocks follow each other, set-points are those of the rules."""
    generator, reference, tick = TrajectoryGenerator(LIMITS, PERIOD, HOME), Reference(), 0
    for _ in range(data.draw(st.integers(1, 12))):
        what = data.draw(st.sampled_from(["run", "run", "accept", "accept", "delay", "reset"]))
        count = data.draw(st.integers(1, 150))
        if what == "run":
            revision = generator.revision
            ahead = generator.setpoints(tick, count)
            wanted = np.array([reference.setpoint(tick + k) for k in range(count)])
            assert ahead == pytest.approx(wanted, abs=1e-9)
            assert generator.revision == revision
            tick += count
        elif what == "accept":
            to, seconds = HOME + 0.001 * data.draw(st.integers(-50, 50)), 0.001 * data.draw(st.integers(150, 400))
            begin = tick + data.draw(st.integers(0, 200))
            target = TrajectoryPoints.create(NAMES, NAMES, [seconds], [to], [ZERO], [ZERO])
            revision = generator.revision
            assert generator.accept(target, tick, begin).begin == begin
            assert generator.revision != revision
            reference.accept(to, seconds, tick, begin)
        elif what == "delay":
            tick += count
            generator.delay(count, tick)
            reference.delay(count, tick - count)
        else:
            hold = generator.setpoints(tick)[0, 0]
            tick = data.draw(st.integers(0, 1000))
            generator.reset(hold)
            reference.begin(hold)


def other(joint: int, value: float, base: Array = HOME) -> Array:
    return np.where(np.arange(6) == joint, value, base)


EDGE, SPIKE = np.full(6, 1.99), other(5, -2.0 - 2e-6)
ADVICE = ", or velocities_from_positions, where the points' velocities do not belong to their positions"
Sent = tuple[list[float], list[Array], list[Array]]
REFUSED: list[tuple[Sent, int | None, str]] = [
    (([1.0], [HOME + 0.1], [ZERO]), 100, "start time 0.1 s is 0.5 s in the past; accepted: now or later"),
    (([0.0, 1.0], [other(3, 0.4011, HOME + 0.4), HOME], [ZERO, ZERO]), None,
     "point 0: joint_4 starts at 0.4011 rad, the set-point there is 0.4 rad"),
    (([1.0, 3.0, 5.0], [HOME, other(1, 2.1), HOME], [ZERO] * 3), None,
     "point 1: joint_2 has the position 2.1 rad; accepted: [-2, 2]"),
    # It swings beyond a limit between two good points.
    (([2.0, 2.5, 4.0], [EDGE, EDGE, HOME], [ZERO, other(4, 2.0, ZERO), ZERO]), None,
     "point 2: joint_5 gets a set-point position 2.0"),
    # 15 s (1 - s) rad/s at the share s of 0.4 s.
    (([0.5, 0.9], [HOME, HOME + 1.0], [ZERO] * 2), None,
     "point 1: joint_1 gets a set-point velocity 3.00741 rad/s on the way there, at 0.611 s; "
     f"accepted: [-3, 3]{ADVICE}"),
    # Points that fit between two set-points cannot hide a jump.
    (([0.9, 0.9002, 0.9003, 1.2], [HOME, HOME, HOME - 0.5, HOME - 0.5], [ZERO] * 4), None,
     "point 3: joint_1 gets a set-point jump of -0.5 rad"),
    # A cubic from rest to rest begins with 6 d/T^2.
    (([0.5, 0.6], [HOME, HOME + 0.15], [ZERO] * 2), None,
     "point 1: joint_1 gets a set-point acceleration 90 rad/s^2 on the way there, at 0.500 s; "
     f"accepted: [-60, 60]{ADVICE}"),
    (([0.0, 1.0], [HOME + 0.4, HOME], [ZERO + 0.1, ZERO]), None,
     "point 0: joint_1 starts at 0.1 rad/s, the set-point there moves at 0 rad/s; accepted: wit"),
    (([0.5, 0.50045, 0.5005, 1.0], [HOME, HOME, HOME + 1e-5, HOME + 0.05], [ZERO, ZERO, ZERO + 0.1, ZERO]), None,
     "point 3: joint_1 gets a set-point step of the velocity of 100.2 rad/s^2"),
    # At whichever set-point it lies, minutes into a trajectory.
    *((([at - 1.0, at, at + 1.0, at + 400.0], [HOME, SPIKE, HOME, HOME], [ZERO] * 4), None, "point 1: joint_6")
      for at in (4.095, 4.096, 4.097, 300.0)),
]  # fmt: skip


@pytest.mark.parametrize(("sent", "start", "words"), REFUSED, ids=[words for *_, words in REFUSED])
def test_breaking_a_limit_is_refused(generator: TrajectoryGenerator, sent: Sent, start: int | None, words: str) -> None:
    """One line names point, joint, value and what is accepted; the running motion goes on untouched."""
    twin = TrajectoryGenerator(LIMITS, PERIOD, HOME)
    for each in (generator, twin):
        each.accept(move(0.4, 0.5), now=0, start=None)
        each.setpoints(0, 600)
    with pytest.raises(TrajectoryError) as caught:
        generator.accept(points(*sent), 600, start)
    assert np.array_equal(generator.setpoints(600, 1000), twin.setpoints(600, 1000))
    assert str(caught.value).startswith(words)
    assert "\n" not in str(caught.value)


def test_limits_are_reached_exactly(generator: TrajectoryGenerator) -> None:
    """A motion that ends on the limit, or runs at it, is accepted."""
    end = np.full(6, 2.0)
    generator.accept(points([2.0], [end], [ZERO]), 0, None)
    assert np.all(generator.setpoints(2001)[0, 0] == 2.0)
    # Ramps of 0.05 s, in each of which half of the way is lost.
    generator.accept(points([4.0 / 3.0 + 0.05], [np.full(6, -2.0)], None), 2002, None)
    assert generator.setpoints(2002 + 50)[0, 1] == pytest.approx(-3.0)


@pytest.mark.parametrize("beyond", [1e-6, 0.05])
def test_an_arm_beyond_a_limit_may_come_back(beyond: float) -> None:
    """From a held position beyond a limit a trajectory that begins there, or a joint move, leads inwards."""
    held = HOME.copy()
    held[2] = LIMITS.upper[2] + beyond
    for back in (points([1.0], [HOME], [ZERO]), points([0.0, 1.0], [held + 2e-4, HOME], [ZERO, ZERO])):
        generator = TrajectoryGenerator(LIMITS, PERIOD, held)
        generator.accept(back, 0, None)
        assert generator.setpoints(0, 1200)[-1, 0] == pytest.approx(HOME)


def test_an_arm_beyond_a_limit_is_not_led_further_out() -> None:
    """From beyond a limit neither a motion outwards nor one that turns back outwards is accepted."""
    held = HOME.copy()
    held[2] = LIMITS.upper[2] + 0.05
    inwards, out_again = held.copy(), held.copy()
    inwards[2], out_again[2] = LIMITS.upper[2] + 0.01, LIMITS.upper[2] + 0.04
    generator = TrajectoryGenerator(LIMITS, PERIOD, held)
    for bad in (points([1.0], [held + 0.02], [ZERO]), points([1.0, 2.0], [inwards, out_again], [ZERO, ZERO])):
        with pytest.raises(TrajectoryError, match=r"joint_3 (gets a set-point|has the) position"):
            generator.accept(bad, 0, None)
    with pytest.raises(TrajectoryError, match="joint_3"):
        TrajectoryGenerator(LIMITS, PERIOD, HOME).accept(points([2.0], [held], [ZERO]), 0, None)
