"""Work beside the page's thread: the newest wins, and what it overtakes is dropped."""

from __future__ import annotations

import threading
from collections.abc import Callable
from typing import Generic, TypeVar

_PATIENCE = 1.0  # s
_Item = TypeVar("_Item")


class NewestOnly(Generic[_Item]):
    """Hands the newest of what it is given to a function, on a thread of its own.

    Args:
        work: what is done with an item; may take its time, the next one waits for it.
        interval: the shortest time from one call to the next, s.
    """

    def __init__(self, work: Callable[[_Item], None], interval: float) -> None:
        self._work, self._interval = work, interval
        self._changed = threading.Condition()
        self._waiting: list[_Item] = []
        self._closed = False
        self._thread = threading.Thread(target=self._run, name="newest", daemon=True)
        self._thread.start()

    def give(self, item: _Item) -> None:
        """Have `item` worked on, in place of one that still waits; returns at once."""
        with self._changed:
            self._waiting[:] = [item]
            self._changed.notify()

    def close(self) -> None:
        """Drop what waits, and end the thread after what it works on, which may last longer than this waits."""
        with self._changed:
            self._closed = True
            self._changed.notify()
        self._thread.join(_PATIENCE)

    def _run(self) -> None:
        while (item := self._next()) is not None:
            self._work(item[0])
            with self._changed:
                self._changed.wait_for(lambda: self._closed, self._interval)

    def _next(self) -> list[_Item] | None:
        with self._changed:
            self._changed.wait_for(lambda: self._closed or bool(self._waiting))
            item, self._waiting = self._waiting, []
            return None if self._closed else item
