"""The parameters of the nodes without starting any: what each declares, parameter files, and what a setup comes to.

It needs ROS for the types that the nodes' declarations use. Parameter files are those that `--params-file` and launch
files take: `NODE: {ros__parameters: {…}}`.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping
from functools import cache
from pathlib import Path
from typing import Any, NamedTuple

from pydantic import ValidationError

from friction_bench.node.bench_node import BenchParameters, bench_content
from rx90_common.base.config import read_yaml, yaml_lines, yaml_value
from rx90_common.base.errors import ConfigError, Rx90Error
from rx90_common.base.models import FileModel, JsonSchema, fault_lines, json_schema
from rx90_common.base.quoting import plain, quoted
from rx90_common.base.rates import Rates
from rx90_common.description.robot import load_robot
from rx90_common.description.robot_files import FILES, RobotFiles
from rx90_common.exchange.endpoints import PREFIX
from rx90_common.exchange.parameters import OF_ROS, NodeModel, flat, leaves, with_robot_files
from rx90_controller.law.parameters import load_controller
from rx90_controller.node.parameters import ControllerParameters, controller_content, unused_parameters
from rx90_emulator.configuration.kinds import NODE_PARAMETERS, FileKind
from rx90_emulator.configuration.origins import COMMAND_LINE, OF_CODE, ShownValue, rig_values, setup_values, steps_value
from rx90_emulator.loop.recorded_run import OF_LAW
from rx90_emulator.loop.setup import Setup
from rx90_sim.node.parameters import SimulationParameters

ARM_NODES = ("rx90_sim", "rx90_controller")
RIG_NODE = "friction_bench"
_PARAMETERS = "ros__parameters"
_CONSTRAINTS = "constraints"
"""Group of parameters named by the robot's joints."""
_EVERY_NODE = "**"
_SHARED = ("robot", "base_rate", "position_rate", "urdf", "drives")
_SECTION: JsonSchema = {"anyOf": [{"required": [_PARAMETERS]}, {"additionalProperties": {"type": "object"}}]}
"""A mapping is a node's section, or a namespace that holds sections."""


class NodeKind(NamedTuple):
    """Parameters of a node.

    Attributes:
        model: of them.
        content: returns what they come to, unchecked, for those that are given by name; raises Rx90Error.
    """

    model: type[NodeModel]
    content: Callable[[Mapping[str, Any]], dict[str, Any]]


def _simulation_content(given: Mapping[str, Any]) -> dict[str, Any]:
    return with_robot_files(SimulationParameters, given)


NODES: dict[str, NodeKind] = {
    "rx90_sim": NodeKind(SimulationParameters, _simulation_content),
    "rx90_controller": NodeKind(ControllerParameters, controller_content),
    RIG_NODE: NodeKind(BenchParameters, bench_content),
}
"""The parameters of each node once it is active."""


def _of_project(node: str, given: Mapping[str, Any]) -> dict[str, Any]:
    """Return the given parameters that are not rclpy's, nor unused."""
    others = {name for name in given if name in OF_ROS or name.startswith(PREFIX)}
    if node == "rx90_controller":
        others |= {*unused_parameters(given)}
    return {name: value for name, value in given.items() if name not in others}


def node_values(node: str, given: Mapping[str, Any]) -> NodeModel:
    """Return the parameters of a node, one of NODES, for those that it is given by name.

    Raises:
        ConfigError: naming the parameter, its value and what is accepted.
    """
    kind = NODES[node]
    content = kind.content(_of_project(node, given))
    try:
        values = kind.model.model_validate(content)
    except ValidationError as error:
        raise ConfigError(f"parameter {fault_lines(kind.model, error, '', content)[0]}") from None
    if isinstance(values, SimulationParameters):
        files = values.files()
        values.start(load_robot(files.urdf, files.tool))
    if isinstance(values, ControllerParameters):
        values.law(load_controller(values.files().controller))
    return values


def _node_faults(node: str, path: Path, place: str, given: Mapping[str, Any]) -> list[ConfigError]:
    """Return what is wrong with the parameters of a node in a file: single values, or if those are right, together."""
    kind = NODES[node]
    where = f"{plain(path)}: {place}"
    used = _of_project(node, given)
    try:
        content = kind.content(used)
        kind.model.model_validate(content)
        node_values(node, given)
    except ValidationError as error:
        return [ConfigError(f"{where}.{line}") for line in fault_lines(kind.model, error, "", content)]
    except Rx90Error as error:
        return [ConfigError(f"{where}.{str(error).removeprefix('parameter ').removeprefix('parameter: ')}")]
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
            fault
            for node, place, given in sections
            if node in NODES
            for fault in _node_faults(node, path, place, given)
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
    root = {"$defs": {}, **json_schema(NODES[node].model, "")}
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


@cache
def _default_names(node: str) -> frozenset[str]:
    return frozenset(name for name, _, _ in leaves(node_values(node, {})))


Given = dict[str, dict[str, tuple[Any, str]]]
"""By node and name: the value that a parameter is given, and where."""


def given_parameters(files: Iterable[Path], rules: Iterable[str]) -> Given:
    """Return what parameter files and rules [NODE:]NAME:=VALUE give the nodes, as ROS takes them: later ones win."""
    given: Given = {node: {} for node in NODES}

    def give(nodes: Iterable[str], name: str, value: Any, origin: str) -> None:
        for node in nodes:
            given[node][name] = value, origin
            if value == "" and name in FILES:  # an empty file name is none
                del given[node][name]

    for path in files:
        NODE_FILE.read(path)
        lines = yaml_lines(path)
        for node, place, values in _sections_of(read_yaml(path), path):
            nodes = ARM_NODES if node == _EVERY_NODE else [node] if node in given else []
            for name, value in values.items():
                if value != {}:  # a name's beginning with nothing behind it
                    give(nodes, name, value, f"{path}:{lines.get(f'{place}.{name}', 0)}")
    for rule in rules:
        left, sign, text = rule.partition(":=")
        node, _, name = left.rpartition(":")
        if not sign or not name or (node and node not in NODES):
            accepted = f"[NODE:]NAME:=VALUE, NODE one of {', '.join(NODES)}"
            raise ConfigError(f"-p {quoted(rule)}; accepted: {accepted}")
        nodes = [node] if node else [each for each in ARM_NODES if name in _default_names(each)]
        if not nodes:
            raise ConfigError(
                f"-p {quoted(rule)}: no parameter of {' or '.join(ARM_NODES)}; accepted: those in rx90_config show"
            )
        give(nodes, name, yaml_value(text), COMMAND_LINE)
    return given


def node_setup(given: Given) -> list[ShownValue]:
    """Return what both nodes of the arm and the rig's come to, as they would read it."""

    def values_of(node: str) -> dict[str, tuple[Any, str]]:
        parameters = node_values(node, {name: value for name, (value, _) in given[node].items()})
        values = {name: list(value) if isinstance(value, tuple) else value for name, value, _ in leaves(parameters)}
        return {name: (value, given[node].get(name, (value, OF_CODE))[1]) for name, value in values.items()}

    found: list[ShownValue] = []
    shared: dict[str, Any] = {}
    files: dict[str, tuple[str, str]] = {}
    law: dict[str, tuple[Any, str]] = {}
    substeps: int | None = None
    for node in ARM_NODES:
        parameters = values_of(node)
        substeps = substeps or parameters.get("substeps", (None, ""))[0]
        for name, (value, stated) in parameters.items():
            origin = stated
            if name in _SHARED and shared.setdefault(name, value) != value:
                raise ConfigError(f"{name}: {shared[name]} and {value}; accepted: the same for both nodes")
            if name in FILES:
                origin = f"robot {parameters['robot'][0]}" if origin == OF_CODE else origin
                files[name] = value, files.get(name, (value, origin))[1]
            if not name.startswith(OF_LAW):
                found.append(ShownValue(f"{node}.{name}", value, "", origin))
            elif origin != OF_CODE:
                law[f"controller.{name}"] = value, origin
    robot = RobotFiles.named(shared["robot"], **{name: value for name, (value, _) in files.items()})
    for one in setup_values(robot, {name: origin for name, (_, origin) in files.items()}):
        value, origin = law.get(one.name, (one.value, ""))
        found.append(one._replace(value=value, origin=origin, provenance="", source="") if origin else one)
    found.append(steps_value(Setup.load(robot, Rates(shared["base_rate"], shared["position_rate"])), substeps or None))
    of_rig = values_of(RIG_NODE)
    rig, chosen = of_rig["rig"]
    if of_rig["baud"][1] == OF_CODE:  # what the node takes where it is given none
        of_rig["baud"] = of_rig["baud"][0], f"rig {rig}"
    found += [ShownValue(f"{RIG_NODE}.{name}", value, "", origin) for name, (value, origin) in of_rig.items()]
    return found + rig_values(str(rig), chosen)
