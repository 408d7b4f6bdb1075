"""Lines of a text file, as many as a table that a user gives may have."""

from __future__ import annotations

from io import BytesIO, TextIOWrapper
from itertools import islice
from pathlib import Path

from rx90_common.base.errors import ConfigError
from rx90_common.base.quoting import plain

MAX_BYTES = 16 << 20
_MAX_LINES = 500_000
_MAX_CHARACTERS = 1 << 16  # in a line


def read_bytes(file: Path) -> bytes:
    """Return the content of a file of up to MAX_BYTES.

    Raises:
        ConfigError: if it is larger, or cannot be read.
    """
    try:
        with file.open("rb") as stream:
            content = stream.read(MAX_BYTES + 1)
    except OSError as error:
        raise ConfigError(f"{plain(file)}: cannot be read ({error}); accepted: a file") from error
    if len(content) > MAX_BYTES:
        raise ConfigError(f"{plain(file)}: holds more than {MAX_BYTES:,} bytes; accepted: up to that")
    return content


def read_lines(file: Path) -> list[str]:
    """Return the lines of a text file, with or without the byte order mark of a spreadsheet.

    Raises:
        ConfigError: if it cannot be read, or is larger than memory should be spent on.
    """
    text = TextIOWrapper(BytesIO(read_bytes(file)), encoding="utf-8-sig")
    try:
        lines = list(islice(text, _MAX_LINES + 1))
    except UnicodeDecodeError as error:
        raise ConfigError(f"{plain(file)}: cannot be read ({error}); accepted: a text file") from error
    if len(lines) > _MAX_LINES or max(map(len, lines), default=0) > _MAX_CHARACTERS:
        raise ConfigError(
            f"{plain(file)}: holds more than {_MAX_LINES:,} lines, or {_MAX_CHARACTERS:,} characters in a line; "
            "accepted: up to that"
        )
    return lines
