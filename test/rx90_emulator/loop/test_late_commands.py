"""Free-running time with a controller that is late: plant, law, and both nodes' exchange on a clock made by hand."""

from collections.abc import Callable, Iterator
from itertools import repeat
from types import SimpleNamespace

import numpy as np
import pytest
from numpy.typing import NDArray

from benchmarks.command_delay import HOME, constant, in_turns, motion, run
from rx90_common.exchange.cdr import JointStateCodec
from rx90_common.exchange.channel import Matches
from rx90_common.exchange.pacing import Pacer
from rx90_common.exchange.topics import motor_names
from rx90_controller.node import serving
from rx90_controller.node.servo_loop import ServoLoop
from rx90_emulator.loop.setup import Setup
from rx90_sim.node import held_command

TICKS = 5000


class Side:
    """One end of the exchange; who waits on the simulation's lets the controller run."""

    def __init__(self, topic: str) -> None:
        self.subscribe_topic = topic
        self.inbox: list[bytes] = []
        self.peer = self
        self.serve = lambda: None

    def publish(self, raw: bytes) -> None:
        self.peer.inbox.append(raw)

    def receive(self, timeout: float) -> bytes | None:
        if not self.inbox and timeout > 0.0:
            self.serve()
        return self.inbox.pop(0) if self.inbox else None

    def matches(self) -> Matches:
        return Matches(1, 1)


class Nodes:
    """Both nodes' ticking threads in turns: the controller runs when its time has come, or when it is waited for."""

    def __init__(self, setup: Setup) -> None:
        self.said: list[str] = []
        self.plant, cs7b = setup.plant(), setup.cs7b()
        self.plant.reset(HOME)
        ours, theirs = Side("/motor_commands"), Side("/motor_states")
        ours.peer, theirs.peer = theirs, ours
        self._channel = ours
        rates = setup.rates
        outputs = SimpleNamespace(
            wait_for_subscribers=lambda: None, ready="ready", wake=lambda: None, publish=self._note,
            info=self.said.append, error=self.said.append,
        )  # fmt: skip
        self.loop = ServoLoop(cs7b, outputs, horizon=60.0)
        self.cs7b = cs7b
        pacer = Pacer(rates.period, 1.0, lambda: 0.0, lambda _: None)
        self.controller = serving.Serving(
            theirs, motor_names(6), rates, self.loop, pacer, "robot", self.said.append, self.said.append
        )
        self._modes = {
            "serving": self.controller.serve_free_running,
            "lock_step": lambda: self.controller.serve_lock_step(0.0),
        }
        ours.serve = self.controller.serve_free_running
        self.setup = setup
        codec = JointStateCodec(motor_names(6))
        self._encode = JointStateCodec(motor_names(6)).encoder(*self.plant.motor_states())
        self.held = held_command.HeldCommand(
            ours,
            lambda raw: codec.decode(raw)[3],
            rates.period_ns,
            0.1,
            self.said.append,
            self.said.append,
            lambda: False,
        )
        self._period_ns = rates.period_ns
        self.error = np.zeros(6)
        self.torque = np.zeros(6)

    @property
    def moving(self) -> bool:
        return self.cs7b.trajectory.moving(self.cs7b.position_tick)

    def follow(self, mode: str) -> None:
        self.controller.begin_anew()
        self._channel.serve = self._modes[mode]

    def _note(self, _stamp: int) -> None:
        self.error = np.maximum(self.error, np.abs(self.cs7b.tracking_error()[0]))

    def run(self, ticks: int, turns: Iterator[int]) -> None:
        """Run ticks of the plant; the controller runs again after each of `turns`, in ticks."""
        turn = next(turns)
        for _ in range(ticks):
            tick = self.plant.tick
            self._channel.publish(self._encode(tick * self._period_ns))
            turn -= 1
            if turn <= 0:
                self._channel.serve()
                turn = next(turns)
            self.plant.step(self.held.take(tick))
            self.torque = np.maximum(self.torque, np.abs(self.plant.motor_states()[2]))


@pytest.fixture
def nodes(shipped: Setup) -> Nodes:
    nodes = Nodes(shipped)
    nodes.run(400, repeat(1))
    nodes.cs7b.trajectory.accept(motion(shipped, 2), nodes.cs7b.position_tick, None)
    nodes.error[:] = nodes.torque[:] = 0.0
    return nodes


@pytest.mark.parametrize("turns", ["in time", "often late"])
def test_a_controller_that_is_late_leaves_no_deviation(nodes: Nodes, shipped: Setup, turns: str) -> None:
    """Stalls of up to 60 ticks add less than 3 % and 20 urad to the undelayed errors; no motor nears its limit."""
    rng = np.random.default_rng(3)
    stalls = (int(n) for n in np.minimum(rng.pareto(0.8, 100_000) + 1.0, 60.0))
    nodes.run(TICKS, repeat(1) if turns == "in time" else stalls)
    ideal, end = run(shipped, constant(TICKS, 0))
    assert end == -1
    assert np.all(nodes.error < 1.03 * ideal[0] + 2e-5)
    assert np.all(nodes.torque < 0.7 * shipped.drives.peak_torque)
    assert not [line for line in nodes.said if "torque off" in line or "behind" in line]


def test_a_controller_that_stays_away_closes_the_brakes(nodes: Nodes) -> None:
    """Without a controller no torque is older than a few ticks; back again, it leads the motion on without a fault."""
    nodes.run(1500, repeat(1))
    nodes._channel.serve = lambda: None
    nodes.held._timeout = 0.0
    nodes.run(1000, repeat(10_000))
    assert nodes.plant.brakes_closed
    assert "torque off, brakes closed" in nodes.said[-1]
    nodes._channel.serve = nodes.controller.serve_free_running
    nodes.held._timeout = 0.1
    nodes.run(TICKS, repeat(1))
    assert not nodes.plant.brakes_closed
    assert nodes.loop.state.switch.fault is None
    assert any("behind the simulation: a trajectory that runs comes later" in line for line in nodes.said)
    assert np.abs(nodes.cs7b.tracking_error()[0]).max() < 5e-3


def test_a_reset_and_a_new_mode_end_a_motion(nodes: Nodes) -> None:
    """After a reset, and after each change of `time_mode` under way, the arm is held where it is, without a fault."""
    nodes.run(1000, repeat(1))
    assert nodes.moving
    nodes.plant.reset(HOME)
    nodes.held.forget()
    nodes.run(400, repeat(1))
    assert not nodes.moving
    assert nodes.plant.joint_states()[0] == pytest.approx(HOME, abs=1e-3)
    for mode in ("lock_step", "serving"):
        nodes.cs7b.trajectory.accept(motion(nodes.setup, 2), nodes.cs7b.position_tick, None)
        nodes.run(1000, repeat(1))
        assert nodes.moving
        nodes.follow(mode)
        nodes.run(400, repeat(1))
        assert not nodes.moving
        assert not nodes.plant.brakes_closed
        assert nodes.cs7b.tick == nodes.plant.tick
        assert np.abs(nodes.plant.joint_states()[1]).max() < 0.02
        nodes.cs7b.reset(nodes.plant.motor_states()[0], nodes.cs7b.tick)
        nodes.plant.reset(HOME)
        nodes.held.forget()
        nodes.run(400, repeat(1))
    assert nodes.loop.state.switch.fault is None


@pytest.mark.parametrize("pattern", [constant, in_turns])
def test_the_oldest_command_that_is_applied_is_harmless(
    shipped: Setup, pattern: Callable[[int, int], NDArray[np.int64]]
) -> None:
    """Commands as old as is accepted, always or in turns, leave deviation and torque of the motion as they are."""
    ideal, _ = run(shipped, constant(TICKS, 0))
    worst, end = run(shipped, pattern(TICKS, held_command.MAX_AGE))
    assert end == -1
    assert np.all(worst[0] < ideal[0] + 2e-5)
    assert np.all(worst[1] < 0.7 * shipped.drives.peak_torque)
