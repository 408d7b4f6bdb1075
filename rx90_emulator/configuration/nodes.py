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
from rx90_common.base.models import fault_lines
from rx90_common.base.quoting import plain, quoted
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


def node_faults(node: str, given: Mapping[str, Any]) -> list[str]:
    """Return what is wrong with the parameters that a node, one of NODES, is given by name, a line for each.

    These are single values or, if those are right, what does not go together.
    """
    model = NODES[node]
    others = {name for name in given if name in OF_ROS}
    if model is ControllerParameters:
        others |= {*unused_parameters(given)}
    content: dict[str, Any] = {}
    try:
        content = model.completed(
            {name: value for name, value in given.items() if name not in others}
        )
        model.model_validate(content).check_files()
    except ValidationError as error:
        return fault_lines(model, error, "", content)
    except Rx90Error as error:
        return [str(error).removeprefix("parameter ")]
    return []


def _sections_of(
    content: Mapping[str, Any], path: Path, above: str = ""
) -> Iterator[tuple[str, str, dict[str, Any]]]:
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


def _read(path: Path) -> None:
    faults = NODE_FILE.faults(path, read_yaml(path))
    if faults:
        raise faults[0]


NODE_FILE = NodeFile(NODE_PARAMETERS, NodeModel, _read)
"""The kind of parameter files."""
