"""Both nodes in one process, each with its name, topics, parameters and services, as composition is known in ROS.

In lock-step one thread ticks: it steps the plant, and the controller answers on it. In free-running time each node has
the ticking thread that it has in a process of its own.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from functools import partial
from itertools import pairwise

from rx90_common.base.errors import ConfigError
from rx90_common.base.quoting import quoted
from rx90_common.exchange import lifecycle
from rx90_common.exchange.channel import LocalLink
from rx90_common.exchange.lifecycle import Managed, TickingNode, started
from rx90_common.exchange.topics import MOTOR_INTERFACE, MOTOR_STATES
from rx90_controller.node.controller_node import ControllerNode
from rx90_sim.node.simulation import Simulation

SIMULATION = "rx90_sim"
CONTROLLER = "rx90_controller"
_PARAMETER = re.compile(r"(?P<node>[^:]*):(?P<assignment>[^:]+:=.*)", re.DOTALL)


def spin(args: Sequence[str]) -> None:
    """Run both nodes until the simulation ends or they are interrupted."""
    lifecycle.spin(partial(compose, own_parameters(args)), args)


def own_parameters(args: Sequence[str]) -> dict[str, list[str]]:
    """Return the arguments for each node alone, from `-p NODE:NAME:=VALUE`.

    ROS takes NODE for a node in the root namespace, and says nothing where there is none of that name.
    """
    own: dict[str, list[str]] = {SIMULATION: [], CONTROLLER: []}
    for option, word in pairwise(args):
        match = _PARAMETER.fullmatch(word) if option in {"-p", "--param"} else None
        if match is not None:
            if match["node"] not in own:
                raise ConfigError(
                    f"-p {quoted(word)}: no such node here; accepted: {', '.join(own)}"
                )
            own[match["node"]] += ["-p", match["assignment"]]
    return {node: ["--ros-args", *words] if words else [] for node, words in own.items()}


def compose(own: Mapping[str, Sequence[str]]) -> list[TickingNode]:
    """Make both nodes, each with arguments for ROS of its own, and connect them."""
    link = LocalLink()
    simulation = Simulation(link.end, own[SIMULATION])
    interface = simulation.node.get_parameter("command_interface").value
    if interface != MOTOR_INTERFACE:
        raise ConfigError(
            f"parameter command_interface is {quoted(interface)} with {CONTROLLER} in the same process; accepted: "
            f"{MOTOR_INTERFACE}, or {SIMULATION} alone"
        )
    control = ControllerNode(link.end, own[CONTROLLER], local=True)
    name = simulation.node.get_fully_qualified_name()
    if name == control.node.get_fully_qualified_name():
        raise ConfigError(
            f"both nodes are named {name}; accepted: -r {SIMULATION}:__node:=... for one node alone"
        )
    link.served = MOTOR_STATES
    link.serve = control.answer
    simulation.lead(control.follow, lambda: control.publishers)
    members: list[Managed] = [simulation, control]
    return [*started(members)]
