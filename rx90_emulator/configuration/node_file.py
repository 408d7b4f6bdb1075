"""Parameter files of the nodes, as `--params-file` and launch files take them: `NODE: {ros__parameters: {…}}`."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

from rx90_common.base.config import load_yaml
from rx90_common.base.entries import Entry, JsonSchema
from rx90_common.base.errors import ConfigError, Rx90Error
from rx90_common.base.quoting import listed
from rx90_common.base.section import Section
from rx90_common.exchange.endpoints import PREFIX
from rx90_common.exchange.parameters import OF_ROS
from rx90_controller.node.parameters import has_no_use
from rx90_emulator.configuration.kinds import FileKind
from rx90_emulator.configuration.node_parameters import NODES, DeclaredParameters, declared

PARAMETERS = "ros__parameters"
_OF_ROBOT = ("robot", "urdf", "drives", "controller", "rig")
"""What decides which parameters there are."""
_CONSTRAINTS = "constraints"
"""Below it stand names of joints, which are the robot's."""


_SECTION: JsonSchema = {"anyOf": [{"required": [PARAMETERS]}, {"additionalProperties": {"type": "object"}}]}
"""What is no section of a node is a namespace, and holds such sections."""


@cache
def usual_parameters(node: str) -> DeclaredParameters:
    """Return the parameters of a node that is given none."""
    return declared(node)


def flat(content: Mapping[str, Any], before: str = "") -> dict[str, Any]:
    """Return parameters by their whole names: mappings in mappings stand for names with dots; an empty one stays."""
    found: dict[str, Any] = {}
    for key, value in content.items():
        found |= flat(value, f"{before}{key}.") if isinstance(value, dict) and value else {f"{before}{key}": value}
    return found


def sections_of(root: Section) -> Iterator[tuple[str, Section]]:
    """Yield the name of each node, its last part without a namespace, and its parameters.

    Raises:
        ConfigError: for what is no section of a node.
    """
    for name in root:
        section = root.section(name)
        if PARAMETERS in section:
            yield name.rpartition("/")[2], section.section(PARAMETERS)
        else:
            yield from sections_of(section)


@dataclass(frozen=True)
class NodeFile(Entry):
    """A parameter file: sections of this project's nodes are checked, those of others are left alone."""

    def read(self, root: Section) -> dict[str, dict[str, Any]]:
        """Return the parameters by node.

        Raises:
            ConfigError: naming file, node, parameter, value and what is accepted.
        """
        found: dict[str, dict[str, Any]] = {}
        nodes: list[tuple[str, Section]] = []
        root.attempt(lambda: nodes.extend(sections_of(root)))
        for node, section in nodes:
            given = {name: value for name, value in flat(section.content).items() if value != {} or _known(node, name)}
            found[node] = {**found.get(node, {}), **given}
            if node in NODES:
                _check(node, section, given)
        return found

    def rules(self) -> JsonSchema:
        """Return the parameters of each node, in any namespace."""
        nodes: JsonSchema = {f"(^|/){node}$": _node_schema(node) for node in NODES}
        other = {"type": "object", "properties": {PARAMETERS: {"type": "object"}}, **_SECTION}
        return {"type": "object", "patternProperties": nodes, "additionalProperties": other}


def _known(node: str, name: str) -> bool:
    return node in NODES and usual_parameters(node).has_parameter(name)


def _check(node: str, section: Section, given: Mapping[str, Any]) -> None:
    entries = dict(usual_parameters(node).entries)
    chosen = {name: given[name] for name in _OF_ROBOT if name in given and name in entries}
    if chosen:
        section.attempt(lambda: entries.update(declared(node, chosen).entries))
    names = Section(dict(given), section.file, section.path, [])
    fine = True
    for name in given:
        if name in OF_ROS or name.startswith(PREFIX) or (node == "rx90_controller" and has_no_use(name)):
            continue
        try:
            if name not in entries:
                names.fault(name, f" is unknown to {node}; accepted: {listed(entries)}")
            entries[name].take(names, name)
        except ConfigError as error:
            fine = False
            section.attempt(_refuse, error)
    if fine:
        section.attempt(_declare, node, section, given)


def _refuse(error: ConfigError) -> None:
    raise error


def _declare(node: str, section: Section, given: Mapping[str, Any]) -> None:
    try:
        declared(node, given)
    except Rx90Error as error:
        text = str(error).removeprefix("parameter ").removeprefix("parameter: ")
        raise ConfigError(f"{section.file}: {section.path}.{text}") from error


def _node_schema(node: str) -> JsonSchema:
    entries = usual_parameters(node).entries
    of_ros: JsonSchema = {name: {"description": "Of every ROS node."} for name in OF_ROS}
    parameters = _names_schema({name: entry.schema() for name, entry in entries.items()})
    parameters["properties"] |= of_ros
    parameters["patternProperties"] = {f"^({PREFIX[:-1]}|{_CONSTRAINTS})(\\.|$)": {}}
    return {
        "description": f"Parameters of the node {node}.",
        "type": "object",
        "properties": {PARAMETERS: parameters},
        **_SECTION,
    }


def _names_schema(schemas: Mapping[str, JsonSchema]) -> JsonSchema:
    """Return the schema of a mapping of these names, in which any dot may be a mapping in a mapping instead."""
    properties = dict(schemas)
    for prefix in {name[:i] for name in schemas for i, letter in enumerate(name) if letter == "."}:
        inner = {name[len(prefix) + 1 :]: schema for name, schema in schemas.items() if name.startswith(f"{prefix}.")}
        properties[prefix] = _names_schema(inner)
        if prefix.partition(".")[0] == _CONSTRAINTS:
            properties[prefix]["additionalProperties"] = True
    return {"type": "object", "properties": dict(sorted(properties.items())), "additionalProperties": False}


def _read(path: Path) -> object:
    return _NODE_ENTRY.read(load_yaml(path))


_NODE_ENTRY = NodeFile("Parameters of nodes: a section for each, NODE: {ros__parameters: {...}}, in any namespace.")
NODE_FILE = FileKind("node_parameters", _NODE_ENTRY, _read)
"""The kind of parameter files."""
