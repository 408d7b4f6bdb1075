"""The progress bar of an identification."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from typing import Any

from tqdm import tqdm

_BAR = "{desc:<40.40}{bar}| {n_fmt}/{total_fmt} [{elapsed}<{remaining}]"


@contextmanager
def steps(total: int) -> Iterator[Callable[[str], None]]:
    """Show a progress bar of `total` steps; call what is yielded with the name of each step before it."""
    with ExitStack() as shown:
        bars: list[tqdm[Any]] = []

        def step(text: str) -> None:
            if not bars:  # only now: what is refused before the first step needs no bar
                bars.append(shown.enter_context(tqdm(total=total, bar_format=_BAR, disable=None, file=sys.stderr)))
            bars[0].set_description_str(text)
            bars[0].update()

        yield step
