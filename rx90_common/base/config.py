"""The one reader and the one writer of YAML: every refusal names file, key, value and accepted range."""

from __future__ import annotations

import math
import re
from collections.abc import Iterator, Mapping, Sequence
from io import StringIO
from pathlib import Path
from typing import Any

import yaml

from rx90_common.base.errors import ConfigError
from rx90_common.base.quoting import plain, quoted

PROVENANCE = ("published", "derived", "assumed", "identified")

_MOST_BYTES = 16 << 20
_MOST_VALUES = 1_000_000  # counted as often as aliases repeat them; some 40,000 are read in a second
_DEEPEST = 64
_LONGEST_INTEGER = 400  # characters; the largest finite number has 309 digits
_LONGEST_REASON = 400


class Section:
    """A mapping of a YAML file, with its place in the file for messages.

    A section may carry `source:` (a sentence) and `provenance:` (one of PROVENANCE), or a mapping from keys to these.
    `finish()` refuses keys that were not read: a misspelt key must not fall back to a default.
    """

    def __init__(self, data: dict[str, Any], file: Path, path: str = "") -> None:
        self._data = data
        self.file = file
        self.path = path
        self._used = {"source", "provenance", "note"}
        provenance = data.get("provenance")
        for value in provenance.values() if isinstance(provenance, dict) else [provenance]:
            if value is not None and value not in PROVENANCE:
                self.refuse("provenance", value, f"one of {', '.join(PROVENANCE)}")

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

    def __contains__(self, key: str) -> bool:
        return key in self._data

    def __iter__(self) -> Iterator[str]:
        return iter(key for key in self._data if key not in {"source", "provenance", "note"})

    def holds_mapping(self, key: str) -> bool:
        """Return whether the value under `key` is itself a mapping."""
        return isinstance(self._data.get(key), dict)

    def _get(self, key: str, accepted: str) -> Any:
        self._used.add(key)
        if key not in self._data:
            raise ConfigError(f"{self.where(key)} is missing; accepted: {accepted}")
        return self._data[key]

    def section(self, key: str) -> Section:
        """Return the mapping under `key`."""
        value = self._get(key, "a mapping")
        if not isinstance(value, dict):
            self.refuse(key, value, "a mapping")
        return Section(value, self.file, f"{self.path}{'.' if self.path else ''}{key}")

    def sections(self, key: str) -> list[Section]:
        """Return the mappings in the list under `key`."""
        values = self._get(key, "a list of mappings")
        if not isinstance(values, list) or not all(isinstance(value, dict) for value in values):
            self.refuse(key, values, "a list of mappings")
        where = f"{self.path}{'.' if self.path else ''}{key}"
        return [Section(value, self.file, f"{where}[{i}]") for i, value in enumerate(values)]

    def number(self, key: str, low: float = -math.inf, high: float = math.inf, *, above: bool = False) -> float:
        """Return a finite number in [low, high], or in (low, high] with `above`."""
        accepted = _range_text(low, high, above)
        return self._check_number(key, self._get(key, accepted), low, high, above, accepted)

    def numbers(
        self, key: str, count: int, low: float = -math.inf, high: float = math.inf, *, above: bool = False
    ) -> tuple[float, ...]:
        """Return `count` finite numbers, each in [low, high] (or (low, high] with `above`)."""
        accepted = f"{count} numbers, each {_range_text(low, high, above)}"
        values = self._get(key, accepted)
        if not isinstance(values, Sequence) or isinstance(values, str) or len(values) != count:
            self.refuse(key, values, accepted)
        return tuple(self._check_number(f"{key}[{i}]", v, low, high, above, accepted) for i, v in enumerate(values))

    def rows(self, key: str, count: int) -> tuple[tuple[float, ...], ...]:
        """Return a list, not an empty one, of rows of `count` finite numbers."""
        accepted = f"a list of rows of {count} numbers"
        values = self._get(key, accepted)
        if not isinstance(values, list) or not values:
            self.refuse(key, values, accepted)
        names = [f"{key}[{i}]" for i in range(len(values))]
        inner = Section(dict(zip(names, values, strict=True)), self.file, self.path)
        return tuple(inner.numbers(name, count) for name in names)

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

    def finish(self) -> None:
        """Refuse keys that were not read."""
        unknown = sorted(set(self._data) - self._used)
        if unknown:
            known = ", ".join(sorted(self._used - {"source", "provenance", "note"}))
            raise ConfigError(f"{self.where(unknown[0])} is not a known key; accepted: {known}")

    def _check_number(self, key: str, value: Any, low: float, high: float, above: bool, accepted: str) -> float:
        if isinstance(value, bool) or not isinstance(value, int | float):
            self.refuse(key, value, accepted)
        try:
            number = float(value)
        except OverflowError:
            number = math.inf
        if not math.isfinite(number):
            self.refuse(key, value, accepted.replace("a number >", "a finite number >"))  # infinity is > 0, too
        if number > high or number < low or (above and number == low):
            self.refuse(key, value, accepted)
        return number


def _range_text(low: float, high: float, above: bool) -> str:
    if math.isinf(low) and math.isinf(high):
        return "a finite number"
    if math.isinf(high):
        return f"a number {'>' if above else '>='} {low:g}"
    return f"a number in {'(' if above else '['}{low:g}, {high:g}]"


class _Loader(yaml.SafeLoader):
    """Reads YAML 1.2 (core schema) with names as keys, and refuses a key written twice: one value would be lost.

    YAML 1.1, which PyYAML follows, reads 1e5 as a text, 1:30 as 90, 010 as 8, yes as true and 2001-01-01 as a date.
    Depth and number of values are limited, because a few lines of aliases can stand for more than a memory holds.
    """

    def __init__(self, stream: StringIO) -> None:
        super().__init__(stream)
        self._depth = 0
        self._values: dict[yaml.Node, int] = {}  # in each node that is complete, itself included

    def compose_node(self, parent: yaml.Node | None, index: Any) -> yaml.Node:
        """Compose the next node, within the limits."""
        event: Any = self.peek_event()  # type: ignore[no-untyped-call]
        if self._depth == _DEEPEST:
            raise _Fault(None, None, f"deeper than {_DEEPEST} levels", event.start_mark)
        self._depth += 1
        node: Any = super().compose_node(parent, index)
        self._depth -= 1
        if not isinstance(event, yaml.AliasEvent):
            self._values[node] = 1 + sum(self._values[child] for child in _children(node))
        elif node not in self._values:
            raise _Fault(None, None, f"{quoted(event.anchor)} stands for something that contains it", event.start_mark)
        if self._values[node] > _MOST_VALUES:
            raise _Fault(None, None, f"more than {_MOST_VALUES:,} values", event.start_mark)
        return node  # type: ignore[no-any-return]


def _children(node: yaml.Node) -> list[yaml.Node]:
    if isinstance(node, yaml.MappingNode):
        return [part for pair in node.value for part in pair]
    return node.value if isinstance(node, yaml.SequenceNode) else []


class _Dumper(yaml.SafeDumper):
    """Writes what YAML 1.1 and YAML 1.2 read alike: a text that either takes for something else is quoted."""

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
# The tags of the core schema alone. None is for all others, and refuses them.
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
        if not isinstance(key, str):
            fault = f"the key {quoted(key)} is not a name"
            raise _Fault(None, None, fault, key_node.start_mark)
        if key in mapping:
            fault = f"the key {quoted(key)} stands twice"
            raise _Fault(None, None, fault, key_node.start_mark)
        mapping[key] = loader.construct_object(value_node, deep=True)
    return mapping


_Loader.add_constructor("tag:yaml.org,2002:int", _construct_integer)
_Loader.add_constructor("tag:yaml.org,2002:bool", _construct_switch)
_Loader.add_constructor(yaml.resolver.BaseResolver.DEFAULT_MAPPING_TAG, _construct_mapping)


def load_yaml(path: Path, accepted: str = "a mapping of keys to values", *, first: bool = False) -> Section:
    """Read a YAML file whose top level is a mapping.

    Args:
        path: of the file.
        accepted: what it should hold, for messages.
        first: whether to read the first of several documents; otherwise there must be one.

    Raises:
        ConfigError: if the file is missing, unreadable, too large, not YAML or not a mapping.
    """
    text = StringIO(_read(path))
    try:
        data = next(yaml.load_all(text, _Loader), None) if first else yaml.load(text, _Loader)
    except (yaml.YAMLError, ValueError, LookupError, TypeError, OverflowError, RecursionError) as error:
        # All but the first: PyYAML on a tag or an escape that its text does not fit, and on deep nesting.
        reason = plain(" ".join(str(error).replace('in "<file>", ', "").split()), _LONGEST_REASON)
        raise ConfigError(f"{plain(path)}: not valid YAML ({reason})") from error
    if not isinstance(data, dict):
        raise ConfigError(f"{plain(path)}: holds {type(data).__name__}; accepted: {accepted}")
    return Section(data, path)


def _read(path: Path) -> str:
    try:
        with path.open("rb") as stream:
            content = stream.read(_MOST_BYTES + 1)
        if len(content) > _MOST_BYTES:
            raise ConfigError(f"{plain(path)}: larger than {_MOST_BYTES >> 20} MiB; accepted: up to that")
        return content.decode("utf-8")
    except (OSError, UnicodeDecodeError) as error:
        raise ConfigError(f"{plain(path)}: cannot be read ({getattr(error, 'strerror', error)})") from error


def check_numbers(content: object, most: float = math.inf, where: str = "") -> None:
    """Refuse plain data with a number that no file may hold.

    Args:
        content: mappings, lists and scalars.
        most: largest magnitude of a floating-point number.
        where: its place, for the message.

    Raises:
        ConfigError: naming place and value.
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
    """Return plain data as YAML; `load_yaml` and readers of YAML 1.1 give it back to the same bits.

    Lists and mappings without others inside stand on one line each.

    Raises:
        ConfigError: for a NaN or an infinity.
    """
    check_numbers(content)
    return yaml.dump(content, Dumper=_Dumper, sort_keys=False, default_flow_style=None, width=118)
