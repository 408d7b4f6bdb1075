"""Mappings of files as tables of entries: known keys, free names, and keys that depend on another one."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import KW_ONLY, dataclass, field
from typing import Any, ClassVar, Final

from rx90_common.base.config import ABOUT, PROVENANCE, Section
from rx90_common.base.entries import LEFT_OUT, REQUIRED, Entry, JsonSchema, Text

DEFINITIONS: Final[Mapping[str, JsonSchema]] = {
    "provenance": {
        "description": "Where the values come from: one word for the whole mapping, or one for each key.",
        "anyOf": [
            {"enum": [*PROVENANCE, None]},
            {"type": "object", "additionalProperties": {"enum": [*PROVENANCE, None]}},
        ],
    },
    "source": {"description": "A sentence that names the source, for the whole mapping or for each key."},
    "note": {"description": "A remark for readers."},
}
"""Keys that every mapping may have, as JSON schemas."""


@dataclass(frozen=True)
class Group(Entry):
    """A mapping with known keys.

    Attributes:
        keys: the entries of their values.
        one_of: keys of which exactly one is required.
        one_of_with: keys that require one of these; without them none is permitted.
        some_of: keys of which at least one is required.
        needed_by: key that is required if another one is there, by that other one.
        known: whether other keys are refused.
        accepted: the accepted content, in words.
    """

    _: KW_ONLY
    keys: Mapping[str, Entry] = field(hash=False)
    one_of: tuple[str, ...] = ()
    one_of_with: tuple[str, ...] = ()
    some_of: tuple[str, ...] = ()
    needed_by: Mapping[str, str] = field(default_factory=dict, hash=False)
    known: bool = True
    accepted: str = "a mapping"

    def take(self, section: Section, key: str) -> dict[str, Any]:
        """Return the values by their keys."""
        return self.read(section.section(key, self.accepted))

    def read(self, section: Section) -> dict[str, Any]:
        """Return the values by their keys; keys with a default are always there."""
        found: dict[str, Any] = {}
        required = [key for key, entry in self.keys.items() if entry.default is REQUIRED]
        meant = section.refuse_unknown(self.keys) if self.known else section.refuse_misspelt(required)
        if not meant:  # else one mistake would be told twice
            section.attempt(self._check_keys, section)
        for key, entry in self.keys.items():
            needed = key in required or any(self.needed_by.get(other) == key for other in section)
            if key in section or (needed and key not in meant):
                section.attempt(lambda key=key, entry=entry: found.update({key: entry.take(section, key)}))
            elif entry.default is not LEFT_OUT and entry.default is not REQUIRED:
                found[key] = entry.default
        return found if self.known else {**section.content, **found}

    def _check_keys(self, section: Section) -> None:
        if self.one_of and (not self.one_of_with or any(key in section for key in (*self.one_of_with, *self.one_of))):
            there = [key for key in self.one_of if key in section]
            if len(there) != 1:
                first, *others = self.one_of
                found_keys = "both are there" if len(self.one_of) == 2 else f"{len(there)} of them are there"
                found_keys = found_keys if there else "none is there"
                section.fault(first, f" and {', '.join(others)}: {found_keys}; accepted: one of them")
            if self.one_of_with and not any(key in section for key in self.one_of_with):
                section.fault(there[0], f" alone; accepted: with {', '.join(self.one_of_with)}")
        if self.some_of and not any(key in section for key in self.some_of):
            section.fault(self.some_of[0], f" is missing; accepted: one or more of {', '.join(self.some_of)}")

    def rules(self) -> JsonSchema:
        """Return keys and their dependencies."""
        about = {key: {"$ref": f"#/$defs/{key}"} for key in ABOUT}
        rules: JsonSchema = {
            "type": "object",
            "properties": {key: {"title": key.replace("_", " ")} | s.schema() for key, s in self.keys.items()} | about,
        }
        needed = [key for key, entry in self.keys.items() if entry.default is REQUIRED]
        if needed:
            rules["required"] = needed
        if self.known:
            rules["additionalProperties"] = False
        if self.one_of:
            one = {"oneOf": [{"required": [key]} for key in self.one_of]}
            rules |= (
                {"if": _any_of((*self.one_of_with, *self.one_of)), "then": one | _any_of(self.one_of_with)}
                if (self.one_of_with)
                else one
            )
        if self.some_of:
            rules |= _any_of(self.some_of)
        if self.needed_by:
            rules["allOf"] = [
                {"if": {"required": [key]}, "then": {"required": [other]}} for key, other in self.needed_by.items()
            ]
        return rules


def _any_of(keys: tuple[str, ...]) -> JsonSchema:
    return {"anyOf": [{"required": [key]} for key in keys]}


@dataclass(frozen=True)
class Entries(Entry):
    """A mapping from free names to values of one entry.

    Attributes:
        of: the entry.
        least: the smallest number of entries.
        what: description of an entry.
        names: pattern that all names must match, if any, and its meaning.
    """

    _: KW_ONLY
    of: Entry
    least: int = 0
    what: str = "entry"
    names: tuple[str, str] = ("", "")

    def take(self, section: Section, key: str) -> dict[str, Any]:
        """Return the values by their names."""
        inner = section.section(key)
        if sum(1 for _ in inner) < self.least:
            section.refuse(key, inner.content, f"at least one {self.what}")
        return self.read(inner)

    def read(self, section: Section) -> dict[str, Any]:
        """Return the values by their names."""
        found: dict[str, Any] = {}
        pattern, accepted = self.names
        for name in section:
            if pattern and not re.search(pattern, name):
                section.attempt(section.fault, name, f" is no name of a {self.what}; accepted: {accepted}")
            section.attempt(lambda name=name: found.update({name: self.of.take(section, name)}))
        return found

    def rules(self) -> JsonSchema:
        """Return the description of the values."""
        about = {key: {"$ref": f"#/$defs/{key}"} for key in ABOUT}
        some: JsonSchema = {"minProperties": self.least} if self.least else {}
        some |= {"propertyNames": {"pattern": self.names[0]}} if self.names[0] else {}
        return {"type": "object", "properties": about, "additionalProperties": self.of.schema(), **some}


@dataclass(frozen=True)
class Either(Entry):
    """A mapping of one entry, or a value of another."""

    _: KW_ONLY
    mapping: Entry
    plain: Entry

    def take(self, section: Section, key: str) -> Any:
        """Return the description."""
        return (self.mapping if section.holds_mapping(key) else self.plain).take(section, key)

    def rules(self) -> JsonSchema:
        """Return both."""
        return {"anyOf": [self.plain.schema(), self.mapping.schema()]}


@dataclass(frozen=True)
class Variants(Entry):
    """A mapping whose other keys follow from the text under one of them, `key`."""

    _: KW_ONLY
    key: str
    groups: Mapping[str, Group] = field(hash=False)
    _rest: ClassVar[str] = "which of these keys there are"

    def take(self, section: Section, key: str) -> dict[str, Any]:
        """Return the values by their keys, `key` among them."""
        inner = section.section(key)
        if self.key not in inner:
            inner.refuse_unknown({self.key, *(name for group in self.groups.values() for name in group.keys)})
        chosen = Text("", choices=tuple(self.groups)).take(inner, self.key)
        return {self.key: chosen, **self.groups[chosen].read(inner)}

    def rules(self) -> JsonSchema:
        """Return each group with the text that it belongs to."""
        head = {self.key: {"description": self._rest, "enum": list(self.groups)}}
        either = []
        for text, group in self.groups.items():
            rules = group.rules()
            rules["properties"] = {self.key: {}} | rules["properties"]
            either.append({"if": {"properties": {self.key: {"const": text}}}, "then": rules})
        return {"type": "object", "properties": head, "required": [self.key], "allOf": either}
