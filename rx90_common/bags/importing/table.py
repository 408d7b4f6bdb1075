"""A log as rows of texts: encoding, header, delimiter and decimal sign are found out where they are not given."""

from __future__ import annotations

import csv
import math
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from itertools import chain, islice
from pathlib import Path
from typing import NamedTuple

from rx90_common.bags.importing.lines import Line, lines_of
from rx90_common.bags.importing.mapping import DELIMITERS, Column, LogMapping
from rx90_common.bags.importing.spool import BLOCK
from rx90_common.base.errors import BagError
from rx90_common.base.quoting import listed, plain, quoted

_COMMENTS = ("#", "%", "//")
_LOOKED_AT = 200  # lines, by which delimiter and decimal sign are found out
_CANDIDATES = ((",", "."), (";", "."), ("tab", "."), ("|", "."), ("space", "."), (";", ","), ("tab", ","), ("|", ","),
               ("space", ","))  # fmt: skip


class RowBlock(NamedTuple):
    """Some rows of a log, with the number of each one's line in the file."""

    rows: Sequence[Sequence[str]]
    lines: Sequence[int]


@dataclass(frozen=True, eq=False)
class LogTable:
    """The rows of a log, block by block.

    Attributes:
        path: of the log.
        delimiter: between columns, as in DELIMITERS.
        decimal: "." or ",".
        header: names of the columns; empty without a header.
        head: lines before the first row, blank ones and comments aside.
        width: columns of a whole row.
        blocks: the rows, once; each block but the last has BLOCK of them. Raises BagError where the log cannot be read.
    """

    path: Path
    delimiter: str
    decimal: str
    header: tuple[str, ...]
    head: int
    width: int
    blocks: Iterator[RowBlock]

    @classmethod
    def read(cls, path: Path, mapping: LogMapping, told: Callable[[int], None] = lambda _: None) -> LogTable:
        """Read the beginning of a log, by which it is found out how the rest is to be read.

        Args:
            path: of the log.
            mapping: what its columns hold.
            told: called now and then with how many bytes were read since the call before.

        Raises:
            BagError: if it cannot be read or holds no row.
        """
        comments: list[str] = []
        numbered = _rows_among(lines_of(path, told), comments)
        first = list(islice(numbered, BLOCK))
        delimiter, decimal = _dialect([line for _, line in first[:_LOOKED_AT]], mapping)
        split = [fields_of(line, delimiter) for _, line in first]
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
        blocks = _blocks(chain(first[head:], numbered), delimiter)
        return cls(path, delimiter, decimal, header, head, width, blocks)

    @property
    def told(self) -> str:
        """Return how it was read, for the user."""
        named = f"header {listed(self.header)}" if self.header else "no header"
        named += f" in {self.head} lines before the first row" if self.head > 1 else ""
        return f"{self.width} columns, delimiter {self.delimiter!r}, decimal {self.decimal!r}, {named}"

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


def _rows_among(lines: Iterable[Line], comments: list[str]) -> Iterator[Line]:
    """Yield the lines that are neither blank nor comments; the first comments are added to a list."""
    for line in lines:
        text = line.text.strip()
        if text.startswith(_COMMENTS):
            comments += [text] * (len(comments) < _LOOKED_AT)
        elif text:
            yield Line(line.number, line.text.rstrip("\r\n"))


def _blocks(lines: Iterator[Line], delimiter: str) -> Iterator[RowBlock]:
    while some := list(islice(lines, BLOCK)):
        yield RowBlock([fields_of(line.text, delimiter) for line in some], [line.number for line in some])


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
