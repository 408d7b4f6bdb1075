"""The simulation's ticks: exchange, plant step and pace, in lock-step or in free-running time."""

from __future__ import annotations

import time
from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray
from rclpy.node import Node

from rx90_common.base.errors import ExchangeError
from rx90_common.base.rates import NANOSECONDS
from rx90_common.exchange import node_tools
from rx90_common.exchange.joint_state_cdr import JointStateCodec
from rx90_common.exchange.listeners import Listeners
from rx90_common.exchange.lockstep import LockstepSimulation
from rx90_common.exchange.pacing import Pacer
from rx90_common.exchange.qos import TICK_QOS
from rx90_common.exchange.throttle import ThrottledLog
from rx90_common.exchange.tick_channel import MakeChannel
from rx90_common.exchange.topics import LOCK_STEP, MOTOR_COMMANDS, MOTOR_NAMES, MOTOR_STATES
from rx90_sim.node.held_command import HeldCommand
from rx90_sim.node.parameters import SimulationParameters
from rx90_sim.node.publications import Publications
from rx90_sim.node.run_control import RunControl, Turn
from rx90_sim.node.transforms import Transforms
from rx90_sim.plant import Plant

_WAIT_SLICE = 0.1  # s
_MATCH_ATTEMPTS = 100  # of 50 ms
_PERIOD = 0.25  # s on the wall clock


class Heartbeat:
    """Repeats what was published last for as long as the tick stays the same; for the thread that ticks.

    Latching would not do: only subscribers that ask for it are told, and those would get as many old samples as the
    queue of a recorder is deep.

    Args:
        repeat: publishes the newest samples again, to the bit.
        clock: the steady clock, s.
    """

    def __init__(self, repeat: Callable[[], None], clock: Callable[[], float] = time.monotonic) -> None:
        self._repeat, self._clock = repeat, clock
        self._tick: int | None = None
        self._due = 0.0

    def beat(self, tick: int) -> None:
        """Repeat the samples if that is due; called again and again while tick `tick` does not end."""
        now = self._clock()
        if tick != self._tick:
            self._tick = tick
        elif now >= self._due:
            self._repeat()
        else:
            return
        self._due = now + _PERIOD


class Ticks:
    """Runs the plant tick by tick, on a thread of its own; held at first.

    Args:
        node: the node whose topics are published.
        plant: at rest in tick 0.
        parameters: of the node.
        make_channel: makes the exchange with the controller.
        transforms: what publishes /tf, None for nothing.

    Attributes:
        control: takes requests from other threads.
        pacer: the clock.
        listeners: who is waited for in a run that is not paced.
        held: commands in free-running time.
        lockstep: exchange in lock-step.
    """

    def __init__(
        self,
        node: Node,
        plant: Plant,
        parameters: SimulationParameters,
        make_channel: MakeChannel,
        transforms: Transforms | None = None,
    ) -> None:
        self._node, self._plant, self._parameters = node, plant, parameters
        rates, log = parameters.rates, node.get_logger()
        self._period_ns = rates.period_ns
        self._lock_step = parameters.time_mode == LOCK_STEP
        self._publications = Publications(node, plant, parameters, transforms)
        self.pacer = Pacer(rates.period, parameters.real_time_factor if self._lock_step else 1.0)
        self._channel = make_channel(node, MOTOR_STATES, MOTOR_COMMANDS, TICK_QOS.profile)
        self._heartbeat = Heartbeat(self._publications.repeat)
        self._publishers = (*self._publications.publishers, self._channel.publisher)
        self._published_tick = -1
        self._encode_states = JointStateCodec(MOTOR_NAMES).encoder(*plant.motor_states())
        self._commands = JointStateCodec(MOTOR_NAMES)
        self._torques: NDArray[np.float64] | None = None  # of the newest command; brakes closed for None
        self._throttled = ThrottledLog(log.error)
        self.control = RunControl(parameters.paused, self._channel.wake, parameters.last_tick)
        self.control.hold()
        self.lockstep = LockstepSimulation(self._channel, log.info)
        ticks = min(rates.ratio, rates.base_hz // parameters.joint_state_rate)
        self.listeners = Listeners(self._publications.publishers, ticks, self.control.interrupting)
        self.listeners.add([self._channel.publisher], self._channel.answering)
        self.held = HeldCommand(
            self._channel,
            lambda raw: self._commands.decode(raw)[3],
            rates.period_ns,
            parameters.command_timeout,
            log.info,
            self.control.interrupting,
        )

    @property
    def next_stamp_ns(self) -> int:
        """Return the simulated time, ns, from which on at the latest a change counts that is made now."""
        return (self._plant.tick + 1) * self._period_ns

    @property
    def time(self) -> float:
        """Return simulated time, s."""
        return self._plant.tick * self._period_ns / NANOSECONDS

    def run(self) -> None:
        """Run ticks until the end of the run, or until `control` stops.

        Raises:
            DivergenceError: naming joint and tick.
        """
        advance = self._step_in_lock_step if self._lock_step else self._step_free_running
        moving = False
        while True:
            turn = self.control.next_turn(self._plant.tick, _WAIT_SLICE)
            if turn is Turn.STOP:
                break
            if turn is Turn.RESET:
                self._reset()
            elif turn is Turn.STEP:
                if not moving:
                    if self._plant.tick == 0:
                        stop = self.control.interrupting
                        node_tools.wait_until_matched(self._node, self._publishers, _MATCH_ATTEMPTS, stop)
                        if stop():  # before the first state of a run that is no more
                            continue
                    self.pacer.restart()
                if advance():
                    self.control.step_done()
            else:
                self._heartbeat.beat(self._plant.tick)
            moving = turn is Turn.STEP
        node_tools.wait_until_received(self._publishers)

    def _step_in_lock_step(self) -> bool:
        plant = self._plant
        stamp = plant.tick * self._period_ns
        states = self._encode_states(stamp)
        raw = self.lockstep.exchange(stamp, states, self._interrupted, self._publish_due)
        while raw is not None and not self._usable(raw):
            raw = self.lockstep.again(stamp, states, self._interrupted)
        if raw is None:
            return False
        plant.step(self._torques)
        if self.pacer.factor == 0.0:
            self.listeners.tick_done()
        self.pacer.wait()
        return True

    def _interrupted(self) -> bool:
        """Return whether the exchange should come back; asked now and then while there is no command."""
        self._heartbeat.beat(self._plant.tick)
        return self.control.interrupting()

    def _step_free_running(self) -> bool:
        plant = self._plant
        self.pacer.wait()
        self._publish_due()
        self._channel.publish(self._encode_states(plant.tick * self._period_ns))
        plant.step(self.held.take(plant.tick))
        return True

    def _publish_due(self) -> None:
        # An exchange that was interrupted comes back in the same tick.
        if self._published_tick != self._plant.tick:
            self._published_tick = self._plant.tick
            self._publications.publish_due()

    def _usable(self, raw: bytes) -> bool:
        """Take the command's torques, None for none; return whether it is a command at all."""
        try:
            self._torques = self._commands.decode(raw)[3]
        except ExchangeError as error:
            self._throttled.say("command", f"{self._channel.subscribe_topic}: {error}; the message is ignored")
            return False
        return True

    def _reset(self) -> None:
        self._plant.reset(self._parameters.initial_position)
        self._published_tick = -1
        self.held.forget()
        self.control.reset_done()
        self.pacer.restart()
