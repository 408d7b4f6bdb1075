"""Commands held in free-running time, on a channel and a clock made by hand."""

import struct
from collections.abc import Callable
from functools import partial
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from rclpy.qos import QoSProfile, ReliabilityPolicy

from rx90_common.exchange.cdr import JointStateCodec
from rx90_common.exchange.channel import Matches
from rx90_common.exchange.pacing import OnceLog, ThrottledLog
from rx90_sim.node import held_command
from rx90_sim.node.held_command import CommandWatch, HeldCommand, NewestCommand, joint_commands

CODEC = JointStateCodec(["a"])
PERIOD = 250_000
TIMEOUT = 0.02
OWN_CLOCK = 1_790_000_000 * 4000  # ticks


class Drive:
    """A held command in ticks of 250 us of a clock made by hand; who waits gets the next one of `late` in time."""

    subscribe_topic = "/motor_commands"

    def __init__(self, monkeypatch: pytest.MonkeyPatch) -> None:
        self.now = 20.0
        self.number = 0
        monkeypatch.setattr(held_command.time, "monotonic", lambda: self.now)
        self.inbox: list[bytes] = []
        self.late: list[tuple[float, int]] = []  # seconds of waiting, stamp in ticks
        self.said: list[str] = []
        self.publishers = 1
        self.hold(held_command.HeldCommand, TIMEOUT, partial(ThrottledLog(self.said.append).say, "command"))

    def hold(
        self,
        kind: type[HeldCommand],
        timeout: float,
        complain: Callable[[str], None],
        decode: Callable[[bytes], Any] = lambda raw: CODEC.decode(raw)[3],
    ) -> None:
        channel: Any = self
        self.held = kind(channel, decode, PERIOD, timeout, self.said.append, complain, lambda: False)

    def receive(self, timeout: float) -> bytes | None:
        if not self.inbox and timeout > 0.0:
            after, stamp = self.late[0] if self.late else (1e9, 0)
            waited = min(timeout, after)
            self.now += waited
            if self.late:
                self.late[0] = (after - waited, stamp)
                if after <= timeout:
                    self.late.pop(0)
                    self.inbox.append(command(stamp))
        return self.inbox.pop(0) if self.inbox else None

    def matches(self) -> Matches:
        return Matches(1, self.publishers)

    def tick(self, *stamps: int, to: int | None = None) -> float | None:
        """Run the next tick, or all up to tick `to`, the first with commands of these stamps; return what is held."""
        self.inbox += [command(stamp) for stamp in stamps]
        torques = None
        for _ in range(1 if to is None else to - self.number):
            self.number += 1
            self.now += 250e-6
            torques = self.held.take(self.number)
        return None if torques is None else float(torques[0])


def command(stamp: int) -> bytes:
    return CODEC.encode(stamp * PERIOD, effort=np.array([float(stamp)]))


@pytest.fixture
def drive(monkeypatch: pytest.MonkeyPatch) -> Drive:
    return Drive(monkeypatch)


def test_a_command_is_held_while_it_is_new(drive: Drive) -> None:
    """The newest command is held for three ticks after the one that it answers; then it is waited for, in vain once."""
    assert drive.tick() is None
    assert drive.tick(1, 2) == 2.0
    assert drive.tick(to=5) == 2.0
    began = drive.now
    assert drive.tick() is None
    assert drive.now - began == pytest.approx(250e-6 + TIMEOUT)
    assert drive.tick(to=500) is None
    assert drive.now - began == pytest.approx(495 * 250e-6 + TIMEOUT)
    assert drive.tick(499) == 499.0
    assert [line.split(" on ")[0] for line in drive.said] == [
        "waiting for a controller",
        "commands",
        "no command",
        "commands",
    ]


def test_a_late_command_holds_time_up(drive: Drive) -> None:
    """A command that comes within the timeout is waited for; the brakes stay open."""
    drive.tick(1)
    drive.late = [(0.005, 2), (0.010, 5)]
    assert drive.tick(to=5) == 2.0
    assert drive.tick() == 5.0
    assert drive.held.waited == 2
    assert drive.now == pytest.approx(20.0 + 6 * 250e-6 + 0.015)
    assert drive.said == []


def test_a_command_does_not_age_while_time_stands_still(drive: Drive) -> None:
    """However long no tick is run, the command is held in the next one."""
    drive.tick(1)
    drive.now += 3600.0
    assert drive.tick() == 1.0


@pytest.mark.parametrize("stamp", [-1, 3, 10**12, -(10**12), 2**31 * 4000 - 1])
def test_a_command_from_elsewhere_is_no_command(drive: Drive, stamp: int) -> None:
    """A stamp before the start, of the future or decades away changes nothing; a new one is named in a line."""
    drive.tick(1)
    raw = bytearray(command(1))
    seconds, ticks = divmod(stamp, 4000)
    raw[4:12] = struct.pack("<iI", max(-(2**31), min(seconds, 2**31 - 1)), ticks * PERIOD)
    drive.inbox = [bytes(raw)]
    assert drive.tick() == 1.0
    assert len(drive.said) == (stamp > 0)
    assert all("/motor_commands: the stamp is" in line and "is ignored" in line for line in drive.said)


@pytest.mark.parametrize("raw", [b"", b"\0", b"\0\1\0\0", command(2)[:-3], b"\0\1\0\0" + b"\xff" * 60])
def test_garbage_is_no_command(drive: Drive, raw: bytes) -> None:
    """Bytes that are no command, before or after one, are named in a line and change nothing."""
    drive.tick(1)
    drive.inbox = [raw]
    assert drive.tick() == 1.0
    drive.inbox = [command(3), raw]
    assert drive.tick() == 3.0
    (line,) = (line for line in drive.said if "ignored" in line)
    assert line.startswith("/motor_commands: ")


def test_a_second_controller_is_told_and_takes_the_torque_away(drive: Drive) -> None:
    """Commands of two controllers, recognised by stamps that go back, are not used until one is left."""
    drive.publishers = 2
    drive.number = 1000
    for k in range(1, 11):
        torque = drive.tick(1000 + k, 990 + k)
    assert torque is None
    assert drive.held.two_controllers
    assert [line for line in drive.said if "two controllers" in line] == drive.said[-1:]
    for k in range(30_000):
        torque = drive.tick(1011 + k)
    assert torque == 31_010.0
    assert not drive.held.two_controllers
    assert "one controller is left" in drive.said[-1]


def test_a_reset_takes_the_command_away(drive: Drive) -> None:
    """After a reset, commands from before it that are still on their way are ignored; the first new one is followed."""
    drive.number = 1000
    assert drive.tick(1000) == 1000.0
    drive.held.forget()
    drive.number = 0
    drive.publishers = 2  # a dead controller may still be in the graph
    assert drive.tick(1001) is None
    assert drive.tick(1002, 2) == 2.0
    assert not drive.held.two_controllers


@pytest.fixture
def joints(drive: Drive) -> Drive:
    drive.hold(NewestCommand, 0.01, OnceLog(drive.said.append, lambda: drive.now).say)
    drive.number = 1000
    return drive


def test_the_newest_is_held_until_its_age_limit(joints: Drive) -> None:
    """By the stamp of the states, 10 ms are 40 ticks; time never waits, and a late command opens the brakes again."""
    assert joints.tick() is None
    assert joints.tick(1001, 1002) == 1002.0
    assert joints.tick(to=1042) == 1002.0
    assert joints.tick() is None
    assert joints.tick(1040) == 1040.0
    assert joints.held.waited == 0
    assert "no command on /motor_commands for 0.01 s: torque off, brakes closed" in joints.said


def test_commands_without_effort_close_the_brakes(joints: Drive) -> None:
    """They are followed, and the brakes are said to be closed, not to be open; torque opens them again."""
    joints.tick()
    joints.inbox = [CODEC.encode(1002 * PERIOD)]
    assert joints.tick() is None
    assert len(joints.said) == 1
    assert joints.tick(1003) is not None
    joints.inbox = [CODEC.encode(1004 * PERIOD)]
    assert joints.tick() is None
    assert joints.said[1:] == ["commands on /motor_commands: the brakes open",
                               "commands on /motor_commands without effort: torque off, brakes closed"]  # fmt: skip


@pytest.mark.parametrize("stamp", [OWN_CLOCK, 0, 20])
def test_of_another_clock_the_newest_counts_from_its_arrival(joints: Drive, stamp: int) -> None:
    """Stamps of the wall clock, none, and those of an old clock: one line, and commands are held for 40 ticks."""
    moves = stamp == OWN_CLOCK
    for k in range(50):
        torque = joints.tick(stamp + k * moves)
    assert torque == float(stamp + 49 * moves)
    assert joints.tick(to=1090) is not None
    assert joints.tick() is None
    (line,) = (line for line in joints.said if "stamp" in line)
    assert ("not set" if stamp == 0 else "the stamp is") in line
    assert "from its arrival" in line


def test_commands_from_before_a_reset_are_none_of_another_clock(joints: Drive) -> None:
    """One or two stamps of the future, still on their way at a reset, are not held, and nothing is said of them."""
    assert joints.tick(1001) is not None
    joints.held.forget()
    joints.number = 0
    assert joints.tick(1002, 1003) is None
    assert joints.tick(2) == 2.0
    assert not [line for line in joints.said if "stamp" in line]


JOINTS = ("joint_1", "joint_2")
ONES = np.ones(2)


@pytest.mark.parametrize(
    ("names", "arrays", "words"),
    [
        (("a", "joint_2"), {"effort": ONES}, "joint name 'a' is unknown; accepted: joint_1, joint_2"),
        (JOINTS[:1], {"effort": ONES[:1]}, "joint name 'joint_2' is missing; accepted: joint_1, joint_2"),
        (JOINTS, {"position": ONES}, "position without effort; accepted: 2 efforts at the joints, Nm"),
        (JOINTS, {"effort": np.array([np.nan, 0.0])}, "effort of joint_1 is nan; accepted: a finite number"),
        (JOINTS, {}, "effort is empty: no torque, brakes closed; for torque: 2 efforts at the joints, Nm"),
    ],
)
def test_each_fault_is_one_line(drive: Drive, names: tuple[str, ...], arrays: dict[str, Any], words: str) -> None:
    """However often it comes: what is wrong, and what is expected; the next right command is followed."""
    once = OnceLog(drive.said.append, lambda: drive.now)
    joints: Any = SimpleNamespace(motor_torques=lambda effort: effort)
    drive.hold(NewestCommand, 0.01, once.say, joint_commands(joints, JOINTS, "/joint_commands", once))
    for k in range(1, 51):
        drive.inbox = [JointStateCodec(names).encode(k * PERIOD, **arrays)]
        assert drive.tick() is None
    assert [words in line for line in drive.said].count(True) == 1
    drive.inbox = [JointStateCodec(JOINTS).encode(51 * PERIOD, effort=ONES)]
    assert drive.tick() == 1.0


def test_publishers_that_are_not_heard_are_told_once() -> None:
    """Best effort, another type, and the topic of the other interface: node and what is accepted."""

    def endpoint(node: str, kind: str, reliability: ReliabilityPolicy) -> SimpleNamespace:
        qos = QoSProfile(depth=1, reliability=reliability)
        return SimpleNamespace(node_name=node, endpoint_gid=node.encode(), topic_type=kind, qos_profile=qos)

    good = "sensor_msgs/msg/JointState", ReliabilityPolicy.RELIABLE
    hasty = endpoint("hasty", good[0], ReliabilityPolicy.BEST_EFFORT)
    other = endpoint("other", "std_msgs/msg/Float64MultiArray", good[1])
    publishers = {"/joint_commands": [hasty, other], "/motor_commands": [endpoint("stray", *good)]}
    node: Any = SimpleNamespace(
        resolve_topic_name=lambda name: f"/{name}",
        create_timer=lambda *_: None,
        get_publishers_info_by_topic=lambda topic: publishers.get(topic, []),
    )
    said: list[str] = []
    watch = CommandWatch(node, "joint", OnceLog(said.append, lambda: 0.0))
    for _ in range(5):
        watch.look()
    assert len(said) == 3
    assert said[0].startswith("/joint_commands: node hasty publishes best effort, which is not heard; accepted: ")
    assert said[1].endswith("node other publishes std_msgs/msg/Float64MultiArray; accepted: sensor_msgs/msg/JointState")
    assert said[2].startswith("/motor_commands: node stray is not heard, because command_interface is joint; accepted")
