"""Streamed set-points, MoveIt Servo's too, are followed within the limits, 6 (joint 2) to 60 rad/s^2, to rest."""

import math
from collections.abc import Callable, Sequence
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from joint_moves import stamp as message_stamp
from joint_moves import trajectory
from moveit_servo import Servo
from scipy.interpolate import CubicHermiteSpline
from servo_rig import Rig

from rx90_common.base.arrays import Array
from rx90_controller.servo.servo import MotorStates
from rx90_controller.trajectory import JointLimits, TrajectoryGenerator
from rx90_controller.trajectory.request import ResultCode, State
from rx90_controller.trajectory.stream import INTERFACES, POSITION, SetPoints, Stream, StreamOptions, from_message
from rx90_emulator.loop.setup import Setup

T, RATIO = 1e-3, 4  # s, ticks of the position loop; base ticks in each
DELAY = StreamOptions().delay
Delivery = tuple[float, Any]  # when a message comes, s, and the message


class Arm(Rig):
    def __init__(self, setup: Setup) -> None:
        super().__init__(setup)
        self.limits, self._drives = self.cs7b.trajectory.limits, setup.drives
        self.options = StreamOptions()
        self.loop.hold(self.states(0))
        self.setpoints: list[Array] = []

    @property
    def now(self) -> float:
        return self.cs7b.position_tick * T

    def states(self, tick: int) -> MotorStates:
        motors = self._drives.gear * (self._drives.turning.turns @ self.cs7b.setpoint[0])
        return MotorStates(tick * self.period, motors, np.zeros(6))

    def play(self, deliveries: Sequence[Delivery], until: float) -> Array:
        """Hand over each message when it comes; return all set-points so far, shape (n, 3, 6), a millisecond apart."""
        waiting = sorted(deliveries, key=lambda each: each[0])
        for tick in range(self.cs7b.position_tick, round(until / T)):
            while waiting and waiting[0][0] <= tick * T + 1e-9:
                self.take(waiting.pop(0)[1])
            assert all(self.run(tick * RATIO, RATIO)), self.around.lines[-1]
            self.setpoints.append(self.cs7b.setpoint.copy())
        return np.array(self.setpoints)

    def take(self, message: Any) -> None:
        if hasattr(message, "points"):
            self.loop.receive(message)
            return
        some = self.loop.options.allow_partial_joints_goal
        self.loop.receive_stream(lambda: from_message(self.names, message, self.options, partial=some), "a topic")


def keeps_limits(limits: JointLimits, setpoints: Array) -> None:
    q, v = setpoints[:, 0], setpoints[:, 1]
    assert (q <= limits.upper + 1e-6).all()
    assert (q >= limits.lower - 1e-6).all()
    assert (np.abs(v) <= limits.velocity * (1 + 1e-9)).all()
    assert (np.abs(np.diff(v, axis=0)) <= limits.acceleration * T * (1 + 1e-6)).all()
    assert np.abs(np.diff(q, axis=0) - 0.5 * T * (v[1:] + v[:-1])).max() < 1e-8


@pytest.fixture
def arm(shipped: Setup) -> Arm:
    return Arm(shipped)


def state(position: Any = (), velocity: Any = (), stamp: float = 0.0, **other: Any) -> SimpleNamespace:
    names = other.get("names", [f"joint_{i}" for i in range(1, 7)])
    rows = [[float(row)] * len(names) if np.isscalar(row) else list(row)
            for row in (position, velocity, other.get("effort", ()))]  # fmt: skip
    header = SimpleNamespace(stamp=message_stamp(stamp, other.get("epoch", 0)))
    return SimpleNamespace(header=header, name=names, position=rows[0], velocity=rows[1], effort=rows[2])


def wave(times: Any) -> Any:
    """Return a smooth motion from rest at 0 on that all joints can follow: 0.04 rad, 2 Hz, up to 3.2 rad/s^2."""
    return 0.02 * (1.0 - np.cos(4.0 * np.pi * np.maximum(times, 0.0)))


def sent(period: float, until: float) -> list[Delivery]:
    times = [k * period for k in range(1, round(until / period))]
    return [(at, state(wave(at), stamp=at)) for at in times]


@pytest.mark.parametrize("period", [0.001, 0.002, 0.01, 0.014])
def test_the_motion_is_the_cubic_through_the_set_points_after_the_delay(arm: Arm, period: float) -> None:
    """From 70 Hz to 1 kHz it is SciPy's Hermite spline with slopes of parabolas, `stream.delay` after the stamps."""
    setpoints = arm.play(sent(period, 1.0), 1.0)
    times = period * np.arange(1, round(1.0 / period))
    positions = wave(times)
    slopes = np.gradient(positions, times, edge_order=2)  # of the parabola through three neighbours
    oracle = CubicHermiteSpline(times + DELAY, positions, slopes)
    at = T * np.arange(round((times[4] + DELAY) / T), round(times[-2] / T))
    rows = np.rint(at / T).astype(int)
    assert np.abs(setpoints[rows, 0] - oracle(at)[:, None]).max() < 3e-6
    assert np.abs(setpoints[rows, 1] - oracle(at, 1)[:, None]).max() < 4e-3
    keeps_limits(arm.limits, setpoints)
    assert not any("stream:" in line for line in arm.around.lines)


def test_it_arrives_however_it_is_stamped(arm: Arm, shipped: Setup) -> None:
    """A clock of its own, which is said once, gives the same motion as no stamps, and as an array without names."""
    own, unstamped, array = arm, Arm(shipped), Arm(shipped)
    messages = [(at, message.position) for at, message in sent(0.01, 0.5)]
    first = own.play([(at, state(q, stamp=at, epoch=1_700_000_000)) for at, q in messages], 0.7)
    second = unstamped.play([(at, state(q)) for at, q in messages], 0.7)
    third = array.play([(at, SimpleNamespace(data=q)) for at, q in messages], 0.7)
    assert (first == second).all()
    assert (second == third).all()
    (line,) = [line for line in own.around.lines if line.startswith("stream:")]
    assert "stamps are of another clock" in line
    assert "accepted: simulated time" in line


@given(seed=st.integers(0, 2**32 - 1), spread=st.sampled_from([0.01, 0.3, 6.0]), interface=st.sampled_from(INTERFACES))
@settings(max_examples=60, deadline=None)
def test_whatever_is_streamed_limits_are_kept(shipped: Setup, seed: int, spread: float, interface: str) -> None:
    """Random set-points at random times beyond all limits: within them, then at rest, there if that is within."""
    random, limits = np.random.default_rng(seed), shipped.controller.limits(shipped.robot)
    every = np.ones(6, dtype=bool)
    generator, parts = TrajectoryGenerator(limits, T, np.zeros(6)), []
    stream, now = Stream(interface, every, limits, T, StreamOptions()), 0
    for _ in range(random.integers(1, 20)):
        stamp = now * T + random.normal(0.0, 0.02) if random.random() < 0.8 else None
        due = np.sort(random.uniform(0.0, 0.05, random.integers(1, 4)))
        values, slopes = random.normal(0.0, spread if stream.count else 0.0, (2, len(due), 6))
        slopes[random.random(len(due)) < 0.7] = np.nan
        stamp_ns = 0 if stamp is None else round(stamp * 1e9)
        points = SetPoints(interface, stamp_ns, due, np.stack([values, slopes], axis=1), every)
        generator.follow_stream(stream, points, now)
        wait = int(random.integers(1, 60))
        parts.append(generator.setpoints(now, wait))
        now += wait
    setpoints = np.concatenate([*parts, generator.setpoints(now, 8000)])
    keeps_limits(limits, setpoints)
    assert (setpoints[-1, 1:] == 0.0).all()
    if interface == POSITION:
        reached = np.clip(stream._values[-1, 0], limits.lower, limits.upper)
        assert np.abs(setpoints[-1, 0] - reached).max() < 1e-9


def test_a_step_is_travelled_as_fast_as_the_limits_allow_without_overshoot(arm: Arm) -> None:
    """A step of 1 rad takes the time of a trapezoid, v/a + way/v, is not overshot, and is said to be beyond limits."""
    arm.take(state(0.0))
    arm.take(state(1.0))
    setpoints = arm.play([], 3.0)
    keeps_limits(arm.limits, setpoints)
    assert (setpoints[:, 0] <= 1.0 + 1e-9).all()
    for joint, (v, a) in enumerate(zip(arm.limits.velocity, arm.limits.acceleration, strict=True)):
        fastest = 2.0 * math.sqrt(1.0 / a) if v * v > a else v / a + 1.0 / v
        arrived = T * int(np.argmax(setpoints[:, 0, joint] > 1.0 - 1e-6))
        assert 0.0 <= arrived - fastest < 0.032, joint  # the step is interpolated over the delay of 0.03 s
    (line,) = [line for line in arm.around.lines if line.startswith("stream:")]
    assert "a position beyond the limits; followed within them" in line


def test_a_late_set_point_is_told_once_while_the_last_one_is_held(arm: Arm) -> None:
    """Without its successor a position is held; a late one is followed at once, and told of with its lateness."""
    messages = sent(0.01, 0.6)
    on_time, late = messages[:30], [(at + 0.2, message) for at, message in messages[30:]]
    setpoints = arm.play(on_time + late, 1.2)
    keeps_limits(arm.limits, setpoints)
    held = setpoints[440:505]
    assert np.abs(held[:, 0] - wave(0.3)).max() < 1e-9
    assert not held[:, 1].any()
    assert np.abs(setpoints[-1, 0] - wave(0.59)).max() < 1e-9
    assert len([line for line in arm.around.lines if "came 0.17 s after it was due" in line]) == 1
    ends = [line for line in arm.around.lines if line.startswith("stream ended")]
    assert len(ends) == 2
    assert "29 set-points, 29 of them late" in ends[1]


def test_velocities_are_followed_held_for_the_timeout_and_braked(arm: Arm) -> None:
    """0.2 rad/s, sent for a second, is travelled until `stream.timeout` after the last one, then braked to rest."""
    messages = [(k * 0.01, state(velocity=0.2, stamp=k * 0.01)) for k in range(1, 101)]
    setpoints = arm.play(messages, 2.0)
    keeps_limits(arm.limits, setpoints)
    last = 1.0 + DELAY + arm.options.timeout
    assert np.abs(setpoints[100 : int(last / T) - 1, 1] - 0.2).max() < 1e-12
    assert np.abs(setpoints[int(last / T) + 40 :, 1]).max() == 0.0


def test_goals_and_streams_replace_each_other_without_a_jump(arm: Arm) -> None:
    """A set-point ends the goal, with -1 and why; a trajectory ends the stream; in between the velocity goes on."""
    told: list[Any] = []
    goal = arm.goal(arm.trajectory(0.3), SimpleNamespace(on_feedback=lambda _: None, on_result=told.append))
    arm.loop.offer(goal)
    arm.play([], 0.5)
    arm.play([(0.5 + k * 0.01, state(0.2 if k else arm.cs7b.setpoint[0])) for k in range(10)], 0.6)
    assert told == [goal]
    assert (goal.state, goal.code) == (State.ABORTED, ResultCode.INVALID_GOAL)
    assert goal.reason.startswith("replaced by streamed set-points, at 0.5")
    arm.loop.receive(arm.trajectory(-0.1))
    setpoints = arm.play([], 2.0)
    keeps_limits(arm.limits, setpoints)
    assert np.abs(setpoints[-1, 0] + 0.1).max() < 1e-12
    assert any(line.startswith("stream ended at 0.600 s after 10 set-points") for line in arm.around.lines)


def test_joints_that_are_not_named_hold_and_speed_scaling_holds_all(arm: Arm) -> None:
    """With `allow_partial_joints_goal` a stream may be of some joints; at speed scaling 0 nothing moves."""
    one, first = state([0.2], names=["joint_3"]), state([0.0], names=["joint_3"])
    arm.take(one)
    assert "set-point from a topic ignored: joint 'joint_1' is missing" in arm.around.lines[-1]
    arm.loop.options = type(arm.loop.options)(allow_partial_joints_goal=True)
    arm.cs7b.trajectory.set_speed_scaling(0.0, 0)
    assert not arm.play([(k * 0.01, one if k else first) for k in range(20)], 0.2)[:, 0].any()
    arm.cs7b.trajectory.set_speed_scaling(1.0, arm.cs7b.position_tick)
    setpoints = arm.play([(0.2 + k * 0.01, one) for k in range(20)], 1.0)
    keeps_limits(arm.limits, setpoints)
    assert np.abs(setpoints[-1, 0] - np.array([0, 0, 0.2, 0, 0, 0])).max() < 1e-9


@pytest.mark.parametrize(
    ("message", "said"),
    [
        (state(0.1, names=["joint_1", "elbow"]), "unknown joint 'elbow'; accepted: joint_1"),
        (state([0.1] * 5 + [math.nan]), "positions of joint_6: nan; accepted: a finite number"),
        (state(), "neither position nor velocity; accepted: one of them, or both"),
        (state(0.1, effort=1.0), "carries effort; accepted: position, with velocity or without, or velocity alone"),
    ],
)
def test_what_is_no_set_point_is_one_line(arm: Arm, message: Any, said: str) -> None:
    """It is named with what is accepted, counted, and moves nothing; hundreds of them are not as many lines."""
    setpoints = arm.play([(k * T, message) for k in range(200)], 0.3)
    assert not setpoints[:, :2].any()
    lines = arm.around.lines[1:]  # again after some seconds of the wall clock
    assert 1 <= len(lines) < 20
    assert all(said in line for line in lines)
    assert arm.loop.servo.rejected == 200


@pytest.mark.parametrize("velocities", ["none", "rest", "their own"])
def test_single_points_are_followed_at_their_time(arm: Arm, velocities: str) -> None:
    """Points sent every 10 ms, each 20 ms ahead, with velocities, zeros or none, are passed through at their times."""
    given: dict[str, Callable[[float], Any]] = {
        "none": lambda _: None,
        "rest": lambda _: np.zeros(6),
        "their own": lambda t: (wave(t + 1e-6) - wave(t - 1e-6)) / 2e-6,
    }
    times = [0.01 * k for k in range(1, 100)]
    messages = [(at, trajectory([0.02], [wave(at - 0.01)], [given[velocities](at - 0.01)])) for at in times]
    setpoints = arm.play(messages, 1.3)
    keeps_limits(arm.limits, setpoints)
    rows = np.array([round((at + 0.02) / T) for at in times[5:]])
    assert np.abs(setpoints[rows, 0] - wave(rows * T - 0.03)[:, None]).max() < 2e-5
    assert arm.loop.servo.rejected == 0


@pytest.mark.parametrize("jitter", [0.0, 0.003])
def test_moveit_servo_drives_the_arm(arm: Arm, jitter: float) -> None:
    """Its windows of points, with stamps in the past and velocities at the end, are one stream that is followed."""
    servo, random, wanted = Servo(np.zeros(6)), np.random.default_rng(1), {}
    for k in range(1, 200):
        at = k * 0.01 + jitter * random.random()
        arm.play([], math.floor(at / T) * T)
        speed = 0.25 * np.ones(6) if k < 60 else -0.15 * np.ones(6) if k < 120 else None
        message = servo.cycle(at, speed, arm.cs7b.setpoint[0].copy())
        if message is None:
            continue
        arm.loop.receive(message)
        wanted |= {stamp: q for stamp, q, _ in servo.window[:-1]}
    setpoints = arm.play([], 3.0)
    keeps_limits(arm.limits, setpoints)
    assert arm.loop.servo.rejected == 0
    assert not any("rejected" in line or "came" in line for line in arm.around.lines)
    stamps = np.array([stamp for stamp in wanted if stamp > 0.3])
    actual = np.array([np.interp(stamps, T * np.arange(len(setpoints)), setpoints[:, 0, j]) for j in range(6)]).T
    furthest = np.abs(actual - np.array([wanted[stamp] for stamp in stamps])).max(axis=0)
    assert furthest.max() < 7e-3  # where Servo turns faster than joint 2 can
    assert furthest[3:].max() < 1e-4
    assert np.abs(setpoints[-1, 0] - wanted[max(wanted)]).max() < 1e-9
    assert max(np.abs(q).max() for q in wanted.values()) > 0.08


@pytest.mark.parametrize("velocities", [None, np.zeros(6)])
def test_what_begins_too_far_away_is_refused_with_the_time_it_needs(arm: Arm, velocities: Any) -> None:
    """By any topic, as a point alone or in a window: nothing moves, and in the stated time the place is reached."""
    away = np.array([0.0, -1.0, 0.0, 0.0, 0.0, 0.5])
    arm.take(state(0.2 * away))
    v, a = arm.limits.velocity[1], arm.limits.acceleration[1]
    least = 2.0 * math.sqrt(0.2 / a) if 0.2 * a < v * v else 0.2 / v + v / a
    assert f"joint_2 cannot go -0.2 rad in 0.03 s within its limits, {v:.6g} rad/s" in arm.around.lines[-1]
    assert float(arm.around.lines[-1].split("accepted: from ")[1][:-5]) == pytest.approx(least, abs=1e-3)
    window = trajectory([0.02, 0.05], [0.0 * away, away], [velocities] * 2)
    for message in (SimpleNamespace(data=[1e308] * 6), window, *(trajectory([t], [away]) for t in (1e-9, 0.05, 0.1))):
        arm.take(message)
    arm.take(trajectory([0.101], [away], [velocities]))
    assert arm.loop.servo.rejected == 7
    assert not arm.play([], 0.2)[:, 0].any()
    least = float(arm.around.lines[-1].split("joint_2 cannot go -1 rad in 0.101 s ")[1].split("from ")[1][:-5])
    arm.take(trajectory([0.98 * least], [away], [velocities]))
    assert arm.loop.servo.rejected == 8
    arm.take(trajectory([least], [away], [velocities]))
    assert np.abs(arm.play([], arm.now + least + 0.1)[-1, 0] - away).max() < 1e-9


def test_a_running_arm_takes_up_a_stream_where_that_goes_on(arm: Arm) -> None:
    """What lies ahead on its way is in reach, as far behind it is not, and leaves the motion as it is."""
    arm.loop.receive(arm.trajectory(0.6))
    arm.play([], 0.5)
    position, velocity, _ = arm.cs7b.setpoint
    arm.take(state(position - velocity * DELAY))
    assert "cannot go" in arm.around.lines[-1]
    arm.take(state(position + velocity * DELAY))
    assert "stream begins" in arm.around.lines[-1]


def test_a_stream_goes_on_after_a_short_silence(arm: Arm) -> None:
    """A sender that moves on while its messages are held up is followed again; after a second it begins anew."""
    way = np.array([0.0, -0.1, 0.0, 0.0, 0.0, 0.0])
    arm.take(state(0.01 * way))
    arm.play([], arm.now + 0.5)
    arm.take(state(0.51 * way))
    assert "stream begins" in arm.around.lines[-2]
    assert np.abs(arm.play([], arm.now + 2.0)[-1, 0] - 0.51 * way).max() < 1e-6
    arm.take(state(2.0 * way))
    assert "cannot go" in arm.around.lines[-1]


def test_longer_trajectories_are_none_of_a_stream(arm: Arm) -> None:
    """What ends further ahead than `stream.window` is a trajectory as ever: refused beyond limits, not followed."""
    arm.loop.servo.streaming = StreamOptions(window=0.0)
    arm.loop.receive(trajectory([0.02], [0.5]))
    assert arm.around.lines[-1].startswith("trajectory rejected: point 0: ")
    assert not arm.play([], 0.2)[:, 0].any()
