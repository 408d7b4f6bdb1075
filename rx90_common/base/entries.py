"""Accepted contents of files, as tables: readers check with them, and the JSON schemas for editors come from them.

A file is a `Group` (base/groups.py) of keys, each with its `Entry`; its `read` returns plain data, or refuses by file,
key, value and accepted values. Rules that involve several values are left to the readers.
"""

from __future__ import annotations

import math
import sys
from collections.abc import Callable, Mapping, Sequence
from dataclasses import KW_ONLY, dataclass
from numbers import Real
from typing import Any, Final, NoReturn, TypeAlias

from rx90_common.base.config import Section
from rx90_common.base.quoting import counted

JsonSchema: TypeAlias = dict[str, Any]

REQUIRED: Final = object()
"""Default of a key that may not be left out."""
LEFT_OUT: Final = object()
"""Default of a key that may be left out, and then is missing in the result of `read`."""


class NotAccepted(Exception):  # noqa: N818 - caught by whoever knows the value's place
    """A value that an entry does not accept; `place` is that of the value in a list, such as `[2]`, else empty."""

    def __init__(self, value: object, accepted: str, place: str = "") -> None:
        super().__init__(value, accepted, place)
        self.value = value
        self.accepted = accepted
        self.place = place


@dataclass(frozen=True)
class Entry:
    """The accepted values of a key.

    Attributes:
        about: its meaning, in words.
        unit: its unit; empty without one.
        default: its value if it is left out, LEFT_OUT or REQUIRED.
    """

    about: str
    unit: str = ""
    _: KW_ONLY
    default: Any = REQUIRED

    def acceptance(self) -> str:
        """Return the accepted values in words."""
        raise NotImplementedError

    def check(self, value: Any) -> Any:
        """Return a value as readers get it.

        Raises:
            NotAccepted: for a value that is not accepted.
        """
        raise NotImplementedError

    def take(self, section: Section, key: str) -> Any:
        """Return the value under `key`, checked."""
        value = section.get(key, self.acceptance())
        try:
            return self.check(value)
        except NotAccepted as fault:
            section.refuse(f"{key}{fault.place}", fault.value, fault.accepted)

    def refuse(self, value: object) -> NoReturn:
        """Raise NotAccepted for the whole value."""
        raise NotAccepted(value, self.acceptance())

    def rules(self) -> JsonSchema:
        """Return the constraints of a value as a JSON schema."""
        raise NotImplementedError

    def schema(self) -> JsonSchema:
        """Return the JSON schema of a value, with the texts that an editor shows."""
        described: JsonSchema = {"description": f"{self.about}{f' [{self.unit}]' * bool(self.unit)}"}
        known = self.default not in (REQUIRED, LEFT_OUT, math.inf)
        return described | self.rules() | ({"default": self.default} if known else {})


@dataclass(frozen=True)
class Number(Entry):
    """A finite number in [low, high], or in (low, high] with `above`; `nonzero`: not 0, `infinite`: also .inf."""

    _: KW_ONLY
    low: float = -math.inf
    high: float = math.inf
    above: bool = False
    nonzero: bool = False
    infinite: bool = False

    @property
    def _each(self) -> str:
        """Return the words before the range."""
        return ""

    def acceptance(self) -> str:
        """Return the range in words."""
        return f"{self._each}{range_text(self.low, self.high, self.above)}"

    def check(self, value: Any) -> Any:
        """Return the number as a float."""
        return self._number(value)

    def _number(self, value: Any, place: str = "") -> float:
        if type(value) is float and self.low < value < self.high and value:  # most are: a sweep checks thousands
            return value
        if self.infinite and value == math.inf:
            return math.inf
        number = as_number(value)
        if math.isinf(number) or (isinstance(value, float) and math.isnan(value)):  # infinity is > 0, too
            raise NotAccepted(value, self.acceptance().replace("a number >", "a finite number >"), place)
        if not self.low <= number <= self.high or (self.above and number == self.low):
            raise NotAccepted(value, self.acceptance(), place)
        if self.nonzero and number == 0.0:
            raise NotAccepted(value, f"{self._each}a finite number other than 0", place)
        return number

    def rules(self) -> JsonSchema:
        """Return the range; infinite values are beyond the largest number, where that is refused."""
        largest = sys.float_info.max
        least = {} if self.above else {"minimum": max(self.low, -largest)}
        least |= {"exclusiveMinimum": self.low} if self.above else {}
        other = {"not": {"const": 0}} if self.nonzero else {}
        most = {} if self.infinite else {"maximum": min(self.high, largest)}
        return {"type": "number", **least, **most, **other}


MAX_JOINTS: Final = 7
"""Joints that an arm may have."""


PER_JOINT: Final = 0
"""The count of a list that has one value for each joint, or each motor, of an arm."""


def _count_text(count: int) -> str:
    return f"one number per joint, up to {MAX_JOINTS}" if count == PER_JOINT else counted(count, "number")


def _fits(count: int, value: Sequence[Any]) -> bool:
    return 1 <= len(value) <= MAX_JOINTS if count == PER_JOINT else len(value) == count


def _count_rules(count: int) -> JsonSchema:
    least, most = (1, MAX_JOINTS) if count == PER_JOINT else (count, count)
    return {"minItems": least, "maxItems": most}


@dataclass(frozen=True)
class Numbers(Number):
    """So many numbers, each as a Number is."""

    _: KW_ONLY
    count: int

    @property
    def _each(self) -> str:
        return f"{_count_text(self.count)}, each "

    def check(self, value: Any) -> Any:
        """Return them as a tuple."""
        if not isinstance(value, list | tuple) or not _fits(self.count, value):
            self.refuse(value)
        return tuple(self._number(each, f"[{i}]") for i, each in enumerate(value))

    def rules(self) -> JsonSchema:
        """Return length and items."""
        return {"type": "array", **_count_rules(self.count), "items": super().rules()}


def _checked_items(values: list[Any], item: Entry) -> tuple[Any, ...]:
    checked = []
    for i, value in enumerate(values):
        try:
            checked.append(item.check(value))
        except NotAccepted as fault:
            raise NotAccepted(fault.value, fault.accepted, f"[{i}]{fault.place}") from None
    return tuple(checked)


@dataclass(frozen=True)
class Rows(Entry):
    """A list, not an empty one, of rows of so many finite numbers."""

    _: KW_ONLY
    count: int

    def acceptance(self) -> str:
        """Return the size of a row."""
        return f"a list of rows of {_count_text(self.count)}"

    def check(self, value: Any) -> tuple[tuple[float, ...], ...]:
        """Return the rows."""
        if not isinstance(value, list) or not value:
            self.refuse(value)
        rows = _checked_items(value, Numbers("", count=self.count))
        if len({len(row) for row in rows}) > 1:
            raise NotAccepted(value, "rows that are equally long")
        return rows

    def rules(self) -> JsonSchema:
        """Return length and rows."""
        return {"type": "array", "minItems": 1, "items": Numbers("", count=self.count).rules()}


@dataclass(frozen=True)
class Integer(Entry):
    """An integer in [low, high]."""

    _: KW_ONLY
    low: int
    high: int

    def acceptance(self) -> str:
        """Return the range in words."""
        return f"an integer in [{self.low}, {self.high}]"

    def check(self, value: Any) -> int:
        """Return the integer."""
        if not isinstance(value, int) or isinstance(value, bool) or not self.low <= value <= self.high:
            self.refuse(value)
        return int(value)

    def rules(self) -> JsonSchema:
        """Return the range."""
        return {"type": "integer", "minimum": self.low, "maximum": self.high}


@dataclass(frozen=True)
class Switch(Entry):
    """True or false."""

    def acceptance(self) -> str:
        """Return both."""
        return "true or false"

    def check(self, value: Any) -> bool:
        """Return it."""
        if not isinstance(value, bool):
            self.refuse(value)
        return bool(value)

    def rules(self) -> JsonSchema:
        """Return the type."""
        return {"type": "boolean"}


@dataclass(frozen=True)
class Text(Entry):
    """A text, one of `choices` where there are any."""

    _: KW_ONLY
    choices: tuple[str, ...] = ()

    def acceptance(self) -> str:
        """Return the choices."""
        return f"one of {', '.join(self.choices)}" if self.choices else "a text"

    def check(self, value: Any) -> str:
        """Return the text."""
        if not isinstance(value, str) or (self.choices and value not in self.choices):
            self.refuse(value)
        return str(value)

    def rules(self) -> JsonSchema:
        """Return type or choices."""
        return {"enum": list(self.choices)} if self.choices else {"type": "string"}


@dataclass(frozen=True)
class Texts(Entry):
    """A list of texts; with `once` not an empty one, and each text once."""

    _: KW_ONLY
    once: bool = False

    def acceptance(self) -> str:
        """Return the description of the items."""
        return "a list of texts"

    def check(self, value: Any) -> tuple[str, ...]:
        """Return the texts."""
        if not isinstance(value, list) or not all(isinstance(item, str) for item in value):
            self.refuse(value)
        if self.once and (not value or len(set(value)) < len(value)):
            raise NotAccepted(value, "one name or more, each once")
        return tuple(value)

    def rules(self) -> JsonSchema:
        """Return the description of the items."""
        once = {"minItems": 1, "uniqueItems": True} if self.once else {}
        return {"type": "array", "items": {"type": "string"}, **once}


@dataclass(frozen=True)
class Other(Entry):
    """A value with a test of its own.

    Attributes:
        accepted: the accepted values, in words.
        good: the test.
        fragment: the same as a JSON schema.
    """

    _: KW_ONLY
    accepted: str
    good: Callable[[Any], bool]
    fragment: Mapping[str, Any]

    def acceptance(self) -> str:
        """Return it."""
        return self.accepted

    def check(self, value: Any) -> Any:
        """Return the value."""
        if not self.good(value):
            self.refuse(value)
        return value

    def rules(self) -> JsonSchema:
        """Return the test."""
        return dict(self.fragment)


@dataclass(frozen=True)
class ListOf(Entry):
    """A list of at least `least` items that all have one entry; `accepted` describes it in words."""

    _: KW_ONLY
    item: Entry
    accepted: str
    least: int = 0

    def acceptance(self) -> str:
        """Return it."""
        return self.accepted

    def check(self, value: Any) -> tuple[Any, ...]:
        """Return the items."""
        if not isinstance(value, list) or len(value) < self.least:
            self.refuse(value)
        return _checked_items(value, self.item)

    def take(self, section: Section, key: str) -> tuple[Any, ...]:
        """Return the items, which may be mappings with places of their own."""
        values = section.get(key, self.accepted)
        if not isinstance(values, list) or len(values) < self.least:
            section.refuse(key, values, self.accepted)
        return tuple(self.item.take(section.item(key, i, value), f"{key}[{i}]") for i, value in enumerate(values))

    def rules(self) -> JsonSchema:
        """Return length and items."""
        return {"type": "array", "minItems": self.least, "items": self.item.schema()}


def as_number(value: object) -> float:
    """Return a number, NumPy's scalars included, as a float, an integer beyond the largest as infinity; else NaN."""
    if isinstance(value, bool) or not isinstance(value, Real):
        return math.nan
    try:
        return float(value)
    except OverflowError:
        return math.inf


def range_text(low: float, high: float, above: bool) -> str:
    """Return an interval in words; `above` for one that does not hold its least number."""
    if math.isinf(low) and math.isinf(high):
        return "a finite number"
    if math.isinf(high):
        return f"a number {'>' if above else '>='} {low:g}"
    return f"a number in {'(' if above else '['}{low:g}, {high:g}]"
