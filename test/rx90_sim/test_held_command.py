"""Commands held in free-running time, on a channel and a clock made by hand."""

from __future__ import annotations

import numpy as np
import pytest

held_command = pytest.importorskip("rx90_sim.node.held_command", reason="needs rclpy", exc_type=ImportError)
from rx90_common.exchange.channel import Matches  # noqa: E402
from rx90_common.exchange.joint_state_cdr import JointStateCodec  # noqa: E402

CODEC = JointStateCodec(["a"])
PERIOD = 250_000
TIMEOUT = 4


class Drive:
    """A held command whose ticks are a quarter of a millisecond of a clock made by hand."""

    subscribe_topic = "/motor_commands"

    def __init__(self, monkeypatch: pytest.MonkeyPatch) -> None:
        self.now = 20.0
        monkeypatch.setattr(held_command.time, "monotonic", lambda: self.now)
        self.inbox: list[bytes] = []
        self.said: list[str] = []
        self.publishers = 1
        self.held = held_command.HeldCommand(self, lambda raw: CODEC.decode(raw)[3], TIMEOUT, self.said.append)

    def receive(self, _timeout: float) -> bytes | None:
        """Return the next command."""
        return self.inbox.pop(0) if self.inbox else None

    def matches(self) -> Matches:
        """Return the peers."""
        return Matches(1, self.publishers)

    def tick(self, *stamps: int, count: int = 1) -> float | None:
        """Run ticks, the first one with commands of these stamps; return what the last one holds."""
        self.inbox += [CODEC.encode(stamp * PERIOD, effort=np.array([float(stamp)])) for stamp in stamps]
        for _ in range(count):
            self.now += 250e-6
            torques = self.held.take()
        return None if torques is None else float(torques[0])


@pytest.fixture
def drive(monkeypatch: pytest.MonkeyPatch) -> Drive:
    """Return a drive that has heard nothing yet."""
    return Drive(monkeypatch)


def test_a_command_is_held_until_it_is_stale(drive: Drive) -> None:
    """The newest command is held for the timeout's ticks and no tick longer, each change is one line."""
    assert drive.tick() is None
    assert drive.tick(1, 2) == 2.0
    assert drive.tick(count=TIMEOUT) == 2.0
    assert drive.tick() is None
    assert drive.tick(9) == 9.0
    assert [line.split(" on ")[0] for line in drive.said] == [
        "waiting for a controller",
        "commands",
        "no fresh command",
        "commands",
    ]


def test_a_command_does_not_age_while_time_stands_still(drive: Drive) -> None:
    """However long no tick is run, the command is held in the next one."""
    drive.tick(1)
    drive.now += 3600.0
    assert drive.tick() == 1.0


def test_brakes_that_flap_do_not_flood_the_terminal(drive: Drive) -> None:
    """Of 400 changes within a second a handful of lines is left, and the last state is reported with a count."""
    drive.tick(1)
    for stamp in range(200):
        drive.tick(stamp, count=TIMEOUT + 2)
    assert len(drive.said) == 4
    drive.tick(count=50_000)
    assert len(drive.said) == 5
    assert "brakes closed" in drive.said[-1]
    assert "(after 39" in drive.said[-1]


def test_a_second_controller_is_told_and_takes_the_torque_away(drive: Drive) -> None:
    """Commands of two controllers, recognised by stamps that go back, are not used until one is left."""
    drive.publishers = 2
    for k in range(1, 11):
        torque = drive.tick(1000 + k, k)
    assert torque is None
    assert drive.held.two_controllers
    assert [line for line in drive.said if "two controllers" in line] == drive.said[-1:]
    for k in range(30_000):
        torque = drive.tick(2000 + k)
    assert torque == 31_999.0
    assert not drive.held.two_controllers
    assert "one controller is left" in drive.said[-1]


def test_a_controller_that_begins_again_is_no_second_one(drive: Drive) -> None:
    """One step back of the stamps, beside a dead controller that is still in the graph, changes nothing."""
    drive.publishers = 2
    drive.tick(1000)
    assert drive.tick(1) == 1.0
    assert drive.tick(2) == 2.0
    assert not drive.held.two_controllers
