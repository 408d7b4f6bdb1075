"""The parameters of the nodes without starting any: what each declares, parameter files, and what a setup comes to.

It needs ROS for the types that the nodes' declarations use. Parameter files are those that `--params-file` and launch
files take: `NODE: {ros__parameters: {…}}`.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from types import SimpleNamespace
from typing import Any

from friction_bench.node.bench_node import declare_bench_parameters
from rx90_common.base.config import Section, load_yaml, yaml_lines, yaml_value
from rx90_common.base.entries import PER_JOINT, Entry, Integer, JsonSchema, Number, Numbers, Switch, Text
from rx90_common.base.errors import ConfigError, Rx90Error
from rx90_common.base.quoting import listed, nearest, plain, question, quoted
from rx90_common.base.rates import Rates
from rx90_common.description.robot import load_robot
from rx90_common.description.robot_files import FILES, RobotFiles
from rx90_common.exchange.endpoints import PREFIX
from rx90_common.exchange.lifecycle import declare_autostart
from rx90_common.exchange.parameters import OF_ROS, declare_rates, declare_robot_files
from rx90_controller.law.parameters import FeedForward, Servo, Supervision
from rx90_controller.node.parameters import FILE_PARAMETERS as CONTROLLER_FILES
from rx90_controller.node.parameters import (
    declare_goal_parameters,
    declare_law,
    declare_own,
    is_unused,
)
from rx90_emulator.configuration.kinds import NODE_PARAMETERS, FileKind
from rx90_emulator.configuration.origins import COMMAND_LINE, OF_CODE, ShownValue, rig_values, setup_values, steps_value
from rx90_emulator.loop.recorded_run import OF_LAW
from rx90_emulator.loop.setup import Setup
from rx90_sim.node.parameters import FILE_PARAMETERS as SIMULATION_FILES
from rx90_sim.node.parameters import declare_step_ticks, read_parameters

ARM_NODES = ("rx90_sim", "rx90_controller")
RIG_NODE = "friction_bench"
_PARAMETERS = "ros__parameters"
_LARGEST_INTEGER = 2**63 - 1
_DECIDING = ("robot", "urdf", "drives", "controller", "rig")
"""Parameters that decide which other parameters a node has."""
_CONSTRAINTS = "constraints"
"""Group of parameters named by the robot's joints."""
_EVERY_NODE = "**"
_SHARED = ("robot", "base_rate", "position_rate", "urdf", "drives")
_SECTION: JsonSchema = {"anyOf": [{"required": [_PARAMETERS]}, {"additionalProperties": {"type": "object"}}]}
"""A mapping is a node's section, or a namespace that holds sections."""


class DeclaredParameters:
    """Stands in for a node: keeps what is declared, with the values that are given.

    Args:
        given: values by name.

    Attributes:
        entries: of the parameters by name, their defaults among them.
        values: by name.
    """

    def __init__(self, given: Mapping[str, Any]) -> None:
        self.entries: dict[str, Entry] = {}
        self.values: dict[str, Any] = {}
        self._parameter_overrides = {
            name: SimpleNamespace(name=name, value=value, type_=None) for name, value in given.items()
        }

    def has_parameter(self, name: str) -> bool:
        """Return whether a parameter is declared."""
        return name in self.entries

    def get_parameter(self, name: str) -> SimpleNamespace:
        """Return a parameter."""
        return SimpleNamespace(value=self.values[name])

    def declare_parameter(self, name: str, default: Any, descriptor: Any) -> SimpleNamespace:
        """Declare a parameter; a given value that it cannot have is refused."""
        about = f"{descriptor.description[:1].upper()}{descriptor.description[1:]}."
        kind = type(default)
        (span,) = (*descriptor.integer_range, *descriptor.floating_point_range)[:1] or (None,)
        bounds = {} if span is None else {"low": span.from_value, "high": span.to_value}
        if kind is list:
            self.entries[name] = Numbers(about, count=PER_JOINT, default=tuple(default))
        elif kind is int:
            limits = {"low": -_LARGEST_INTEGER, "high": _LARGEST_INTEGER, **bounds}
            self.entries[name] = Integer(about, **limits, default=default)
        else:
            self.entries[name] = {bool: Switch, float: Number, str: Text}[kind](about, **bounds, default=default)
        value = default
        if name in self._parameter_overrides:
            section = Section({name: self._parameter_overrides[name].value}, Path("parameter"))
            try:
                value = self.entries[name].take(section, name)
            except ConfigError as error:
                raise ConfigError(str(error).replace("parameter: ", "parameter ", 1)) from error
        self.values[name] = list(value) if isinstance(value, tuple) else value
        return self.get_parameter(name)


def _declare_simulation(node: Any) -> None:
    declare_autostart(node)
    parameters = read_parameters(node)
    files = declare_robot_files(node, *SIMULATION_FILES)
    declare_step_ticks(node)
    parameters.start(load_robot(files.urdf, files.tool))


def _declare_controller(node: Any) -> None:
    declare_autostart(node)
    declare_rates(node)
    files = declare_robot_files(node, *CONTROLLER_FILES)
    declare_own(node)
    declare_law(node, files.controller)
    declare_goal_parameters(node, load_robot(files.urdf).joint_names)


NODES: dict[str, Callable[[Any], object]] = {
    "rx90_sim": _declare_simulation,
    "rx90_controller": _declare_controller,
    RIG_NODE: declare_bench_parameters,
}
"""What each node declares until it is active."""


def declared(node: str, given: Mapping[str, Any] | None = None) -> DeclaredParameters:
    """Return the parameters of a node, one of NODES, with the values that they are given."""
    parameters = DeclaredParameters(given or {})
    NODES[node](parameters)
    # What is still there: a node takes out what it has no use for.
    for name in parameters._parameter_overrides:
        if name not in parameters.entries and name not in OF_ROS and not name.startswith(PREFIX):
            asked = question(nearest(name, parameters.entries))
            accepted = listed(parameters.entries)
            raise ConfigError(f"parameter {plain(name)} is unknown to {node}{asked}; accepted: {accepted}")
    return parameters


_declared_by_default = cache(declared)


def _flat(content: Mapping[str, Any], before: str = "") -> dict[str, Any]:
    """Return parameters by their full names, a dot for each nested mapping; an empty mapping is kept as a value."""
    found: dict[str, Any] = {}
    for key, value in content.items():
        found |= _flat(value, f"{before}{key}.") if isinstance(value, dict) and value else {f"{before}{key}": value}
    return found


def _sections_of(root: Section) -> Iterator[tuple[str, Section]]:
    """Yield the name of each node, its last part without a namespace, and its parameters."""
    for name in root:
        section = root.section(name)
        if _PARAMETERS in section:
            yield name.rpartition("/")[2], section.section(_PARAMETERS)
        else:
            yield from _sections_of(section)


@dataclass(frozen=True)
class NodeFile(Entry):
    """A parameter file: sections of this project's nodes are checked, those of others are left alone."""

    def read(self, root: Section) -> None:
        """Check a file."""
        nodes: list[tuple[str, Section]] = []
        root.attempt(lambda: nodes.extend(_sections_of(root)))
        for node, section in nodes:
            if node in NODES:
                _check_section(node, section)

    def rules(self) -> JsonSchema:
        """Return the parameters of each node, in any namespace."""
        nodes: JsonSchema = {f"(^|/){node}$": _node_schema(node) for node in NODES}
        other = {"type": "object", "properties": {_PARAMETERS: {"type": "object"}}, **_SECTION}
        return {"type": "object", "patternProperties": nodes, "additionalProperties": other}


def _check_section(node: str, section: Section) -> None:
    """Check the parameters of a node one by one and, if there is nothing wrong with them, together."""
    entries = dict(_declared_by_default(node).entries)
    given = {name: value for name, value in _flat(section.content).items() if value != {} or name in entries}
    chosen = {name: given[name] for name in _DECIDING if name in given and name in entries}
    if chosen:
        section.attempt(lambda: entries.update(declared(node, chosen).entries))
    faults: list[ConfigError] = []
    names = Section(given, section.file, section.path, faults)

    def check(name: str) -> None:
        if name not in entries:
            asked = question(nearest(name, entries))
            names.fault(name, f" is unknown to {node}{asked}; accepted: {listed(entries)}")
        entries[name].take(names, name)

    for name in given:
        if not (name in OF_ROS or name.startswith(PREFIX) or (node == "rx90_controller" and is_unused(name))):
            names.attempt(check, name)
    if not faults:
        try:
            declared(node, given)
        except Rx90Error as error:
            text = str(error).removeprefix("parameter ").removeprefix("parameter: ")
            faults.append(ConfigError(f"{section.file}: {section.path}.{text}"))
    for fault in faults:
        section.attempt(_refuse, fault)


def _refuse(error: ConfigError) -> None:
    raise error


def _node_schema(node: str) -> JsonSchema:
    entries = _declared_by_default(node).entries
    schemas = {name: entry.schema() for name, entry in entries.items()}
    for block, model in (("servo", Servo), ("feed_forward", FeedForward), ("supervision", Supervision)):
        for key, schema in model.model_json_schema()["properties"].items():
            if f"{block}.{key}" in entries:
                schemas[f"{block}.{key}"] = schema
    parameters = _names_schema(schemas)
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


_ENTRY = NodeFile("Parameters of nodes: a section for each, NODE: {ros__parameters: {...}}, in any namespace.")
NODE_FILE = FileKind(NODE_PARAMETERS, _ENTRY, lambda path: _ENTRY.read(load_yaml(path)))
"""The kind of parameter files."""

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
        for node, section in _sections_of(load_yaml(path)):
            nodes = ARM_NODES if node == _EVERY_NODE else [node] if node in given else []
            for name, value in _flat(section.content).items():
                if value != {}:  # a name's beginning with nothing behind it
                    give(nodes, name, value, f"{path}:{lines.get(f'{section.path}.{name}', 0)}")
    for rule in rules:
        left, sign, text = rule.partition(":=")
        node, _, name = left.rpartition(":")
        if not sign or not name or (node and node not in NODES):
            accepted = f"[NODE:]NAME:=VALUE, NODE one of {', '.join(NODES)}"
            raise ConfigError(f"-p {quoted(rule)}; accepted: {accepted}")
        nodes = [node] if node else [each for each in ARM_NODES if name in _declared_by_default(each).entries]
        if not nodes:
            raise ConfigError(
                f"-p {quoted(rule)}: no parameter of {' or '.join(ARM_NODES)}; accepted: those in rx90_config show"
            )
        give(nodes, name, yaml_value(text), COMMAND_LINE)
    return given


def node_setup(given: Given) -> list[ShownValue]:
    """Return what both nodes of the arm and the rig's come to, as they would read it."""

    def values_of(node: str) -> dict[str, tuple[Any, str]]:
        values = declared(node, {name: value for name, (value, _) in given[node].items()}).values
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
