"""A ROS 2 node, or both of the arm in one process: see docs/reference/parameters.md and `ros2 param describe`."""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from argparse import (  # not before the frame has taken care of the signals
        ArgumentParser,
        Namespace,
    )

NODES = {
    "rx90_sim": "rx90_sim.node.simulation",
    "rx90_controller": "rx90_controller.node.controller_node",
    "rx90_cell": "rx90_emulator.composed_cell",
    "friction_bench": "friction_bench.node.bench_node",
}
"""The executables that are nodes, or two of them, and the module whose `spin(ros_args)` runs each."""


def add_arguments(parser: ArgumentParser) -> None:
    """Accept arguments for ROS alone."""
    parser.usage = (
        f"{parser.prog} [--ros-args [-p NAME:=VALUE ...] [-r FROM:=TO ...] [--params-file FILE]]"
    )
    parser.set_defaults(module=NODES[parser.prog], ros_args=[])


def main(options: Namespace) -> None:
    """Run the node until it ends or is interrupted."""
    from rx90_common.exchange.ros_start import prepare

    prepare()
    import_module(options.module).spin(options.ros_args)
