"""The simulation's side of lock-step on a channel made by hand, with a clock made by hand."""

from collections import deque
from collections.abc import Callable

import numpy as np
import pytest

from rx90_common.base.errors import ExchangeError
from rx90_common.exchange import lockstep
from rx90_common.exchange.cdr import JointStateCodec
from rx90_common.exchange.channel import Matches

PERIOD = 250_000
CODEC = JointStateCodec(["a"])


def message(tick: int, value: float = 0.0) -> bytes:
    return CODEC.encode(tick * PERIOD, *[np.array([value])] * 3)


class Controller:
    """The channel to a controller that replays what a test gives it; waiting lets the clock pass."""

    subscribe_topic = "/other"

    def __init__(self) -> None:
        self.passed = 0.0
        self.inbox: deque[bytes] = deque()
        self.sent: list[bytes] = []
        self.said: list[str] = []
        self.peers = Matches(1, 1)
        self.on_wait: Callable[[], None] = lambda: None
        self.side = lockstep.LockstepSimulation(self, self.said.append, self.said.append, self.usable)  # type: ignore[arg-type]

    def usable(self, raw: bytes) -> bool:
        try:
            CODEC.decode(raw)
        except ExchangeError:
            self.said.append("unusable")
            return False
        return True

    def publish(self, raw: bytes) -> None:
        self.sent.append(raw)

    def receive(self, timeout_s: float) -> bytes | None:
        if not self.inbox:
            self.passed += timeout_s
            self.on_wait()
        return self.inbox.popleft() if self.inbox else None

    def matches(self) -> Matches:
        return self.peers

    def exchange(self, tick: int, interrupted: Callable[[], bool] = lambda: False) -> bytes | None:
        return self.side.exchange(tick * PERIOD, message(tick), interrupted)


@pytest.fixture
def controller(monkeypatch: pytest.MonkeyPatch) -> Controller:
    controller = Controller()
    monkeypatch.setattr(lockstep.time, "monotonic", lambda: 50.0 + controller.passed)
    return controller


def test_the_simulation_takes_the_command_of_its_tick_alone(controller: Controller) -> None:
    """Commands with other stamps are counted and ignored, whatever their order."""
    for tick in range(50):
        command = message(tick, 1.0 * tick)
        controller.inbox.extend([message(tick - 1) if tick else message(7), message(tick + 3), command])
        assert controller.exchange(tick) == command
    assert controller.side.ignored == 100
    assert controller.sent == [message(tick) for tick in range(50)]
    assert controller.said == []


def test_a_command_that_cannot_be_used_leaves_the_tick_to_the_next_one(controller: Controller) -> None:
    """The one that is usable is taken; only where time has stood still meanwhile, a line says that it runs on."""
    for tick in range(1, 51):
        good = message(tick, 1.0)
        controller.inbox.extend([message(tick, np.nan), message(tick - 1), good, good])
        assert controller.exchange(tick) == good
    assert controller.sent == [message(tick) for tick in range(1, 51)]
    assert controller.said == ["unusable"] * 50
    controller.inbox.clear()
    controller.on_wait = lambda: controller.inbox.extend([message(51, np.nan)] * (controller.passed % 1.0 < 0.05))
    assert controller.exchange(51, lambda: controller.passed > 5.0) is None
    assert set(controller.said) == {"unusable"}
    assert len(controller.sent) > 53
    controller.on_wait = lambda: controller.inbox.append(message(51))
    assert controller.exchange(51) == message(51)
    assert controller.said[-1] == "the controller answers: time runs on from 0.01275 s"


def test_who_answers_with_the_stamp_before_is_told(controller: Controller) -> None:
    """Such a controller is right once the states come again, so that time creeps; that is said, not that it runs on."""
    last = [9]

    def answer() -> None:
        if len(controller.sent) > heard[0]:
            heard[0] = len(controller.sent)
            controller.inbox.append(message(last[0], 0.5 * heard[0]))
            last[0] = tick

    heard = [0]
    controller.on_wait = answer
    for tick in range(8):
        assert controller.exchange(tick) is not None
    assert 6.0 < controller.passed < 10.0
    assert controller.said
    assert all("accepted in lock_step: that of the states" in line for line in controller.said)


def test_a_silent_controller_gets_the_states_again_once_a_second(controller: Controller) -> None:
    """Silence of a controller that is there is announced once and answered with the same bytes once a second."""
    controller.on_wait = lambda: controller.inbox.extend([message(4, 1.0)] * (controller.passed > 10.5))
    assert controller.exchange(4) == message(4, 1.0)
    assert controller.sent == [message(4)] * len(controller.sent)
    assert 10 <= len(controller.sent) <= 12
    said = [line.split(":")[0] for line in controller.said]
    assert said == ["the controller on /other is silent", "the controller answers"]


def test_a_controller_that_appears_gets_the_states_at_once(controller: Controller) -> None:
    """The pending states are sent again as soon as the endpoints have changed, not a second later."""
    controller.peers = Matches(0, 0)
    at: list[float] = []

    def appear() -> None:
        if controller.passed > 0.3:
            controller.peers = Matches(1, 1)
        if len(controller.sent) == 2 and not at:
            at.append(controller.passed)
            controller.inbox.append(message(0))

    controller.on_wait = appear
    assert controller.exchange(0) is not None
    assert at[0] - 0.3 < 0.2
    assert len(controller.said) == 2


def test_an_interruption_ends_the_wait(controller: Controller) -> None:
    """`interrupted` ends a wait without a command, also in a stream of foreign commands."""
    assert controller.exchange(0, lambda: True) is None
    controller.on_wait = lambda: controller.inbox.append(message(99))
    asked = iter([False, False, True])
    assert controller.exchange(0, lambda: next(asked)) is None


def test_wrong_stamps_are_one_line(controller: Controller) -> None:
    """Who answers with other stamps, or always with the last one, is told in one line what is expected."""
    for tick, stamp in ((0, 7_000_000_000_000), (1, 0)):
        controller.passed = 0.0
        controller.said.clear()

        def answer(tick: int = tick, stamp: int = stamp) -> None:
            right = controller.passed > 9.0
            controller.inbox.append(message(tick) if right else message(stamp))

        controller.on_wait = answer
        assert controller.exchange(tick) == message(tick)
        wrong, over = controller.said
        assert wrong.endswith("accepted in lock_step: that of the states that a command answers; time stands still")
        assert ("of another clock" in wrong) == (stamp > 0)
        assert ("not set" in wrong) == (stamp == 0)
        assert over.startswith("the controller answers")


def test_two_controllers_stop_time_until_one_is_left(controller: Controller) -> None:
    """Two that answer differently are announced once, and no tick is done until one is left; repetitions are no two."""
    controller.peers = Matches(2, 2)
    for tick in range(50):
        controller.inbox.extend([message(tick)] * 3)
        assert controller.exchange(tick) is not None
    assert (controller.side.ignored, controller.said) == (98, [])
    controller.inbox.clear()
    alone: list[bool] = []

    def answer() -> None:
        if controller.passed > 5.0:
            controller.peers = Matches(1, 1)
            alone.append(True)
        controller.inbox.append(message(tick, 1.0))
        if not alone:
            controller.inbox.append(message(tick, 2.0))

    controller.on_wait = answer
    done: list[bool] = []
    for tick in range(50, 70):
        assert controller.exchange(tick) == message(tick, 1.0)
        done.append(bool(alone))
    assert done.index(True) < 8
    assert controller.said[0].startswith("two controllers answer differently on /other")
    assert len(controller.said) == 2
