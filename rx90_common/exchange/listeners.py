"""Keep a run that is as fast as it goes from outrunning those who listen to it."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from contextlib import suppress

from rclpy.duration import Duration
from rclpy.exceptions import InvalidHandle
from rclpy.publisher import Publisher

from rx90_common.exchange.qos import STATE_QOS, TICK_QOS

_SHARE = 0.75  # of the publishers' history that is sent before the next wait
_SLICE = Duration(nanoseconds=50_000_000)
_PATIENCE = 6.0  # s; the lease of a process that was killed, in config/dds, is 5 s


class Listeners:
    """Waits, every some thousand ticks, until what was sent has arrived; owned by the thread that ticks.

    Publishers keep two seconds of simulated time. A run that is not paced spends them in a fraction of that, and a
    recorder that the machine keeps waiting for so long would lose messages.

    Args:
        publishers: whose messages are to arrive.
        state_ticks: ticks from one message to the next of those that do not come in each.
        interrupted: asked 20 times a second during a wait, which it ends.
        clock: the steady clock, s.
    """

    def __init__(
        self,
        publishers: Sequence[Publisher],
        state_ticks: int,
        interrupted: Callable[[], bool],
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        self._interrupted, self._clock = interrupted, clock
        self._watched: list[tuple[Publisher, int]] = []
        self._others: Callable[[], Sequence[Publisher]] = tuple
        self.add(publishers)
        self._ticks = self._left = int(_SHARE * min(TICK_QOS.depth, STATE_QOS.depth * state_ticks))

    def add(self, publishers: Sequence[Publisher], answering: int = 0) -> None:
        """Wait for the messages of these, too, if there are more subscriptions than the `answering` ones."""
        self._watched += [(publisher, answering) for publisher in publishers]

    def ask(self, others: Callable[[], Sequence[Publisher]]) -> None:
        """Wait also for the messages of the publishers that there are then; another thread may destroy them."""
        self._others = others

    def tick_done(self) -> None:
        """Count a tick; wait if it is time to."""
        self._left -= 1
        if self._left == 0:
            self._left = self._ticks
            deadline = self._clock() + _PATIENCE
            for publisher, answering in (*self._watched, *((other, 0) for other in self._others())):
                with suppress(InvalidHandle):  # destroyed: nothing to wait for
                    while publisher.get_subscription_count() > answering:
                        if publisher.wait_for_all_acked(_SLICE) or self._interrupted() or self._clock() > deadline:
                            break
