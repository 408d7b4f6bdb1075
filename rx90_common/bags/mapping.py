"""The signal map: quantities, joints or motors, and units of a log's columns; for tables and bags alike.

```yaml
time: {column: 1, unit: s}           # or, without a column of times, rate: 5000 (Hz)
names: [shoulder, elbow]
position: {columns: [2, 3], unit: deg}
velocity: {columns: [dq1, dq2], unit: rad/s}
effort: {columns: [i1, i2], unit: A, factor: [1, -1]}
gear: [100, 80]                      # of motors: as --gear, --coupling, --torque-constant and --zero
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
from collections.abc import Mapping
from dataclasses import dataclass, field
from fractions import Fraction
from pathlib import Path
from typing import Any, Final, TypeAlias

from rx90_common.bags.joint_series import JointSeries
from rx90_common.bags.topics import FIELDS, quantities
from rx90_common.base.config import Section, load_yaml, yaml_text
from rx90_common.base.entries import LEFT_OUT, Integer, ListOf, Number, Numbers, Other, Switch, Text, Texts
from rx90_common.base.errors import BagError, ConfigError
from rx90_common.base.groups import Entries, Group
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
DELIMITERS: Final = {",": ",", ";": ";", "|": "|", "tab": "\t", "space": None}
ARRAYS: Final = (".parquet", ".npz")
"""Suffixes of logs of arrays."""
TABLES: Final = (".csv", ".tsv", ".txt", ".dat", *ARRAYS)
"""Suffixes of logs in columns."""
UNNAMED: Final = "joint_states"
"""Topic of a table whose map names none."""
_MAX_FILES = 100
_MAX_COLUMNS = 100_000
_NAMES = (
    r"^/?[A-Za-z_][A-Za-z0-9_]*(/[A-Za-z_][A-Za-z0-9_]*)*\Z",
    "topics as ROS names them, of letters, digits, _ and /, no part of which begins with a digit",
)


_NOT_0 = Number("", nonzero=True).rules()
_COLUMN = Other(
    "Number of a column, from 1 on, or its name in the header.",
    accepted="the number of a column, from 1 on, or its name in the header",
    good=lambda v: isinstance(v, str) or (type(v) is int and 1 <= v <= _MAX_COLUMNS),
    fragment={"anyOf": [{"type": "integer", "minimum": 1, "maximum": _MAX_COLUMNS}, {"type": "string"}]},
)
_FILE = Integer("Number of the log, from 1 on, where several belong together.", low=1, high=_MAX_FILES, default=1)


def _for_each(about: str) -> Other:
    return Other(
        f"{about} One number, or a list of them, one for each name.",
        accepted="a number other than 0, or a list of them, one for each name",
        good=lambda _: True,  # how many there are is known with the names
        fragment={"anyOf": [_NOT_0, {"type": "array", "minItems": 1, "items": _NOT_0}]},
        default=LEFT_OUT,
    )


def _of_field(name: str) -> Group:
    turn = {"counts_per_turn": _for_each("Counts of a whole turn, where the unit is counts or counts/s.")}
    return Group(
        f"Where each joint's {name} comes from.",
        keys={
            "columns": ListOf(
                "A column for each name.", item=_COLUMN, least=1, accepted="a list of columns, one for each name"
            ),
            "unit": Text("Unit in the log.", choices=tuple(UNITS[name])),
            "factor": _for_each("What the log's numbers are multiplied by."),
            **(turn if any(unit.startswith(COUNTS) for unit in UNITS[name]) else {}),
            "file": _FILE,
        },
        default=LEFT_OUT,
    )


def _numbers(about: str, *, nonzero: bool = False) -> ListOf:
    return ListOf(about, item=Number("", nonzero=nonzero), least=1, accepted="a list of numbers", default=LEFT_OUT)


_COLUMNS = ("topics", "position", "velocity", "effort")
MAPPING = Group(
    "What a log holds: columns of a table, or messages of a bag.",
    keys={
        "topic": Text("JointState topic of a bag, or of a table with several.", default=LEFT_OUT),
        "names": Texts("What the log calls the joints, or their motors.", once=True, default=LEFT_OUT),
        **{name: _of_field(name) for name in _COLUMNS[1:]},
        "gear": _numbers("Motor turns per joint turn: says that the log holds the motors' states.", nonzero=True),
        "coupling": _numbers("Turns of each motor per joint turn without the gears, row by row, n x n."),
        "torque_constant": _numbers("Torque per unit of effort, where effort is a current, Nm/A.", nonzero=True),
        "zero": _numbers("Recorded angle of each joint where its angle in the URDF is 0, rad."),
        "record_time": Switch("Whether a bag's times of recording replace the stamps.", default=False),
        "time": Group(
            "The column of the times.",
            keys={"column": _COLUMN, "unit": Text("Unit of the times.", choices=tuple(SECONDS)), "file": _FILE},
            default=LEFT_OUT,
        ),
        "rate": Number(
            "Rows per second, where no column holds the times.", "Hz", low=1e-3, high=1e6, default=LEFT_OUT
        ),
        "topics": Entries(
            "Topics of joint states, by name, of a table that holds several.",
            of=Group(
                "What becomes the messages of the topic.",
                keys={
                    "names": Texts("Names of the joints.", once=True),
                    **{name: _of_field(name) for name in FIELDS},
                },
                some_of=FIELDS,
            ),
            least=1, what="topic", names=_NAMES, default=LEFT_OUT,
        ),
        "delimiter": Text("Between columns; found out if left out.", choices=tuple(DELIMITERS), default=LEFT_OUT),
        "decimal": Text("Decimal sign; found out if left out.", choices=(".", ","), default=LEFT_OUT),
        "header": Integer("Lines of header; found out if left out.", low=0, high=1000, default=LEFT_OUT),
        "exact": Switch("Numbers and times are taken as they stand: NaN, any order.", default=False),
    },
    one_of=("time", "rate"),
    one_of_with=_COLUMNS,
    needed_by=dict.fromkeys(_COLUMNS[1:], "names"),
)  # fmt: skip
"""What a signal map holds."""
MESSAGE_KEYS: Final = ("topic", "names", "gear", "coupling", "torque_constant", "zero", "record_time")
"""Those of them that describe messages; they are options of commands, too."""


@dataclass(frozen=True)
class FieldMapping:
    """Where a field of the messages comes from.

    Attributes:
        file: number of the log, from 1 on.
        columns: of each joint.
        unit: of the log's numbers, a key of UNITS.
        factor: turns the log's numbers of each joint into SI units.
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
        fields: by name, of position, velocity and effort, one at least.
    """

    names: tuple[str, ...]
    fields: Mapping[str, FieldMapping]

    @classmethod
    def of(cls, section: Section, content: dict[str, Any]) -> TopicMapping:
        """Return that of a topic, as a section of a signal map has it."""
        names = content["names"]
        if any("\0" in name for name in names):
            section.refuse("names", list(names), "texts without NUL")
        given = [name for name in FIELDS if name in content]
        fields: dict[str, FieldMapping] = {}
        for name in given:
            part = section.section(name)
            columns = content[name]["columns"]
            unit = content[name]["unit"]
            if len(columns) != len(names):
                part.refuse("columns", list(columns), f"a list of {len(names)}, one for each name")
            if not unit.startswith(COUNTS) and "counts_per_turn" in part:
                part.fault("counts_per_turn", f" stands beside unit: {unit}; accepted: beside counts or counts/s")
            each = []
            for key, needed in (("factor", "factor" in part), ("counts_per_turn", unit.startswith(COUNTS))):
                values = (1.0,) * len(names)
                if needed:
                    if isinstance(part.content.get(key), list):
                        values = Numbers("", nonzero=True, count=len(names)).take(part, key)
                    else:
                        values = (Number("", nonzero=True).take(part, key),) * len(names)
                each.append(values)
            scale = UNITS[name][unit]
            factor = tuple(scale * f / turn for f, turn in zip(*each, strict=True))
            fields[name] = FieldMapping(content[name]["file"], columns, unit, factor)
        return cls(names, fields)

    def effort_unit(self, topic: str) -> str:
        """Return the unit of the efforts in the bag if it is not the usual one of the topic's name."""
        unit = self.fields["effort"].unit.removeprefix("m") if "effort" in self.fields else ""
        return "" if unit == quantities(topic)["effort"][1] else unit


@dataclass(frozen=True)
class LogMapping:
    """The description of a log's columns.

    Attributes:
        file: of the mapping.
        topics: by name.
        time: file and column of the times; None with a rate.
        seconds: length of a unit of time, s.
        rate: rows per second if there is no column of times, Hz.
        delimiter: between columns, as in DELIMITERS; None to detect it.
        decimal: "." or ","; None to detect it.
        header: number of header lines; None to detect it.
        exact: whether all numbers, also NaN and infinities, and times in any order are kept unchanged.
        messages: values of its MESSAGE_KEYS.
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
    messages: Mapping[str, Any] = field(default_factory=dict)

    @property
    def files(self) -> int:
        """Return how many logs it takes columns from."""
        used = {one.file for topic in self.topics.values() for one in topic.fields.values()}
        return max(used | ({self.time[0]} if self.time is not None else {1}))

    @classmethod
    def load(cls, path: Path) -> LogMapping:
        """Read a signal map."""
        root = load_yaml(path)
        content = MAPPING.read(root)
        topics = {
            name: TopicMapping.of(root.section("topics").section(name), topic)
            for name, topic in content.get("topics", {}).items()
        }
        if any(name in content for name in _COLUMNS[1:]):
            if UNNAMED in {name.removeprefix("/") for name in topics}:
                root.fault("topics", f" has {UNNAMED}, too, which stands twice; accepted: once")
            topics[UNNAMED] = TopicMapping.of(root, content)
        time = content.get("time", {})
        mapping = cls(
            path,
            topics,
            (time["file"], time["column"]) if time else None,
            SECONDS[time.get("unit", "s")],
            content.get("rate"),
            content.get("delimiter"),
            content.get("decimal"),
            content.get("header"),
            content["exact"],
            {key: content[key] for key in MESSAGE_KEYS if key in root},
        )
        if mapping.exact and (mapping.delimiter != "," or mapping.header is None or not time or mapping.files > 1):
            raise ConfigError(
                f"{root.where('exact')} is true; accepted together with delimiter: ',', header, time, and one log"
            )
        if (mapping.delimiter, mapping.decimal) == (",", ","):
            raise ConfigError(
                f"{root.where('decimal')} is ',', and so is delimiter: they could not be distinguished; "
                "accepted: two different ones"
            )
        return mapping


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
    if not found.topics:
        raise BagError(f"{plain(found.file)}: names no columns of {plain(path)}; accepted: such as position")
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
