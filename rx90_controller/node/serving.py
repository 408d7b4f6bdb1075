"""The controller's ticks: it answers the simulation's states, in lock-step or in free-running time.

In lock-step the simulation waits for each command (rx90_common/exchange/lockstep.py). A controller that receives the
same states again sends the same bytes again. The loops begin and hold the arm when the states do not follow the last
ones:
at the start, after a reset of the simulation, or after an interruption of either process.

In free-running time the states do not wait. The loops tick with them, one tick for each, as drives do that share
a cycle with their controller: a set-point is compared with the measurement of its own time, however late either
process is. A late controller computes all ticks whose states have arrived meanwhile, and sends the newest command
alone. While the simulation is paused the loops rest and keep their state: the motion continues with the next states.
They begin anew when simulated time has gone back, and skip the time in which this process did not run, so that a motion
comes later. A single message with a foreign stamp causes neither.
"""

from __future__ import annotations

import threading
import time
from collections import deque
from collections.abc import Callable, Sequence

from rx90_common.base.errors import ExchangeError
from rx90_common.base.rates import NANOSECONDS, Rates
from rx90_common.exchange.cdr import JointStateCodec
from rx90_common.exchange.channel import TickChannel
from rx90_common.exchange.lockstep import Wait
from rx90_common.exchange.pacing import Pacer, ThrottledLog
from rx90_common.exchange.topics import FREE_RUNNING, LOCK_STEP, TimeMode
from rx90_controller.node.servo_loop import ServoLoop
from rx90_controller.servo.servo import MotorStates

_WAIT_SLICE = 0.1  # s of a wait for states; in free-running time also the time at rest after which it is reported
_PATIENCE = 1.0  # s without a simulation, after which that is announced
_MODE_PATIENCE = 5.0  # s with a simulation that does not announce its mode
_MAX_LAG = 0.005  # s; up to here missed ticks are computed one by one, beyond it time is skipped
# of a period: by so much it wakes earlier each time, until it is there before the states
_PHASE_ADVANCE = 0.02
_BACKWARD = 3  # jumps back within _BACKWARD_WINDOW that make two simulations; a reset makes one
_BACKWARD_WINDOW = 5.0  # s


class Serving:
    """Runs the loops tick by tick: on a thread of its own, or in lock-step on that of a simulation in this process.

    Messages without usable states are ignored. If stamps go back again and again, there is a second simulation;
    while there are two, no command is sent.

    Args:
        channel: publishes commands, receives states.
        names: of the motors.
        rates: of the loops; states are stamped with multiples of the base tick.
        loop: runs in each tick.
        pacer: the clock of free-running time; it sleeps from one state to the next, which takes less of the processor
            than a wait for a message.
        robot: name of the robot, which must be the simulation's.
        announce: prints a line about what happened.
        complain: prints a line about a message that is ignored; called now and then only.
        local: whether a simulation in this process calls `answer` in each tick in lock-step; `run` then rests.

    Attributes:
        mode: the simulation's time mode, one of TIME_MODES; None until it is known.
    """

    def __init__(
        self,
        channel: TickChannel,
        names: Sequence[str],
        rates: Rates,
        loop: ServoLoop,
        pacer: Pacer,
        robot: str,
        announce: Callable[[str], None],
        complain: Callable[[str], None],
        *,
        local: bool = False,
    ) -> None:
        self._channel = channel
        self._topic = channel.subscribe_topic
        self._loop = loop
        self._pacer = pacer
        self._robot = robot
        self._announce = announce
        self._local = local
        self._rates = rates
        self._period_ns = rates.period_ns
        self._slow_ns = rates.period_ns * rates.ratio
        # Two, in turns: a message that is refused half-way leaves the states before it as they are.
        self._codec = JointStateCodec(names)
        self._spare = JointStateCodec(names)
        commands = JointStateCodec(names)
        self._encode = commands.encoder(effort=loop.command)
        self._encode_no_torque = commands.encoder()
        self._complaints = ThrottledLog(complain)
        self._log = ThrottledLog(announce)
        # times at which the stamps have gone back
        self._backward: deque[float] = deque(maxlen=_BACKWARD)
        self._two_simulations = False
        self.mode: str | None = None
        self._changed = threading.Event()  # the mode is known, or the end is near
        self._stopped = threading.Event()
        self._refused: ExchangeError | None = None
        # In lock-step.
        self._wait = Wait(announce, "the simulation is there:")
        self._stamp: int | None = None
        # as received; an empty message must not pass for a repetition
        self._state: bytes | None = None
        self._command = b""
        self._last_message = time.monotonic()
        # In free-running time.
        self._lag_ns = max(round(_MAX_LAG * NANOSECONDS), 2 * self._slow_ns)
        self._next: int | None = None  # the stamp of the next tick, once the loops have begun
        # a stamp that does not follow; the next one may go on from there
        self._elsewhere: int | None = None
        self._prepared = self._resting = False

    def run(self) -> None:
        """Answer the simulation until `stop`, on the ticking thread.

        A simulation that does not announce its mode within some seconds is assumed to be in lock-step: loops that began
        in the wrong mode would begin again in the right one, and drop the running trajectory.

        Raises:
            ExchangeError: if the simulation's rates are not the controller's.
        """
        deadline = time.monotonic() + _MODE_PATIENCE
        while not self._stopped.is_set() and self.mode is None and time.monotonic() < deadline:
            if self._channel.matches().publishers == 0:
                deadline = time.monotonic() + _MODE_PATIENCE
                self._announce_silence()
            self._changed.wait(_WAIT_SLICE)
        mode = self.mode
        while not self._stopped.is_set():
            if mode != self.mode:
                mode = self.mode
                self.begin_anew()
            if mode == FREE_RUNNING:
                self.serve_free_running()
            elif self._local:
                self._stopped.wait(_WAIT_SLICE)
            else:
                self.serve_lock_step(_WAIT_SLICE)
        if self._refused is not None:
            raise self._refused

    def begin_anew(self) -> None:
        """Hold the arm at the next states of free-running time, whatever has been before."""
        self._next = self._elsewhere = None

    def answer(self) -> None:
        """Answer one tick in lock-step; called by the thread that ticks in a simulation of this process."""
        if self.mode == LOCK_STEP:
            self.serve_lock_step(0.0)

    def serve_lock_step(self, timeout: float) -> None:
        """Answer the next states; return after `timeout` seconds without any, or a wake-up."""
        loop = self._loop
        raw = self._channel.receive(timeout)
        if raw is None:
            self._announce_silence()
            return
        if self._two_simulations:
            if self._two_remain():
                return
            self._stamp = self._state = None
        if raw != self._state:
            states = self._decode(raw)
            if states is None:
                return
            stamp = states.stamp_ns
            if self._stamp is None or stamp != self._stamp + self._period_ns:
                loop.begin()
                loop.hold(states)
                if self._stamp is not None and stamp < self._stamp:
                    self._note_backward()
                    if self._two_simulations:
                        return
            self._command = (self._encode if loop.step(stamp, states) else self._encode_no_torque)(
                stamp
            )
            self._stamp = stamp
            self._state = raw
            self._channel.publish(self._command)
            loop.after_command(stamp)
        else:
            self._channel.publish(self._command)
        self._last_message = time.monotonic()
        assert self._stamp is not None
        self._wait.end(self._stamp)

    def serve_free_running(self) -> None:
        """Answer the states that have come, or wait for some for a short while."""
        loop = self._loop
        channel = self._channel
        period = self._rates.period
        self._pacer.wait()
        raw = channel.receive(0.0)
        if raw is not None:
            self._pacer.shift(-_PHASE_ADVANCE * period)
        else:
            raw = channel.receive(_WAIT_SLICE)
            self._pacer.restart()
            if raw is None:
                if self._next is not None and not self._resting:
                    self._resting = True
                    self._announce(f"no fresh states on {self._topic}: the loops rest")
                return
            self._pacer.shift(period)
        # earlier ones are beyond the lag
        batch = deque([raw], maxlen=self._lag_ns // self._period_ns)
        while (raw := channel.receive(0.0)) is not None:
            batch.append(raw)
        command = None
        for raw in batch:
            states = self._decode(raw)
            if states is None or not self._follows(states):
                continue
            assert self._next is not None
            while self._next <= states.stamp_ns:
                torque = loop.step(self._next, states)
                command = (self._encode if torque else self._encode_no_torque)(self._next)
                loop.after_command(self._next)
                self._next += self._period_ns
        if command is not None and not self._two_remain():
            channel.publish(command)

    def _follows(self, states: MotorStates) -> bool:
        """Return whether these states follow the last ones; begin, or skip time, if two in a row require it."""
        stamp = states.stamp_ns
        before = self._elsewhere
        if stamp != self._next:
            if self._next is not None and (
                before is None or not 0 < stamp - before <= self._lag_ns
            ):
                self._elsewhere = stamp
                return False
            if not self._prepared:
                # Time goes on while the subscribers are waited for, so that the next states are the first ones.
                self._prepared = True
                self._elsewhere = None
                self._loop.begin()
                while self._channel.receive(0.0) is not None:
                    pass
                return False
            if self._next is None or stamp < self._next:
                if self._next is not None:
                    self._note_backward()
                self._next = stamp
                self._loop.hold(states)
            elif stamp - self._next > self._lag_ns:  # this process did not run
                ticks = (stamp - self._next) // self._slow_ns
                self._loop.skip(ticks)
                late = ticks * self._slow_ns
                self._next += late
                text = "behind the simulation: a trajectory that runs comes later by as much"
                self._log.say("lag", f"{late / NANOSECONDS:.3g} s {text}")
        elif before is not None:
            self._log.say(
                "stamp",
                f"{self._topic}: the stamp {before / NANOSECONDS:.6g} s does not follow "
                f"{(stamp - self._period_ns) / NANOSECONDS:.6g} s, nor does the next one go on from there; the message "
                "is ignored",
            )
        self._elsewhere = None
        if self._resting:
            self._resting = False
            self._announce(f"states on {self._topic} from {stamp / NANOSECONDS:.6g} s on")
        return True

    def _decode(self, raw: bytes) -> MotorStates | None:
        """Return the states in a message; None if it has none, or those of a time between two ticks."""
        try:
            stamp_ns, position, velocity, torque = self._spare.decode(raw)
            if position is None or velocity is None:
                raise ExchangeError("no positions or no velocities; accepted: both")
            if stamp_ns < 0 or stamp_ns % self._period_ns:
                raise ExchangeError(
                    f"the stamp is {stamp_ns} ns; accepted: multiples of {self._period_ns} ns (base_rate "
                    f"{self._rates.base_hz} Hz, as the simulation's)"
                )
        except ExchangeError as error:
            self._complaints.say("states", f"{self._topic}: {error}; the message is ignored")
            return None
        self._codec, self._spare = self._spare, self._codec
        return MotorStates(stamp_ns, position, velocity, torque)

    def _note_backward(self) -> None:
        """Note that a stamp has gone back; if that happens often enough, there is a second simulation."""
        now = time.monotonic()
        self._backward.append(now)
        often = len(self._backward) == _BACKWARD and now - self._backward[0] < _BACKWARD_WINDOW
        if often and not self._two_simulations and self._channel.matches().publishers > 1:
            self._two_simulations = True
            self._announce(
                f"two simulations publish on {self._topic}: no commands until one is left"
            )

    def _two_remain(self) -> bool:
        """Return whether there are two simulations, and still are."""
        if self._two_simulations and self._channel.matches().publishers < 2:
            self._two_simulations = False
            self._backward.clear()
            self._announce(f"one simulation is left on {self._topic}")
        return self._two_simulations

    def _announce_silence(self) -> None:
        """Say that there is no simulation, if there has been none for a while."""
        if (
            self._channel.matches().publishers == 0
            and time.monotonic() - self._last_message > _PATIENCE
        ):
            self._wait.begin(f"waiting for a simulation on {self._topic}")

    # Any thread.

    def is_stopped(self) -> bool:
        """Return whether `run` is to end."""
        return self._stopped.is_set()

    def follow(self, time_mode: TimeMode) -> None:
        """Answer in this mode.

        Raises:
            ExchangeError: if the simulation's rates or robot are not this one's; then `run` ends with the same error.
        """
        try:
            time_mode.check(self._rates, self._robot)
        except ExchangeError as error:
            self._refused = error
            self.stop()
            raise
        self.mode = time_mode.mode
        self._changed.set()
        self._channel.wake()

    def stop(self) -> None:
        """End `run` soon."""
        self._stopped.set()
        self._changed.set()
        self._channel.wake()
