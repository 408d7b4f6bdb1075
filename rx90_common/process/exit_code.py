"""Force an exit code: for programs that start others, and where a library keeps the process from ending in order."""

from __future__ import annotations

import atexit
import logging
import os
import sys

_codes: list[int] = []


def end_with(code: int) -> None:
    """Let this process end with `code`, whatever it returns in the end; for code -n, of signal n, with 128 + n.

    The first code that is not 0 counts: what ends later is what the launcher ends itself.
    """
    if code and not _codes:
        _codes.append(code if code > 0 else 128 - code)
        atexit.register(_leave)


def _leave() -> None:
    # At the end of the process there is no other way to another exit code; what was registered earlier is not run.
    logging.shutdown()
    sys.stdout.flush()
    sys.stderr.flush()
    os._exit(_codes[0])
