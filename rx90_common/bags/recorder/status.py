"""The line on a terminal that tells how a recording goes."""

from __future__ import annotations

import sys
import time
from types import TracebackType
from typing import TYPE_CHECKING

from tqdm import tqdm

from rx90_common.base.rates import NANOSECONDS

if TYPE_CHECKING:
    from rx90_common.bags.recorder.recording import Progress

_PERIOD_S = 0.5


class StatusLine:
    """Shows count, rate and simulated time on a terminal and nothing elsewhere; lines said stand above it."""

    def __init__(self) -> None:
        self._bar = tqdm(unit=" msgs", unit_scale=True, disable=None, mininterval=0.0, miniters=0)
        self._next = 0.0

    def __enter__(self) -> StatusLine:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._bar.close()

    def say(self, line: str) -> None:
        """Print a line."""
        self._bar.write(line, file=sys.stdout)
        sys.stdout.flush()

    def show(self, progress: Progress) -> None:
        """Show where the recording stands, at most twice a second."""
        now = time.monotonic()
        if self._bar.disable or now < self._next:
            return
        self._next = now + _PERIOD_S
        if progress.newest_ns is not None:
            self._bar.set_postfix_str(f"t = {progress.newest_ns / NANOSECONDS:.3f} s", refresh=False)
        self._bar.update(progress.received - self._bar.n)
