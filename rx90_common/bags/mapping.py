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
`file: 2` takes columns from the second. `exact: true`, as `rx90_bag export` writes it, takes numbers and times as they
stand. Position, velocity and effort may each be left out;
a topic of temperatures has `temperature: {columns: [8, 9], unit: °C}` alone. `delimiter`, `decimal` and
`header` (lines of it) are found out, and may be given.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from fractions import Fraction
from pathlib import Path
from typing import Any, Final, TypeAlias

from rx90_common.bags.topics import SERIES_FIELDS, quantities
from rx90_common.base.config import load_yaml
from rx90_common.base.entries import LEFT_OUT, Integer, ListOf, Number, Other, Switch, Text, Texts
from rx90_common.base.errors import ConfigError
from rx90_common.base.groups import Entries, Group
from rx90_common.base.section import Section

Column: TypeAlias = int | str
"""Number of a column, from 1 on, or its name."""

COUNTS: Final = "counts"
SECONDS: Final = {"s": Fraction(1), "ms": Fraction(1, 10**3), "us": Fraction(1, 10**6), "ns": Fraction(1, 10**9)}
UNITS: Final[Mapping[str, Mapping[str, float]]] = {
    "position": {"rad": 1.0, "deg": math.pi / 180.0, "turns": 2.0 * math.pi, COUNTS: 2.0 * math.pi},
    "velocity": {
        "rad/s": 1.0, "deg/s": math.pi / 180.0, "rpm": math.pi / 30.0, f"{COUNTS}/s": 2.0 * math.pi,
    },
    "effort": {"Nm": 1.0, "mNm": 1e-3, "A": 1.0, "mA": 1e-3, "rad/s^2": 1.0},
    "temperature": {"°C": 1.0},
}  # fmt: skip
"""What a unit of each field is in rad, rad/s, Nm, A and °C; of counts, a whole turn."""
DELIMITERS: Final = {",": ",", ";": ";", "|": "|", "tab": "\t", "space": None}
_MOST_FILES = 100
_MOST_COLUMNS = 100_000
_NAMES = (
    r"^/?[A-Za-z_][A-Za-z0-9_]*(/[A-Za-z_][A-Za-z0-9_]*)*\Z",
    "topics as ROS names them, of letters, digits, _ and /, no part of which begins with a digit",
)


def _is_column(value: object) -> bool:
    number = isinstance(value, int) and not isinstance(value, bool) and 1 <= value <= _MOST_COLUMNS
    return number or isinstance(value, str)


_COLUMN = Other(
    "Number of a column, from 1 on, or its name in the header.",
    accepted="the number of a column, from 1 on, or its name in the header",
    good=_is_column,
    fragment={"anyOf": [{"type": "integer", "minimum": 1, "maximum": _MOST_COLUMNS}, {"type": "string"}]},
)
_FILE = Integer("Number of the log, from 1 on, where several belong together.", low=1, high=_MOST_FILES, default=1)
_NOT_0 = Number("", nonzero=True).rules()


def _for_each(about: str) -> Other:
    return Other(
        f"{about} One number, or a list of them, one for each name.",
        accepted="a number other than 0, or a list of them, one for each name",
        good=lambda _: True,  # how many there are is known with the names
        fragment={"anyOf": [_NOT_0, {"type": "array", "minItems": 1, "items": _NOT_0}]},
        default=LEFT_OUT,
    )


_TURN = {"counts_per_turn": _for_each("Counts of a whole turn, where the unit is counts or counts/s.")}


def _of_field(name: str) -> Group:
    return Group(
        f"Where each joint's {name} comes from.",
        keys={
            "columns": ListOf(
                "A column for each name.", item=_COLUMN, least=1, accepted="a list of columns, one for each name"
            ),
            "unit": Text("Unit in the log.", choices=tuple(UNITS[name])),
            "factor": _for_each("What the log's numbers are multiplied by."),
            **(_TURN if any(unit.startswith(COUNTS) for unit in UNITS[name]) else {}),
            "file": _FILE,
        },
        default=LEFT_OUT,
    )


_TOPIC = Group(
    "What becomes the messages of the topic.",
    keys={"names": Texts("Names of the joints.", once=True), **{name: _of_field(name) for name in SERIES_FIELDS}},
    some_of=SERIES_FIELDS,
)

MAPPING = Group(
    "What the columns of a log hold, for rx90_bag import.",
    keys={
        "time": Group(
            "The column of the times.",
            keys={"column": _COLUMN, "unit": Text("Unit of the times.", choices=tuple(SECONDS)), "file": _FILE},
            default=LEFT_OUT,
        ),
        "rate": Number(
            "Rows per second, where no column holds the times.", "Hz", low=1e-3, high=1e6, default=LEFT_OUT
        ),
        "topics": Entries(
            "Topics of joint states or temperatures, by name.", of=_TOPIC, least=1, what="topic", names=_NAMES
        ),
        "delimiter": Text("Between columns; found out if left out.", choices=tuple(DELIMITERS), default=LEFT_OUT),
        "decimal": Text("Decimal sign; found out if left out.", choices=(".", ","), default=LEFT_OUT),
        "header": Integer("Lines of header; found out if left out.", low=0, high=1000, default=LEFT_OUT),
        "exact": Switch("Numbers and times are taken as they stand: NaN, any order.", default=False),
    },
    one_of=("time", "rate"),
)  # fmt: skip
"""What a mapping file holds."""


@dataclass(frozen=True)
class FieldMapping:
    """Where a field of the messages comes from.

    Attributes:
        file: number of the log, from 1 on.
        columns: of each joint.
        unit: of the log's numbers, a key of UNITS.
        factor: that turns the log's numbers of each joint into SI units.
    """

    file: int
    columns: tuple[Column, ...]
    unit: str
    factor: tuple[float, ...]


@dataclass(frozen=True)
class TopicMapping:
    """What becomes the messages of a topic.

    Attributes:
        names: of the joints.
        fields: by name, of position, velocity and effort, one at least, or temperature alone.
    """

    names: tuple[str, ...]
    fields: Mapping[str, FieldMapping]

    def effort_unit(self, topic: str) -> str:
        """Return the unit of the efforts in the bag where it is not the one that the topic's name says."""
        if "effort" not in self.fields:
            return ""
        unit = self.fields["effort"].unit.removeprefix("m")
        return "" if unit == quantities(topic)["effort"][1] else unit


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
        exact: whether every number, also NaN and an infinity, and times in any order are taken as they stand.
    """

    file: Path
    topics: Mapping[str, TopicMapping]
    time: tuple[int, Column] | None
    seconds: Fraction
    rate: float | None
    delimiter: str | None
    decimal: str | None
    header: int | None
    exact: bool = False

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
        content = MAPPING.read(root)
        time = content.get("time")
        topics = root.section("topics")
        mapping = cls(
            file=path,
            topics={name: _topic(topics.section(name), topic) for name, topic in content["topics"].items()},
            time=None if time is None else (time["file"], time["column"]),
            seconds=Fraction(1) if time is None else SECONDS[time["unit"]],
            rate=content.get("rate"),
            delimiter=content.get("delimiter"),
            decimal=content.get("decimal"),
            header=content.get("header"),
            exact=content["exact"],
        )
        if mapping.exact and (mapping.delimiter != "," or mapping.header is None or time is None or mapping.files > 1):
            raise ConfigError(
                f"{root.where('exact')} is true; accepted together with delimiter: ',', header, time, and one log"
            )
        if (mapping.delimiter, mapping.decimal) == (",", ","):
            raise ConfigError(
                f"{root.where('decimal')} is ',', and so is delimiter: a field could not be told from a decimal; "
                "accepted: two different ones"
            )
        return mapping


def _topic(section: Section, content: dict[str, Any]) -> TopicMapping:
    names = content["names"]
    if any("\0" in name for name in names):
        section.refuse("names", list(names), "texts without NUL")
    fields: dict[str, FieldMapping] = {
        name: _field(section.section(name), name, content[name], len(names))
        for name in SERIES_FIELDS
        if name in content
    }
    if "temperature" in fields and len(fields) > 1:
        section.fault("temperature", " stands beside others; accepted: temperatures in a topic of their own")
    return TopicMapping(names, fields)


def _field(section: Section, name: str, content: dict[str, Any], count: int) -> FieldMapping:
    columns, unit = content["columns"], content["unit"]
    if len(columns) != count:
        section.refuse("columns", list(columns), f"a list of {count}, one for each name")
    factor = _each(section, "factor", count) if "factor" in section else (1.0,) * count
    counted = unit.startswith(COUNTS)
    if not counted and "counts_per_turn" in section:
        section.fault("counts_per_turn", f" stands beside unit: {unit}; accepted: beside counts or counts/s")
    turn = _each(section, "counts_per_turn", count) if counted else (1.0,) * count
    scale = UNITS[name][unit]
    return FieldMapping(content["file"], columns, unit, tuple(scale * f / c for f, c in zip(factor, turn, strict=True)))


def _each(section: Section, key: str, count: int) -> tuple[float, ...]:
    """Return a number other than 0 for each joint; a single one is that of all."""
    values = (
        section.numbers(key, count) if isinstance(section.content.get(key), list) else (section.number(key),) * count
    )
    if 0.0 in values:
        section.refuse(key, 0.0, "numbers other than 0")
    return values
