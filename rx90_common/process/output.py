"""Standard output that cannot be written: a full disk is one line, a reader that has gone is a quiet end."""

from __future__ import annotations

import io
import os
import sys
from collections.abc import Callable
from typing import Any

from rx90_common.base.errors import OutputError

READER_GONE = 141  # as a shell tells the end by SIGPIPE
_STDOUT = 1


class _Output(io.FileIO):
    """Standard output; once it has failed, the rest goes nowhere, or Python would complain again at the end."""

    _failed = False

    def write(self, data: Any) -> int:
        if self._failed:
            return len(data)
        try:
            return super().write(data) or 0
        except BrokenPipeError:
            self._failed = True
            raise SystemExit(READER_GONE) from None
        except OSError as error:
            self._failed = True
            raise OutputError(f"standard output cannot be written: {error.strerror}") from error


def with_checked_output(program: str, run: Callable[[], int]) -> int:
    """Return the exit code of `run`, 1 if its output could not be written, and `READER_GONE` after a closed pipe."""
    if sys.stdout is None:
        # Closed by the parent: the next file that is opened would get its number.
        os.open(os.devnull, os.O_WRONLY)
        return run()
    before = sys.stdout
    before.flush()
    sys.stdout = io.TextIOWrapper(
        io.BufferedWriter(_Output(_STDOUT, "wb", closefd=False)),
        encoding=before.encoding,
        errors=before.errors,
        line_buffering=bool(before.line_buffering),
    )
    try:
        code = _code(run)
        sys.stdout.flush()
    except OutputError as error:
        print(f"{program}: {error}", file=sys.stderr)
        return 1
    except SystemExit as end:
        return int(end.code or 0)
    return code


def _code(run: Callable[[], int]) -> int:
    try:
        return run()
    except SystemExit as end:  # argparse: --help, wrong usage
        return end.code if isinstance(end.code, int) else 0 if end.code is None else 1
