"""The progress bar of commands that go through a file."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from typing import Any

_BAR = "{desc}: {percentage:3.0f} % |{bar}| [{elapsed}<{remaining}]"


@contextmanager
def progress_bar(what: str) -> Iterator[Callable[[int, int], None]]:
    """Yield a function that is called with how much is done and how much there is; after a second it shows a bar."""
    from tqdm import tqdm

    with ExitStack() as shown:
        bars: list[tqdm[Any]] = []

        def tell(done: int, total: int) -> None:
            if not bars:
                bars.append(
                    shown.enter_context(
                        tqdm(total=total, desc=what, bar_format=_BAR, delay=1.0, disable=None, file=sys.stderr)
                    )
                )
            bars[0].update(done - bars[0].n)

        yield tell
