"""Files that a user gives, of bounded size: bytes, text, or the lines of a table."""

from __future__ import annotations

from io import StringIO
from pathlib import Path

from rx90_common.base.errors import ConfigError
from rx90_common.base.quoting import plain

MAX_BYTES = 16 << 20
_MAX_LINES = 500_000
_MAX_CHARACTERS = 65_536  # in a line


def read_bytes(file: Path, most: int = MAX_BYTES) -> bytes:
    """Return the content of a file of up to so many bytes.

    Raises:
        ConfigError: if it is larger, or cannot be read.
    """
    try:
        with file.open("rb") as stream:
            content = stream.read(most + 1)
    except OSError as error:
        raise ConfigError(
            f"{plain(file)}: cannot be read ({error.strerror}); accepted: a file"
        ) from error
    if len(content) > most:
        raise ConfigError(f"{plain(file)}: larger than {most:,} bytes; accepted: up to that")
    return content


def read_text(file: Path, most: int = MAX_BYTES) -> str:
    """Return the text of such a file, with or without the byte order mark of a spreadsheet."""
    try:
        return read_bytes(file, most).decode("utf-8-sig")
    except UnicodeDecodeError as error:
        raise ConfigError(
            f"{plain(file)}: cannot be read ({error}); accepted: a text file"
        ) from error


def read_lines(file: Path) -> list[str]:
    """Return the lines of a text file.

    Raises:
        ConfigError: if it cannot be read, or is larger than memory should be spent on.
    """
    lines = StringIO(read_text(file), newline=None).readlines()
    if len(lines) > _MAX_LINES or max(map(len, lines), default=0) > _MAX_CHARACTERS:
        raise ConfigError(
            f"{plain(file)}: holds more than {_MAX_LINES:,} lines, or {_MAX_CHARACTERS:,} characters in a line; "
            "accepted: up to that"
        )
    return lines
