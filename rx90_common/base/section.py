"""A mapping of a configuration file: every refusal names file, key, value and the accepted values."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

from rx90_common.base.errors import ConfigError
from rx90_common.base.quoting import plain, quoted

PROVENANCE = ("published", "derived", "assumed", "identified")
ABOUT = ("source", "provenance", "note")
"""Keys that every mapping may have: they speak of the values in it."""


class Section:
    """A mapping of a YAML file, with its place in the file for messages.

    A section may carry `source:` (a sentence) and `provenance:` (one of PROVENANCE), or a mapping from keys to these.
    `finish()` refuses keys that were not read: a misspelt key must not fall back to a default.

    Args:
        data: the mapping.
        file: that contains it.
        path: to the mapping.
        faults: collects the refusals of `attempt`, so that the checks continue; by default they are raised.
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
        """Raise a ConfigError that names file, key, value and the accepted values."""
        raise ConfigError(f"{self.where(key)} is {quoted(value)}; accepted: {accepted}")

    def fault(self, key: str, text: str) -> None:
        """Raise a ConfigError whose text continues after file and key."""
        raise ConfigError(f"{self.where(key)}{text}")

    def attempt(self, action: Callable[..., object], *values: Any) -> None:
        """Call `action` with the values; collect its refusals if faults are collected."""
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

    def get(self, key: str, accepted: str) -> Any:
        """Return the value of `key`, of any type; refuse a mapping without it."""
        self._used.add(key)
        if key not in self._data:
            raise ConfigError(f"{self.where(key)} is missing; accepted: {accepted}")
        return self._data[key]

    def finish(self) -> None:
        """Refuse keys that were not read."""
        known = ", ".join(sorted(self._used - set(ABOUT)))
        for key in sorted(set(self._data) - self._used):
            self.attempt(self.fault, key, f" is not a known key; accepted: {known}")

    def section(self, key: str, accepted: str = "a mapping") -> Section:
        """Return the mapping under `key`."""
        value = self.get(key, accepted)
        if not isinstance(value, dict):
            self.refuse(key, value, accepted)
        return Section(value, self.file, f"{self.path}{'.' if self.path else ''}{key}", self._faults)

    def sections(self, key: str) -> list[Section]:
        """Return the mappings in the list under `key`."""
        values = self.get(key, "a list of mappings")
        if not isinstance(values, list) or not all(isinstance(value, dict) for value in values):
            self.refuse(key, values, "a list of mappings")
        where = f"{self.path}{'.' if self.path else ''}{key}"
        return [Section(value, self.file, f"{where}[{i}]") for i, value in enumerate(values)]

    def item(self, key: str, index: int, value: object) -> Section:
        """Return a mapping that holds a value of the list under `key` alone, under the name `key[index]`."""
        return Section({f"{key}[{index}]": value}, self.file, self.path, self._faults)
