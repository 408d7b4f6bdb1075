"""The controller's ticks: it answers the simulation's states, in lock-step or in free-running time.

In free-running time nobody holds the states back. The loops tick with them, one tick for each, as drives do that share
a cycle with their controller: a set-point is compared with what was measured at its own time, however late either
process is. A controller that is late computes all ticks whose states have come meanwhile, and sends the newest command
alone.
"""

from __future__ import annotations

import threading
import time
from collections import deque
from collections.abc import Callable

from rx90_common.base.errors import ExchangeError, MessageError
from rx90_common.base.rates import NANOSECONDS
from rx90_common.exchange.channel import TickChannel
from rx90_common.exchange.lockstep import LockstepController
from rx90_common.exchange.motor_messages import MotorMessages, MotorStates, ServoLoops
from rx90_common.exchange.pacing import Pacer, ThrottledLog
from rx90_common.exchange.topics import FREE_RUNNING, LOCK_STEP, TimeMode

_WAIT_SLICE = 0.1  # s of a wait for states; in free-running time also at rest after which it is said
_MODE_PATIENCE = 5.0  # s with a simulation that does not say its mode
_MAX_LAG = 0.005  # s; up to here missed ticks are computed one by one, beyond it time is skipped
_PHASE_ADVANCE = 0.02  # of a period: by so much it wakes earlier each time, until it is there before the states
_BACKWARD = 3  # jumps back within _BACKWARD_WINDOW that make two simulations; a reset makes one
_BACKWARD_WINDOW = 5.0  # s


class FreeRunningController:
    """Runs the law once for each tick of the states; owned by the thread that ticks.

    While the simulation is paused the loops rest and keep what they hold: the motion goes on with the next states. They
    begin anew when simulated time has gone back, and skip the time in which this process did not run, so that a motion
    comes later. A single message with a stamp from elsewhere does neither. Stamps that go back again and again are
    those of a second simulation; while there are two, no command is sent.

    Args:
        channel: publishes commands, receives states.
        messages: decodes and encodes them.
        loops: what runs.
        pacer: sleeps from one state to the next, which takes less of the processor than a wait for a message.
        announce: prints a line for the user.
    """

    def __init__(
        self,
        channel: TickChannel,
        messages: MotorMessages,
        loops: ServoLoops,
        pacer: Pacer,
        announce: Callable[[str], None],
    ) -> None:
        rates = messages.rates
        self._channel, self._messages, self._loops, self._pacer = channel, messages, loops, pacer
        self._announce, self._log = announce, ThrottledLog(announce)
        self._period, self._period_ns, self._slow_ns = rates.period, rates.period_ns, rates.period_ns * rates.ratio
        self._lag_ns = max(round(_MAX_LAG * NANOSECONDS), 2 * self._slow_ns)
        self._next: int | None = None  # the stamp of the next tick, once the loops have begun
        self._elsewhere: int | None = None  # a stamp that does not follow; the next one may go on from there
        self._backward: deque[float] = deque(maxlen=_BACKWARD)  # when the stamps have gone back
        self._two_simulations = self._prepared = self._resting = False

    def begin_anew(self) -> None:
        """Hold the arm at the next states, whatever has been before."""
        self._next = self._elsewhere = None

    def serve(self) -> None:
        """Answer the states that have come, or wait for some for a short while."""
        self._pacer.wait()
        raw = self._channel.receive(0.0)
        if raw is not None:
            self._pacer.shift(-_PHASE_ADVANCE * self._period)
        else:
            raw = self._channel.receive(_WAIT_SLICE)
            self._pacer.restart()
            if raw is None:
                if self._next is not None and not self._resting:
                    self._resting = True
                    self._announce(f"no fresh states on {self._channel.subscribe_topic}: the loops rest")
                return
            self._pacer.shift(self._period)
        batch = deque([raw], maxlen=self._lag_ns // self._period_ns)  # what came before them lies beyond the lag
        while (raw := self._channel.receive(0.0)) is not None:
            batch.append(raw)
        command = None
        for raw in batch:
            try:
                states = self._messages.decode(raw)
            except MessageError:
                continue
            if not self._follows(states):
                continue
            assert self._next is not None
            while self._next <= states.stamp_ns:
                torque = self._loops.step(self._next, states)
                command = self._messages.encode(self._next, torque)
                self._loops.after_command(self._next)
                self._next += self._period_ns
        if command is not None and not (self._two_simulations and self._two_remain()):
            self._channel.publish(command)

    def _follows(self, states: MotorStates) -> bool:
        """Return whether these states go on from the last ones; begin, or skip time, where two in a row ask for it."""
        stamp, before, topic = states.stamp_ns, self._elsewhere, self._channel.subscribe_topic
        if stamp != self._next:
            if self._next is not None and (before is None or not 0 < stamp - before <= self._lag_ns):
                self._elsewhere = stamp
                return False
            if not self._prepared:
                # Time goes on while the subscribers are waited for, so that the next states are the first ones.
                self._prepared, self._elsewhere = True, None
                self._loops.begin()
                while self._channel.receive(0.0) is not None:
                    pass
                return False
            if self._next is None or stamp < self._next:
                self._begin(states)
            elif stamp - self._next > self._lag_ns:
                self._skip(stamp)
        elif before is not None:
            self._log.say(
                "stamp",
                f"{topic}: the stamp {before / NANOSECONDS:.6g} s does not follow "
                f"{(stamp - self._period_ns) / NANOSECONDS:.6g} s, nor does the next one go on from there; the message "
                "is ignored",
            )
        self._elsewhere = None
        if self._resting:
            self._resting = False
            self._announce(f"states on {topic} from {stamp / NANOSECONDS:.6g} s on")
        return True

    def _begin(self, states: MotorStates) -> None:
        if self._next is not None:
            now = time.monotonic()
            self._backward.append(now)
            often = len(self._backward) == _BACKWARD and now - self._backward[0] < _BACKWARD_WINDOW
            if often and not self._two_simulations and self._channel.matches().publishers > 1:
                self._two_simulations = True
                self._announce(
                    f"two simulations publish on {self._channel.subscribe_topic}: no commands until one is left"
                )
        self._next = states.stamp_ns
        self._loops.hold(states)

    def _two_remain(self) -> bool:
        """Return whether there are still two simulations."""
        self._two_simulations = self._channel.matches().publishers > 1
        if not self._two_simulations:
            self._backward.clear()
            self._announce(f"one simulation is left on {self._channel.subscribe_topic}")
        return self._two_simulations

    def _skip(self, stamp: int) -> None:
        """Skip the time in which this process did not run."""
        assert self._next is not None
        ticks = (stamp - self._next) // self._slow_ns
        self._loops.skip(ticks)
        late = ticks * self._slow_ns
        self._next += late
        self._log.say(
            "lag", f"{late / NANOSECONDS:.3g} s behind the simulation: a trajectory that runs comes later by as much"
        )


class Serving:
    """Runs the loops tick by tick: on a thread of its own, or in lock-step on that of a simulation in this process.

    Args:
        channel: publishes commands, receives states.
        messages: decodes and encodes them.
        loops: what runs in each tick.
        pacer: the clock of free-running time.
        announce: prints a line for the user.
        robot: name of the robot, which has to be the simulation's.

    Attributes:
        mode: how the simulation keeps time, one of TIME_MODES; None until it is known.
    """

    def __init__(
        self,
        channel: TickChannel,
        messages: MotorMessages,
        loops: ServoLoops,
        pacer: Pacer,
        announce: Callable[[str], None],
        robot: str,
    ) -> None:
        self._channel, self._messages, self._robot = channel, messages, robot
        self._lockstep = LockstepController(channel, messages, loops, announce)
        self._free = FreeRunningController(channel, messages, loops, pacer, announce)
        self.mode: str | None = None
        self._changed = threading.Event()  # the mode is known, or the end is near
        self._stopped = threading.Event()
        self._refused: ExchangeError | None = None
        self._handed_over = False

    def hand_over(self) -> Callable[[], None]:
        """Return what answers one tick in lock-step, to be called by the thread that ticks; `run` then rests."""
        self._handed_over = True

        def answer() -> None:
            if self.mode == LOCK_STEP:
                self._lockstep.serve(0.0)

        return answer

    def run(self) -> None:
        """Answer the simulation until `stop`, on the ticking thread.

        A simulation that does not say its mode within some seconds is taken for lock-step: loops that began in the
        wrong mode would begin again in the right one, and drop the trajectory that they follow.

        Raises:
            ExchangeError: if the simulation's rates are not this one's.
        """
        deadline = time.monotonic() + _MODE_PATIENCE
        while not self._stopped.is_set() and self.mode is None and time.monotonic() < deadline:
            if self._channel.matches().publishers == 0:
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
            elif self._handed_over:
                self._stopped.wait(_WAIT_SLICE)
            else:
                self._lockstep.serve(_WAIT_SLICE)
        if self._refused is not None:
            raise self._refused

    # Any thread.

    def follow(self, time_mode: TimeMode) -> None:
        """Answer in this mode.

        Raises:
            ExchangeError: if the simulation's rates or robot are not this one's; then `run` ends with the same error.
        """
        try:
            time_mode.check(self._messages.rates, self._robot)
        except ExchangeError as error:
            self._refused = error
            self.stop()
            raise
        # In this order: the ticking thread acts on the mode as soon as it is there.
        self._messages.same_rates = True
        self.mode = time_mode.mode
        self._changed.set()
        self._channel.wake()

    def stop(self) -> None:
        """End `run` soon."""
        self._stopped.set()
        self._changed.set()
        self._channel.wake()
