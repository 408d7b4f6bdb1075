"""The parameters of the nodes, as they declare them, without starting any; needs ROS for the types that they use."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

from friction_bench.node.bench_node import declare_bench_parameters
from rx90_common.base.entries import Entry, Integer, Number, Numbers, Switch, Text
from rx90_common.base.errors import ConfigError
from rx90_common.base.quoting import listed, plain, quoted
from rx90_common.base.section import Section
from rx90_common.description.robot import load_robot
from rx90_common.exchange.endpoints import PREFIX
from rx90_common.exchange.lifecycle import declare_autostart
from rx90_common.exchange.parameters import OF_ROS, declare_rates, declare_robot_files
from rx90_controller.node.parameters import FILE_PARAMETERS as CONTROLLER_FILES
from rx90_controller.node.parameters import (
    LAW_ENTRIES,
    LawParameters,
    declare_decimation,
    declare_goal_parameters,
    declare_horizon,
)
from rx90_sim.node.parameters import FILE_PARAMETERS as SIMULATION_FILES
from rx90_sim.node.parameters import declare_step_ticks, read_parameters

_LARGEST_INTEGER = 2**63 - 1


class DeclaredParameters:
    """Stands in for a node: keeps what is declared, with the values that are given.

    Args:
        given: values by name.

    Attributes:
        entries: of the parameters by name, their defaults among them.
        values: by name.
    """

    def __init__(self, given: Mapping[str, Any] | None = None) -> None:
        self.entries: dict[str, Entry] = {}
        self.values: dict[str, Any] = {}
        self._parameter_overrides = {
            name: SimpleNamespace(name=name, value=value, type_=None) for name, value in (given or {}).items()
        }

    def has_parameter(self, name: str) -> bool:
        """Return whether a parameter is declared."""
        return name in self.entries

    def get_parameter(self, name: str) -> SimpleNamespace:
        """Return a parameter."""
        return SimpleNamespace(value=self.values[name])

    def declare_parameter(self, name: str, default: Any, descriptor: Any) -> SimpleNamespace:
        """Declare a parameter; a given value that it cannot have is refused."""
        entry = self.entries[name] = _entry(default, descriptor)
        override = self._parameter_overrides.get(name)
        self.values[name] = value = default if override is None else _checked(name, entry, override.value)
        return SimpleNamespace(value=value)

    def refuse_unknown(self, node: str) -> None:
        """Refuse values given to parameters that were not declared.

        Raises:
            ConfigError: naming the first one, and those that there are.
        """
        for name in self._parameter_overrides:
            if name not in self.entries and name not in OF_ROS and not name.startswith(PREFIX):
                raise ConfigError(f"parameter {plain(name)} is unknown to {node}; accepted: {listed(self.entries)}")


def _entry(default: Any, descriptor: Any) -> Entry:
    about = f"{descriptor.description[:1].upper()}{descriptor.description[1:]}."
    if isinstance(default, bool):
        return Switch(about, default=default)
    if isinstance(default, int):
        low, high = _range(descriptor.integer_range, -_LARGEST_INTEGER, _LARGEST_INTEGER)
        return Integer(about, low=int(low), high=int(high), default=default)
    if isinstance(default, float):
        low, high = _range(descriptor.floating_point_range, -float("inf"), float("inf"))
        return Number(about, low=low, high=high, default=default)
    if isinstance(default, str):
        return Text(about, default=default)
    return Numbers(about, count=len(default), default=tuple(default))


def _range(ranges: Any, low: float, high: float) -> tuple[float, float]:
    return (ranges[0].from_value, ranges[0].to_value) if ranges else (low, high)


def _checked(name: str, entry: Entry, value: Any) -> Any:
    try:
        taken = entry.take(Section({name: value}, Path("parameter")), name)
    except ConfigError as error:
        raise ConfigError(str(error).replace("parameter: ", "parameter ", 1)) from error
    return list(taken) if isinstance(taken, tuple) else taken


def _simulation(node: Any) -> None:
    declare_autostart(node)
    read_parameters(node)
    declare_robot_files(node, *SIMULATION_FILES)
    declare_step_ticks(node)


def _controller(node: Any) -> None:
    declare_autostart(node)
    rates = declare_rates(node)
    files = declare_robot_files(node, *CONTROLLER_FILES)
    declare_horizon(node)
    declare_decimation(node)
    LawParameters(node, files.controller, lambda _: None)
    for name, entry in LAW_ENTRIES.items():  # which say more than a descriptor: the range of each number
        node.entries[name] = replace(entry, default=node.entries[name].default)
    declare_goal_parameters(node, load_robot(files.urdf).joint_names, rates)


def _bench(node: Any) -> None:
    declare_bench_parameters(node)


NODES: dict[str, Callable[[Any], None]] = {
    "rx90_sim": _simulation,
    "rx90_controller": _controller,
    "friction_bench": _bench,
}
"""What each node declares until it is active."""


def declared(node: str, given: Mapping[str, Any] | None = None) -> DeclaredParameters:
    """Return the parameters of a node with the values that they are given.

    Raises:
        ConfigError: naming parameter or file, value and what is accepted.
    """
    if node not in NODES:
        raise ConfigError(f"node {quoted(node)}; accepted: {listed(NODES)}")
    parameters = DeclaredParameters(given)
    NODES[node](parameters)
    parameters.refuse_unknown(node)
    return parameters
