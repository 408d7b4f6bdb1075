"""Standard output that cannot be written: a full disk is one line, a reader that has gone is a quiet end."""

from __future__ import annotations

import io
import os
import sys
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


def check_output() -> None:
    """From now on raise OutputError where standard output cannot be written, and SystemExit after a closed pipe."""
    if sys.stdout is None:
        # Closed by the parent: the next file that is opened would get its number.
        os.open(os.devnull, os.O_WRONLY)
        return
    before = sys.stdout
    before.flush()
    sys.stdout = io.TextIOWrapper(
        io.BufferedWriter(_Output(_STDOUT, "wb", closefd=False)),
        encoding=before.encoding,
        errors=before.errors,
        line_buffering=bool(before.line_buffering or getattr(before, "write_through", False)),  # python -u
    )
