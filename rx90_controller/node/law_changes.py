"""Other constants for the control law while its loops run."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np

_Record = np.ndarray[Any, Any]


class LawChanges:
    """Hands constants of the law from the executor's thread to the one that ticks.

    They count from a tick of the position loop on: before it the velocity loop would have gains that do not belong to
    the torque of the position loop. Integrators, which hold torques, go on as they are.

    Args:
        law: that is changed, shape (1,), CONTROLLER_DTYPE.
        post: has something called later, on the executor's thread.
    """

    def __init__(self, law: _Record, post: Callable[[Callable[[], None]], None]) -> None:
        self._law, self._post = law, post
        self.waiting: deque[tuple[_Record, Callable[[int], None]]] = deque()

    def add(self, law: _Record, effective: Callable[[int], None]) -> None:
        """Let these constants count soon; `effective` is then called with the time of the first tick, ns."""
        self.waiting.append((law, effective))

    def apply(self, stamp_ns: int) -> None:
        """Let those that wait count from this tick of the position loop on."""
        while self.waiting:
            self._law[:], effective = self.waiting.popleft()
            self._post(partial(effective, stamp_ns))
