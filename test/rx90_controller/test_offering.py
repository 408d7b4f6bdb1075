"""Long trajectories, of the topic and of goals, come into the ticks without holding them up."""

from collections.abc import Callable, Iterator
from types import SimpleNamespace
from typing import Any
from unittest import mock

import numpy as np
import pytest
from joint_moves import trajectory
from servo_rig import Rig

from rx90_controller.trajectory import TrajectoryGenerator, points
from rx90_controller.trajectory.points import points_from_message
from rx90_controller.trajectory.request import GoalOptions

TICKS = 8  # that pass while a stamped trajectory is joined


class Ways:
    """Notes whether the ticks' lock is free where a trajectory enters a generator, and calls `meanwhile`."""

    def __init__(self, rig: Rig) -> None:
        self.rig, self.beside, self.tick = rig, [], 0
        self.calls = 0
        self.meanwhile: Callable[[int], None] = lambda _: self.run(3)

    def begin(self, meanwhile: Callable[[int], None]) -> None:
        self.beside.clear()
        self.calls, self.meanwhile = 0, meanwhile

    def run(self, count: int) -> None:
        for _ in range(count):
            gear = self.rig.cs7b
            self.rig.run(self.tick, gear.rates.ratio)
            self.tick += gear.rates.ratio

    def note(self, name: str) -> Any:
        original = getattr(TrajectoryGenerator, name)

        def entered(generator: TrajectoryGenerator, *args: Any, **kwargs: Any) -> Any:
            free = not self.rig.loop.between_ticks.locked()
            self.beside.append(free)
            result = original(generator, *args, **kwargs)
            if free:
                self.calls += 1
                self.meanwhile(self.calls - 1)
            return result

        return mock.patch.object(TrajectoryGenerator, name, entered)


@pytest.fixture
def ways(rig: Rig) -> Iterator[Ways]:
    ways = Ways(rig)
    rig.loop.hold(rig.states(0))
    rig.around.lines.clear()
    with ways.note("accept"), ways.note("join"):
        yield ways


def message(rig: Rig, count: int, last: float, start: float = 0.0) -> SimpleNamespace:
    times = np.linspace(0.0, last, count + 1)[1:]
    share = times / last
    positions = 0.02 * (10 * share**3 - 15 * share**4 + 6 * share**5)
    velocities = 0.02 * (30 * share**2 - 60 * share**3 + 30 * share**4) / last
    velocities[-1] = 0.0
    return trajectory(times, positions, velocities, start=start, names=rig.names)


def goal(rig: Rig, given: SimpleNamespace) -> mock.Mock:
    sender = mock.Mock()
    rig.loop.offer(rig.goal(given, sender))
    return sender


@pytest.mark.parametrize(("count", "last", "beside"), [(20, 20.0, False), (21, 2.0, True), (2, 21.0, True)])
@pytest.mark.parametrize("offered", ["topic", "goal"])
def test_long_checks_run_beside_ticks(ways: Ways, offered: str, count: int, last: float, beside: bool) -> None:
    """Goals and trajectories of more than 20 points, or 20 s: from rest, on the way, and behind one that waits."""
    rig = ways.rig
    with mock.patch.object(points, "joint_table", wraps=points.joint_table) as table:
        table.side_effect = lambda *_, **__: ways.beside.append(not rig.loop.between_ticks.locked()) or mock.DEFAULT
        for _ in range(3):
            given = message(rig, count, last)
            rig.loop.receive(given) if offered == "topic" else goal(rig, given)
            ways.run(30)
        rig.loop.receive(message(rig, 1, 1.0, start=3.0))  # waits
        if offered == "topic":
            rig.loop.receive(message(rig, count, last))
    source = "" if offered == "topic" else "follow_joint_trajectory"
    assert [each[2] for each in rig.around.taken[:4]] == [source] * 3 + [""]
    of_one = [True, True, True, beside]  # its three tables and its way
    assert ways.beside == of_one * 3 + [True, True, True, False] + of_one * (offered == "topic")
    assert not any("rejected" in line for line in rig.around.lines)


def test_a_long_stamped_trajectory_gives_the_same_bits_whenever_it_comes(ways: Ways, rig: Rig) -> None:
    """On the way, behind one that waits, early or just in time: the set-points of the generator that is asked alone."""
    first, last = message(rig, 30, 2.0, start=0.1), message(rig, 2, 21.0, start=1.0)
    last.points[0].velocities = last.points[1].velocities = []
    alone = TrajectoryGenerator(rig.cs7b.trajectory.limits, rig.cs7b.trajectory.period, np.zeros(6))
    for given, start in ((first, 100), (last, 1000)):
        alone.accept(points_from_message(rig.names, given), start, start)
    expected = alone.setpoints(1000, 21_000)
    for early in (120, 400, 950, 1000 - TICKS):
        rig.loop.hold(rig.states(0))
        ways.tick = 0
        ways.meanwhile = lambda _: None
        rig.loop.receive(first)
        ways.run(early)
        ways.begin(lambda _: ways.run(TICKS))
        rig.loop.receive(last)
        assert ways.beside == [True]
        ways.run(1000 - early - TICKS)
        motion = rig.cs7b.trajectory.setpoints(1000, 21_000)
        assert np.array_equal(motion, expected)


def test_what_the_time_was_too_short_for_is_joined_again_beside_the_ticks(ways: Ways) -> None:
    """So where ticks have changed the motion meanwhile, and where the start has passed: the tick is not held up."""
    rig = ways.rig
    rig.loop.receive(message(rig, 2, 2.0))
    ways.run(100)
    lead = round((5e-3 + 30 * 1e-4 + 1.5 * 5e-4) * 1e3)
    ways.begin(lambda call: ways.run(lead + 5 if call == 0 else 3))
    now = rig.cs7b.position_tick
    rig.loop.receive(message(rig, 30, 1.5))
    assert ways.beside == [True, True]
    begin = now + lead + 5 + 4 * lead
    assert rig.around.lines[-1].endswith(f"1.500 s from {begin * 1e-3:.3f} s")

    ways.begin(lambda call: rig.loop.skip(1) if call == 0 else None)
    rig.loop.receive(message(rig, 30, 1.5))
    assert ways.beside == [True, True]

    ways.begin(lambda call: ways.run(20) if call == 0 else None)
    start = (rig.cs7b.position_tick + 10) * 1e-3
    rig.loop.receive(message(rig, 30, 1.5, start=start))
    assert ways.beside == [True, True]
    assert "accepted" in rig.around.lines[-1]


def test_of_a_trajectory_that_has_begun_the_rest_is_followed(ways: Ways) -> None:
    """As by joint_trajectory_controller: a stamp that is over leaves the points still to come; none: it is refused."""
    ways.run(500)
    for end, said in ((2.0, "accepted"), (0.4, "rejected: the last point is at 0.5 s, the controller's time is 0.5 s")):
        ways.rig.loop.receive(message(ways.rig, 4, end, start=0.1))
        assert said in ways.rig.around.lines[-1]
    assert ways.rig.cs7b.trajectory.setpoints(2100)[0, 0] == pytest.approx([0.02] * 6)


@pytest.mark.parametrize(
    ("option", "change", "refusal"),
    [
        ("allow_partial_joints_goal", "joints", "joint 'joint_1' is missing"),
        ("allow_nonzero_velocity_at_trajectory_end", "end", "point 1: joint_1 ends at 0.01 rad/s"),
        ("allow_trajectory_replacement", "first", "point 0: joint_1 starts at 0.5 rad"),
    ],
)
def test_options_of_goals_hold_for_the_topic(rig: Rig, option: str, change: str, refusal: str) -> None:
    """A part of the joints, a last point that moves and a first one elsewhere: refused, and followed by the option."""
    rig.loop.hold(rig.states(0))
    given = message(rig, 2, 2.0)
    if change == "joints":
        given.joint_names = given.joint_names[1:]
        for each in given.points:
            each.positions, each.velocities = each.positions[1:], each.velocities[1:]
    elif change == "end":
        given.points[-1].velocities = [0.01] * 6
    else:
        given.points[0].positions, given.points[0].time_from_start = [0.5] * 6, SimpleNamespace(sec=0, nanosec=0)
    rig.loop.receive(given)
    assert rig.around.lines[-1].startswith(f"trajectory rejected: {refusal}")
    rig.loop.change(options=GoalOptions(**{option: True}))
    rig.loop.receive(given)
    assert "accepted" in rig.around.lines[-1]
    held, velocity, _ = rig.cs7b.trajectory.setpoints(2000)[0]
    assert held == pytest.approx([0.0 if change == "joints" else 0.02, *[0.02] * 5])
    assert velocity == pytest.approx([0.01 if change == "end" else 0.0] * 6)
