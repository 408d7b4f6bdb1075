"""The signal map: quantities, joints or motors, and units of a log's columns; for tables and bags alike.

```yaml
time: {column: 1, unit: s}           # or, without a column of times, rate: 5000 (Hz)
names: [shoulder, elbow]
position: {columns: [2, 3], unit: deg}
velocity: {columns: [dq1, dq2], unit: rad/s}
effort: {columns: [i1, i2], unit: A, factor: [1, -1]}
gear: [100, 80]                      # of motors; coupling, torque_constant, zero, spring likewise
torque_constant: [0.1, 0.08]
```

A bag needs no columns: `topic`, `names` and the keys of motors and joints. A table may contain several topics,
as `topics: {NAME: {names: ..., position: ...}}`; without a name it is `joint_states`.

Columns are numbers from 1 on, or names in the log's header. If several logs were written together row by row,
`file: 2` selects columns of the second. `exact: true`, as `rx90_bag export` writes it, keeps numbers and times
unchanged. Position, velocity and effort may each be left out. `delimiter`, `decimal` and `header` (its number
of lines) are detected, and may be given.
"""

from __future__ import annotations

import math
import re
from collections.abc import Mapping
from fractions import Fraction
from pathlib import Path
from typing import Annotated, Any, Final, Literal, TypeAlias

import numpy as np
from pydantic import AfterValidator, Field, model_validator

from rx90_common.bags.joint_series import JointSeries
from rx90_common.bags.topics import FIELDS, quantities
from rx90_common.base.config import yaml_text
from rx90_common.base.errors import BagError
from rx90_common.base.models import FileModel, NotZero, Some, not_accepted, quantity, read_model, refusal
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
    "effort": {"Nm": 1.0, "mNm": 1e-3, "A": 1.0, "mA": 1e-3, "rad/s^2": 1.0},
}  # fmt: skip
"""What a unit of each field is in rad, rad/s, Nm and A; of counts, a whole turn."""
_SCALES: Final = {unit: scale for units in UNITS.values() for unit, scale in units.items()}
DELIMITERS: Final = {",": ",", ";": ";", "|": "|", "tab": "\t", "space": None}
ARRAYS: Final = (".parquet", ".npz")
"""Suffixes of logs of arrays."""
TABLES: Final = (".csv", ".tsv", ".txt", ".dat", *ARRAYS)
"""Suffixes of logs in columns."""
UNNAMED: Final = "joint_states"
"""Topic of a table whose map names none."""
_MAX_FILES = 100
_MAX_COLUMNS = 100_000
_TOPIC = r"^/?[A-Za-z_][A-Za-z0-9_]*(/[A-Za-z_][A-Za-z0-9_]*)*\Z"
_TOPICS = "topics as ROS names them, of letters, digits, _ and /, no part of which begins with a digit"


_Column: TypeAlias = Annotated[
    Annotated[int, Field(ge=1, le=_MAX_COLUMNS)] | str,
    Field(
        description="Number of a column, from 1 on, or its name in the header.",
        json_schema_extra={"accepted": "the number of a column, from 1 on, or its name in the header"},
    ),
]
_Log: TypeAlias = Annotated[
    int,
    Field(ge=1, le=_MAX_FILES, description="Number of the log, from 1 on, where several belong together."),
]
_Numbers: TypeAlias = Annotated[tuple[float, ...], Field(strict=False, min_length=1)]
_NotZeros: TypeAlias = Annotated[tuple[NotZero, ...], Field(strict=False, min_length=1)]
_ForEach: TypeAlias = Annotated[
    NotZero | _NotZeros,
    Field(json_schema_extra={"accepted": "a number other than 0, or a list of them, one for each name"}),
]
_TURN = "Counts of a whole turn, where the unit is counts or counts/s: one number, or one for each name."


class FieldColumns(FileModel):
    """Where an array comes from."""

    columns: Annotated[
        tuple[_Column, ...],
        Field(
            strict=False,
            min_length=1,
            description="A column for each name.",
            json_schema_extra={"accepted": "a list of columns, one for each name"},
        ),
    ]
    unit: Annotated[str, Field(description="Unit in the log.")]
    factor: Annotated[
        _ForEach, Field(description="What the log's numbers are multiplied by: one number, or one for each name.")
    ] = 1.0
    file: _Log = 1

    @property
    def turn(self) -> float | tuple[float, ...]:
        """Return the log's numbers in a whole turn, where they are counts."""
        return 1.0

    @property
    def factors(self) -> tuple[float, ...]:
        """Return what turns the numbers of each column into SI units."""
        return tuple((np.broadcast_to(self.factor, len(self.columns)) * _SCALES[self.unit] / self.turn).tolist())


class EffortColumns(FieldColumns):
    """Where each joint's effort comes from."""

    unit: Annotated[Literal["Nm", "mNm", "A", "mA", "rad/s^2"], Field(description="Unit in the log.")]


class _CountedColumns(FieldColumns):
    counts_per_turn: Annotated[
        _ForEach | None,
        Field(
            description="Counts of a whole turn, where the unit is counts or counts/s: one number, or one for each "
            "name."
        ),
    ] = None

    @model_validator(mode="after")
    def _check_counts(self) -> _CountedColumns:
        if not self.unit.startswith(COUNTS) and self.counts_per_turn is not None:
            raise refusal("counts_per_turn", self.counts_per_turn, f"none beside unit {self.unit}")
        if self.unit.startswith(COUNTS) and self.counts_per_turn is None:
            raise ValueError(f"counts_per_turn is missing; accepted beside {self.unit}: a number, or one for each name")
        return self

    @property
    def turn(self) -> float | tuple[float, ...]:
        """Return the log's numbers in a whole turn, where they are counts."""
        return 1.0 if self.counts_per_turn is None else self.counts_per_turn


class PositionColumns(_CountedColumns):
    """Where each joint's position comes from."""

    unit: Annotated[Literal["rad", "deg", "turns", "counts"], Field(description="Unit in the log.")]


class VelocityColumns(_CountedColumns):
    """Where each joint's velocity comes from."""

    unit: Annotated[Literal["rad/s", "deg/s", "rpm", "counts/s"], Field(description="Unit in the log.")]


def _check_names(names: tuple[str, ...]) -> tuple[str, ...]:
    if len(set(names)) < len(names) or any("\0" in name for name in names):
        raise not_accepted()
    return names


_JointNames: TypeAlias = Annotated[
    tuple[str, ...],
    Field(
        strict=False,
        min_length=1,
        description="What the log calls the joints, or their motors.",
        json_schema_extra={"accepted": "a list of texts, one or more, each once, without NUL", "uniqueItems": True},
    ),
    AfterValidator(_check_names),
]


class MessageColumns(FileModel):
    """What becomes messages of joint states."""

    names: _JointNames | None = None
    position: PositionColumns | None = None
    velocity: VelocityColumns | None = None
    effort: EffortColumns | None = None

    @model_validator(mode="after")
    def _check_columns(self) -> MessageColumns:
        for name, array in self.fields.items():
            if self.names is None:
                raise ValueError(f"has {name} and no names; accepted: names, a list of texts")
            for key, values in (("columns", array.columns), ("factor", array.factor), ("counts_per_turn", array.turn)):
                if isinstance(values, tuple) and len(values) != len(self.names):
                    raise refusal(f"{name}.{key}", values, f"a list of {len(self.names)}, one for each name")
        return self

    @property
    def fields(self) -> dict[str, FieldColumns]:
        """Return the columns by what they hold."""
        columns = {"position": self.position, "velocity": self.velocity, "effort": self.effort}
        return {name: given for name, given in columns.items() if given is not None}

    def effort_unit(self, topic: str) -> str:
        """Return the unit of the efforts in the bag if it is not the usual one of the topic's name."""
        unit = "" if self.effort is None else self.effort.unit.removeprefix("m")
        return "" if unit == quantities(topic)["effort"][1] else unit


class TopicColumns(MessageColumns):
    """What becomes the messages of a topic."""

    names: _JointNames

    @model_validator(mode="after")
    def _check_fields(self) -> TopicColumns:
        if not self.fields:
            raise ValueError(f"has no columns; accepted: one or more of {', '.join(FIELDS)}")
        return self


class TimeColumn(FileModel):
    """The column of the times."""

    column: _Column
    unit: Annotated[Literal["s", "ms", "us", "ns"], Field(description="Unit of the times.")]
    file: _Log = 1


class SignalMapFile(MessageColumns):
    """What a log holds: columns of a table, or messages of a bag."""

    topic: Annotated[str | None, Field(description="JointState topic of a bag, or of a table with several.")] = None
    gear: Annotated[
        _NotZeros | None,
        Field(description="Motor turns per joint turn: says that the log holds the motors' states."),
    ] = None
    coupling: Annotated[
        _Numbers | None,
        Field(description="Turns of each motor per joint turn without the gears, row by row, n x n."),
    ] = None
    torque_constant: Annotated[
        _NotZeros | None, Field(description="Torque per unit of effort, where effort is a current, Nm/A.")
    ] = None
    zero: Annotated[
        _Numbers | None, Field(description="Recorded angle of each joint where its angle in the URDF is 0, rad.")
    ] = None
    spring: Annotated[
        _Numbers | None,
        Field(description="Amplitude k of a gravity-compensation spring on each joint, torque -k sin(q), Nm."),
    ] = None
    torque_delay: Annotated[
        float | None,
        quantity(
            "s", "How much later a torque acted than in the sample period that ends at its stamp.", ge=-0.05, le=0.05
        ),
    ] = None
    record_time: Annotated[bool, Field(description="Whether a bag's times of recording replace the stamps.")] = False
    time: TimeColumn | None = None
    rate: Annotated[
        float | None, quantity("Hz", "Rows per second, where no column holds the times.", ge=1e-3, le=1e6)
    ] = None
    topics: Annotated[
        Some[TopicColumns] | None, Field(description="Topics of joint states, by name, of a table that holds several.")
    ] = None
    delimiter: Annotated[
        Literal[",", ";", "|", "tab", "space"] | None, Field(description="Between columns; found out if left out.")
    ] = None
    decimal: Annotated[Literal[".", ","] | None, Field(description="Decimal sign; found out if left out.")] = None
    header: Annotated[int | None, Field(ge=0, le=1000, description="Lines of header; found out if left out.")] = None
    exact: Annotated[bool, Field(description="Numbers and times are taken as they stand: NaN, any order.")] = False

    @model_validator(mode="after")
    def _check_keys(self) -> SignalMapFile:
        given = [key for key, value in (("time", self.time), ("rate", self.rate)) if value is not None]
        if self.topics is None and not self.fields:
            if given:
                raise ValueError(f"has {given[0]} alone; accepted: with topics, {', '.join(FIELDS)}")
        elif len(given) != 1:
            raise ValueError(f"has {' and '.join(given) or 'none'} of time, rate; accepted: one of them")
        names = {} if self.topics is None else self.topics.entries
        for name in names:
            if not re.search(_TOPIC, name):
                raise ValueError(f"topics.{plain(name)} is no name of a topic; accepted: {_TOPICS}")
        if self.fields and UNNAMED in {name.removeprefix("/") for name in names}:
            raise ValueError(f"topics has {UNNAMED}, too, which stands twice; accepted: once")
        logs = {array.file for topic in (self, *names.values()) for array in topic.fields.values()}
        if self.exact and (self.delimiter != "," or self.header is None or self.time is None or max(logs) > 1):
            raise ValueError("exact is true; accepted together with delimiter: ',', header, time, and one log")
        if (self.delimiter, self.decimal) == (",", ","):
            raise ValueError(
                "decimal is ',', and so is delimiter: they could not be distinguished; accepted: two different ones"
            )
        return self


MESSAGE_KEYS: Final = (
    *("topic", "names", "gear", "coupling", "torque_constant", "zero"),
    *("spring", "torque_delay", "record_time"),
)
"""Those of them that describe messages and drives; some are options of commands, too."""


class LogMapping(SignalMapFile):
    """A signal map as its file has it."""

    path: Path

    @classmethod
    def load(cls, path: Path) -> LogMapping:
        """Read a signal map."""
        return cls(path=path, **dict(read_model(SignalMapFile, path)))

    @property
    def by_topic(self) -> dict[str, MessageColumns]:
        """Return the columns of the messages by topic."""
        columns: dict[str, MessageColumns] = {} if self.topics is None else {**self.topics.entries}
        if self.fields:
            columns[UNNAMED] = self
        return columns

    @property
    def seconds(self) -> Fraction:
        """Return the length of a unit of time, s."""
        return SECONDS["s" if self.time is None else self.time.unit]

    @property
    def files(self) -> int:
        """Return how many logs it takes columns from."""
        used = [array.file for columns in self.by_topic.values() for array in columns.fields.values()]
        return max([*used, 1 if self.time is None else self.time.file])

    @property
    def messages(self) -> dict[str, Any]:
        """Return the values of its MESSAGE_KEYS."""
        return self.model_dump(include={*MESSAGE_KEYS}, exclude_defaults=True)


def is_table(path: Path) -> bool:
    """Return whether a path is that of a log in columns, by its suffix."""
    return path.suffix.lower() in TABLES and not path.is_dir()


def mapping_of(path: Path, mapping: LogMapping | None = None) -> LogMapping:
    """Return the mapping of a log: the given one, or that of the file beside the log, named as the log, with .yaml."""
    default_file = path.with_suffix(".yaml")
    if mapping is None and not default_file.is_file():
        raise BagError(
            f"{plain(path)}: no signal map {plain(default_file.name)} beside it; accepted: that file, or --signals FILE"
        )
    found = LogMapping.load(default_file) if mapping is None else mapping
    if not found.by_topic:
        raise BagError(f"{plain(found.path)}: names no columns of {plain(path)}; accepted: such as position")
    return found


def exported_mapping(series: JointSeries) -> str:
    """Return the signal map by which the CSV file of a series, as it is exported, becomes a bag again."""
    content: dict[str, Any] = {"names": list(series.names)}
    column = 2
    for name in series.fields:
        content[name] = {"columns": list(range(column, column + len(series.names))), "unit": series.units[name]}
        column += len(series.names)
    return yaml_text({
        "exact": True, "delimiter": ",", "decimal": ".", "header": 1, "time": {"column": 1, "unit": "s"},
        "topics": {series.topic: content},
    })  # fmt: skip
