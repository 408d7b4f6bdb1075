"""The controller in operation, without ROS: held arm, trajectories, torque on and off."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

from rx90_common.exchange.motor_messages import MotorStates
from rx90_controller.node.servo_loop import ServoLoop
from rx90_emulator.loop.setup import Setup


class Surroundings:
    """What a servo loop has around it: a log, and topics that note what is published."""

    def __init__(self) -> None:
        self.lines: list[str] = []
        self.published: list[int] = []

    def info(self, text: str) -> None:
        """Note a line."""
        self.lines.append(text)

    def error(self, text: str) -> None:
        """Note a line."""
        self.lines.append(text)

    def wait_for_subscribers(self) -> None:
        """Note the wait."""
        self.lines.append("subscribers")

    def ready(self) -> None:
        """Note that the first states have come."""
        self.lines.append("ready")

    def publish(self, stamp_ns: int) -> None:
        """Note when."""
        self.published.append(stamp_ns)


class Rig:
    """A servo loop on motors that stand still, ticked by hand."""

    def __init__(self, setup: Setup) -> None:
        self.around = Surroundings()
        self.cs7b = setup.cs7b()
        self.names = setup.robot.joint_names
        self.loop = ServoLoop(self.cs7b, self.around)
        self.period = setup.rates.period_ns
        self.position = np.zeros(6)

    def states(self, tick: int) -> MotorStates:
        """Return the states of a tick."""
        return MotorStates(tick * self.period, self.position, np.zeros(6))

    def run(self, first: int, count: int) -> list[bool]:
        """Run ticks; return for each whether there is torque."""
        return [self.loop.step(tick * self.period, self.states(tick)) for tick in range(first, first + count)]

    def trajectory(self, target: float, seconds: int = 1) -> SimpleNamespace:
        """Return a message that moves all joints to `target`, rad, from now on."""
        empty: list[float] = []
        point = SimpleNamespace(
            positions=[target] * 6, velocities=[0.0] * 6, accelerations=empty, effort=empty,
            time_from_start=SimpleNamespace(sec=seconds, nanosec=0),
        )  # fmt: skip
        header = SimpleNamespace(stamp=SimpleNamespace(sec=0, nanosec=0))
        return SimpleNamespace(header=header, joint_names=list(self.names), points=[point])


@pytest.fixture
def rig(shipped: Setup) -> Rig:
    """Return a servo loop that has seen nothing yet."""
    return Rig(shipped)


def test_a_trajectory_waits_for_the_first_states(rig: Rig) -> None:
    """What comes before the first states is followed from their tick on; that they have come is said once."""
    rig.loop.offer(rig.trajectory(0.1))
    assert rig.around.lines == ["a trajectory waits for the simulation's first tick"]
    rig.loop.begin()
    rig.loop.hold(rig.states(400))
    assert rig.around.lines[1:] == ["subscribers", "ready", "trajectory accepted: 1 points, 1.000 s from 0.100 s"]
    rig.run(400, 4004)
    assert rig.cs7b.reference()[0] == pytest.approx([0.1] * 6)
    rig.loop.hold(rig.states(0))
    assert rig.around.lines.count("ready") == 1


def test_set_points_are_published_in_ticks_of_the_position_loop(rig: Rig) -> None:
    """Of eight ticks two run the position loop, and each of these is published with its own stamp."""
    rig.loop.hold(rig.states(8))
    assert rig.run(8, 8) == [True] * 8
    assert rig.around.published == [8 * rig.period, 12 * rig.period]


def test_switched_off_the_loop_gives_no_torque_and_holds_what_it_measures(rig: Rig) -> None:
    """Without torque the set-points follow the arm and trajectories are refused; on again it is held where it is."""
    rig.loop.hold(rig.states(0))
    rig.loop.offer(rig.trajectory(0.1))
    rig.loop.enable(False)
    rig.position = np.full(6, 3.0)
    assert rig.run(0, 3) == [False] * 3
    rig.loop.offer(rig.trajectory(0.2))
    assert rig.loop.rejected == 1
    assert "the controller is disabled" in rig.around.lines[-1]
    rig.loop.enable(True)
    assert rig.run(3, 8) == [True] * 8
    assert rig.loop.command == pytest.approx(np.zeros(6), abs=1e-9)
    assert not rig.cs7b.trajectory.moving(rig.cs7b.position_tick)


def test_skipped_ticks_come_later(rig: Rig) -> None:
    """A motion goes on where it was after ticks without set-points."""
    rig.loop.hold(rig.states(0))
    rig.loop.offer(rig.trajectory(0.1))
    rig.run(0, 2000)
    before = rig.cs7b.reference()[0].copy()
    rig.loop.skip(300)
    rig.run(2000 + 4 * 300, 1)
    assert np.abs(rig.cs7b.reference()[0] - before).max() < 1e-3
    assert rig.cs7b.trajectory.moving(rig.cs7b.position_tick)
