"""A log as rows of texts: encoding, header, delimiter and decimal sign are found out where they are not given."""

from __future__ import annotations

import csv
import math
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from rx90_common.bags.importing.mapping import DELIMITERS, Column, LogMapping
from rx90_common.base.errors import BagError
from rx90_common.base.quoting import listed, plain, quoted

_COMMENTS = ("#", "%", "//")
_LOOKED_AT = 200  # lines, by which delimiter and decimal sign are found out
_CANDIDATES = ((",", "."), (";", "."), ("tab", "."), ("|", "."), ("space", "."), (";", ","), ("tab", ","), ("|", ","),
               ("space", ","))  # fmt: skip
_UTF16 = (b"\xff\xfe", b"\xfe\xff")


@dataclass(frozen=True, eq=False)
class LogTable:
    """The rows of a log.

    Attributes:
        path: of the log.
        delimiter: between columns, as in DELIMITERS.
        decimal: "." or ",".
        header: names of the columns; empty without a header.
        width: columns of a whole row.
        rows: fields of each row.
        lines: number of each row's line in the file, from 1 on.
    """

    path: Path
    delimiter: str
    decimal: str
    header: tuple[str, ...]
    width: int
    rows: Sequence[Sequence[str]]
    lines: Sequence[int]

    @classmethod
    def read(cls, path: Path, mapping: LogMapping) -> LogTable:
        """Read a log.

        Raises:
            BagError: if it cannot be read or holds no row.
        """
        numbered = [(k + 1, line) for k, line in enumerate(_text(path).splitlines()) if line.strip()]
        comments = [line.strip() for _, line in numbered if line.strip().startswith(_COMMENTS)]
        numbered = [(k, line) for k, line in numbered if not line.strip().startswith(_COMMENTS)]
        delimiter, decimal = _dialect([line for _, line in numbered[:_LOOKED_AT]], mapping)
        split = [fields_of(line, delimiter) for _, line in numbered]
        head = _header_lines(split, decimal) if mapping.header is None else mapping.header
        rows = split[head:]
        if not rows:
            raise BagError(f"{plain(path)}: holds no row of numbers; accepted: one or more behind the header")
        width = Counter(map(len, rows)).most_common(1)[0][0]
        names = [names for names in split[:head] if len(names) == width]
        if not names:  # as NumPy and Matlab write it
            said = [fields_of(line.lstrip("#%/ "), delimiter) for line in comments]
            names = [names for names in said if len(names) == width]
        header = tuple(name.strip() for name in names[0]) if names else ()
        return cls(path, delimiter, decimal, header, width, rows, [k for k, _ in numbered[head:]])

    @property
    def told(self) -> str:
        """Return how it was read, for the user."""
        named = f"header {listed(self.header)}" if self.header else "no header"
        return f"{self.width} columns, delimiter {self.delimiter!r}, decimal {self.decimal!r}, {named}"

    def at(self, row: int) -> str:
        """Return file and line of a row."""
        return f"{plain(self.path)}:{self.lines[row]}"

    def place(self, column: Column) -> int:
        """Return the index of a column.

        Raises:
            BagError: if it is not there.
        """
        if isinstance(column, str):
            if self.header.count(column) == 1:
                return self.header.index(column)
            found = "more than one column" if column in self.header else "no column"
            raise BagError(
                f"{plain(self.path)}: {found} {quoted(column)}; there are {listed(self.header) or 'no names'}"
            )
        if column > self.width:
            raise BagError(f"{plain(self.path)}: no column {column}; accepted: 1 to {self.width}")
        return column - 1


def number(text: str, decimal: str) -> float:
    """Return the number that a field holds; NaN if it holds none."""
    text = text.strip()
    if decimal == ",":
        if "." in text:
            return math.nan
        text = text.replace(",", ".")
    try:
        return math.nan if "_" in text else float(text)
    except ValueError:
        return math.nan


def fields_of(line: str, delimiter: str) -> list[str]:
    """Return the fields of a line; behind a delimiter at its end there is none."""
    sign = DELIMITERS[delimiter]
    if sign is None:
        return line.replace('"', " ").split()
    line = line.strip(" \r\n")
    try:
        fields = next(csv.reader([line], delimiter=sign)) if '"' in line else line.split(sign)
    except csv.Error:  # a quotation mark that damage or a slip has put there
        return [line]
    return fields[:-1] if len(fields) > 1 and not fields[-1].strip() else fields


def _text(path: Path) -> str:
    try:
        content = path.read_bytes()
    except OSError as error:
        raise BagError(f"{plain(path)}: cannot be read ({error.strerror})") from error
    # What is no text in a damaged file makes a corrupt row, not an unreadable file.
    return content.decode("utf-16" if content[:2] in _UTF16 else "utf-8-sig", "replace")


def _dialect(lines: Sequence[str], mapping: LogMapping) -> tuple[str, str]:
    """Return delimiter and decimal sign by which most fields are numbers and fewest others are not."""
    choice = [
        pair for pair in _CANDIDATES if mapping.delimiter in (None, pair[0]) and mapping.decimal in (None, pair[1])
    ] or [(mapping.delimiter or ",", mapping.decimal or ".")]

    def score(pair: tuple[str, str]) -> int:
        texts = [text for line in lines for text in fields_of(line, pair[0])]
        good = sum(not math.isnan(number(text, pair[1])) for text in texts)
        return 2 * good - len(texts)

    return max(choice, key=score)


def _header_lines(rows: Sequence[Sequence[str]], decimal: str) -> int:
    """Return how many lines there are before the first one that holds a number."""
    for k, fields in enumerate(rows):
        if any(not math.isnan(number(text, decimal)) for text in fields):
            return k
    return len(rows)
