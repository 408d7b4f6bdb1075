"""The simulation's ticks: exchange, plant step and pace, and the requests to pause, step, reset and stop them."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from enum import Enum, auto
from functools import partial

from rx90_common.base.arrays import Array
from rx90_common.base.errors import ExchangeError
from rx90_common.base.rates import NANOSECONDS
from rx90_common.description.robot import RobotModel
from rx90_common.exchange.cdr import JointStateCodec
from rx90_common.exchange.endpoints import Listeners, wait_until_matched, wait_until_received
from rx90_common.exchange.lifecycle import ManagedNode
from rx90_common.exchange.lockstep import LockstepSimulation
from rx90_common.exchange.pacing import OnceLog, Pacer, ThrottledLog
from rx90_common.exchange.topics import COMMAND_INTERFACES, JOINT_INTERFACE, LOCK_STEP, motor_names
from rx90_sim.node.held_command import CommandWatch, HeldCommand, NewestCommand, joint_commands
from rx90_sim.node.parameters import SimulationParameters
from rx90_sim.node.publications import Publications
from rx90_sim.plant import JointInterface, Plant

_WAIT_SLICE = 0.1  # s
_MATCH_ATTEMPTS = 100  # of 50 ms
_HEARTBEAT_PERIOD = 0.25  # s on the wall clock


class NextAction(Enum):
    """What the ticking thread does next."""

    STEP = auto()
    RESET = auto()
    WAIT = auto()
    STOP = auto()


class RunControl:
    """Requests to the ticking thread; every request returns once it has been carried out.

    The ticking thread calls `next_action` before each tick; services call the others from their own thread.

    Args:
        paused: whether time stands still at first.
        wake: interrupts whatever the ticking thread waits for.
        last_tick: the tick before which the run ends; None for a run without end.

    Attributes:
        held: whether time stands still by `hold`.
        stopped: whether the run is over.
    """

    def __init__(
        self, paused: bool, wake: Callable[[], None], last_tick: int | None = None
    ) -> None:
        self._changed = threading.Condition()
        self._wake = wake
        self._last_tick = last_tick
        self._paused = paused
        self.held = self.stopped = self._reset = False
        self._steps = 0

    @property
    def paused(self) -> bool:
        """Return whether time stands still on request."""
        with self._changed:
            return self._paused and self._steps == 0

    def interrupting(self) -> bool:
        """Return whether the ticking thread should come back from a wait: for a reset or the end."""
        return self.stopped or self._reset

    def next_action(self, tick: int, timeout: float) -> NextAction:
        """Return what to do before tick `tick`; waits up to `timeout` seconds while paused."""
        with self._changed:
            if self._last_tick is not None and tick >= self._last_tick:
                self.stopped = True
                # Who waits for ticks beyond the last one waits in vain.
                self._changed.notify_all()
            if not self._runnable():
                self._changed.wait(timeout)
            if self.stopped:
                return NextAction.STOP
            if self._reset:
                return NextAction.RESET
            return NextAction.STEP if self._runnable() else NextAction.WAIT

    def pause(self) -> None:
        """Stop time before the next tick."""
        self._request(_paused=True, _steps=0)

    def resume(self) -> None:
        """Let time run again."""
        self._request(_paused=False)

    def hold(self) -> None:
        """Stop time before the next tick, whatever other requests there are, until `release`."""
        self._request(held=True)

    def release(self) -> None:
        """End `hold`: time runs, unless it is paused."""
        self._request(held=False)

    def stop(self) -> None:
        """End the run."""
        self._request(stopped=True)

    def step(self, ticks: int, timeout: float) -> bool:
        """Pause, then run `ticks` ticks; return whether they were done within `timeout` seconds."""
        self._request(_paused=True, _steps=ticks)
        done = self._wait_until(lambda: self._steps == 0, timeout)
        if not done:
            # What was not done in time must not happen later, unasked.
            self.pause()
        return done

    def reset(self, timeout: float) -> bool:
        """Begin again at tick 0; return whether that was done within `timeout` seconds."""
        self._request(_reset=True)
        return self._wait_until(lambda: not self._reset, timeout)

    def reset_done(self) -> None:
        """Report that the reset requested by `next_action` has been carried out."""
        self._change(_reset=False, _steps=0)

    def step_done(self) -> None:
        """Report that the tick requested by `next_action` has been carried out."""
        with self._changed:
            if self._steps > 0:
                self._steps -= 1
                if self._steps == 0:
                    self._changed.notify_all()

    def _runnable(self) -> bool:
        return self.stopped or self._reset or not (self.held or (self._paused and self._steps == 0))

    def _request(self, **state: object) -> None:
        self._change(**state)
        self._wake()

    def _change(self, **state: object) -> None:
        with self._changed:
            for name, value in state.items():
                setattr(self, name, value)
            self._changed.notify_all()

    def _wait_until(self, done: Callable[[], bool], timeout: float) -> bool:
        with self._changed:
            return (
                self._changed.wait_for(lambda: done() or self.stopped, timeout) and not self.stopped
            )


class Ticks:
    """Runs the plant tick by tick, in lock-step or in free-running time, on a thread of its own; held at first.

    Args:
        node: the node whose topics are published.
        robot: with its tool.
        plant: at rest in tick 0.
        parameters: of the node.

    Attributes:
        control: takes requests from other threads.
        pacer: the clock.
        listeners: who is waited for in a run that is not paced.
        held: commands in free-running time.
        lockstep: exchange in lock-step.
    """

    def __init__(
        self, node: ManagedNode, robot: RobotModel, plant: Plant, parameters: SimulationParameters
    ) -> None:
        self._node = node
        self._plant = plant
        self._initial_position = parameters.start(robot)
        rates = parameters.rates
        log = node.get_logger()
        self._period_ns = rates.period_ns
        self._lock_step = parameters.time_mode == LOCK_STEP
        self._publications = Publications(node, robot, plant, parameters)
        self.pacer = Pacer(rates.period, parameters.real_time_factor if self._lock_step else 1.0)
        self._channel = channel = node.make_channel(
            *COMMAND_INTERFACES[parameters.command_interface]
        )
        # the tick that does not end; s of the steady clock
        self._waiting_tick = -1
        self._heartbeat_due = 0.0
        self._publishers = (*self._publications.publishers, self._channel.publisher)
        self._published_tick = -1
        self._torques: Array | None = None  # of the newest command; brakes closed for None
        once = OnceLog(log.error)
        self._watch = CommandWatch(node, parameters.command_interface, once)
        self.control = RunControl(parameters.paused, self._channel.wake, parameters.last_tick)
        self.control.hold()
        ticks = min(rates.ratio, rates.base_hz // parameters.joint_state_rate)
        self.listeners = Listeners(self._publications.publishers, ticks, self.control.interrupting)
        self.listeners.add([self._channel.publisher], self._channel.answering)
        self._joints: JointInterface | None = None
        self._command_ticks = 1
        if parameters.command_interface == JOINT_INTERFACE:
            self._joints = joints = JointInterface(plant, rates, parameters.command_hz)
            self._command_ticks = joints.ticks
            self._encode_states = JointStateCodec(plant.joint_names).encoder(*joints.measure())
            self._decode = joint_commands(joints, plant.joint_names, channel.subscribe_topic, once)
            self._complain: Callable[[str], None] = once.say
            timeout = parameters.command_age_limit
            hold: type[HeldCommand] = NewestCommand
        else:
            motors = motor_names(len(plant.joint_names))
            commands = JointStateCodec(motors)
            throttled = ThrottledLog(log.error)
            self._encode_states = JointStateCodec(motors).encoder(*plant.motor_states())
            self._decode = lambda raw: commands.decode(raw)[3]
            self._complain = partial(throttled.say, "command")
            timeout = parameters.command_timeout
            hold = HeldCommand
        self.held = hold(
            channel,
            self._decode,
            rates.period_ns,
            timeout,
            log.info,
            self._complain,
            self.control.interrupting,
        )
        self.lockstep = LockstepSimulation(channel, log.info, self._complain, self._usable)

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
            action = self.control.next_action(self._plant.tick, _WAIT_SLICE)
            if action is NextAction.STOP:
                break
            if action is NextAction.RESET:
                self._reset()
            elif action is NextAction.STEP:
                if not moving:
                    if self._plant.tick == 0:
                        stop = self.control.interrupting
                        wait_until_matched(self._node, self._publishers, _MATCH_ATTEMPTS, stop)
                        if stop():  # before the first state of a run that is no more
                            continue
                    self.pacer.restart()
                if advance():
                    self.control.step_done()
            else:
                self._beat()
            moving = action is NextAction.STEP
        wait_until_received(self._publishers)

    def _step_in_lock_step(self) -> bool:
        plant = self._plant
        if plant.tick % self._command_ticks:
            self._publish_due()
        else:
            stamp = plant.tick * self._period_ns
            if (
                self.lockstep.exchange(stamp, self._states(), self._interrupted, self._publish_due)
                is None
            ):
                return False
        plant.step(self._torques)
        if self.pacer.factor == 0.0:
            self.listeners.tick_done()
        self.pacer.wait()
        return True

    def _interrupted(self) -> bool:
        """Return whether the exchange should return; called now and then while there is no command."""
        self._beat()
        return self.control.interrupting()

    def _beat(self) -> None:
        """Repeat the last publications, to the bit, now and then while the tick stays the same.

        Latching would not do: only subscribers that request it get the latched message, and they would get as many old
        samples as the queue of a recorder is deep.
        """
        now = time.monotonic()
        tick = self._plant.tick
        if tick == self._waiting_tick:
            if now < self._heartbeat_due:
                return
            self._publications.repeat()
        self._waiting_tick = tick
        self._heartbeat_due = now + _HEARTBEAT_PERIOD

    def _step_free_running(self) -> bool:
        plant = self._plant
        self.pacer.wait()
        self._publish_due()
        if plant.tick % self._command_ticks == 0:
            self._channel.publish(self._states())
            self._torques = self.held.take(plant.tick)
        plant.step(self._torques)
        return True

    def _states(self) -> bytes:
        """Return the message with the states that the next command answers."""
        if self._joints is not None:
            self._joints.measure()
        return self._encode_states(self._plant.tick * self._period_ns)

    def _publish_due(self) -> None:
        # An exchange that was interrupted comes back in the same tick.
        if self._published_tick != self._plant.tick:
            self._published_tick = self._plant.tick
            self._publications.publish_due()

    def _usable(self, raw: bytes) -> bool:
        """Take the command's torques, None for none; return whether it is a command at all."""
        try:
            self._torques = self._decode(raw)
        except ExchangeError as error:
            self._complain(f"{self._channel.subscribe_topic}: {error}; the message is ignored")
            return False
        return True

    def _reset(self) -> None:
        self._plant.reset(self._initial_position)
        self._published_tick = -1
        self.held.forget()
        self.control.reset_done()
        self.pacer.restart()
