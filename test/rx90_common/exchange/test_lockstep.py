"""The lock-step's rules on a channel made by hand, with a clock made by hand."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable

import numpy as np
import pytest
from numpy.typing import NDArray

from rx90_common.base.rates import Rates
from rx90_common.base.stamps import cdr_stamp_ns
from rx90_common.exchange import lockstep
from rx90_common.exchange.cdr import JointStateCodec
from rx90_common.exchange.channel import Matches
from rx90_common.exchange.pacing import Pacer
from rx90_controller.node.serving import Serving
from rx90_controller.node.servo_loop import MotorStates

PERIOD = 250_000
CODEC = JointStateCodec(["a"])


def message(tick: int, value: float = 0.0) -> bytes:
    """Return a message stamped with a tick."""
    return CODEC.encode(tick * PERIOD, _array(value), _array(value), _array(value))


def unusable(tick: int) -> bytes:
    """Return a message stamped with a tick that holds no velocities."""
    return CODEC.encode(tick * PERIOD, position=_array(7.0))


def _array(value: float) -> NDArray[np.float64]:
    return np.array([value])


NOT_FINITE = [CODEC.encode(tick * PERIOD, _array(np.nan), _array(0.0)) for tick in range(3)]


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


class Controller:
    """A controller that counts the calls of its loops."""

    def __init__(self, channel: FakeChannel) -> None:
        self.said: list[str] = []
        self.refused: list[str] = []
        self.answered: list[int] = []
        self.reported: list[int] = []
        self.begun: list[int] = []
        self.prepared = 0
        self.channel = channel
        self.command = np.zeros(1)
        pacer, said = Pacer(Rates().period, 1.0), (self.said.append, self.refused.append)
        self.side = Serving(channel, ["a"], Rates(), self, pacer, "robot", *said)  # type: ignore[arg-type]

    def begin(self) -> None:
        """Count the preparations."""
        self.prepared += 1

    def hold(self, states: MotorStates) -> None:
        """Note where the loops begin."""
        assert self.prepared == len(self.begun) + 1
        self.begun.append(states.stamp_ns // PERIOD)

    def step(self, stamp: int, states: MotorStates) -> bool:
        """Note the tick."""
        assert stamp == states.stamp_ns
        self.answered.append(stamp // PERIOD)
        self.command[0] = float(len(self.answered))
        return True

    def after_command(self, stamp_ns: int) -> None:
        """Note that the command of this tick is out."""
        assert cdr_stamp_ns(self.channel.sent[-1]) == stamp_ns
        self.reported.append(stamp_ns // PERIOD)

    def skip(self, count: int) -> None:
        """Fail: lock-step leaves nothing out."""
        pytest.fail(f"{count} ticks skipped")

    def hear(self, *messages: bytes) -> None:
        """Serve these states."""
        for raw in messages:
            self.channel.inbox.append(raw)
            self.side.serve_lock_step(0.1)


def test_repeated_states_get_the_same_bytes_and_no_second_step(channel: FakeChannel) -> None:
    """States that come again are answered with the cached bytes; the law runs once for each tick."""
    controller = Controller(channel)
    controller.hear(message(0), message(1), message(1), message(1), message(2))
    assert controller.answered == [0, 1, 2]
    assert channel.sent[1] == channel.sent[2] == channel.sent[3]
    assert controller.begun == [0]


def test_other_states_with_the_same_stamp_are_a_reset(channel: FakeChannel) -> None:
    """A simulation that was reset in its first tick is not answered with the command of the states before."""
    controller = Controller(channel)
    controller.hear(message(0, 1.0), message(0, 2.0))
    assert controller.begun == [0, 0]
    assert controller.answered == [0, 0]
    assert channel.sent[0] != channel.sent[1]


@pytest.mark.parametrize("tick", [0, 3, 5, 100])
def test_states_that_do_not_follow_begin_anew(channel: FakeChannel, tick: int) -> None:
    """A stamp other than the next one, back or forth, calls `begin` before the law."""
    controller = Controller(channel)
    controller.hear(*(message(k) for k in range(4)), message(tick, 9.0))
    assert controller.begun == [0, tick]
    assert controller.answered == [0, 1, 2, 3, tick]


def test_foreign_states_at_another_pace_do_not_end_a_controller(channel: FakeChannel) -> None:
    """The loops begin anew with each of them, and with the simulation's own that follow."""
    controller = Controller(channel)
    controller.hear(message(0), message(1), *(message(4000 * k) for k in range(1, 6)), message(2), message(3))
    assert controller.answered == [0, 1, 4000, 8000, 12000, 16000, 20000, 2, 3]
    assert controller.begun == [0, 4000, 8000, 12000, 16000, 20000, 2]


def test_two_simulations_get_no_commands_until_one_is_left(channel: FakeChannel) -> None:
    """Interleaved states of two publishers are announced once and left unanswered until one publisher is left."""
    controller = Controller(channel)
    channel.peers = Matches(2, 2)
    for k in range(20):
        controller.hear(message(1000 + k), message(k))
    sent = len(channel.sent)
    assert sent <= 10
    assert [line for line in controller.said if "two simulations" in line] == controller.said
    assert len(controller.said) == 1
    channel.peers = Matches(1, 1)
    controller.hear(message(40), message(41))
    assert len(channel.sent) == sent + 2
    assert controller.begun[-1] == 40


def test_repeated_resets_of_one_simulation_are_no_second_one(channel: FakeChannel) -> None:
    """One publisher may jump back as often as it likes."""
    controller = Controller(channel)
    for _ in range(20):
        controller.hear(message(0), message(1), message(2))
    assert len(channel.sent) == 60
    assert not controller.said


def test_a_missing_simulation_is_announced_once_and_its_return_too(channel: FakeChannel) -> None:
    """Waiting for a simulation is one line, however long, and its arrival another one."""
    controller = Controller(channel)
    channel.peers = Matches(0, 0)
    for _ in range(100):
        controller.side.serve_lock_step(0.1)
    assert controller.said == ["waiting for a simulation on /other"]
    channel.peers = Matches(1, 1)
    controller.hear(message(0), message(1))
    assert controller.said[1:] == ["the simulation is there: 0 s"]


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
    channel.inbox.extend([NOT_FINITE[1], message(0), message(1, 1.0), message(1, 1.0)])
    assert simulation.exchange(PERIOD, message(1), never) == NOT_FINITE[1]
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


def test_states_that_cannot_be_used_are_left_out(channel: FakeChannel) -> None:
    """A message without usable states changes nothing, whatever its stamp: the next tick's states are answered."""
    controller = Controller(channel)
    bad = [b"", unusable(2), unusable(1), unusable(0), b"garbage", *NOT_FINITE]
    controller.hear(*bad, message(0), message(1), *bad, *bad, message(2), message(3))
    assert controller.answered == [0, 1, 2, 3]
    assert controller.begun == [0]
    assert controller.said == []
    assert len(controller.refused) == 1  # a line, throttled


def test_a_stamp_between_two_ticks_is_refused(channel: FakeChannel) -> None:
    """It is a line with what is accepted, and leaves the states around it alone."""
    odd = CODEC.encode(PERIOD + 7, _array(0.0), _array(0.0))
    controller = Controller(channel)
    controller.hear(message(0), odd, message(1))
    assert "/other: the stamp is 250007 ns; accepted: multiples of 250000 ns" in controller.refused[0]
    assert controller.answered == [0, 1]
