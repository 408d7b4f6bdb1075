"""What files may hold, as tables: readers check with them, and the JSON schemas for editors are written from them.

A file is a `Group` (base/groups.py) of keys, each with its `Entry`; its `read` returns plain data, or refuses by file,
key, value and what is accepted. Rules that tie several values together are left to the readers.
"""

from __future__ import annotations

import math
import sys
from collections.abc import Callable, Mapping
from dataclasses import KW_ONLY, dataclass
from typing import Any, Final, TypeAlias

from rx90_common.base.section import Section

JsonSchema: TypeAlias = dict[str, Any]

REQUIRED: Final = object()
"""Default of a key that may not be left out."""
LEFT_OUT: Final = object()
"""Default of a key that may be left out, and then is not in what `read` returns."""


@dataclass(frozen=True)
class Entry:
    """What may stand under a key.

    Attributes:
        about: what it means, in words.
        unit: its unit; empty where it has none.
        default: its value where it is left out, LEFT_OUT or REQUIRED.
    """

    about: str
    unit: str = ""
    _: KW_ONLY
    default: Any = REQUIRED

    def take(self, section: Section, key: str) -> Any:
        """Return the value under `key`, checked.

        Raises:
            ConfigError: naming file, key, value and what is accepted.
        """
        raise NotImplementedError

    def holds(self, value: object) -> bool:  # noqa: ARG002 - of numbers
        """Return True for a value that `take` would return as it is; False leaves the question to `take`."""
        return False

    def rules(self) -> JsonSchema:
        """Return what a value must keep, as a JSON schema."""
        raise NotImplementedError

    def schema(self) -> JsonSchema:
        """Return the JSON schema of a value, with what an editor shows."""
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

    def holds(self, value: object) -> bool:
        """Return whether it is a finite float in the range."""
        inside = type(value) is float and self.low <= value <= self.high and abs(value) < math.inf
        return inside and not (self.above and value == self.low) and not (self.nonzero and value == 0.0)

    def take(self, section: Section, key: str) -> float:
        """Return the number."""
        value = section.number(key, self.low, self.high, above=self.above, infinite=self.infinite)
        if self.nonzero and value == 0.0:
            section.refuse(key, value, "a finite number other than 0")
        return value

    def rules(self) -> JsonSchema:
        """Return the range; what is not finite is beyond the largest number, where that is refused."""
        largest = sys.float_info.max
        least = {} if self.above else {"minimum": max(self.low, -largest)}
        least |= {"exclusiveMinimum": self.low} if self.above else {}
        other = {"not": {"const": 0}} if self.nonzero else {}
        most = {} if self.infinite else {"maximum": min(self.high, largest)}
        return {"type": "number", **least, **most, **other}


@dataclass(frozen=True)
class Numbers(Number):
    """So many numbers, each as a Number is."""

    _: KW_ONLY
    count: int

    def holds(self, value: object) -> bool:
        """Return whether it is a tuple of so many of these."""
        return type(value) is tuple and len(value) == self.count and all(map(super().holds, value))

    def take(self, section: Section, key: str) -> Any:
        """Return them as a tuple."""
        values = section.numbers(key, self.count, self.low, self.high, above=self.above, infinite=self.infinite)
        for i, value in enumerate(values):
            if self.nonzero and value == 0.0:
                section.refuse(f"{key}[{i}]", value, f"{self.count} numbers, each a finite number other than 0")
        return values

    def rules(self) -> JsonSchema:
        """Return length and items."""
        return {"type": "array", "minItems": self.count, "maxItems": self.count, "items": super().rules()}


@dataclass(frozen=True)
class Rows(Entry):
    """A list, not an empty one, of rows of so many finite numbers."""

    _: KW_ONLY
    count: int

    def take(self, section: Section, key: str) -> tuple[tuple[float, ...], ...]:
        """Return the rows."""
        return section.rows(key, self.count)

    def rules(self) -> JsonSchema:
        """Return length and rows."""
        return {"type": "array", "minItems": 1, "items": Numbers("", count=self.count).rules()}


@dataclass(frozen=True)
class Integer(Entry):
    """An integer in [low, high]."""

    _: KW_ONLY
    low: int
    high: int

    def take(self, section: Section, key: str) -> int:
        """Return the integer."""
        return section.integer(key, self.low, self.high)

    def rules(self) -> JsonSchema:
        """Return the range."""
        return {"type": "integer", "minimum": self.low, "maximum": self.high}


@dataclass(frozen=True)
class Switch(Entry):
    """True or false."""

    def take(self, section: Section, key: str) -> bool:
        """Return it."""
        return section.boolean(key)

    def rules(self) -> JsonSchema:
        """Return the type."""
        return {"type": "boolean"}


@dataclass(frozen=True)
class Text(Entry):
    """A text, one of `choices` where there are any."""

    _: KW_ONLY
    choices: tuple[str, ...] = ()

    def take(self, section: Section, key: str) -> str:
        """Return the text."""
        return section.text(key, self.choices or None)

    def rules(self) -> JsonSchema:
        """Return type or choices."""
        return {"enum": list(self.choices)} if self.choices else {"type": "string"}


@dataclass(frozen=True)
class Texts(Entry):
    """A list of texts; with `once` not an empty one, and each text once."""

    _: KW_ONLY
    once: bool = False

    def take(self, section: Section, key: str) -> tuple[str, ...]:
        """Return the texts."""
        texts = section.texts(key)
        if self.once and (not texts or len(set(texts)) < len(texts)):
            section.refuse(key, list(texts), "one name or more, each once")
        return texts

    def rules(self) -> JsonSchema:
        """Return what the items are."""
        once = {"minItems": 1, "uniqueItems": True} if self.once else {}
        return {"type": "array", "items": {"type": "string"}, **once}


@dataclass(frozen=True)
class Other(Entry):
    """A value with a test of its own.

    Attributes:
        accepted: what is, in words.
        good: the test.
        fragment: the same as a JSON schema.
    """

    _: KW_ONLY
    accepted: str
    good: Callable[[Any], bool]
    fragment: Mapping[str, Any]

    def take(self, section: Section, key: str) -> Any:
        """Return the value."""
        value = section.value(key, self.accepted)
        if not self.good(value):
            section.refuse(key, value, self.accepted)
        return value

    def rules(self) -> JsonSchema:
        """Return the test."""
        return dict(self.fragment)


@dataclass(frozen=True)
class ListOf(Entry):
    """A list, of `least` items or more, that all have one entry; `accepted` says so in words."""

    _: KW_ONLY
    item: Entry
    accepted: str
    least: int = 0

    def take(self, section: Section, key: str) -> tuple[Any, ...]:
        """Return the items."""
        values = section.value(key, self.accepted)
        if not isinstance(values, list) or len(values) < self.least:
            section.refuse(key, values, self.accepted)
        return tuple(self.item.take(section.item(key, i, value), f"{key}[{i}]") for i, value in enumerate(values))

    def rules(self) -> JsonSchema:
        """Return length and items."""
        return {"type": "array", "minItems": self.least, "items": self.item.schema()}
