"""The controller's loops on a steady clock of their own, as in the real controller.

That clock follows the simulated time of the states. It is made a little slower or faster and never set, so that
set-points come one after the other, whatever the two clocks do: none is left out, none comes twice.
"""

from __future__ import annotations

from collections.abc import Callable

from rx90_common.base.errors import MessageError
from rx90_common.base.rates import NANOSECONDS
from rx90_common.exchange.motor_messages import MotorMessages, MotorStates, ServoLoops
from rx90_common.exchange.pacing import Pacer
from rx90_common.exchange.throttle import ThrottledLog
from rx90_common.exchange.tick_channel import TickChannel

_LEAD = 0.005  # s that the loops run ahead of the newest states; further ahead, time stands still and they rest
_LAG = 0.25  # s behind the states that are caught up; further behind, time is skipped and the motion comes later
_SETTLING = 0.25  # s, time constant with which the clock follows
_SLEW = 0.025  # largest share by which it runs slower or faster
_SLICE = 0.1  # s of a wait for states
_STALE = 0.1  # s at rest after which it is said


class FreeRunningController:
    """Runs the law on every tick of the clock with the newest states; owned by the thread that ticks.

    Commands carry the stamps of the controller's own ticks. While the simulation is paused the loops rest and keep
    what they hold: the motion goes on with the next states. They begin anew when simulated time has gone back.

    Args:
        channel: publishes commands, receives states.
        messages: decodes and encodes them.
        loops: what runs.
        pacer: the clock.
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
        self._lags = ThrottledLog(announce)
        self._period_ns, self._slow_ns = rates.period_ns, rates.period_ns * rates.ratio
        self._lead_ns = round(_LEAD * NANOSECONDS)
        self._lag_ns = round(_LAG * NANOSECONDS)
        self._states: MotorStates | None = None  # the newest
        self._stamp = 0
        self._rested = 0.0
        self._rest_announced = False
        self._begun = False

    def serve(self) -> None:
        """Run one tick, or wait for states for a short while."""
        if self._states is None or self._stamp - self._states.stamp_ns > self._lead_ns:
            self._rest()
            return
        self._pacer.wait()
        fresh = self._take(self._channel.receive(0.0))
        if fresh is not None:
            self._states = fresh
            self._follow(fresh.stamp_ns)
        torque = self._loops.step(self._stamp, self._states)
        self._channel.publish(self._messages.encode(self._stamp, torque))
        self._loops.after_command(self._stamp)
        self._stamp += self._period_ns

    def _rest(self) -> None:
        fresh = self._take(self._channel.receive(_SLICE))
        if fresh is None:
            self._rested += _SLICE
            if self._states is not None and not self._rest_announced and self._rested >= _STALE:
                self._rest_announced = True
                self._announce(f"no fresh states on {self._channel.subscribe_topic}: the loops rest")
            return
        self._states = fresh
        if self._rest_announced:
            self._rest_announced = False
            self._announce(f"states on {self._channel.subscribe_topic} from {fresh.stamp_ns / NANOSECONDS:.6g} s on")
        self._rested = 0.0
        self._pacer.restart()
        self._pacer.shift(self._period_ns / NANOSECONDS)  # states come before their tick, not after it

    def _take(self, raw: bytes | None) -> MotorStates | None:
        """Return the newest of the states that have come, from `raw` on; begin, or skip time, where they ask for it."""
        newest = None
        while raw is not None:
            newest = raw
            raw = self._channel.receive(0.0)
        if newest is None:
            return None
        try:
            states = self._messages.decode(newest)
        except MessageError:
            return None
        if self._states is None or states.stamp_ns < self._states.stamp_ns:
            if not self._begun:
                self._begun = True
                self._loops.begin()
                # Time went on meanwhile: the next states are the first ones.
                return None
            self._loops.hold(states)
            self._stamp = states.stamp_ns
        elif states.stamp_ns - self._stamp > self._lag_ns:
            self._catch_up(states.stamp_ns)
        return states

    def _catch_up(self, stamp: int) -> None:
        """Skip the time in which this process did not run."""
        ticks = (stamp - self._stamp) // self._slow_ns
        self._loops.skip(ticks)
        late = ticks * self._slow_ns
        self._stamp += late
        self._lags.say(
            "lag", f"{late / NANOSECONDS:.3g} s behind the simulation: a trajectory that runs comes later by as much"
        )

    def _follow(self, stamp: int) -> None:
        """Bring the clock closer to the time of the states that have just come."""
        late = (stamp - self._stamp) / self._period_ns
        step = self._period_ns / NANOSECONDS
        self._pacer.shift(-step * max(-_SLEW, min(_SLEW, late * step / _SETTLING)))
