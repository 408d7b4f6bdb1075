"""Efforts at the joints: their transform to the motors, their age in free-running time, and what is said once."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from benchmarks.any_arm import write_arm
from rx90_common.base.errors import ConfigError
from rx90_common.base.rates import Rates
from rx90_common.exchange.cdr import JointStateCodec
from rx90_common.exchange.channel import Matches
from rx90_common.exchange.pacing import OnceLog
from rx90_emulator.loop.own_controller import run_controller
from rx90_emulator.loop.setup import Setup, load_setup
from rx90_sim.joint_interface import JointInterface
from rx90_sim.node.held_command import NewestCommand
from rx90_sim.node.parameters import SimulationParameters
from rx90_sim.plant import Plant

CODEC = JointStateCodec(["a"])
PERIOD = 250_000
OWN_CLOCK = 1_790_000_000 * 10**9


@pytest.fixture(scope="module")
def plant(shipped: Setup) -> Plant:
    """Return the RX90B."""
    return shipped.plant()


def test_power_is_the_same_at_motors_and_joints(plant: Plant) -> None:
    """Whatever moves: motor torque times motor speed, by finite differences, is effort times joint speed.

    The motors' angles for joints' angles are those of the manual: each joint by its gear, motor 6 with joint 5, too.
    """
    rng = np.random.default_rng(1)
    joints, gear = JointInterface(plant, Rates(), 1000), plant.constants["gear"][0]
    for _ in range(20):
        effort, speed = rng.normal(size=(2, 6))
        motor_speed = gear * (speed + np.array([0, 0, 0, 0, 0, speed[4]]))
        torques = joints.motor_torques(effort).copy()
        assert torques @ motor_speed == pytest.approx(effort @ speed, rel=1e-12)
        plant.state["motor_velocity"][0], plant.state["motor_torque"][0] = motor_speed, torques
        _, measured, felt = joints.measure()
        np.testing.assert_allclose(measured, speed, rtol=1e-12, atol=1e-13)
        np.testing.assert_allclose(felt, effort, rtol=1e-12, atol=1e-13)


@pytest.mark.parametrize(
    ("given", "words"),
    [
        ({"command_interface": "gripper"}, "command_interface is 'gripper'; accepted: motor, joint"),
        ({"command_rate": 1000}, "command_rate is 1000 with command_interface motor"),
        ({"command_interface": "joint", "command_rate": 300}, "command_rate is 300 Hz; accepted: a rate that divides"),
        (
            {"command_interface": "joint", "command_rate": 10, "time_mode": "free_running"},
            "command_age_limit is 0.1 s; accepted: at least two periods of the commands, 0.2 s",
        ),
    ],
)
def test_what_cannot_be_kept_is_refused(given: dict[str, object], words: str) -> None:
    """Rates that do not divide, a rate of the motor side, and limits that leave no time to answer are one line."""
    with pytest.raises(ConfigError, match=words):
        SimulationParameters(Rates(), **given)  # type: ignore[arg-type]


class Drive:
    """Newest commands on a channel made by hand, one tick of a quarter of a millisecond after the other."""

    subscribe_topic = "/joint_commands"

    def __init__(self) -> None:
        self.number = 1000
        self.inbox: list[bytes] = []
        self.said: list[str] = []
        once = OnceLog(self.said.append)
        self.held = NewestCommand(self, lambda raw: CODEC.decode(raw)[3], PERIOD, 0.01, self.said.append, once.say)  # type: ignore[arg-type]

    def receive(self, _timeout: float) -> bytes | None:
        """Return the next command."""
        return self.inbox.pop(0) if self.inbox else None

    def matches(self) -> Matches:
        """Return the peers."""
        return Matches(1, 1)

    def tick(self, *stamps_ns: int, to: int | None = None) -> float | None:
        """Run the next tick, or all up to tick `to`, the first with commands of these stamps; return what is held."""
        self.inbox += [CODEC.encode(stamp, effort=np.array([float(stamp)])) for stamp in stamps_ns]
        for _ in range(1 if to is None else to - self.number):
            self.number += 1
            torques = self.held.take(self.number)
        return None if torques is None else float(torques[0])


def test_the_newest_is_held_until_its_age_limit() -> None:
    """By the stamp of the states, 10 ms are 40 ticks; time never waits, and a late command opens the brakes again."""
    drive = Drive()
    assert drive.tick() is None
    assert drive.tick(1001 * PERIOD, 1002 * PERIOD) == 1002.0 * PERIOD
    assert drive.tick(to=1042) == 1002.0 * PERIOD
    assert drive.tick() is None
    assert drive.tick(1040 * PERIOD) == 1040.0 * PERIOD
    assert drive.held.waited == 0
    assert "no command on /joint_commands for 0.01 s: torque off, brakes closed" in drive.said


def test_commands_without_effort_close_the_brakes() -> None:
    """They are followed, and the brakes are said to be closed, not to be open; torque opens them again."""
    drive = Drive()
    drive.tick()
    drive.inbox = [CODEC.encode(1002 * PERIOD)]
    assert drive.tick() is None
    assert len(drive.said) == 1
    assert drive.tick(1003 * PERIOD) is not None
    drive.inbox = [CODEC.encode(1004 * PERIOD)]
    assert drive.tick() is None
    assert drive.said[1:] == ["commands on /joint_commands: the brakes open",
                              "commands on /joint_commands without effort: torque off, brakes closed"]  # fmt: skip


@pytest.mark.parametrize("stamp", [OWN_CLOCK, 0, 20 * PERIOD])
def test_of_another_clock_the_newest_counts_from_its_arrival(stamp: int) -> None:
    """Stamps of the wall clock, none, and those of an old clock: one line, and commands are held for 40 ticks."""
    drive = Drive()
    moves = stamp == OWN_CLOCK
    for k in range(50):
        torque = drive.tick(stamp + k * moves)
    assert torque == float(stamp + 49 * moves)
    assert drive.tick(to=1090) is not None
    assert drive.tick() is None
    (line,) = (line for line in drive.said if "stamp" in line)
    assert ("not set" if stamp == 0 else "the stamp is") in line
    assert "from its arrival" in line


def test_commands_from_before_a_reset_are_none_of_another_clock() -> None:
    """One or two stamps of the future, still on their way at a reset, are not held, and nothing is said of them."""
    drive = Drive()
    assert drive.tick(1001 * PERIOD) is not None
    drive.held.forget()
    drive.number = 0
    assert drive.tick(1002 * PERIOD, 1003 * PERIOD) is None
    assert drive.tick(2 * PERIOD) == 2.0 * PERIOD
    assert not [line for line in drive.said if "stamp" in line]


def test_a_fault_is_said_once() -> None:
    """However often it comes and whatever its numbers; another fault, and one that comes back later, have lines."""
    said: list[str] = []
    now = [0.0]
    once = OnceLog(said.append, lambda: now[0])
    for k in range(1000):
        now[0] += 0.5
        once.say(f"/joint_commands: the stamp is {1.79e9 + k} s at {k:g} s")
    once.say("/joint_commands: joint name 'elbow' is unknown")
    now[0] += 31.0
    once.say("/joint_commands: the stamp is 7 s at 9 s")
    assert [line.split(" is ")[0] for line in said] == [
        "/joint_commands: the stamp",
        "/joint_commands: joint name 'elbow'",
        "/joint_commands: the stamp",
    ]


def test_the_arm_may_have_another_number_of_joints_and_another_coupling(tmp_path: Path) -> None:
    """Seven joints, the last motor of which turns with two: power is the same on both sides; drives give the efforts.

    Efforts that are no number for each joint are refused with their count.
    """
    turns = np.eye(7)
    turns[6, 5] = -1.0  # motor 7 turns with joint 7, and against joint 6
    setup = load_setup(robot=write_arm(tmp_path / "arm", 7, turns.tolist()))
    plant, rng = setup.plant(), np.random.default_rng(2)
    joints = JointInterface(plant, setup.rates, 500)
    effort, speed = rng.normal(size=(2, 7))
    torques, motor_speed = joints.motor_torques(effort).copy(), setup.drives.gear * (turns @ speed)
    assert torques @ motor_speed == pytest.approx(effort @ speed, rel=1e-12)
    plant.state["motor_velocity"][0] = motor_speed
    np.testing.assert_allclose(joints.measure()[1], speed, rtol=1e-12, atol=1e-13)
    stiffness = np.array([2000.0, 2000.0, 2000.0, 1000.0, 500.0, 300.0, 100.0])
    run = run_controller(setup, lambda q, v, _t: stiffness * (0.02 - q - 0.1 * v), 0.5, command_rate=500)
    assert run.measured.shape == (250, 3, 7)
    assert np.isfinite(run.joint_states).all()
    asked = run.efforts[-2]  # which the drives have had for a period
    np.testing.assert_allclose(run.measured[-1, 2], asked, rtol=0.02, atol=0.02)
    with pytest.raises(ConfigError, match="accepted: 7 finite efforts, Nm, or None"):
        run_controller(setup, lambda _q, _v, _t: np.zeros(6), 0.01)
