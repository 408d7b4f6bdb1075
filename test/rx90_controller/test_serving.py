"""The controller's ticks in lock-step and in free-running time, on a channel and a wall clock made by hand."""

import threading
import time
from collections.abc import Callable
from itertools import pairwise
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from processes import TIMEOUT, wait_until
from rclpy.serialization import serialize_message
from std_msgs.msg import String

from rx90_common.base.rates import Rates
from rx90_common.exchange.cdr import JointStateCodec
from rx90_common.exchange.channel import Matches
from rx90_common.exchange.pacing import Pacer
from rx90_common.exchange.topics import FREE_RUNNING, TimeMode
from rx90_controller.node import serving, simulation_mode
from rx90_controller.servo.servo import MotorStates

RATES = Rates(1000, 1000)
TICK = RATES.period
CODEC = JointStateCodec(["a"])


class Simulation:
    """A simulation behind a channel: one message for each tick of its clock, which may run fast, slow or not at all."""

    subscribe_topic = "/motor_states"

    def __init__(self) -> None:
        self.now = 100.0
        self.publishers = 1
        self.waits = 0
        self.speed = 1.0
        self.tick = 0
        self.inbox: list[bytes] = []
        self.foreign: list[bytes] = []  # what somebody else sends, each right behind the next states
        self.commands: list[bytes] = []
        self._phase = 0.0

    def sleep(self, seconds: float) -> None:
        self.now += seconds
        self._phase += seconds * self.speed / TICK
        while self._phase >= 1.0:
            self._phase -= 1.0
            values = np.full(1, float(self.tick))
            self.inbox.append(CODEC.encode(self.tick * RATES.period_ns, values, values))
            self.tick += 1
            if self.foreign:
                self.inbox.append(self.foreign.pop())

    def matches(self) -> Matches:
        return Matches(1, self.publishers)

    def receive(self, timeout: float) -> bytes | None:
        deadline = self.now + timeout
        self.waits += timeout > 0.0 and not self.inbox
        while not self.inbox and self.now < deadline:
            self.sleep(TICK)
        return self.inbox.pop(0) if self.inbox else None

    def publish(self, raw: bytes) -> None:
        self.commands.append(raw)

    def wake(self) -> None:
        """Nobody waits."""


class Loops:
    def __init__(self, simulation: Simulation) -> None:
        self.simulation = simulation
        self.said: list[str] = []
        self.refused: list[str] = []
        self.begun: list[int] = []
        self.skipped: list[int] = []
        self.ticks: list[tuple[float, int, int]] = []  # wall clock, own tick, the simulation's
        self.answered: list[tuple[int, int]] = []  # own tick, that of the states
        self.prepared = 0
        self.command = np.zeros(1)
        pacer = Pacer(TICK, 1.0, lambda: simulation.now, simulation.sleep)
        said = self.said.append, self.refused.append
        self.side = serving.Serving(simulation, ["a"], RATES, self, pacer, "robot", *said)  # type: ignore[arg-type]

    def begin(self) -> None:
        self.prepared += 1
        self.simulation.sleep(0.5)

    def after_command(self, stamp_ns: int) -> None:
        """Publish nothing."""

    def skip(self, count: int) -> None:
        self.skipped.append(count)

    def hold(self, states: MotorStates) -> None:
        self.begun.append(states.stamp_ns // RATES.period_ns)

    def step(self, stamp: int, states: MotorStates) -> bool:
        measured = states.stamp_ns // RATES.period_ns
        assert states.position[0] == states.velocity[0] == measured
        self.answered.append((stamp // RATES.period_ns, measured))
        self.ticks.append((self.simulation.now, stamp // RATES.period_ns, self.simulation.tick))
        self.command[0] = float(len(self.ticks))
        return True

    def hear(self, *messages: bytes) -> None:
        for raw in messages:
            self.simulation.inbox.append(raw)
            self.side.serve_lock_step(0.0)

    def run(self, until: Callable[[], bool]) -> None:
        for _ in range(200_000):
            if until():
                return
            self.side.serve_free_running()
        pytest.fail("the condition never held")

    def run_for(self, seconds: float) -> None:
        end = self.simulation.now + seconds
        self.run(lambda: self.simulation.now >= end)


def message(tick: int, effort: float = 0.0) -> bytes:
    values = np.full(1, float(tick))
    return CODEC.encode(tick * RATES.period_ns, values, values, np.full(1, effort))


@pytest.fixture
def lock_step() -> Loops:
    loops = Loops(Simulation())
    loops.simulation.speed = 0.0
    return loops


@pytest.mark.parametrize(
    ("heard", "begun", "answered"),
    [
        ([0, 1, 1, 1, 2], [0], [0, 1, 2]),
        ([0, 0.5], [0, 0], [0, 0]),  # reset in its first tick
        ([0, 1, 2, 3, 0], [0, 0], [0, 1, 2, 3, 0]),
        ([0, 1, 2, 5], [0, 5], [0, 1, 2, 5]),
        ([0, 1, 4000, 8000, 12000, 2, 3], [0, 4000, 8000, 12000, 2], [0, 1, 4000, 8000, 12000, 2, 3]),
    ],
)
def test_ticks_are_answered_once(lock_step: Loops, heard: list[float], begun: list[int], answered: list[int]) -> None:
    """States that come again get the same bytes; others with their stamp, or with one from elsewhere, begin anew."""
    lock_step.hear(*(message(int(tick), tick % 1.0) for tick in heard))
    assert (lock_step.begun, [own for own, _ in lock_step.answered]) == (begun, answered)
    sent = lock_step.simulation.commands
    assert len(sent) == len(heard)
    for k in range(1, len(heard)):
        assert (sent[k] == sent[k - 1]) == (heard[k] == heard[k - 1])


def test_two_simulations_in_lock_step_get_no_commands_until_one_is_left(lock_step: Loops) -> None:
    """Interleaved states of two publishers are announced once; one publisher may jump back as often as it likes."""
    simulation = lock_step.simulation
    for _ in range(20):
        lock_step.hear(message(0), message(1), message(2))
    assert (len(simulation.commands), lock_step.said) == (60, [])
    simulation.publishers = 2
    for k in range(20):
        lock_step.hear(message(1000 + k), message(k))
    sent = len(simulation.commands)
    assert sent <= 70
    assert ["two simulations" in line for line in lock_step.said] == [True]
    simulation.publishers = 1
    lock_step.hear(message(40), message(41))
    assert len(simulation.commands) == sent + 2
    assert lock_step.begun[-1] == 40


def test_a_mode_that_comes_late_costs_no_trajectory() -> None:
    """Loops that begin before it is known would begin again in it, and drop the trajectory: they begin once, in it."""
    loops = Loops(Simulation())
    loops.simulation.sleep(0.1)
    thread = threading.Thread(target=loops.side.run, daemon=True)
    thread.start()
    time.sleep(0.2)
    assert loops.begun == []
    loops.side.follow(TimeMode(FREE_RUNNING, RATES, "robot"))
    wait_until(lambda: len(loops.ticks) > 1000, "ticks")
    loops.side.stop()
    thread.join(TIMEOUT)
    assert len(loops.begun) == 1


@pytest.fixture
def loops() -> Loops:
    loops = Loops(Simulation())
    loops.run_for(2.0)
    return loops


@pytest.mark.parametrize("speed", [0.9, 1.0, 1.1, 3.0])
def test_each_tick_answers_its_own_states(loops: Loops, speed: float) -> None:
    """However fast simulated time runs, the loops run each tick once, with the states of that tick, and soon."""
    loops.simulation.speed = speed
    loops.run_for(5.0)
    assert all(b[1] - a[1] == 1 for a, b in pairwise(loops.ticks))
    assert all(own == measured for own, measured in loops.answered)
    assert all(theirs - own <= 4 for _, own, theirs in loops.ticks)
    assert len(loops.begun) == 1


def test_a_short_stall_is_caught_up(loops: Loops) -> None:
    """After 4 ms in which the controller did not run, all ticks come at once, and one command answers them."""
    loops.simulation.sleep(4 * TICK)
    sent = len(loops.simulation.commands)
    loops.side.serve_free_running()
    assert len(loops.simulation.commands) == sent + 1
    loops.run_for(1.0)
    assert all(b[1] - a[1] == 1 for a, b in pairwise(loops.ticks))
    assert loops.skipped == []
    assert loops.said == []


def test_a_longer_lag_is_skipped_and_told(loops: Loops) -> None:
    """After 3 s in which the controller did not run, its time is set forward; the line about it tells by how much."""
    loops.simulation.sleep(3.0)
    loops.run_for(1.0)
    assert loops.skipped == [pytest.approx(3000, abs=10)]
    assert len(loops.begun) == 1
    (line,) = loops.said
    assert "3 s behind the simulation" in line
    assert abs(loops.ticks[-1][1] - loops.ticks[-1][2]) <= 3


def test_the_motion_goes_on_after_a_pause(loops: Loops) -> None:
    """While simulated time stands still for 10 s the loops rest at once, and then go on where they were."""
    loops.simulation.speed = 0.0
    before = loops.ticks[-1][1]
    loops.run_for(10.0)
    assert loops.ticks[-1][1] - before <= 2
    loops.simulation.speed = 1.0
    loops.run_for(3.0)
    assert all(b[1] - a[1] == 1 for a, b in pairwise(loops.ticks))
    assert abs(loops.ticks[-1][1] - loops.ticks[-1][2]) <= 3
    assert len(loops.begun) == 1
    assert sum("rest" in line for line in loops.said) == 1


def test_a_reset_begins_anew(loops: Loops) -> None:
    loops.simulation.tick = 0
    loops.run_for(1.0)
    assert len(loops.begun) == 2
    assert loops.begun[1] <= 3


@pytest.mark.parametrize("ahead", [-2000, -3, 0, 5, 5000, 10**9])
@pytest.mark.parametrize("what", ["cut off", "not a number", "somebody else's"])
def test_states_that_cannot_be_used_change_nothing(loops: Loops, ahead: int, what: str) -> None:
    """Messages without usable states, or with a stamp from elsewhere, cost no tick: the motion goes on."""
    for _ in range(3):
        stamp = loops.simulation.tick + ahead
        values = np.full(1, float(stamp))
        bad = CODEC.encode(stamp * RATES.period_ns, np.full(1, np.nan) if what == "not a number" else values, values)
        loops.simulation.foreign.append(bad[:16] if what == "cut off" else bad)
        loops.run_for(0.5)
    if what == "somebody else's" and ahead == 0:
        return  # the states of the next tick: nobody can tell
    assert all(b[1] - a[1] == 1 for a, b in pairwise(loops.ticks))
    assert len(loops.begun) == 1
    assert loops.skipped == []
    assert loops.refused or loops.said
    assert abs(loops.ticks[-1][1] - loops.ticks[-1][2]) <= 3


def test_two_simulations_get_no_commands(loops: Loops) -> None:
    """Where two simulations send bursts of states in turns, commands stop until one of them is left."""
    simulation = loops.simulation
    simulation.publishers = 2
    for _ in range(10):
        for tick in range(100, 108):
            values = np.full(1, float(tick))
            simulation.inbox.append(CODEC.encode(tick * RATES.period_ns, values, values))
        loops.run_for(0.1)
    assert sum("two simulations" in line for line in loops.said) == 1
    sent = len(simulation.commands)
    loops.run_for(1.0)
    assert len(simulation.commands) == sent
    simulation.publishers = 1
    loops.run_for(1.0)
    assert len(simulation.commands) > sent + 500
    assert "one simulation is left" in loops.said[-1]


def test_a_time_mode_counts_from_nobody_where_the_middleware_names_no_sender(monkeypatch: pytest.MonkeyPatch) -> None:
    """Its GID, here a handle as that of Cyclone DDS, is no process's: one warning that names it, and no mode."""
    raw, warnings, followed, looks = serialize_message(String(data="free_running")), [], [], []
    log = SimpleNamespace(warning=warnings.append)
    node: Any = SimpleNamespace(
        create_subscription=lambda *_, **__: SimpleNamespace(topic_name="/time_mode"),
        create_timer=lambda _, look: looks.append(look),
        resolve_topic_name="/{}".format,
        get_logger=lambda: log,
    )
    monkeypatch.setattr(simulation_mode, "take_with_sender", lambda _: [(raw, bytes(12))])
    monkeypatch.setattr(simulation_mode, "senders_on", lambda *_: {b"process here": "/rx90_sim"})
    monkeypatch.setattr(simulation_mode, "get_rmw_implementation_identifier", lambda: "rmw_cyclonedds_cpp")
    monkeypatch.setattr(simulation_mode, "_PATIENCE", -1.0)
    simulation_mode.SimulationMode(node, followed.append)
    for _ in range(3):
        looks[0]()
    (said,) = warnings
    assert followed == []
    assert said.startswith("/time_mode: 'free_running' of a process that rmw_cyclonedds_cpp does not name, ignored: ")
