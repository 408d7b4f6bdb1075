"""The one reader and the one writer of YAML, and the mappings in a file.

Every refusal names file, key, value and accepted range.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Collection, Iterator, Mapping
from io import StringIO
from pathlib import Path
from typing import Any

import yaml

from rx90_common.base.errors import ConfigError
from rx90_common.base.quoting import breaks_a_line, nearest, plain, question, quoted

# What is read in two seconds: letters, and values, as often as aliases repeat them.
_MAX_BYTES = 3 << 20
_MAX_VALUES = 150_000
_DEEPEST = 64
_LONGEST_INTEGER = 400  # characters; the largest finite number has 309 digits
_IN_FILE = re.compile(r',? in "<file>", ')
_LONGEST_REASON = 400
_TYPING_ERROR = 0.8  # likeness of a misspelt key to the required one that is meant, where other keys are accepted, too
_SCHEMA_LINE = "# yaml-language-server: $schema="


class _Loader(yaml.composer.Composer, yaml.CSafeLoader):
    """Reads YAML 1.2 (core schema) with names as keys, and refuses repeated keys, because one value would be lost.

    YAML 1.1, which PyYAML follows, reads 1e5 as a text, 1:30 as 90, 010 as 8, yes as true and 2001-01-01 as a date.
    Depth and number of values are limited, because a few lines of aliases can expand to more than the memory. libyaml
    parses; the composer, which counts, is PyYAML's own.
    """

    def __init__(self, stream: StringIO) -> None:
        yaml.CSafeLoader.__init__(self, stream)
        yaml.composer.Composer.__init__(self)
        self._depth = 0
        self._values: dict[yaml.Node, int] = {}  # in each node that is complete, itself included

    def compose_node(self, parent: yaml.Node | None, index: Any) -> yaml.Node:
        """Compose the next node, within the limits."""
        event: Any = self.peek_event()
        if self._depth == _DEEPEST:
            raise _Fault(None, None, f"deeper than {_DEEPEST} levels", event.start_mark)
        self._depth += 1
        node: Any = super().compose_node(parent, index)
        self._depth -= 1
        if not isinstance(event, yaml.AliasEvent):
            self._values[node] = 1 + sum(self._values[child] for child in _children(node))
        elif node not in self._values:
            raise _Fault(None, None, f"{quoted(event.anchor)} stands for something that contains it", event.start_mark)
        if self._values[node] > _MAX_VALUES:
            raise _Fault(None, None, f"more than {_MAX_VALUES:,} values", event.start_mark)
        return node  # type: ignore[no-any-return]


def _children(node: yaml.Node) -> list[yaml.Node]:
    if isinstance(node, yaml.MappingNode):
        return [part for pair in node.value for part in pair]
    return node.value if isinstance(node, yaml.SequenceNode) else []


class _Dumper(yaml.SafeDumper):
    """Writes YAML that 1.1 and 1.2 read alike: a text that either reads as another type is quoted."""

    def ignore_aliases(self, data: object) -> bool:  # noqa: ARG002 - the interface of SafeDumper
        return True


_CORE_SCHEMA = (
    ("null", r"(~|null|Null|NULL|)$", ("~", "n", "N", "")),
    ("bool", r"(true|True|TRUE|false|False|FALSE)$", "tTfF"),
    ("int", r"([-+]?[0-9]+|0o[0-7]+|0x[0-9a-fA-F]+)$", "-+0123456789"),
    (
        "float",
        r"([-+]?(\.[0-9]+|[0-9]+(\.[0-9]*)?)([eE][-+]?[0-9]+)?|[-+]?\.(inf|Inf|INF)|\.(nan|NaN|NAN))$",
        "-+.0123456789",
    ),
)
_Fault: Any = yaml.constructor.ConstructorError
_Loader.yaml_implicit_resolvers = {}
# The tags of the core schema alone. None is for all others, which are refused.
_Loader.yaml_constructors = {
    tag: constructor
    for tag, constructor in yaml.SafeLoader.yaml_constructors.items()
    if tag is None or tag.rpartition(":")[2] in {"null", "float", "seq", "str"}
}
for _name, _pattern, _first in _CORE_SCHEMA:
    for _class in (_Loader, _Dumper):
        _class.add_implicit_resolver(f"tag:yaml.org,2002:{_name}", re.compile(_pattern), list(_first))


def _construct_integer(loader: _Loader, node: yaml.ScalarNode) -> int:
    text = str(loader.construct_scalar(node))
    if len(text) > _LONGEST_INTEGER:
        fault = f"an integer of {len(text):,} characters; accepted: up to {_LONGEST_INTEGER}"
        raise _Fault(None, None, fault, node.start_mark)
    return int(text, 0) if text[:2] in ("0o", "0x") else int(text)


def _construct_switch(loader: _Loader, node: yaml.ScalarNode) -> bool:
    return {"true": True, "false": False}[str(loader.construct_scalar(node)).lower()]


def _construct_mapping(loader: _Loader, node: yaml.MappingNode) -> dict[Any, Any]:
    mapping: dict[Any, Any] = {}
    for key_node, value_node in node.value:
        key = loader.construct_object(key_node, deep=True)
        if not isinstance(key, str) or breaks_a_line(key):
            fault = f"the key {quoted(key)} is not a name in one line"
            raise _Fault(None, None, fault, key_node.start_mark)
        if key in mapping:
            fault = f"the key {quoted(key)} stands twice"
            raise _Fault(None, None, fault, key_node.start_mark)
        mapping[key] = loader.construct_object(value_node, deep=True)
    return mapping


_Loader.add_constructor("tag:yaml.org,2002:int", _construct_integer)
_Loader.add_constructor("tag:yaml.org,2002:bool", _construct_switch)
_Loader.add_constructor(yaml.resolver.BaseResolver.DEFAULT_MAPPING_TAG, _construct_mapping)


def load_yaml(
    path: Path,
    accepted: str = "a mapping of keys to values",
    *,
    first: bool = False,
    faults: list[ConfigError] | None = None,
) -> Section:
    """Read a YAML file whose top level is a mapping, as a Section; see `read_yaml`.

    Args:
        path: of the file.
        accepted: expected content, for messages.
        first: whether to read the first of several documents; otherwise there must be one.
        faults: collects refusals, see `Section`.
    """
    return Section(read_yaml(path, accepted, first=first), path, faults=faults)


def read_yaml(path: Path, accepted: str = "a mapping of keys to values", *, first: bool = False) -> dict[str, Any]:
    """Read a YAML file whose top level is a mapping.

    Args:
        path: of the file.
        accepted: expected content, for messages.
        first: whether to read the first of several documents; otherwise there must be one.
    """
    text = StringIO(_read(path))
    try:
        data = next(yaml.load_all(text, _Loader), None) if first else yaml.load(text, _Loader)
    except (yaml.YAMLError, ValueError, LookupError, TypeError, OverflowError, RecursionError) as error:
        # All but the first: PyYAML on a tag or an escape that its text does not fit, and on deep nesting.
        reason = plain(_IN_FILE.sub(", ", " ".join(str(error).split())), _LONGEST_REASON)
        raise ConfigError(f"{plain(path)}: not valid YAML ({reason})") from error
    if not isinstance(data, dict):
        content = "nothing" if data is None else "a list" if isinstance(data, list) else "a single value"
        raise ConfigError(f"{plain(path)}: holds {content}; accepted: {accepted}")
    return data


def yaml_value(text: str) -> Any:
    """Return the value of a text in YAML, as in a file."""
    try:
        return yaml.load(text, _Loader)
    except (yaml.YAMLError, ValueError, LookupError, TypeError, OverflowError, RecursionError) as error:
        raise ConfigError(f"{quoted(text)} is not valid YAML; accepted: a value as in a YAML file") from error


def yaml_lines(path: Path) -> dict[str, int]:
    """Return the line numbers, from 1 on, of the keys and items of a YAML file, by path such as `a.b[2].c`."""
    load_yaml(path, first=True)
    lines: dict[str, int] = {}
    _note_lines(next(yaml.compose_all(_read(path), _Loader)), "", lines)
    return lines


def _note_lines(node: yaml.Node, path: str, lines: dict[str, int]) -> None:
    if isinstance(node, yaml.MappingNode):
        for key, value in node.value:
            place = f"{path}{'.' * bool(path)}{key.value}"
            lines[place] = key.start_mark.line + 1
            _note_lines(value, place, lines)
    elif isinstance(node, yaml.SequenceNode):
        for i, item in enumerate(node.value):
            place = f"{path}[{i}]"
            lines[place] = item.start_mark.line + 1
            _note_lines(item, place, lines)


def _read(path: Path) -> str:
    try:
        with path.open("rb") as stream:
            content = stream.read(_MAX_BYTES + 1)
        if len(content) > _MAX_BYTES:
            raise ConfigError(f"{plain(path)}: larger than {_MAX_BYTES / (1 << 20):g} MiB; accepted: up to that")
        text = content.decode("utf-8")
    except (OSError, UnicodeDecodeError) as error:
        raise ConfigError(f"{plain(path)}: cannot be read ({getattr(error, 'strerror', error)})") from error
    separators = text.count(",") + text.count("\n")
    if separators > _MAX_VALUES:  # before it is parsed, which would take a minute
        what = f"has {separators:,} commas and line ends"
        raise ConfigError(f"{plain(path)}: {what}; accepted: up to {_MAX_VALUES:,}, and as many values")
    return text


def without_schema_line(text: str) -> str:
    """Return a file's text without the line that names its JSON schema for editors, by a path from its own folder."""
    return "".join(line for line in text.splitlines(keepends=True) if not line.startswith(_SCHEMA_LINE))


def check_numbers(content: object, most: float = math.inf, where: str = "") -> None:
    """Refuse plain data with a number that no file may hold.

    Args:
        content: mappings, lists and scalars.
        most: largest magnitude of a floating-point number.
        where: its place, for the message.
    """
    if isinstance(content, Mapping):
        for key, value in content.items():
            check_numbers(value, most, f"{where}{'.' if where else ''}{key}")
    elif isinstance(content, list | tuple):
        for k, value in enumerate(content):
            check_numbers(value, most, f"{where}[{k}]")
    elif isinstance(content, float) and not (math.isfinite(content) and abs(content) <= most):
        range_text = "finite numbers" if math.isinf(most) else f"finite numbers up to {most:g}"
        raise ConfigError(f"{plain(where)} is {content:g}, so the file is not written; accepted: {range_text}")


def yaml_text(content: Mapping[str, Any]) -> str:
    """Return plain data as YAML; `load_yaml` and readers of YAML 1.1 return the same bits.

    Lists and mappings without others inside are written on one line each.
    """
    check_numbers(content)
    return yaml.dump(content, Dumper=_Dumper, sort_keys=False, default_flow_style=None, width=118)


PROVENANCE = ("published", "derived", "assumed", "identified")
ABOUT = ("source", "provenance", "note")
"""Keys that every mapping may have: they speak of the values in it."""


class Section:
    """A mapping of a YAML file, with its place in the file for messages.

    A section may carry `source:` (a sentence) and `provenance:` (one of PROVENANCE), or a mapping from keys to these.
    `refuse_unknown()` refuses keys that nobody knows: a misspelt key must not fall back to a default.

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

    def get(self, key: str, accepted: str) -> Any:
        """Return the value of `key`, of any type; refuse a mapping without it."""
        self._used.add(key)
        if key not in self._data:
            raise ConfigError(f"{self.where(key)} is missing; accepted: {accepted}")
        return self._data[key]

    def refuse_unknown(self, known: Collection[str]) -> set[str]:
        """Refuse keys that are neither known nor have been read; return the known ones that they may be meant for."""
        unknown = self._data.keys() - self._used - set(known)
        accepted = sorted({*known, *self._used} - {*ABOUT})
        missing = [key for key in (*accepted, *ABOUT) if key not in self._data]
        meant: set[str] = set()
        for key in sorted(unknown):
            near = nearest(key, missing)
            meant.add(near)
            self.attempt(self.fault, key, f" is not a known key{question(near)}; accepted: {', '.join(accepted)}")
        return meant - {""}

    def refuse_misspelt(self, required: Collection[str]) -> set[str]:
        """Refuse keys that are much like required ones that are not there, where other keys are accepted, too."""
        missing = [key for key in required if key not in self._data]
        meant = {key: nearest(key, missing, _TYPING_ERROR) for key in self._data if missing and key not in required}
        for key, near in meant.items():
            if near:
                self.attempt(self.fault, key, f" is not a known key{question(near)}; accepted: {', '.join(required)}")
        return {*meant.values()} - {""}

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
