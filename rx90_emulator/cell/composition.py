"""Both nodes in one process, each with its name, topics, parameters and services, as composition is known in ROS.

In lock-step one thread ticks: it steps the plant, and the controller answers on it. In free-running time each node has
the ticking thread that it has in a process of its own.
"""

from __future__ import annotations

from collections.abc import Sequence

from rx90_common.base.errors import ConfigError
from rx90_common.exchange import node_tools
from rx90_common.exchange.local_link import LocalLink
from rx90_common.exchange.node_tools import TickingNode
from rx90_common.exchange.topics import LOCK_STEP
from rx90_controller.node.control import Control
from rx90_sim.node.simulation import Simulation


def spin(args: Sequence[str]) -> None:
    """Run both nodes until the simulation ends or they are interrupted.

    Raises:
        Rx90Error: for parameters that are refused, or what ends the ticks.
    """
    node_tools.spin(compose, args)


def compose() -> list[TickingNode]:
    """Make both nodes and connect them.

    Raises:
        Rx90Error: for parameters, names and remaps that are refused.
    """
    link = LocalLink()
    simulation = Simulation(link.end)
    control = Control(link.end, simulation.time_mode)
    name = simulation.node.get_fully_qualified_name()
    if name == control.node.get_fully_qualified_name():
        raise ConfigError(f"both nodes are named {name}; accepted: -r rx90_sim:__node:=... for one node alone")
    if simulation.time_mode.mode == LOCK_STEP:
        link.serve_with(control.hand_over())
    return [simulation, control]
