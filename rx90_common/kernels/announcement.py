"""Who says that kernels are compiled; kept apart from the compiler, which takes most of a second to import."""

from __future__ import annotations

import sys

_COMPILING = "compiling the numerical kernels, once on this machine, about 20 s ..."
_programs: list[str] = []


def announce_compilation(program: str) -> None:
    """From now on say on stderr, once, that kernels are compiled, if any has to be: none may be on disk, or others."""
    _programs[:] = [program]


def compilation_begins() -> None:
    """Say it, if it has been asked for and not been said."""
    if _programs:
        print(f"{_programs.pop()}: {_COMPILING}", file=sys.stderr, flush=True)
