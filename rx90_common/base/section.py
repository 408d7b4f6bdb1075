"""A mapping of a configuration file: every refusal names file, key, value and what is accepted."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from numbers import Real
from pathlib import Path
from typing import Any

from rx90_common.base.errors import ConfigError
from rx90_common.base.quoting import plain, quoted

PROVENANCE = ("published", "derived", "assumed", "identified")
ABOUT = ("source", "provenance", "note")
"""Keys that every mapping may have: they speak of the values in it."""


class CheckedMapping:
    """A mapping of a YAML file, with its place in the file for messages.

    A section may carry `source:` (a sentence) and `provenance:` (one of PROVENANCE), or a mapping from keys to these.
    `finish()` refuses keys that were not read: a misspelt key must not fall back to a default.

    Args:
        data: the mapping.
        file: that it stands in.
        path: to the mapping.
        faults: to which `attempt` adds refusals, in order to go on behind them; by default it raises them.
    """

    def __init__(
        self, data: dict[str, Any], file: Path, path: str = "", faults: list[ConfigError] | None = None
    ) -> None:
        self._data = data
        self.file = file
        self.path = path
        self._faults = faults
        self._used = set(ABOUT)
        provenance = data.get("provenance")
        for value in provenance.values() if isinstance(provenance, dict) else [provenance]:
            if value is not None and value not in PROVENANCE:
                self.attempt(self.refuse, "provenance", value, f"one of {', '.join(PROVENANCE)}")

    @property
    def provenance(self) -> str | None:
        """Return where the values come from: published, derived, assumed or identified."""
        value = self._data.get("provenance")
        return None if value is None else str(value)

    @property
    def source(self) -> str | None:
        """Return the sentence that names the source."""
        value = self._data.get("source")
        return None if value is None else str(value)

    @property
    def content(self) -> dict[str, Any]:
        """Return the mapping itself, unchecked."""
        return self._data

    def where(self, key: str) -> str:
        """Return `file: path.key`, the way every message names a value."""
        return f"{plain(self.file)}: {plain(self.path)}{'.' if self.path else ''}{plain(key)}"

    def refuse(self, key: str, value: object, accepted: str) -> None:
        """Raise a ConfigError that names file, key, value and what is accepted."""
        raise ConfigError(f"{self.where(key)} is {quoted(value)}; accepted: {accepted}")

    def fault(self, key: str, text: str) -> None:
        """Raise a ConfigError whose text goes on behind file and key."""
        raise ConfigError(f"{self.where(key)}{text}")

    def attempt(self, action: Callable[..., object], *values: Any) -> None:
        """Call `action` with the values; what it refuses is kept where faults are gathered."""
        try:
            action(*values)
        except ConfigError as error:
            if self._faults is None:
                raise
            self._faults.append(error)

    def __contains__(self, key: str) -> bool:
        return key in self._data

    def __iter__(self) -> Iterator[str]:
        return iter(key for key in self._data if key not in ABOUT)

    def holds_mapping(self, key: str) -> bool:
        """Return whether the value under `key` is itself a mapping."""
        return isinstance(self._data.get(key), dict)

    def mark_known(self, key: str) -> None:
        """Say that a key is known which the mapping may have."""
        self._used.add(key)

    def _get(self, key: str, accepted: str) -> Any:
        self._used.add(key)
        if key not in self._data:
            raise ConfigError(f"{self.where(key)} is missing; accepted: {accepted}")
        return self._data[key]

    def finish(self) -> None:
        """Refuse keys that were not read."""
        known = ", ".join(sorted(self._used - set(ABOUT)))
        for key in sorted(set(self._data) - self._used):
            self.attempt(self.fault, key, f" is not a known key; accepted: {known}")


class Section(CheckedMapping):
    """A mapping of a YAML file whose values are read by their kinds; each refuses what is not of its kind."""

    def section(self, key: str, accepted: str = "a mapping") -> Section:
        """Return the mapping under `key`."""
        value = self._get(key, accepted)
        if not isinstance(value, dict):
            self.refuse(key, value, accepted)
        return Section(value, self.file, f"{self.path}{'.' if self.path else ''}{key}", self._faults)

    def item(self, key: str, index: int, value: object) -> Section:
        """Return a mapping that holds a value of the list under `key` alone, under the name `key[index]`."""
        return Section({f"{key}[{index}]": value}, self.file, self.path, self._faults)

    def sections(self, key: str) -> list[Section]:
        """Return the mappings in the list under `key`."""
        values = self._get(key, "a list of mappings")
        if not isinstance(values, list) or not all(isinstance(value, dict) for value in values):
            self.refuse(key, values, "a list of mappings")
        where = f"{self.path}{'.' if self.path else ''}{key}"
        return [Section(value, self.file, f"{where}[{i}]") for i, value in enumerate(values)]

    def number(
        self, key: str, low: float = -math.inf, high: float = math.inf, *, above: bool = False, infinite: bool = False
    ) -> float:
        """Return a finite number in [low, high], or in (low, high] with `above`; with `infinite` infinity, too."""
        accepted = range_text(low, high, above)
        value = self._get(key, accepted)
        if infinite and value == math.inf:
            return math.inf
        return self._check_number(key, value, low, high, above, accepted)

    def numbers(
        self,
        key: str,
        count: int,
        low: float = -math.inf,
        high: float = math.inf,
        *,
        above: bool = False,
        infinite: bool = False,
    ) -> tuple[float, ...]:
        """Return `count` numbers, each as `number` takes it."""
        accepted = f"{count} numbers, each {range_text(low, high, above)}"
        values = self._get(key, accepted)
        if not isinstance(values, Sequence) or isinstance(values, str) or len(values) != count:
            self.refuse(key, values, accepted)
        return tuple(
            math.inf if infinite and v == math.inf else self._check_number(f"{key}[{i}]", v, low, high, above, accepted)
            for i, v in enumerate(values)
        )

    def rows(self, key: str, count: int) -> tuple[tuple[float, ...], ...]:
        """Return a list, not an empty one, of rows of `count` finite numbers."""
        accepted = f"a list of rows of {count} numbers"
        values = self._get(key, accepted)
        if not isinstance(values, list) or not values:
            self.refuse(key, values, accepted)
        return tuple(self.item(key, i, row).numbers(f"{key}[{i}]", count) for i, row in enumerate(values))

    def integer(self, key: str, low: int, high: int) -> int:
        """Return an integer in [low, high]."""
        value = self._get(key, f"an integer in [{low}, {high}]")
        if not isinstance(value, int) or isinstance(value, bool) or not low <= value <= high:
            self.refuse(key, value, f"an integer in [{low}, {high}]")
        return int(value)

    def boolean(self, key: str) -> bool:
        """Return true or false."""
        value = self._get(key, "true or false")
        if not isinstance(value, bool):
            self.refuse(key, value, "true or false")
        return bool(value)

    def text(self, key: str, choices: Sequence[str] | None = None) -> str:
        """Return a string, one of `choices` where they are given."""
        accepted = "a text" if choices is None else "one of " + ", ".join(choices)
        value = self._get(key, accepted)
        if not isinstance(value, str) or (choices is not None and value not in choices):
            self.refuse(key, value, accepted)
        return str(value)

    def texts(self, key: str) -> tuple[str, ...]:
        """Return a list of strings."""
        value = self._get(key, "a list of texts")
        if not isinstance(value, list) or not all(isinstance(item, str) for item in value):
            self.refuse(key, value, "a list of texts")
        return tuple(value)

    def value(self, key: str, accepted: str) -> Any:
        """Return what stands under `key`, whatever it is."""
        return self._get(key, accepted)

    def _check_number(self, key: str, value: Any, low: float, high: float, above: bool, accepted: str) -> float:
        if isinstance(value, bool) or not isinstance(value, Real):  # Real: NumPy's scalars, too
            self.refuse(key, value, accepted)
        number = as_number(value)
        if not math.isfinite(number):
            self.refuse(key, value, accepted.replace("a number >", "a finite number >"))  # infinity is > 0, too
        if number > high or number < low or (above and number == low):
            self.refuse(key, value, accepted)
        return number


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
