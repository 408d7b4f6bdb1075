"""The controller's ticks: it answers the simulation's states, in lock-step or in free-running time.

In lock-step the simulation waits for each command (rx90_common/exchange/lockstep.py). A controller that sees the same
states again sends the same bytes again.

In free-running time nobody holds the states back. The loops tick with them, one tick for each, as drives do that share
a cycle with their controller: a set-point is compared with what was measured at its own time, however late either
process is. A controller that is late computes all ticks whose states have come meanwhile, and sends the newest command
alone.
"""

from __future__ import annotations

import threading
import time
from collections import deque
from collections.abc import Callable, Sequence

from rx90_common.base.arrays import Array
from rx90_common.base.errors import ExchangeError, MessageError
from rx90_common.base.rates import NANOSECONDS, Rates
from rx90_common.exchange.cdr import JointStateCodec
from rx90_common.exchange.channel import TickChannel
from rx90_common.exchange.lockstep import Wait
from rx90_common.exchange.pacing import Pacer, ThrottledLog
from rx90_common.exchange.topics import FREE_RUNNING, LOCK_STEP, TimeMode
from rx90_controller.node.servo_loop import MotorStates, ServoLoop

_WAIT_SLICE = 0.1  # s of a wait for states; in free-running time also at rest after which it is said
_PATIENCE = 1.0  # s without a simulation, after which that is announced
_MODE_PATIENCE = 5.0  # s with a simulation that does not say its mode
_MAX_LAG = 0.005  # s; up to here missed ticks are computed one by one, beyond it time is skipped
_PHASE_ADVANCE = 0.02  # of a period: by so much it wakes earlier each time, until it is there before the states
_BACKWARD = 3  # jumps back within _BACKWARD_WINDOW that make two simulations; a reset makes one
_BACKWARD_WINDOW = 5.0  # s


class SimulationLink:
    """The controller's end of the exchange: motor states in, motor commands out; for one thread.

    Args:
        channel: publishes commands, receives states.
        names: of the motors.
        rates: of the loops; states are stamped with multiples of the base tick.
        command: torques to send, Nm, shape (n,); stays where it is in memory.
        announce: prints a line about what happened.
        complain: prints a line about a message that is ignored; called now and then only.

    Attributes:
        two_simulations: whether the stamps have gone back again and again, with two publishers there.
    """

    def __init__(
        self,
        channel: TickChannel,
        names: Sequence[str],
        rates: Rates,
        command: Array,
        announce: Callable[[str], None],
        complain: Callable[[str], None],
    ) -> None:
        self.channel, self.topic, self.rates, self.announce = channel, channel.subscribe_topic, rates, announce
        self.two_simulations = False
        self._period_ns = rates.period_ns
        # Two, in turns: a message that is refused half-way leaves the states before it as they are.
        self._codec, self._spare = JointStateCodec(names), JointStateCodec(names)
        commands = JointStateCodec(names)
        self._encode, self._encode_no_torque = commands.encoder(effort=command), commands.encoder()
        self._complaints = ThrottledLog(complain)
        self._backward: deque[float] = deque(maxlen=_BACKWARD)  # when the stamps have gone back

    def decode(self, raw: bytes) -> MotorStates:
        """Return the states in a message.

        Raises:
            MessageError: if it holds none, or those of a time between two ticks; a line says why.
        """
        try:
            stamp_ns, position, velocity, torque = self._spare.decode(raw)
            if position is None or velocity is None:
                raise ExchangeError("no positions or no velocities; accepted: both")
            if stamp_ns < 0 or stamp_ns % self._period_ns:
                raise ExchangeError(
                    f"the stamp is {stamp_ns} ns; accepted: multiples of {self._period_ns} ns (base_rate "
                    f"{self.rates.base_hz} Hz, as the simulation's)"
                )
        except ExchangeError as error:
            self._complaints.say("states", f"{self.topic}: {error}; the message is ignored")
            raise MessageError(str(error)) from error
        self._codec, self._spare = self._spare, self._codec
        return MotorStates(stamp_ns, position, velocity, torque)

    def encode(self, stamp_ns: int, torque: bool) -> bytes:
        """Return the command as a message, or one without torques, which closes the brakes."""
        return self._encode(stamp_ns) if torque else self._encode_no_torque(stamp_ns)

    def note_backward(self) -> None:
        """Note that a stamp has gone back; often enough, that comes of a second simulation."""
        now = time.monotonic()
        self._backward.append(now)
        often = len(self._backward) == _BACKWARD and now - self._backward[0] < _BACKWARD_WINDOW
        if often and not self.two_simulations and self.channel.matches().publishers > 1:
            self.two_simulations = True
            self.announce(f"two simulations publish on {self.topic}: no commands until one is left")

    def two_remain(self) -> bool:
        """Return whether there are two simulations, and still are."""
        if self.two_simulations and self.channel.matches().publishers < 2:
            self.two_simulations = False
            self._backward.clear()
            self.announce(f"one simulation is left on {self.topic}")
        return self.two_simulations


class LockstepController:
    """Answers tick by tick; owned by the thread that ticks.

    The loops begin and hold the arm when the states do not follow the last ones: at the start, after a reset of the
    simulation, or after one of the two was away. Messages without usable states are left out.
    """

    def __init__(self, link: SimulationLink, loop: ServoLoop) -> None:
        self._link, self._channel, self._loop = link, link.channel, loop
        self._wait = Wait(link.announce, "the simulation is there:")
        self._period_ns = link.rates.period_ns
        self._stamp: int | None = None
        self._state: bytes | None = None  # as received; an empty message must not pass for a repetition
        self._command = b""
        self._heard = time.monotonic()

    def serve(self, timeout: float) -> None:
        """Answer the next states; return after `timeout` seconds without any, or a wake-up."""
        link, loop = self._link, self._loop
        raw = self._channel.receive(timeout)
        if raw is None:
            self.announce_silence()
            return
        if link.two_simulations:
            if link.two_remain():
                return
            self._stamp = self._state = None
        if raw != self._state:
            try:
                states = link.decode(raw)
            except MessageError:
                return
            stamp = states.stamp_ns
            if self._stamp is None or stamp != self._stamp + self._period_ns:
                loop.begin()
                loop.hold(states)
                if self._stamp is not None and stamp < self._stamp:
                    link.note_backward()
                    if link.two_simulations:
                        return
            self._command = link.encode(stamp, loop.step(stamp, states))
            self._stamp, self._state = stamp, raw
            self._channel.publish(self._command)
            loop.after_command(stamp)
        else:
            self._channel.publish(self._command)
        self._heard = time.monotonic()
        assert self._stamp is not None
        self._wait.end(self._stamp)

    def announce_silence(self) -> None:
        """Say that there is no simulation, if there has been none for a while."""
        if self._channel.matches().publishers == 0 and time.monotonic() - self._heard > _PATIENCE:
            self._wait.begin(f"waiting for a simulation on {self._link.topic}")


class FreeRunningController:
    """Runs the law once for each tick of the states; owned by the thread that ticks.

    While the simulation is paused the loops rest and keep what they hold: the motion goes on with the next states. They
    begin anew when simulated time has gone back, and skip the time in which this process did not run, so that a motion
    comes later. A single message with a stamp from elsewhere does neither. While there are two simulations, no command
    is sent. The pacer sleeps from one state to the next, which takes less of the processor than a wait for a message.
    """

    def __init__(self, link: SimulationLink, loop: ServoLoop, pacer: Pacer) -> None:
        rates = link.rates
        self._link, self._channel, self._loop, self._pacer = link, link.channel, loop, pacer
        self._log = ThrottledLog(link.announce)
        self._period, self._period_ns, self._slow_ns = rates.period, rates.period_ns, rates.period_ns * rates.ratio
        self._lag_ns = max(round(_MAX_LAG * NANOSECONDS), 2 * self._slow_ns)
        self._next: int | None = None  # the stamp of the next tick, once the loops have begun
        self._elsewhere: int | None = None  # a stamp that does not follow; the next one may go on from there
        self._prepared = self._resting = False

    def begin_anew(self) -> None:
        """Hold the arm at the next states, whatever has been before."""
        self._next = self._elsewhere = None

    def serve(self) -> None:
        """Answer the states that have come, or wait for some for a short while."""
        link, loop, channel = self._link, self._loop, self._channel
        self._pacer.wait()
        raw = channel.receive(0.0)
        if raw is not None:
            self._pacer.shift(-_PHASE_ADVANCE * self._period)
        else:
            raw = channel.receive(_WAIT_SLICE)
            self._pacer.restart()
            if raw is None:
                if self._next is not None and not self._resting:
                    self._resting = True
                    link.announce(f"no fresh states on {link.topic}: the loops rest")
                return
            self._pacer.shift(self._period)
        batch = deque([raw], maxlen=self._lag_ns // self._period_ns)  # what came before them lies beyond the lag
        while (raw := channel.receive(0.0)) is not None:
            batch.append(raw)
        command = None
        for raw in batch:
            try:
                states = link.decode(raw)
            except MessageError:
                continue
            if not self._follows(states):
                continue
            assert self._next is not None
            while self._next <= states.stamp_ns:
                torque = loop.step(self._next, states)
                command = link.encode(self._next, torque)
                loop.after_command(self._next)
                self._next += self._period_ns
        if command is not None and not link.two_remain():
            channel.publish(command)

    def _follows(self, states: MotorStates) -> bool:
        """Return whether these states go on from the last ones; begin, or skip time, where two in a row ask for it."""
        stamp, before, link = states.stamp_ns, self._elsewhere, self._link
        if stamp != self._next:
            if self._next is not None and (before is None or not 0 < stamp - before <= self._lag_ns):
                self._elsewhere = stamp
                return False
            if not self._prepared:
                # Time goes on while the subscribers are waited for, so that the next states are the first ones.
                self._prepared, self._elsewhere = True, None
                self._loop.begin()
                while self._channel.receive(0.0) is not None:
                    pass
                return False
            if self._next is None or stamp < self._next:
                if self._next is not None:
                    link.note_backward()
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
                f"{link.topic}: the stamp {before / NANOSECONDS:.6g} s does not follow "
                f"{(stamp - self._period_ns) / NANOSECONDS:.6g} s, nor does the next one go on from there; the message "
                "is ignored",
            )
        self._elsewhere = None
        if self._resting:
            self._resting = False
            link.announce(f"states on {link.topic} from {stamp / NANOSECONDS:.6g} s on")
        return True


class Serving:
    """Runs the loops tick by tick: on a thread of its own, or in lock-step on that of a simulation in this process.

    Args:
        link: to the simulation.
        loop: what runs in each tick.
        pacer: the clock of free-running time.
        robot: name of the robot, which has to be the simulation's.
        local: whether a simulation in this process calls `answer` in each tick in lock-step; `run` then rests.

    Attributes:
        mode: how the simulation keeps time, one of TIME_MODES; None until it is known.
    """

    def __init__(self, link: SimulationLink, loop: ServoLoop, pacer: Pacer, robot: str, *, local: bool) -> None:
        self._link, self._robot, self._local = link, robot, local
        self._lockstep, self._free = LockstepController(link, loop), FreeRunningController(link, loop, pacer)
        self.mode: str | None = None
        self._changed = threading.Event()  # the mode is known, or the end is near
        self._stopped = threading.Event()
        self._refused: ExchangeError | None = None

    def answer(self) -> None:
        """Answer one tick in lock-step; called by the thread that ticks in a simulation of this process."""
        if self.mode == LOCK_STEP:
            self._lockstep.serve(0.0)

    def run(self) -> None:
        """Answer the simulation until `stop`, on the ticking thread.

        A simulation that does not say its mode within some seconds is taken for lock-step: loops that began in the
        wrong mode would begin again in the right one, and drop the trajectory that they follow.

        Raises:
            ExchangeError: if the simulation's rates are not this one's.
        """
        deadline = time.monotonic() + _MODE_PATIENCE
        while not self._stopped.is_set() and self.mode is None and time.monotonic() < deadline:
            if self._link.channel.matches().publishers == 0:
                deadline = time.monotonic() + _MODE_PATIENCE
                self._lockstep.announce_silence()
            self._changed.wait(_WAIT_SLICE)
        mode = self.mode
        while not self._stopped.is_set():
            if mode != self.mode:
                mode = self.mode
                self._free.begin_anew()
            if mode == FREE_RUNNING:
                self._free.serve()
            elif self._local:
                self._stopped.wait(_WAIT_SLICE)
            else:
                self._lockstep.serve(_WAIT_SLICE)
        if self._refused is not None:
            raise self._refused

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
            time_mode.check(self._link.rates, self._robot)
        except ExchangeError as error:
            self._refused = error
            self.stop()
            raise
        self.mode = time_mode.mode
        self._changed.set()
        self._link.channel.wake()

    def stop(self) -> None:
        """End `run` soon."""
        self._stopped.set()
        self._changed.set()
        self._link.channel.wake()
