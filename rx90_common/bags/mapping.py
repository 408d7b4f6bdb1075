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

A bag needs no columns: `topic`, `names` and the keys of motors and joints. A table is the topic `joint_states` unless
`topic` names another one; `topics` holds names and columns of each topic of a table with several.

Columns are numbers from 1 on, or names in the log's header. Position, velocity and effort may each be left out.
`delimiter`, `decimal` and the number of lines of the `header` are found out where the map does not say them.
"""

from __future__ import annotations

import math
import re
from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any, Final, Literal, TypeAlias

import numpy as np
from pydantic import AfterValidator, ConfigDict, Field, model_validator

from rx90_common.bags.joint_series import JointSeries
from rx90_common.bags.topics import FIELDS, quantities
from rx90_common.base.arrays import Array
from rx90_common.base.config import yaml_text
from rx90_common.base.errors import BagError
from rx90_common.base.models import (
    FileModel,
    NotZero,
    Some,
    not_accepted,
    quantity,
    read_model,
    refusal,
)
from rx90_common.base.quoting import plain

TIME_UNITS = {"s": 10**9, "ms": 10**6, "us": 10**3, "ns": 1}
"""What a unit of time is in ns."""
_SCALES: Final[Mapping[str, float]] = {
    "rad": 1.0, "deg": math.pi / 180.0, "turns": 2.0 * math.pi,
    "rad/s": 1.0, "deg/s": math.pi / 180.0, "rpm": math.pi / 30.0,
    "Nm": 1.0, "mNm": 1e-3, "A": 1.0, "mA": 1e-3, "rad/s^2": 1.0,
}  # fmt: skip
"""What a unit is in rad, rad/s, Nm, A and rad/s^2."""
DELIMITERS = {";": ";", "tab": "\t", ",": ",", "space": " "}
"""Between columns, by their names in signal maps; space is any number of blanks and tabs."""
ARRAYS = (".parquet", ".npz")
"""Suffixes of logs of arrays."""
TABLES = (".csv", ".tsv", ".txt", ".dat", *ARRAYS)
"""Suffixes of logs in columns."""

_TOPIC = re.compile(r"/?[A-Za-z_]\w*(/[A-Za-z_]\w*)*")

_Column: TypeAlias = Annotated[
    Annotated[int, Field(ge=1, le=100_000)] | str,
    Field(
        description="Number of a column, from 1 on, or its name in the header.",
        json_schema_extra={
            "accepted": "the number of a column, from 1 on, or its name in the header"
        },
    ),
]
_Numbers: TypeAlias = Annotated[tuple[float, ...], Field(strict=False, min_length=1)]
_NotZeros: TypeAlias = Annotated[tuple[NotZero, ...], Field(strict=False, min_length=1)]


def _check_once(values: tuple[Any, ...]) -> tuple[Any, ...]:
    if len(set(values)) < len(values) or any("\0" in str(value) for value in values):
        raise not_accepted()
    return values


class FieldColumns(FileModel):
    """Where an array comes from."""

    model_config = ConfigDict(use_attribute_docstrings=True)

    columns: Annotated[
        tuple[_Column, ...],
        Field(
            strict=False,
            min_length=1,
            json_schema_extra={"accepted": "a list of columns, one for each name, each once"},
        ),
        AfterValidator(_check_once),
    ]
    """A column for each name."""
    unit: str
    factor: Annotated[
        NotZero | _NotZeros,
        Field(
            json_schema_extra={
                "accepted": "a number other than 0, or a list of them, one for each name"
            }
        ),
    ] = 1.0
    """What the log's numbers are multiplied by: one number, or one for each name."""

    @property
    def factors(self) -> Array:
        """Return what turns the numbers of each column into SI units, one for each."""
        return np.broadcast_to(self.factor, len(self.columns)) * _SCALES[self.unit]


class PositionColumns(FieldColumns):
    """Where each joint's position comes from."""

    unit: Literal["rad", "deg", "turns"]
    """Unit in the log."""


class VelocityColumns(FieldColumns):
    """Where each joint's velocity comes from."""

    unit: Literal["rad/s", "deg/s", "rpm"]
    """Unit in the log."""


class EffortColumns(FieldColumns):
    """Where each joint's effort comes from."""

    unit: Literal["Nm", "mNm", "A", "mA", "rad/s^2"]
    """Unit in the log."""


class TimeColumn(FileModel):
    """The column of the times."""

    column: _Column
    unit: Annotated[Literal["s", "ms", "us", "ns"], Field(description="Unit of the times.")]


class MessageColumns(FileModel):
    """Where the joint states of a topic come from."""

    names: Annotated[
        tuple[str, ...] | None,
        Field(
            strict=False,
            min_length=1,
            description="What the log calls the joints, or their motors.",
            json_schema_extra={
                "accepted": "a list of texts, one or more, each once, without NUL",
                "uniqueItems": True,
            },
        ),
        AfterValidator(lambda names: names and _check_once(names)),
    ] = None
    position: PositionColumns | None = None
    velocity: VelocityColumns | None = None
    effort: EffortColumns | None = None

    @model_validator(mode="after")
    def _check_columns(self) -> MessageColumns:
        for name, array in self.fields.items():
            if self.names is None:
                raise ValueError(f"has {name} and no names; accepted: names, a list of texts")
            for key, values in (("columns", array.columns), ("factor", array.factor)):
                if isinstance(values, tuple) and len(values) != len(self.names):
                    raise refusal(
                        f"{name}.{key}", values, f"a list of {len(self.names)}, one for each name"
                    )
        return self

    @property
    def fields(self) -> dict[str, FieldColumns]:
        """Return the columns by what they hold."""
        return {name: columns for name in FIELDS if (columns := getattr(self, name)) is not None}

    def effort_unit(self, topic: str) -> str:
        """Return the unit of the efforts in the bag if it is not the usual one of the topic's name."""
        unit = "" if self.effort is None else self.effort.unit.removeprefix("m")
        return "" if unit == quantities(topic)["effort"][1] else unit


class SignalMapFile(MessageColumns):
    """What a log holds: columns of a table, or messages of a bag."""

    model_config = ConfigDict(use_attribute_docstrings=True)

    topic: str | None = None
    """JointState topic of a bag, or that of a table, joint_states by default."""
    topics: Some[MessageColumns] | None = None
    """Topics of a table that holds several, by name."""
    gear: _NotZeros | None = None
    """Motor turns per joint turn: says that the log holds the motors' states."""
    coupling: _Numbers | None = None
    """Turns of each motor per joint turn without the gears, row by row, n x n."""
    torque_constant: _NotZeros | None = None
    """Torque per unit of effort, where effort is a current, Nm/A."""
    zero: _Numbers | None = None
    """Recorded angle of each joint where its angle in the URDF is 0, rad."""
    spring: _Numbers | None = None
    """Amplitude k of a gravity-compensation spring on each joint, torque -k sin(q), Nm."""
    torque_delay: Annotated[
        float | None,
        quantity(
            "s",
            "How much later torques acted than their stamps say; negative if recorded late.",
            ge=-0.2,
            le=0.2,
        ),
    ] = None
    record_time: bool = False
    """Whether a bag's times of recording replace the stamps."""
    time: TimeColumn | None = None
    rate: Annotated[
        float | None,
        quantity("Hz", "Rows per second, where no column holds the times.", ge=1e-3, le=1e6),
    ] = None
    delimiter: Literal[",", ";", "tab", "space"] | None = None
    """Between columns; found out if left out."""
    decimal: Literal[".", ","] | None = None
    """Decimal sign; found out if left out."""
    header: Annotated[int | None, Field(ge=0, le=1000)] = None
    """Lines before the first row; found out if left out."""
    exact: bool = False
    """Numbers and times are taken as they stand: NaN, any order."""

    @model_validator(mode="after")
    def _check_keys(self) -> SignalMapFile:
        times = {"time": self.time, "rate": self.rate}
        given = [key for key, value in times.items() if value is not None]
        if len(given) != (1 if self.by_topic else 0):
            accepted = "one of them" if self.by_topic else f"with topics, {', '.join(FIELDS)}"
            raise ValueError(
                f"has {' and '.join(given) or 'none'} of time, rate; accepted: {accepted}"
            )
        for name, columns in self.by_topic.items():
            if not _TOPIC.fullmatch(name) or not columns.fields:
                accepted = f"names of topics, with one or more of {', '.join(FIELDS)}"
                raise ValueError(
                    f"topics.{plain(name)}: no topic, or no columns; accepted: {accepted}"
                )
        return self

    @property
    def by_topic(self) -> dict[str, MessageColumns]:
        """Return the columns of the joint states by topic."""
        columns: dict[str, MessageColumns] = {} if self.topics is None else {**self.topics.entries}
        if self.fields:
            columns[self.topic or "joint_states"] = self
        return columns

    @property
    def columns(self) -> list[int | str]:
        """Return all columns that are used."""
        times = [] if self.time is None else [self.time.column]
        parts = [field for topic in self.by_topic.values() for field in topic.fields.values()]
        return [*times, *(column for field in parts for column in field.columns)]


MESSAGE_KEYS = (
    "topic",
    "names",
    "gear",
    "coupling",
    "torque_constant",
    "zero",
    "spring",
    "torque_delay",
    "record_time",
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
    def messages(self) -> dict[str, Any]:
        """Return the values of its MESSAGE_KEYS."""
        return self.model_dump(include={*MESSAGE_KEYS}, exclude_defaults=True)


def is_table(path: Path) -> bool:
    """Return whether a path is that of a log in columns, by its suffix."""
    return path.suffix.lower() in TABLES and not path.is_dir()


def mapping_of(path: Path, mapping: LogMapping | None = None) -> LogMapping:
    """Return the mapping of a log: the given one, or that of the file beside the log, named as the log, with .yaml."""
    beside = path.with_suffix(".yaml")
    if mapping is None and not beside.is_file():
        raise BagError(
            f"{plain(path)}: no signal map {plain(beside.name)} beside it; accepted: that file, or --signals FILE"
        )
    chosen = LogMapping.load(beside) if mapping is None else mapping
    if not chosen.by_topic:
        raise BagError(
            f"{plain(chosen.path)}: names no columns of {plain(path)}; accepted: such as position"
        )
    return chosen


def exported_mapping(series: JointSeries) -> str:
    """Return the signal map by which the CSV file of a series, as it is exported, is read again."""
    content: dict[str, Any] = {"names": list(series.names)}
    count = len(series.names)
    for k, name in enumerate(series.fields):
        columns = [2 + k * count + joint for joint in range(count)]
        content[name] = {"columns": columns, "unit": series.units[name]}
    layout = {"exact": True, "delimiter": ",", "header": 1, "time": {"column": 1, "unit": "s"}}
    return yaml_text({**layout, "topics": {series.topic: content}})
