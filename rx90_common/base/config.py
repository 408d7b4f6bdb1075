"""The one reader and the one writer of YAML 1.2, with limits on size and depth."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping
from io import StringIO
from pathlib import Path
from typing import Any

import yaml

from rx90_common.base.errors import ConfigError
from rx90_common.base.quoting import breaks_a_line, plain, quoted
from rx90_common.base.text_lines import read_text

# What is read in two seconds: letters, and values, as often as aliases repeat them.
_MAX_BYTES = 3 << 20
_MAX_VALUES = 150_000
_DEEPEST = 64
_LONGEST_INTEGER = 400  # characters; the largest finite number has 309 digits
_IN_FILE = re.compile(r',? in "<file>", ')
_LONGEST_REASON = 400


class _Loader(yaml.composer.Composer, yaml.CSafeLoader):
    """Reads YAML 1.2 (core schema) with names as keys, and refuses repeated keys, because one value would be lost.

    YAML 1.1, which PyYAML follows, reads 1e5 as a text, 1:30 as 90, 010 as 8, yes as true and 2001-01-01 as a date.
    Depth and number of values are limited, because a few lines of aliases can expand to more than the memory. libyaml
    parses; the composer, which counts, is PyYAML's own.
    """

    def __init__(self, stream: StringIO, numbered: bool) -> None:
        yaml.CSafeLoader.__init__(self, stream)
        yaml.composer.Composer.__init__(self)
        self.keys: Any = (str, int) if numbered else str  # their types
        self._depth = 0
        self._count = 0  # of values so far
        self._values: dict[
            yaml.Node, int
        ] = {}  # in each node that has an anchor and is complete, itself included

    def compose_node(self, parent: yaml.Node | None, index: Any) -> yaml.Node:
        """Compose the next node, within the limits."""
        event: Any = self.peek_event()
        if self._depth == _DEEPEST:
            raise _Fault(None, None, f"deeper than {_DEEPEST} levels", event.start_mark)
        before = self._count
        self._count += 1
        self._depth += 1
        node: Any = super().compose_node(parent, index)
        self._depth -= 1
        if isinstance(event, yaml.AliasEvent):
            if node not in self._values:
                fault = f"{quoted(event.anchor)} stands for something that contains it"
                raise _Fault(None, None, fault, event.start_mark)
            self._count = before + self._values[node]
        elif event.anchor is not None:
            self._values[node] = self._count - before
        if self._count > _MAX_VALUES:
            raise _Fault(None, None, f"more than {_MAX_VALUES:,} values", event.start_mark)
        return node  # type: ignore[no-any-return]


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
        _class.add_implicit_resolver(
            f"tag:yaml.org,2002:{_name}", re.compile(_pattern), list(_first)
        )


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
        if not isinstance(key, loader.keys) or breaks_a_line(str(key)):
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


def read_yaml(
    path: Path,
    accepted: str = "a mapping of keys to values",
    *,
    first: bool = False,
    numbered: bool = False,
    lines: dict[str, int] | None = None,
) -> dict[str, Any]:
    """Read a YAML file whose top level is a mapping.

    Args:
        path: of the file.
        accepted: expected content, for messages.
        first: whether to read the first of several documents; otherwise there must be one.
        numbered: whether keys may be integers, too.
        lines: filled with the line numbers, from 1 on, of keys and items, by `a.b[2].c`.
    """
    text = _read(path)
    try:
        loader = _Loader(StringIO(text), numbered)
        node: Any = loader.check_node() and loader.get_node() if first else loader.get_single_node()
        data = loader.construct_document(node) if node else None
    except (
        yaml.YAMLError,
        ValueError,
        LookupError,
        TypeError,
        OverflowError,
        RecursionError,
    ) as error:
        # All but the first: PyYAML on a tag or an escape that its text does not fit, and on deep nesting.
        reason = plain(_IN_FILE.sub(", ", " ".join(str(error).split())), _LONGEST_REASON)
        raise ConfigError(f"{plain(path)}: not valid YAML ({reason})") from error
    if not isinstance(data, dict):
        content = (
            "nothing" if data is None else "a list" if isinstance(data, list) else "a single value"
        )
        raise ConfigError(f"{plain(path)}: holds {content}; accepted: {accepted}")
    if lines is not None:
        _note_lines(node, "", lines)
    return data


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
    text = read_text(path, _MAX_BYTES)
    separators = text.count(",") + text.count("\n")
    if separators > _MAX_VALUES:  # before it is parsed, which would take a minute
        what = f"has {separators:,} commas and line ends"
        raise ConfigError(
            f"{plain(path)}: {what}; accepted: up to {_MAX_VALUES:,}, and as many values"
        )
    return text


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
        raise ConfigError(
            f"{plain(where)} is {content:g}, so the file is not written; accepted: {range_text}"
        )


def yaml_text(content: Mapping[str, Any]) -> str:
    """Return plain data as YAML; `read_yaml` and readers of YAML 1.1 return the same bits.

    Lists and mappings without others inside are written on one line each.
    """
    check_numbers(content)
    return yaml.dump(content, Dumper=_Dumper, sort_keys=False, default_flow_style=None, width=118)
