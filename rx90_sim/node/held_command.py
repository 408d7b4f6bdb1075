"""The last command in free-running time, held as a real drive holds it, until it is too old."""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Callable

from rx90_common.base.arrays import Array
from rx90_common.base.stamps import cdr_stamp_ns
from rx90_common.exchange.tick_channel import TickChannel

_LINES = 4  # about the brakes in _LINES_WINDOW; more changes are counted
_LINES_WINDOW = 10.0  # s
_BACKWARD = 3  # commands older than the one before, within _BACKWARD_WINDOW, that make two controllers
_BACKWARD_WINDOW = 5.0  # s


class HeldCommand:
    """Takes the newest command without waiting.

    A command ages with the ticks of the plant: while time stands still, it stays as it is.

    Attributes:
        two_controllers: whether two of them send commands.
        missed: ticks since a command first came in which no fresh one was there.
    """

    def __init__(
        self,
        channel: TickChannel,
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
        self._stamp = -1
        self._backward: deque[float] = deque(maxlen=_BACKWARD)
        self.two_controllers = False
        self._waiting = False
        self._changes = 0  # of the brakes that have not been announced
        self._lines: deque[float] = deque(maxlen=_LINES)
        self.missed = 0

    def forget(self) -> None:
        """Drop the command, after a reset."""
        self._torques, self._age = None, None

    def take(self) -> Array | None:
        """Return the torques to hold in this tick, None for brakes closed."""
        newest = None
        while (raw := self._channel.receive(0.0)) is not None:
            newest = raw
            stamp = cdr_stamp_ns(raw)
            if stamp < self._stamp:
                self._note_backward()
            self._stamp = stamp
        if newest is not None:
            torques = self._decode(newest)
            self._torques = None if torques is None else torques.copy()
            self._age = 0
        elif self._age is not None:
            self._age += 1
            self.missed += 1
        if self.two_controllers:
            self._note_one_left()
        stale = self._age is None or self._age > self._timeout
        self._say(stale)
        return None if stale or self.two_controllers else self._torques

    def _note_backward(self) -> None:
        """A controller's stamps grow; when it begins again they go back once."""
        now = time.monotonic()
        self._backward.append(now)
        often = len(self._backward) == _BACKWARD and now - self._backward[0] < _BACKWARD_WINDOW
        if often and not self.two_controllers and self._channel.matches().publishers > 1:
            self.two_controllers = True
            self._announce(f"two controllers publish on {self._channel.subscribe_topic}: no torque until one is left")

    def _note_one_left(self) -> None:
        if time.monotonic() - self._backward[-1] > _BACKWARD_WINDOW:
            self.two_controllers = False
            self._backward.clear()
            self._announce(f"one controller is left on {self._channel.subscribe_topic}")

    def _say(self, stale: bool) -> None:
        if stale == self._waiting and not self._changes:
            return
        if stale != self._waiting:
            self._waiting = stale
            self._changes += 1
        now = time.monotonic()
        if len(self._lines) == _LINES and now - self._lines[0] < _LINES_WINDOW:
            return
        self._lines.append(now)
        changes, self._changes = self._changes, 0
        count = f" (after {changes - 1} changes without a line)" if changes > 1 else ""
        self._announce(self._text(stale) + count)

    def _text(self, stale: bool) -> str:
        topic = self._channel.subscribe_topic
        if not stale:
            return f"commands on {topic}: the brakes open"
        if self._age is None:
            return f"waiting for a controller on {topic}: the brakes hold the arm"
        return f"no fresh command on {topic} for {self._timeout} ticks: torque off, brakes closed"
