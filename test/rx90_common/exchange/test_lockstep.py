"""The simulation's side of lock-step on a channel made by hand, with a clock made by hand."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable

import numpy as np
import pytest
from numpy.typing import NDArray

from rx90_common.exchange import lockstep
from rx90_common.exchange.cdr import JointStateCodec
from rx90_common.exchange.channel import Matches

PERIOD = 250_000
CODEC = JointStateCodec(["a"])


def message(tick: int, value: float = 0.0) -> bytes:
    """Return a message stamped with a tick."""
    return CODEC.encode(tick * PERIOD, _array(value), _array(value), _array(value))


def _array(value: float) -> NDArray[np.float64]:
    return np.array([value])


NOT_FINITE = CODEC.encode(PERIOD, _array(np.nan), _array(0.0))


class FakeChannel:
    """Replays what comes in; waiting lets the clock pass."""

    subscribe_topic = "/other"

    def __init__(self, clock: Clock) -> None:
        self.clock = clock
        self.inbox: deque[bytes] = deque()
        self.sent: list[bytes] = []
        self.peers = Matches(1, 1)
        self.on_wait: Callable[[], None] = lambda: None

    def publish(self, raw: bytes) -> None:
        """Note what is sent."""
        self.sent.append(raw)

    def receive(self, timeout_s: float) -> bytes | None:
        """Return the next message, or None after the timeout."""
        if not self.inbox:
            self.clock.now += timeout_s
            self.on_wait()
        return self.inbox.popleft() if self.inbox else None

    def matches(self) -> Matches:
        """Return the peers."""
        return self.peers


class Clock:
    """The steady clock."""

    now = 50.0


@pytest.fixture
def channel(monkeypatch: pytest.MonkeyPatch) -> FakeChannel:
    """Return a channel whose clock is also the lock-step's."""
    clock = Clock()
    monkeypatch.setattr(lockstep.time, "monotonic", lambda: clock.now)
    return FakeChannel(clock)


def never() -> bool:
    """Never interrupt; the inbox of each test ends the wait."""
    return False


def test_the_simulation_takes_the_command_of_its_tick_alone(channel: FakeChannel) -> None:
    """Commands with other stamps are counted and ignored, whatever their order."""
    simulation = lockstep.LockstepSimulation(channel, pytest.fail)
    for tick in range(50):
        channel.inbox.extend([message(tick - 1) if tick else message(7), message(tick + 3), message(tick, 1.0 * tick)])
        assert simulation.exchange(tick * PERIOD, message(tick), never) == message(tick, 1.0 * tick)
    assert simulation.ignored == 100
    assert channel.sent == [message(tick) for tick in range(50)]


def test_a_command_that_cannot_be_used_leaves_the_tick_to_the_next_one(channel: FakeChannel) -> None:
    """Of two commands for a tick the second is taken when the first is refused; the states are not sent again."""
    simulation = lockstep.LockstepSimulation(channel, pytest.fail)
    channel.inbox.extend([NOT_FINITE, message(0), message(1, 1.0), message(1, 1.0)])
    assert simulation.exchange(PERIOD, message(1), never) == NOT_FINITE
    assert simulation.again(PERIOD, message(1), never) == message(1, 1.0)
    assert channel.sent == [message(1)]
    assert simulation.again(PERIOD, message(1), never) == message(1, 1.0)
    assert simulation.again(PERIOD, message(1), lambda: True) is None


def test_a_silent_controller_gets_the_states_again_once_a_second(channel: FakeChannel) -> None:
    """Silence of a controller that is there is announced once and answered with the same bytes once a second."""
    said: list[str] = []
    simulation = lockstep.LockstepSimulation(channel, said.append)
    end = channel.clock.now + 10.5

    def answer_late() -> None:
        if channel.clock.now > end:
            channel.inbox.append(message(4, 1.0))

    channel.on_wait = answer_late
    assert simulation.exchange(4 * PERIOD, message(4), never) == message(4, 1.0)
    assert channel.sent == [message(4)] * len(channel.sent)
    assert 10 <= len(channel.sent) <= 12
    assert [line.split(":")[0] for line in said] == ["the controller on /other is silent", "the controller answers"]


def test_a_controller_that_appears_gets_the_states_at_once(channel: FakeChannel) -> None:
    """The pending states are sent again as soon as the endpoints have changed, not a second later."""
    said: list[str] = []
    simulation = lockstep.LockstepSimulation(channel, said.append)
    channel.peers = Matches(0, 0)
    appears = channel.clock.now + 0.3
    at: list[float] = []

    def appear() -> None:
        if channel.clock.now > appears:
            channel.peers = Matches(1, 1)
        if len(channel.sent) == 2 and not at:
            at.append(channel.clock.now)
            channel.inbox.append(message(0))

    channel.on_wait = appear
    assert simulation.exchange(0, message(0), never) is not None
    assert at[0] - appears < 0.2
    assert len(said) == 2


def test_a_wait_is_announced_once_whatever_it_is_for(channel: FakeChannel) -> None:
    """A killed controller is first silent, then gone, then silent again: one line for the wait and one for its end."""
    said: list[str] = []
    simulation = lockstep.LockstepSimulation(channel, said.append)
    start = channel.clock.now

    def play() -> None:
        passed = channel.clock.now - start
        channel.peers = Matches(0, 0) if 5.0 < passed < 8.0 else Matches(1, 1)
        if passed > 11.0:
            channel.inbox.append(message(1))

    channel.on_wait = play
    simulation.exchange(PERIOD, message(1), never)
    assert len(said) == 2


def test_an_interruption_ends_the_wait(channel: FakeChannel) -> None:
    """`interrupted` ends a wait without a command, also in a stream of foreign commands."""
    simulation = lockstep.LockstepSimulation(channel, lambda _text: None)
    assert simulation.exchange(0, message(0), lambda: True) is None

    def foreign() -> None:
        channel.inbox.append(message(99))

    channel.on_wait = foreign
    asked = iter([False, False, True])
    assert simulation.exchange(0, message(0), lambda: next(asked)) is None


def test_two_controllers_stop_time_until_one_is_left(channel: FakeChannel) -> None:
    """Two controllers that answer differently are announced once, and no tick is done until one of them is left."""
    said: list[str] = []
    simulation = lockstep.LockstepSimulation(channel, said.append)
    channel.peers = Matches(2, 2)
    left = channel.clock.now + 5.0
    alone: list[bool] = []

    def answer() -> None:
        if channel.clock.now > left:
            channel.peers = Matches(1, 1)
            alone.append(True)
        channel.inbox.append(message(tick, 1.0))
        if not alone:
            channel.inbox.append(message(tick, 2.0))

    channel.on_wait = answer
    done: list[bool] = []
    for tick in range(20):
        assert simulation.exchange(tick * PERIOD, message(tick), never) == message(tick, 1.0)
        done.append(bool(alone))
    assert done.index(True) < 8
    assert said[0].startswith("two controllers answer differently on /other")
    assert len(said) == 2


def test_repetitions_of_an_accepted_command_are_no_second_controller(channel: FakeChannel) -> None:
    """A controller that is asked again and answers again in the same bytes is not taken for two."""
    simulation = lockstep.LockstepSimulation(channel, pytest.fail)
    channel.peers = Matches(2, 2)
    for tick in range(50):
        channel.inbox.extend([message(tick)] * 3)
        assert simulation.exchange(tick * PERIOD, message(tick), never) is not None
    assert simulation.ignored == 98
