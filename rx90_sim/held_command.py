"""The last command in free-running time, held as a real drive holds it, until it is too old."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from rx90_exchange.channel import Channel

Array = NDArray[np.float64]


class HeldCommand:
    """Takes the newest command without waiting.

    Attributes:
        missed: ticks since a command first came in which no fresh one was there.
    """

    def __init__(
        self,
        channel: Channel,
        decode: Callable[[bytes], Array | None],
        timeout_ticks: int,
        announce: Callable[[str], None],
    ) -> None:
        """Commands older than `timeout_ticks` ticks are not used; `decode` gives None for "no power"."""
        self._channel = channel
        self._decode = decode
        self._timeout = timeout_ticks
        self._announce = announce
        self._torques: Array | None = None
        self._age: int | None = None
        self._waiting = False
        self.missed = 0

    def forget(self) -> None:
        """Drop the command, after a reset or a pause."""
        self._torques, self._age = None, None

    def take(self) -> Array | None:
        """Return the torques to hold in this tick, None for brakes closed."""
        newest = None
        while (raw := self._channel.receive(0.0)) is not None:
            newest = raw
        if newest is not None:
            torques = self._decode(newest)
            self._torques = None if torques is None else torques.copy()
            self._age = 0
        elif self._age is not None:
            self._age += 1
            self.missed += 1
        stale = self._age is None or self._age > self._timeout
        self._say(stale)
        return None if stale else self._torques

    def _say(self, stale: bool) -> None:
        if stale == self._waiting:
            return
        self._waiting = stale
        topic = self._channel.subscribe_topic
        if not stale:
            self._announce(f"commands on {topic}: the brakes open")
        elif self._age is None:
            self._announce(f"waiting for a controller on {topic}: the brakes hold the arm")
        else:
            self._announce(f"no fresh command on {topic} for {self._timeout} ticks: torque off, brakes closed")
