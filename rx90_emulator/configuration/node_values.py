"""What the nodes' parameters come to: parameter files and single values laid over what the code and the files say."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from rx90_common.base.config import load_yaml, yaml_lines, yaml_value
from rx90_common.base.errors import ConfigError
from rx90_common.base.quoting import quoted
from rx90_common.base.rates import Rates
from rx90_common.description.robot_files import FILES, RobotFiles
from rx90_emulator.configuration.node_file import NODE_FILE, flat, sections_of
from rx90_emulator.configuration.node_parameters import declared
from rx90_emulator.configuration.origins import COMMAND_LINE, OF_CODE, ShownValue, rig_values, setup_values, steps_value
from rx90_emulator.loop.setup import Setup

ARM_NODES = ("rx90_sim", "rx90_controller")
RIG_NODE = "friction_bench"
_NODES = (*ARM_NODES, RIG_NODE)
_ANY = "**"
_SHARED = ("robot", "base_rate", "position_rate", "urdf", "drives")
_LAW = ("servo.", "feed_forward.", "supervision.")
"""Parameters that are values of the controller file."""


@dataclass(frozen=True)
class GivenParameters:
    """Values that are given to the nodes of the arm and of the rig, and where, by node and name."""

    values: Mapping[str, dict[str, Any]] = field(default_factory=lambda: {node: {} for node in _NODES})
    origins: Mapping[str, dict[str, str]] = field(default_factory=lambda: {node: {} for node in _NODES})

    def give(self, node: str, name: str, value: Any, origin: str) -> None:
        """Give a parameter a value, over what it was given before; an empty file name is none."""
        if value == "" and name in FILES:
            self.values[node].pop(name, None)
            return
        self.values[node][name] = value
        self.origins[node][name] = origin

    @classmethod
    def of(cls, files: Iterable[Path], rules: Iterable[str]) -> GivenParameters:
        """Return what parameter files and rules [NODE:]NAME:=VALUE give, as ROS takes them: later ones win.

        Raises:
            ConfigError: naming file or rule, value and what is accepted.
        """
        given = cls()
        for path in files:
            given._read(path)
        for rule in rules:
            given._take(rule)
        return given

    def _read(self, path: Path) -> None:
        NODE_FILE.read(path)
        lines = yaml_lines(path)
        for node, section in sections_of(load_yaml(path)):
            for name, value in flat(section.content).items():
                if value == {}:  # a name's beginning with nothing behind it
                    continue
                origin = f"{path}:{lines.get(f'{section.path}.{name}', 0)}"
                for each in ARM_NODES if node == _ANY else (node,):
                    if each in _NODES:
                        self.give(each, name, value, origin)

    def _take(self, rule: str) -> None:
        left, sign, text = rule.partition(":=")
        node, _, name = left.rpartition(":")
        if not sign or not name or (node and node not in _NODES):
            accepted = f"[NODE:]NAME:=VALUE, NODE one of {', '.join(_NODES)}"
            raise ConfigError(f"-p {quoted(rule)}; accepted: {accepted}")
        value = yaml_value(text)
        nodes = [node] if node else [each for each in ARM_NODES if declared(each).has_parameter(name)]
        if not nodes:
            raise ConfigError(f"-p {quoted(rule)}: no parameter of {' or '.join(ARM_NODES)}; accepted: those in "
                              "rx90_config show")  # fmt: skip
        for each in nodes:
            self.give(each, name, value, COMMAND_LINE)


def node_setup(given: GivenParameters) -> list[ShownValue]:
    """Return what both nodes of the arm and the rig's come to, as they would read it.

    Raises:
        ConfigError: for what a node would refuse, and for nodes that do not fit each other.
    """
    found: list[ShownValue] = []
    files: dict[str, str] = {}
    shared: dict[str, Any] = {}
    chosen: dict[str, str] = {}
    law: dict[str, ShownValue] = {}
    substeps: int | None = None
    for node in ARM_NODES:
        parameters = declared(node, given.values[node])
        substeps = substeps or parameters.values.get("substeps")
        for name, value in parameters.values.items():
            origin = given.origins[node].get(name, OF_CODE) if name in given.values[node] else OF_CODE
            if name in _SHARED and shared.setdefault(name, value) != value:
                raise ConfigError(f"{name}: {shared[name]} and {value}; accepted: the same for both nodes")
            if name in FILES:
                origin = f"robot {parameters.values['robot']}" if origin == OF_CODE else origin
                files[name] = value
                chosen.setdefault(name, origin)
            if name.startswith(_LAW):
                law[f"controller.{name}"] = ShownValue(f"{node}.{name}", value, "", origin)
            else:
                found.append(ShownValue(f"{node}.{name}", value, "", origin))
    robot = RobotFiles.named(shared["robot"], **files)
    of_setup = [_with(one, law.get(one.name)) for one in setup_values(robot, chosen)]
    setup = Setup.load(robot, Rates(shared["base_rate"], shared["position_rate"]))
    return [*found, *of_setup, steps_value(setup, substeps or None), *_of_rig(given)]


def _of_rig(given: GivenParameters) -> list[ShownValue]:
    """Return the parameters of the rig's node and what its file comes to."""
    values, origins = given.values[RIG_NODE], given.origins[RIG_NODE]
    parameters = declared(RIG_NODE, values).values
    chosen = {name: origins[name] if name in values else OF_CODE for name in parameters}
    rig = str(parameters["rig"])
    if "baud" not in values:  # what the node takes where it is given none
        chosen["baud"] = f"rig {rig}"
    found = [ShownValue(f"{RIG_NODE}.{name}", value, "", chosen[name]) for name, value in parameters.items()]
    return found + rig_values(rig, chosen["rig"])


def _with(one: ShownValue, given: ShownValue | None) -> ShownValue:
    """Return a value of the controller file, or the one that the node was given instead."""
    if given is None or given.origin == OF_CODE:
        return one
    return one._replace(value=given.value, origin=given.origin, provenance="", source="")
