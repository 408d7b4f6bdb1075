"""The controller in free-running time: it answers the simulation's states, which nobody holds back for it.

The loops tick with the states, one tick for each, as drives do that share a cycle with their controller: a set-point is
compared with what was measured at its own time, however late either process is. A controller that
is late computes all ticks whose states have come meanwhile, and sends the newest command alone.
"""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Callable

from rx90_common.base.errors import MessageError
from rx90_common.base.rates import NANOSECONDS
from rx90_common.exchange.channel import TickChannel
from rx90_common.exchange.motor_messages import MotorMessages, MotorStates, ServoLoops
from rx90_common.exchange.pacing import Pacer, ThrottledLog

_LAG = 0.005  # s; up to here missed ticks are computed one by one, beyond it time is skipped
_PHASE_ADVANCE = 0.02  # of a period: by so much it wakes earlier each time, until it is there before the states
_SLICE = 0.1  # s of a wait for states, and at rest after which it is said
_BACKWARD = 3  # jumps back within _BACKWARD_WINDOW that make two simulations; a reset makes one
_BACKWARD_WINDOW = 5.0  # s


class _SecondSimulation:
    """Recognises a second simulation by stamps that go back again and again.

    Attributes:
        there: whether there is one.
    """

    def __init__(self, channel: TickChannel, announce: Callable[[str], None]) -> None:
        self._channel, self._announce = channel, announce
        self._backward: deque[float] = deque(maxlen=_BACKWARD)
        self.there = False

    def note_backward(self) -> None:
        """Note that the stamps have gone back; a reset does that once."""
        now = time.monotonic()
        self._backward.append(now)
        often = len(self._backward) == _BACKWARD and now - self._backward[0] < _BACKWARD_WINDOW
        if often and not self.there and self._channel.matches().publishers > 1:
            self.there = True
            self._announce(f"two simulations publish on {self._channel.subscribe_topic}: no commands until one is left")

    def look(self) -> bool:
        """Return whether it is still there."""
        self.there = self._channel.matches().publishers > 1
        if not self.there:
            self._backward.clear()
            self._announce(f"one simulation is left on {self._channel.subscribe_topic}")
        return self.there


class FreeRunningController:
    """Runs the law once for each tick of the states; owned by the thread that ticks.

    While the simulation is paused the loops rest and keep what they hold: the motion goes on with the next states. They
    begin anew when simulated time has gone back, and skip the time in which this process did not run, so that a motion
    comes later. A single message with a stamp from elsewhere does neither.

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
        self._channel, self._messages, self._loops = channel, messages, loops
        self._pacer = pacer
        self._announce = announce
        self._log = ThrottledLog(announce)
        self._period = rates.period
        self._period_ns, self._slow_ns = rates.period_ns, rates.period_ns * rates.ratio
        self._lag_ns = max(round(_LAG * NANOSECONDS), 2 * self._slow_ns)
        self._most = self._lag_ns // self._period_ns  # messages of a batch; what came before them lies beyond the lag
        self._next: int | None = None  # the stamp of the next tick, once the loops have begun
        self._elsewhere: int | None = None  # a stamp that does not follow; the next one may go on from there
        self._second = _SecondSimulation(channel, announce)
        self._prepared = False
        self._resting = False

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
            raw = self._channel.receive(_SLICE)
            self._pacer.restart()
            if raw is None:
                self._rest()
                return
            self._pacer.shift(self._period)
        batch = deque([raw], maxlen=self._most)
        while (raw := self._channel.receive(0.0)) is not None:
            batch.append(raw)
        self._answer(batch)

    def _answer(self, batch: deque[bytes]) -> None:
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
        if command is not None and not (self._second.there and self._second.look()):
            self._channel.publish(command)

    def _follows(self, states: MotorStates) -> bool:
        """Return whether these states go on from the last ones; begin, or skip time, where two in a row ask for it."""
        stamp, before = states.stamp_ns, self._elsewhere
        if stamp == self._next:
            if before is not None:
                self._elsewhere = None
                self._log.say("stamp", self._strange(before))
            self._end_rest(stamp)
            return True
        if self._next is not None and (before is None or not 0 < stamp - before <= self._lag_ns):
            self._elsewhere = stamp
            return False
        self._elsewhere = None
        if not self._prepared:
            self._prepare()
            return False
        if self._next is None or stamp < self._next:
            self._begin(states)
        elif stamp - self._next > self._lag_ns:
            self._skip(stamp)
        self._end_rest(stamp)
        return True

    def _strange(self, stamp: int) -> str:
        return (
            f"{self._channel.subscribe_topic}: the stamp {stamp / NANOSECONDS:.6g} s does not follow "
            f"{((self._next or 0) - self._period_ns) / NANOSECONDS:.6g} s, nor does the next one go on from there; the "
            "message is ignored"
        )

    def _prepare(self) -> None:
        """Wait for the subscribers; time goes on meanwhile, so that the next states are the first ones."""
        self._prepared = True
        self._loops.begin()
        while self._channel.receive(0.0) is not None:
            pass

    def _begin(self, states: MotorStates) -> None:
        if self._next is not None:
            self._second.note_backward()
        self._next = states.stamp_ns
        self._loops.hold(states)

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

    def _rest(self) -> None:
        if self._next is not None and not self._resting:
            self._resting = True
            self._announce(f"no fresh states on {self._channel.subscribe_topic}: the loops rest")

    def _end_rest(self, stamp: int) -> None:
        if self._resting:
            self._resting = False
            self._announce(f"states on {self._channel.subscribe_topic} from {stamp / NANOSECONDS:.6g} s on")
