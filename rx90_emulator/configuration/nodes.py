"""The parameter files of the nodes, which `--params-file` and launch files take: `NODE: {ros__parameters: {…}}`.

They need ROS for the types that the nodes' declarations use.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

from pydantic import ValidationError

from friction_bench.node.bench_node import BenchParameters
from rx90_common.base.config import read_yaml
from rx90_common.base.errors import ConfigError, Rx90Error
from rx90_common.base.models import FileModel, JsonSchema, fault_lines, json_schema
from rx90_common.base.quoting import plain, quoted
from rx90_common.exchange.endpoints import PREFIX
from rx90_common.exchange.parameters import OF_ROS, NodeModel, flat
from rx90_controller.node.parameters import ControllerParameters, unused_parameters
from rx90_emulator.configuration.kinds import NODE_PARAMETERS, FileKind
from rx90_sim.node.parameters import SimulationParameters

NODES: dict[str, type[NodeModel]] = {
    "rx90_sim": SimulationParameters,
    "rx90_controller": ControllerParameters,
    "friction_bench": BenchParameters,
}
"""The parameters of each node once it is active."""
_PARAMETERS = "ros__parameters"
_CONSTRAINTS = "constraints"
"""Group of parameters named by the robot's joints."""
_SECTION: JsonSchema = {"anyOf": [{"required": [_PARAMETERS]}, {"additionalProperties": {"type": "object"}}]}
"""A mapping is a node's section, or a namespace that holds sections."""


def node_faults(node: str, given: Mapping[str, Any]) -> list[str]:
    """Return what is wrong with the parameters that a node, one of NODES, is given by name, a line for each.

    These are single values or, if those are right, what does not go together.
    """
    model = NODES[node]
    others = {name for name in given if name in OF_ROS or name.startswith(PREFIX)}
    if model is ControllerParameters:
        others |= {*unused_parameters(given)}
    content: dict[str, Any] = {}
    try:
        content = model.completed({name: value for name, value in given.items() if name not in others})
        model.model_validate(content).check_files()
    except ValidationError as error:
        return fault_lines(model, error, "", content)
    except Rx90Error as error:
        return [str(error).removeprefix("parameter ")]
    return []


def _sections_of(content: Mapping[str, Any], path: Path, above: str = "") -> Iterator[tuple[str, str, dict[str, Any]]]:
    """Yield the name of each node, without its namespace, the place of its parameters, and these by name."""
    for name, section in content.items():
        place = f"{above}{plain(name)}"
        parameters = section.get(_PARAMETERS) if isinstance(section, dict) else section
        if not isinstance(section, dict) or not isinstance(parameters, dict | None):
            key = f"{place}.{_PARAMETERS}" if isinstance(section, dict) else place
            raise ConfigError(f"{plain(path)}: {key} is {quoted(parameters)}; accepted: a mapping")
        if parameters is None:
            yield from _sections_of(section, path, f"{place}.")
        else:
            yield name.rpartition("/")[2], f"{place}.{_PARAMETERS}", flat(parameters)


class NodeFile(FileKind):
    """The kind of parameter files: sections of this project's nodes are checked, those of others are left alone."""

    def faults(self, path: Path, content: dict[str, Any]) -> list[ConfigError]:
        """Return what is wrong in the sections."""
        try:
            sections = [*_sections_of(content, path)]
        except ConfigError as error:
            return [error]
        return [
            ConfigError(f"{plain(path)}: {place}.{line}")
            for node, place, given in sections
            if node in NODES
            for line in node_faults(node, given)
        ]

    def json_schema(self) -> JsonSchema:
        """Return the parameters of each node, in any namespace."""
        nodes = {f"(^|/){node}$": _node_schema(node) for node in NODES}
        other = {"type": "object", "properties": {_PARAMETERS: {"type": "object"}}, **_SECTION}
        return {
            "$schema": "https://json-schema.org/draft/2020-12/schema",
            "title": f"{NODE_PARAMETERS.replace('_', ' ')} file of rx90_emulator",
            "description": "Parameters of nodes: a section for each, NODE: {ros__parameters: {...}}, in any namespace.",
            "type": "object",
            "patternProperties": nodes,
            "additionalProperties": other,
        }


def _read(path: Path) -> None:
    faults = NODE_FILE.faults(path, read_yaml(path))
    if faults:
        raise faults[0]


def _leaf_schemas(schema: JsonSchema, root: JsonSchema, before: str = "") -> dict[str, JsonSchema]:
    """Return the schemas of parameters by their names; those named by joints are left out."""
    found: dict[str, JsonSchema] = {}
    for name, inner in schema["properties"].items():
        resolved = {**root["$defs"].get(inner.get("$ref", "").rpartition("/")[2], {}), **inner}
        if name in FileModel.about_keys:
            continue
        if "properties" in resolved:
            found |= _leaf_schemas(resolved, root, f"{before}{name}.")
        else:
            found[f"{before}{name}"] = resolved
    return found


def _node_schema(node: str) -> JsonSchema:
    root = {"$defs": {}, **json_schema(NODES[node], "")}
    parameters = _names_schema(_leaf_schemas(root, root))
    parameters["properties"] |= {name: {"description": "Of every ROS node."} for name in OF_ROS}
    parameters["patternProperties"] = {f"^({PREFIX[:-1]}|{_CONSTRAINTS})(\\.|$)": {}}
    about = f"Parameters of the node {node}."
    return {"description": about, "type": "object", "properties": {_PARAMETERS: parameters}, **_SECTION}


def _names_schema(schemas: Mapping[str, JsonSchema]) -> JsonSchema:
    """Return the schema of a mapping of these names, in which any dot may be a mapping in a mapping instead."""
    properties = dict(schemas)
    for prefix in {name[:i] for name in schemas for i, letter in enumerate(name) if letter == "."}:
        inner = {name[len(prefix) + 1 :]: schema for name, schema in schemas.items() if name.startswith(f"{prefix}.")}
        properties[prefix] = _names_schema(inner)
        if prefix.partition(".")[0] == _CONSTRAINTS:
            properties[prefix]["additionalProperties"] = True
    return {"type": "object", "properties": dict(sorted(properties.items())), "additionalProperties": False}


NODE_FILE = NodeFile(NODE_PARAMETERS, NodeModel, _read)
"""The kind of parameter files."""
