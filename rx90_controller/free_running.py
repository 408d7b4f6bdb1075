"""The controller's loops on a steady clock of their own, as in the real controller."""

from __future__ import annotations

from collections.abc import Callable

from rx90_common.rates import Rates
from rx90_exchange.channel import Channel
from rx90_exchange.lockstep import stamp_of
from rx90_exchange.pacing import Pacer

_STALE = 0.1  # s without fresh states after which the loops rest


class FreeRunningController:
    """Runs the law on every tick of the clock with the newest states; owned by the thread that ticks.

    Commands carry the stamps of the controller's own ticks, counted from the states with which it began.
    """

    def __init__(
        self,
        channel: Channel,
        pacer: Pacer,
        announce: Callable[[str], None],
        answer: Callable[[int, bytes], bytes],
        begin: Callable[[int, bytes], None],
        rates: Rates,
    ) -> None:
        """`answer` and `begin` as in `LockstepController`."""
        self._channel = channel
        self._pacer = pacer
        self._announce = announce
        self._answer = answer
        self._begin = begin
        self._period_ns = rates.period_ns
        self._stale_ticks = round(_STALE * rates.base_hz)
        self._newest: bytes | None = None
        self._seen_stamp = -1
        self._stamp = 0
        self._age = 0

    def serve(self) -> None:
        """Run one tick."""
        self._pacer.wait()
        fresh = None
        while (raw := self._channel.receive(0.0)) is not None:
            fresh = raw
        if fresh is not None:
            self._take(fresh)
        elif self._newest is not None:
            self._age += 1
            if self._age > self._stale_ticks:
                self._announce(f"no fresh states on {self._channel.subscribe_topic}: the loops rest")
                self._newest = None
        if self._newest is not None:
            self._channel.publish(self._answer(self._stamp, self._newest))
            self._stamp += self._period_ns

    def _take(self, raw: bytes) -> None:
        stamp = stamp_of(raw)
        if self._newest is None or stamp < self._seen_stamp:
            self._begin(stamp, raw)
            self._stamp = stamp
        self._newest, self._seen_stamp, self._age = raw, stamp, 0
