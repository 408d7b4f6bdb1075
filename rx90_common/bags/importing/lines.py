"""The lines of a log, one by one, whatever its encoding."""

from __future__ import annotations

import io
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import NamedTuple

from rx90_common.base.errors import BagError
from rx90_common.base.quoting import plain

_UTF16 = (b"\xff\xfe", b"\xfe\xff")
_LONGEST = 1 << 20  # characters of a line; a file that is no text may have no end of line at all


class Line(NamedTuple):
    """A line of a log: its number, from 1 on, and its text."""

    number: int
    text: str


def lines_of(path: Path, told: Callable[[int], None] = lambda _: None) -> Iterator[Line]:
    """Yield the lines of a log; what is no text in a damaged one makes a corrupt row, not an unreadable file.

    Args:
        path: of the log, which may be a pipe.
        told: called now and then with how many bytes were read since the call before.

    Raises:
        BagError: if it cannot be read.
    """
    try:
        with path.open("rb") as raw:
            encoding = "utf-16" if raw.peek(2)[:2] in _UTF16 else "utf-8-sig"
            counted = 0
            with io.TextIOWrapper(raw, encoding=encoding, errors="replace") as file:
                number = 0
                while text := file.readline(_LONGEST):
                    number += 1
                    if len(text) == _LONGEST and not text.endswith("\n"):
                        raise BagError(
                            f"{plain(path)}:{number}: more than {_LONGEST} characters in a line; accepted: text in "
                            "lines"
                        )
                    if not number % 4096 and raw.seekable():
                        counted, before = raw.tell(), counted
                        told(counted - before)
                    yield Line(number, text)
                if raw.seekable():
                    told(raw.tell() - counted)
    except OSError as error:
        raise BagError(f"{plain(path)}: cannot be read ({error.strerror})") from error
    except UnicodeError as error:  # a mark of UTF-16 with nothing behind it
        raise BagError(f"{plain(path)}: cannot be read ({error})") from error
