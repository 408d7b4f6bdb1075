"""The mapping file: what the columns of a log hold, in which units.

```yaml
time: {column: 1, unit: s}           # or, without a column of times, rate: 5000 (Hz)
topics:
  joint_states:
    names: [shoulder, elbow]
    position: {columns: [2, 3], unit: deg}
    velocity: {columns: [dq1, dq2], unit: rad/s}
    effort: {columns: [i1, i2], unit: A, factor: [1, -1]}
```

Columns are numbers from 1 on, or names in the log's header. Of several logs that were written together row by row,
`file: 2` takes columns from the second. Position, velocity and effort may each be left out. `delimiter`, `decimal` and
`header` (lines of it) are found out, and may be given.
"""

from __future__ import annotations

import math
import re
from collections.abc import Mapping
from dataclasses import dataclass
from fractions import Fraction
from pathlib import Path
from typing import Final, TypeAlias

from rx90_common.bags.topics import FIELDS
from rx90_common.base.config import Section, load_yaml
from rx90_common.base.errors import ConfigError
from rx90_common.base.quoting import plain

Column: TypeAlias = int | str
"""Number of a column, from 1 on, or its name."""

COUNTS: Final = "counts"
SECONDS: Final = {"s": Fraction(1), "ms": Fraction(1, 10**3), "us": Fraction(1, 10**6), "ns": Fraction(1, 10**9)}
UNITS: Final[Mapping[str, Mapping[str, float]]] = {
    "position": {"rad": 1.0, "deg": math.pi / 180.0, "turns": 2.0 * math.pi, COUNTS: 2.0 * math.pi},
    "velocity": {
        "rad/s": 1.0, "deg/s": math.pi / 180.0, "rpm": math.pi / 30.0, f"{COUNTS}/s": 2.0 * math.pi,
    },
    "effort": {"Nm": 1.0, "mNm": 1e-3, "A": 1.0, "mA": 1e-3},
}  # fmt: skip
"""What a unit of each field is in rad, rad/s, Nm and A; of counts, a whole turn."""
DELIMITERS: Final = {",": ",", ";": ";", "|": "|", "tab": "\t", "space": None}
_MOST_FILES = 100
_TOPIC = re.compile(r"/?[A-Za-z_]\w*(/[A-Za-z_]\w*)*", re.ASCII)
_MOST_COLUMNS = 100_000
_COLUMN = "the number of a column, from 1 on, or its name in the header"


@dataclass(frozen=True)
class FieldMapping:
    """Where a field of the messages comes from.

    Attributes:
        file: number of the log, from 1 on.
        columns: of each joint.
        factor: that turns the log's numbers of each joint into SI units.
    """

    file: int
    columns: tuple[Column, ...]
    factor: tuple[float, ...]


@dataclass(frozen=True)
class TopicMapping:
    """What becomes the messages of a topic.

    Attributes:
        names: of the joints.
        fields: by name, of position, velocity and effort; one at least.
    """

    names: tuple[str, ...]
    fields: Mapping[str, FieldMapping]


@dataclass(frozen=True)
class LogMapping:
    """What the columns of a log hold.

    Attributes:
        file: of the mapping.
        topics: by name.
        time: file and column of the times; None with a rate.
        seconds: what a unit of time is, s.
        rate: rows per second where no column holds the times, Hz.
        delimiter: between columns, as in DELIMITERS; None to find it out.
        decimal: "." or ","; None to find it out.
        header: how many lines of header there are; None to find it out.
    """

    file: Path
    topics: Mapping[str, TopicMapping]
    time: tuple[int, Column] | None
    seconds: Fraction
    rate: float | None
    delimiter: str | None
    decimal: str | None
    header: int | None

    @property
    def files(self) -> int:
        """Return how many logs it takes columns from."""
        used = {field.file for topic in self.topics.values() for field in topic.fields.values()}
        return max(used | ({self.time[0]} if self.time is not None else set()))

    @classmethod
    def load(cls, path: Path) -> LogMapping:
        """Read a mapping file.

        Raises:
            ConfigError: for a key or value that is not acceptable.
        """
        root = load_yaml(path)
        if ("time" in root) == ("rate" in root):
            both = "both are there" if "time" in root else "neither is there"
            raise ConfigError(f"{root.where('time')} and rate: {both}; accepted: one of them")
        time, seconds, rate = None, Fraction(1), None
        if "time" in root:
            section = root.section("time")
            time = _file(section), _columns([section.value("column", _COLUMN)], section, "column")[0]
            seconds = SECONDS[section.text("unit", tuple(SECONDS))]
            section.finish()
        else:
            rate = root.number("rate", 1e-3, 1e6)
        mapping = cls(
            file=path,
            topics=_topics(root.section("topics")),
            time=time,
            seconds=seconds,
            rate=rate,
            delimiter=root.text("delimiter", tuple(DELIMITERS)) if "delimiter" in root else None,
            decimal=root.text("decimal", (".", ",")) if "decimal" in root else None,
            header=root.integer("header", 0, 1000) if "header" in root else None,
        )
        root.finish()
        if (mapping.delimiter, mapping.decimal) == (",", ","):
            raise ConfigError(
                f"{root.where('decimal')} is ',', and so is delimiter: a field could not be told from a decimal; "
                "accepted: two different ones"
            )
        return mapping


def _topics(section: Section) -> dict[str, TopicMapping]:
    topics = {name: _topic(section.section(name)) for name in section}
    if not topics:
        raise ConfigError(f"{section.where('joint_states')} is missing; accepted: one topic or more")
    for name in topics:
        if not _TOPIC.fullmatch(name):
            raise ConfigError(
                f"{plain(section.where(name))}: accepted: topics as ROS names them, of letters, digits, _ and /, "
                "no part of which begins with a digit"
            )
    return topics


def _topic(section: Section) -> TopicMapping:
    names = section.texts("names")
    if not names or len(set(names)) < len(names):
        section.refuse("names", list(names), "one name or more, each once")
    fields = {name: _field(section.section(name), name, len(names)) for name in FIELDS if name in section}
    if not fields:
        raise ConfigError(f"{section.where('position')} is missing; accepted: one or more of {', '.join(FIELDS)}")
    section.finish()
    return TopicMapping(names, fields)


def _field(section: Section, name: str, count: int) -> FieldMapping:
    accepted = f"a list of {count}, one for each name"
    columns = section.value("columns", accepted)
    if not isinstance(columns, list) or len(columns) != count:
        section.refuse("columns", columns, accepted)
    chosen = _columns(columns, section, "columns")
    unit = section.text("unit", tuple(UNITS[name]))
    factor = _each(section, "factor", count) if "factor" in section else (1.0,) * count
    turn = (1.0,) * count
    if unit.startswith(COUNTS):
        turn = _each(section, "counts_per_turn", count)
    found = FieldMapping(
        _file(section), chosen, tuple(UNITS[name][unit] * f / c for f, c in zip(factor, turn, strict=True))
    )
    section.finish()
    return found


def _file(section: Section) -> int:
    return section.integer("file", 1, _MOST_FILES) if "file" in section else 1


def _columns(given: list[object], section: Section, key: str) -> tuple[Column, ...]:
    chosen: list[Column] = []
    for one in given:
        if isinstance(one, str) or (isinstance(one, int) and not isinstance(one, bool) and 1 <= one <= _MOST_COLUMNS):
            chosen.append(one)
        else:
            section.refuse(key, one, _COLUMN)
    return tuple(chosen)


def _each(section: Section, key: str, count: int) -> tuple[float, ...]:
    """Return a number other than 0 for each joint; a single one is that of all."""
    values = (
        section.numbers(key, count) if isinstance(section.content.get(key), list) else (section.number(key),) * count
    )
    if 0.0 in values:
        section.refuse(key, 0.0, "numbers other than 0")
    return values
