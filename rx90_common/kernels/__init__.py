"""Compiled code: kernels and their cache, lanes, elementary functions that give the same bits everywhere.

The message that kernels are being compiled is here, because importing the compiler takes most of a second.
"""

from __future__ import annotations

import sys

_COMPILING = "compiling the numerical kernels, once on this machine, about 20 s ..."
_programs: list[str] = []


def announce_compilation(program: str) -> None:
    """Let the first compilation from now on be announced on stderr, once; kernels in the cache are not announced."""
    _programs[:] = [program]


def compilation_begins() -> None:
    """Print the announcement, if it was requested and has not been printed."""
    if _programs:
        print(f"{_programs.pop()}: {_COMPILING}", file=sys.stderr, flush=True)
