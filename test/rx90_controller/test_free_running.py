"""The controller's own clock in free-running time, on a channel and a wall clock made by hand."""

from __future__ import annotations

from collections.abc import Callable
from itertools import pairwise

import numpy as np
import pytest

from rx90_common.base.rates import Rates

free_running = pytest.importorskip("rx90_controller.node.free_running", reason="needs rclpy", exc_type=ImportError)
from rx90_common.exchange.joint_state_cdr import JointStateCodec  # noqa: E402
from rx90_common.exchange.motor_messages import MotorMessages, MotorStates  # noqa: E402
from rx90_common.exchange.pacing import Pacer  # noqa: E402

RATES = Rates(1000, 1000)
TICK = RATES.period
CODEC = JointStateCodec(["a"])


class Simulation:
    """A simulation behind a channel: one message for each tick of its clock, which may run fast, slow or not at all."""

    subscribe_topic = "/motor_states"

    def __init__(self) -> None:
        self.now = 100.0
        self.speed = 1.0
        self.tick = 0
        self.inbox: list[bytes] = []
        self.foreign: list[bytes] = []  # what somebody else sends, each right behind the next states
        self.commands: list[int] = []
        self._phase = 0.0

    def sleep(self, seconds: float) -> None:
        """Let the wall clock pass."""
        self.now += seconds
        self._phase += seconds * self.speed / TICK
        while self._phase >= 1.0:
            self._phase -= 1.0
            values = np.full(1, float(self.tick))
            self.inbox.append(CODEC.encode(self.tick * RATES.period_ns, values, values))
            self.tick += 1
            if self.foreign:
                self.inbox.append(self.foreign.pop())

    def receive(self, timeout: float) -> bytes | None:
        """Return the next message, or None after the timeout."""
        deadline = self.now + timeout
        while not self.inbox and self.now < deadline:
            self.sleep(TICK)
        return self.inbox.pop(0) if self.inbox else None

    def publish(self, raw: bytes) -> None:
        """Note the command."""
        self.commands.append(len(raw))


class Loops:
    """Loops that note when they ran which tick."""

    def __init__(self, simulation: Simulation) -> None:
        self.simulation = simulation
        self.said: list[str] = []
        self.refused: list[str] = []
        self.begun: list[int] = []
        self.skipped: list[int] = []
        self.ticks: list[tuple[float, int, int]] = []  # wall clock, own tick, the simulation's
        self.prepared = 0
        self.command = np.zeros(1)
        self.side = free_running.FreeRunningController(
            simulation,
            MotorMessages("/motor_states", ["a"], RATES, self.command, self.refused.append),
            self,
            Pacer(TICK, 1.0, lambda: simulation.now, simulation.sleep),
            self.said.append,
        )

    def begin(self) -> None:
        """Take half a second to get ready."""
        self.prepared += 1
        self.simulation.sleep(0.5)

    def after_command(self, stamp_ns: int) -> None:
        """Publish nothing."""

    def skip(self, count: int) -> None:
        """Note the ticks left out."""
        self.skipped.append(count)

    def hold(self, states: MotorStates) -> None:
        """Note where the loops begin."""
        self.begun.append(states.stamp_ns // RATES.period_ns)

    def step(self, stamp: int, states: MotorStates) -> bool:
        """Note the tick; the states must be whole, whatever came in between."""
        assert states.position[0] == states.velocity[0] == states.stamp_ns // RATES.period_ns
        self.ticks.append((self.simulation.now, stamp // RATES.period_ns, self.simulation.tick))
        return True

    def run(self, until: Callable[[], bool]) -> None:
        """Serve until a condition holds."""
        for _ in range(200_000):
            if until():
                return
            self.side.serve()
        pytest.fail("the condition never held")

    def run_for(self, seconds: float) -> None:
        """Serve for a time of the wall clock."""
        end = self.simulation.now + seconds
        self.run(lambda: self.simulation.now >= end)


@pytest.fixture
def loops() -> Loops:
    """Return loops that have run for a second beside a simulation."""
    loops = Loops(Simulation())
    loops.run_for(2.0)
    return loops


def test_nothing_is_old_when_the_loops_begin(loops: Loops) -> None:
    """The wait for subscribers before the first tick, in which time runs on, leaves no lag behind."""
    assert loops.prepared == 1
    assert loops.begun == [pytest.approx(500, abs=5)]
    _, own, theirs = loops.ticks[0]
    assert abs(own - theirs) <= 3


@pytest.mark.parametrize("speed", [0.998, 1.0, 1.002])
def test_the_clock_follows_simulated_time(loops: Loops, speed: float) -> None:
    """Beside a clock that runs 2000 ppm fast or slow the loops stay within 3 ticks, without leaving out a tick."""
    loops.simulation.speed = speed
    loops.run_for(60.0)
    assert all(b[1] - a[1] == 1 for a, b in pairwise(loops.ticks))
    assert all(abs(own - theirs) <= 3 for _, own, theirs in loops.ticks)
    periods = np.diff([at for at, _, _ in loops.ticks])
    assert np.abs(periods / TICK - 1).max() < 0.026
    assert len(loops.begun) == 1


def test_a_lag_is_caught_up_smoothly(loops: Loops) -> None:
    """After 0.2 s in which the controller did not run, no tick is left out and none is more than 2.5 % too short."""
    loops.simulation.sleep(0.2)
    first = len(loops.ticks)
    loops.run_for(15.0)
    later = loops.ticks[first:]
    assert all(b[1] - a[1] == 1 for a, b in pairwise(loops.ticks))
    assert np.diff([at for at, _, _ in later]).min() > 0.974 * TICK
    assert abs(later[-1][1] - later[-1][2]) <= 3
    assert len(loops.begun) == 1


def test_a_longer_lag_is_skipped_and_told(loops: Loops) -> None:
    """After 3 s in which the controller did not run, its time is set forward; the line about it tells by how much."""
    loops.simulation.sleep(3.0)
    loops.run_for(1.0)
    assert loops.skipped == [pytest.approx(3000, abs=5)]
    assert len(loops.begun) == 1
    (line,) = loops.said
    assert "3 s behind the simulation" in line
    assert abs(loops.ticks[-1][1] - loops.ticks[-1][2]) <= 3


def test_a_machine_that_is_too_slow_does_not_flood_the_terminal(loops: Loops) -> None:
    """Where every tick of the loops takes two of the simulation's, lag after lag is skipped; few lines tell it."""
    end = loops.simulation.now + 30.0
    while loops.simulation.now < end:
        loops.side.serve()
        loops.simulation.sleep(2 * TICK)
    assert len(loops.skipped) > 20
    assert len(loops.begun) == 1
    assert 1 <= len(loops.said) <= 8
    assert loops.ticks[-1][2] - loops.ticks[-1][1] < 300


def test_the_motion_goes_on_after_a_pause(loops: Loops) -> None:
    """While simulated time stands still for 10 s the loops rest within 8 ticks, and then go on where they were."""
    loops.simulation.speed = 0.0
    before = loops.ticks[-1][1]
    loops.run_for(10.0)
    assert loops.ticks[-1][1] - before <= 8
    loops.simulation.speed = 1.0
    loops.run_for(3.0)
    assert all(b[1] - a[1] == 1 for a, b in pairwise(loops.ticks))
    assert abs(loops.ticks[-1][1] - loops.ticks[-1][2]) <= 3
    assert len(loops.begun) == 1
    assert sum("rest" in line for line in loops.said) == 1


def test_a_reset_begins_anew(loops: Loops) -> None:
    """Stamps that go back make the loops hold the arm at the new time."""
    loops.simulation.tick = 0
    loops.run_for(1.0)
    assert len(loops.begun) == 2
    assert loops.begun[1] <= 3


@pytest.mark.parametrize("ahead", [-2000, 0, 5, 5000])
@pytest.mark.parametrize("what", ["cut off", "not a number"])
def test_states_that_cannot_be_used_change_nothing(loops: Loops, ahead: int, what: str) -> None:
    """A message without usable states, whatever its stamp, costs no tick: the motion goes on."""
    bad = CODEC.encode((loops.simulation.tick + ahead) * RATES.period_ns, np.full(1, np.nan), np.full(1, 7.0))
    for _ in range(3):
        loops.simulation.foreign.append(bad[:16] if what == "cut off" else bad)
        loops.run_for(0.5)
    assert all(b[1] - a[1] == 1 for a, b in pairwise(loops.ticks))
    assert len(loops.begun) == 1
    assert loops.refused
    assert abs(loops.ticks[-1][1] - loops.ticks[-1][2]) <= 3
