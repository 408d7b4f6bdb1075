"""The controller's loops on a steady clock of their own, as in the real controller.

That clock follows the simulated time of the states. It is made a little slower or faster and never set, so that
set-points come one after the other, whatever the two clocks do: none is left out, none comes twice.
"""

from __future__ import annotations

from collections.abc import Callable

from rx90_common.base.errors import MessageError
from rx90_common.base.rates import NANOSECONDS, Rates
from rx90_common.exchange.channel import Channel
from rx90_common.exchange.lockstep import stamp_of
from rx90_common.exchange.pacing import Pacer
from rx90_common.exchange.throttle import Occasionally

_LEAD = 0.005  # s that the loops run ahead of the newest states; further ahead, time stands still and they rest
_LAG = 0.25  # s behind the states that are caught up; further behind, time is skipped and the motion comes later
_SETTLING = 0.25  # s, time constant with which the clock follows
_SLEW = 0.025  # largest share by which it runs slower or faster
_SLICE = 0.1  # s of a wait for states
_STALE = 0.1  # s at rest after which it is said


class FreeRunningController:
    """Runs the law on every tick of the clock with the newest states; owned by the thread that ticks.

    Commands carry the stamps of the controller's own ticks. While the simulation is paused the loops rest and keep
    what they hold: the motion goes on with the next states.
    """

    def __init__(
        self,
        channel: Channel,
        pacer: Pacer,
        announce: Callable[[str], None],
        answer: Callable[[int, bytes], bytes],
        begin: Callable[[int, bytes], None],
        prepare: Callable[[], None],
        skip: Callable[[int, bytes], None],
        rates: Rates,
    ) -> None:
        """Make the loops.

        Args:
            channel: publishes commands, receives states.
            pacer: the clock.
            announce: prints a line for the user.
            answer: as in `LockstepController`.
            begin: as in `LockstepController`; called at start and when simulated time has gone back.
            prepare: called once, before the first `begin`.
            skip: lets a number of position ticks pass without set-points; with the states that made it necessary,
                which it may refuse with MessageError.
            rates: of the loops.
        """
        self._channel = channel
        self._pacer = pacer
        self._announce = announce
        self._lags = Occasionally(announce)
        self._answer = answer
        self._begin = begin
        self._prepare = prepare
        self._skip = skip
        self._slow_ns = rates.period_ns * rates.ratio
        self._period_ns = rates.period_ns
        self._lead_ns = round(_LEAD * NANOSECONDS)
        self._lag_ns = round(_LAG * NANOSECONDS)
        self._newest: bytes | None = None
        self._seen_stamp = 0
        self._used: tuple[bytes | None, int] = (None, 0)  # the last states that could be used, and their stamp
        self._stamp = 0
        self._rested = 0.0
        self._told_rest = False
        self._prepared = False

    def serve(self) -> None:
        """Run one tick, or wait for states for a short while."""
        if self._newest is None or self._stamp - self._seen_stamp > self._lead_ns:
            self._rest()
            return
        self._pacer.wait()
        fresh = self._take(self._channel.receive(0.0))
        if fresh:
            self._follow()
        self._tick()

    def _rest(self) -> None:
        if not self._take(self._channel.receive(_SLICE)):
            self._rested += _SLICE
            if self._newest is not None and not self._told_rest and self._rested >= _STALE:
                self._told_rest = True
                self._announce(f"no fresh states on {self._channel.subscribe_topic}: the loops rest")
            return
        if self._told_rest:
            self._told_rest = False
            self._announce(f"states on {self._channel.subscribe_topic} from {self._seen_stamp / NANOSECONDS:.6g} s on")
        self._rested = 0.0
        self._pacer.restart()
        self._pacer.shift(self._period_ns / NANOSECONDS)  # states come before their tick, not after it

    def _tick(self) -> None:
        if self._newest is None:
            return
        try:
            command = self._answer(self._stamp, self._newest)
        except MessageError:
            self._newest, self._seen_stamp = self._used
            return
        self._used = self._newest, self._seen_stamp
        self._channel.publish(command)
        self._stamp += self._period_ns

    def _take(self, raw: bytes | None) -> bool:
        """Take the newest of the states that have come, from `raw` on; return whether there are any."""
        newest = None
        while raw is not None:
            newest = raw
            raw = self._channel.receive(0.0)
        if newest is None:
            return False
        stamp = stamp_of(newest)
        if self._newest is None or stamp < self._seen_stamp:
            return self._start(stamp, newest)
        if stamp - self._stamp > self._lag_ns and not self._catch_up(stamp, newest):
            return False
        self._newest, self._seen_stamp = newest, stamp
        return True

    def _start(self, stamp: int, raw: bytes) -> bool:
        """Begin where the arm is; return whether the states could be used."""
        if not self._prepared:
            self._prepared = True
            self._prepare()
            # Time went on meanwhile: the next states are the first ones.
            return False
        try:
            self._begin(stamp, raw)
        except MessageError:
            return False
        self._newest, self._seen_stamp, self._stamp = raw, stamp, stamp
        self._used = raw, stamp
        return True

    def _catch_up(self, stamp: int, raw: bytes) -> bool:
        """Skip the time in which this process did not run; return whether the states could be used."""
        ticks = (stamp - self._stamp) // self._slow_ns
        try:
            self._skip(ticks, raw)
        except MessageError:
            return False
        late = ticks * self._slow_ns
        self._stamp += late
        self._lags.say(
            "lag", f"{late / NANOSECONDS:.3g} s behind the simulation: a trajectory that runs comes later by as much"
        )
        return True

    def _follow(self) -> None:
        """Bring the clock closer to the time of the states that have just come."""
        late = (self._seen_stamp - self._stamp) / self._period_ns
        step = self._period_ns / NANOSECONDS
        self._pacer.shift(-step * max(-_SLEW, min(_SLEW, late * step / _SETTLING)))
