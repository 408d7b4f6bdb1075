"""Corrections are played beside trajectories: faded in and out, into the position error alone, and never beyond it."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from joint_moves import HOME, LIMITS, NAMES, PERIOD, ZERO, trajectory
from servo_rig import Rig

from rx90_common.base.errors import TrajectoryError
from rx90_common.exchange.topics import CORRECTED
from rx90_controller.law.cs7b import position_loop
from rx90_controller.trajectory import TrajectoryGenerator, TrajectoryPoints
from rx90_controller.trajectory.correction import FADE, FASTEST, Correction
from rx90_controller.trajectory.points import (
    correction_from_points,
    correction_points,
    message_content,
    points_from_message,
    trajectory_identity,
)
from rx90_emulator.loop.setup import Setup

SIZE, COUNT = 1e-3, 1000
FADE_TICKS = round(FADE / PERIOD)


def points(target: float = 0.1, seconds: float = 1.0) -> TrajectoryPoints:
    rest = [ZERO, ZERO]
    return TrajectoryPoints.create(NAMES, NAMES, [0.0, seconds], [HOME, HOME + target], rest, rest)


@pytest.fixture
def steady() -> Correction:
    return Correction(np.full((COUNT, 6), SIZE), PERIOD)


def offsets(generator: TrajectoryGenerator, first: int, count: int) -> np.ndarray:
    """Return the offsets of joint 1, 0 where none are played, and check that set-points are what they are without."""
    rows = generator.corrected(first, count)
    assert np.array_equal(rows[:, :2], generator.setpoints(first, count)[:, :2])
    return rows[:, 3, 0] if rows.shape[1] > 3 else np.zeros(count)


def test_it_comes_with_its_trajectory_and_goes_behind_it(generator: TrajectoryGenerator, steady: Correction) -> None:
    """Nothing before, full in between, nothing later; no step on the way, and the same bits tick by tick."""
    generator.accept(points(), 0, 50, steady)
    played = offsets(generator, 0, 50 + COUNT + 2 * FADE_TICKS)
    assert not played[:50].any()
    assert played[50 + FADE_TICKS : 50 + COUNT] == pytest.approx(SIZE)
    assert not played[50 + COUNT + FADE_TICKS :].any()
    assert np.abs(np.diff(played)).max() < 2.0 * SIZE / FADE_TICKS
    single = [generator.corrected(k)[0, 3, 0] for k in range(len(played))]
    assert np.array_equal(single, played)


@pytest.mark.parametrize("what", ["stop", "halt", "another", "slower"])
def test_whatever_comes_in_between_lets_it_fade(generator: TrajectoryGenerator, steady: Correction, what: str) -> None:
    """A stop, another trajectory and another speed end it from the tick on, without a step."""
    generator.accept(points(), 0, 0, steady)
    before = offsets(generator, 0, 400)
    if what == "stop":
        generator.stop(400, None)
    elif what == "halt":
        generator.halt(400)
    elif what == "slower":
        generator.set_speed_scaling(0.5, 400)
    else:
        later = replace(points(0.3), times=np.array([0.5, 1.5]))
        generator.accept(later, 400, 400)
    played = np.concatenate([before, offsets(generator, 400, 400)])
    assert played[399] == pytest.approx(SIZE)
    assert not played[400 + FADE_TICKS :].any()
    assert np.abs(np.diff(played)).max() < 2.0 * SIZE / FADE_TICKS


def test_what_waits_goes_with_its_trajectory(generator: TrajectoryGenerator, steady: Correction) -> None:
    """A trajectory that is replaced before it begins takes its correction with it; a reset takes all."""
    generator.accept(points(), 0, 300, steady)
    generator.accept(points(), 100, 200)
    assert not offsets(generator, 100, 1500).any()
    generator.reset(HOME)
    generator.accept(points(), 0, 0, steady)
    generator.reset(HOME)
    assert not offsets(generator, 0, 500).any()


def test_refusals_leave_everything_as_it_was(generator: TrajectoryGenerator, steady: Correction) -> None:
    """Another rate, a scaled speed, a late begin and offsets beyond the limits of position are refused with numbers."""
    other = Correction(np.zeros((10, 6)), 2.0 * PERIOD)
    with pytest.raises(TrajectoryError, match=r"an offset every .*; accepted: every"):
        generator.accept(points(), 0, None, other)
    with pytest.raises(TrajectoryError, match=r"begins 0\.01 s late"):
        generator.join(points(), 10, 0, steady, anywhere=False)
    generator.set_speed_scaling(0.5, 0)
    with pytest.raises(TrajectoryError, match=r"speed scaling 0\.5 with a correction; accepted: 1"):
        generator.accept(points(), 0, None, steady)
    generator.set_speed_scaling(1.0, 0)
    narrow = replace(LIMITS, upper=HOME + 0.1 + 0.5 * SIZE)
    with pytest.raises(TrajectoryError, match=r"the correction takes .* within the joint's limits"):
        TrajectoryGenerator(narrow, PERIOD, HOME).accept(points(), 0, None, steady)
    assert not generator.moving(1)


def test_only_the_position_error_sees_it(shipped: Setup) -> None:
    """The offset is in the error and PI's torque, and in no feed-forward; none leaves every bit of the state."""
    setpoint = np.array([[0.1] * 6, [0.3] * 6, [1.0] * 6])
    states = []
    for row in (None, np.zeros(6), np.full(6, SIZE)):
        controller = shipped.cs7b()
        controller.reset(np.zeros(6))
        rows = setpoint if row is None else np.vstack([setpoint, row])
        position_loop(controller.law, controller.state, rows, np.zeros(6), np.zeros(6))
        states.append(controller.state.copy())
    plain, none, moved = states
    assert plain.tobytes() == none.tobytes()
    gear = shipped.drives.gear * [1, 1, 1, 1, 1, 2]  # motor 6 turns with joints 5 and 6
    assert moved["error"][0] - plain["error"][0] == pytest.approx(gear * SIZE)
    assert np.array_equal(moved["feed_forward"], plain["feed_forward"])
    assert np.array_equal(moved["reference"], plain["reference"])


def test_a_message_carries_it_to_its_trajectory() -> None:
    """Points of a message come back as the same offsets; times off the set-points are refused; identities differ."""
    rng = np.random.default_rng(4)
    correction = Correction(np.cumsum(rng.uniform(-0.1, 0.1, (50, 6)), axis=0) * FASTEST * PERIOD, PERIOD)
    message = message_content(NAMES, correction_points(correction))["points"]
    rows = [point["positions"] for point in message]
    times = [point["time_from_start"]["sec"] + point["time_from_start"]["nanosec"] / 1e9 for point in message]
    sent = TrajectoryPoints.create(NAMES, NAMES, times, rows, [], [])
    assert np.array_equal(correction_from_points(sent, PERIOD).offsets, correction.offsets)
    with pytest.raises(TrajectoryError, match="accepted: a point every"):
        correction_from_points(replace(sent, times=sent.times * 1.01), PERIOD)
    one, other = points(), points(0.2)
    assert trajectory_identity(one) == trajectory_identity(points()) != trajectory_identity(other)


def test_the_loop_joins_a_trajectory_with_the_correction_that_waits_for_it(rig: Rig) -> None:
    """Sent before it, it is played; asked for and not there, the trajectory is refused; for another, it is dropped."""
    rig.loop.hold(rig.states(0))
    asking = rig.trajectory(0.1)
    asking.header.frame_id = CORRECTED
    rig.loop.receive(asking)
    assert "its correction has not come; accepted: after it on" in rig.around.lines[-1]
    identity = trajectory_identity(points_from_message(rig.names, asking))
    rig.loop.receive_correction(sent(rig, identity, SIZE))
    rig.loop.receive(asking)
    assert rig.around.lines[-1].endswith("; with its correction")
    rig.run(0, 4 * 200)
    assert rig.cs7b.offset == pytest.approx(np.full(6, SIZE))
    rig.loop.receive_correction(sent(rig, identity, 0.02))
    assert "correction rejected: the correction has the offset 0.02 rad" in rig.around.lines[-1]
    rig.loop.receive_correction(sent(rig, "another", SIZE))
    rig.loop.receive(rig.trajectory(0.2))
    assert "the correction that waited belongs to another trajectory; dropped" in rig.around.lines


def sent(rig: Rig, identity: str, size: float) -> SimpleNamespace:
    return trajectory(np.arange(999) * PERIOD, [size] * 999, names=rig.names, frame=identity)
