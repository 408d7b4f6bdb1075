"""An example of a controller of one's own: computed torque with friction compensation, there and back."""

from __future__ import annotations

import argparse
import time
from typing import TYPE_CHECKING

from rx90_common.base.quoting import one_line
from rx90_emulator.cli.options import (
    POSITIVE,
    add_output,
    add_robot_arguments,
    add_verbs,
    new_folder,
    setup_of,
)

if TYPE_CHECKING:
    from rx90_emulator.loop.own_controller import ComputedTorque
    from rx90_emulator.loop.setup import Setup

_AMPLITUDE = 0.3  # rad, of every joint
_PERIOD = 4.0  # s, there and back
_NODES_EPILOG = """\
It drives a simulation that takes efforts at the joints:
  ros2 run rx90_emulator rx90_sim --ros-args -p command_interface:=joint
"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the verbs and their options."""
    parser.epilog = (
        "Robot, tool, drives and friction are the arm as the controller knows it; "
        "the simulation may have others."
    )
    parser.set_defaults(ros_args=[])
    add_verbs(parser, _VERBS)


def _add_engine(parser: argparse.ArgumentParser) -> None:
    _add_motion(parser)
    add_output(parser, new_folder, "bag to write; must not exist", metavar="FOLDER")


def _add_nodes(parser: argparse.ArgumentParser) -> None:
    parser.epilog = _NODES_EPILOG
    parser.formatter_class = argparse.RawDescriptionHelpFormatter
    _add_motion(parser)
    parser.add_argument("--timeout", type=POSITIVE, default=30.0, metavar="S",
                        help="s of the wall clock to wait for states (%(default)g)")  # fmt: skip


def _add_motion(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "--duration", type=POSITIVE, default=8.0, metavar="S", help="simulated time (%(default)g)"
    )
    parser.add_argument("--no-compensation", action="store_true", help="of the friction")
    add_robot_arguments(parser, "urdf", "tool", "drives", "friction")


def _engine(options: argparse.Namespace) -> None:
    """Drive an arm in this process, without ROS, with the same bits as the nodes."""
    from rx90_common.bags.writing import write_joint_states
    from rx90_emulator.loop.own_controller import run_controller

    setup, controller = _controller(options)
    run = run_controller(setup, controller, options.duration)
    if options.output is not None:
        write_joint_states(options.output, list(run.series.values()))
        print(one_line(f"bag: {options.output}"))
    _show(setup, controller)


def _nodes(options: argparse.Namespace) -> None:
    """Drive the arm of a running simulation."""
    setup, controller = _controller(options)
    _drive(controller, setup.robot.joint_names, options)
    _show(setup, controller)


def _controller(options: argparse.Namespace) -> tuple[Setup, ComputedTorque]:
    # Here, because --help must not wait for them.
    from rx90_emulator.loop.own_controller import ComputedTorque

    setup = setup_of(options)
    return setup, ComputedTorque(setup, _AMPLITUDE, _PERIOD, friction=not options.no_compensation)


def _show(setup: Setup, controller: ComputedTorque) -> None:
    """Print how well the arm followed."""
    import numpy as np

    errors = 1e3 * np.abs(np.array(controller.errors))
    for name, worst, rms in zip(
        setup.robot.joint_names, errors.max(axis=0), np.sqrt((errors**2).mean(axis=0)), strict=True
    ):
        print(f"{name}: worst tracking error {worst:.4f} mrad, RMS {rms:.4f} mrad")


def _drive(controller: ComputedTorque, names: tuple[str, ...], options: argparse.Namespace) -> None:
    from rx90_common.exchange.ros_start import prepare

    prepare()
    from rx90_common.base.errors import ExchangeError
    from rx90_common.exchange.client_node import client_node
    from rx90_common.exchange.topics import MEASURED_JOINT_STATES
    from rx90_sim.node.simulation_client import EffortController

    timeout = options.timeout
    with client_node(
        "own_controller", timeout, lambda text: print(text, flush=True), options.ros_args
    ) as client:
        node = EffortController(client.node, controller, names)
        topic = client.node.resolve_topic_name(MEASURED_JOINT_STATES)
        client.wait(
            lambda: node.time is not None,
            f"states on {topic}, of rx90_sim with command_interface joint,",
        )
        begin = node.time or 0.0
        calls = 0
        heard = time.monotonic()
        while (node.time or 0.0) - begin < options.duration:
            client.spin()
            if len(controller.errors) > calls:
                calls = len(controller.errors)
                heard = time.monotonic()
            elif time.monotonic() - heard > timeout:
                raise ExchangeError(
                    f"no states within {timeout:g} s; accepted: a simulation that runs"
                )
        controller.errors.pop()  # at the end itself, which a run in one process has not


_VERBS = (
    (_add_engine, _engine, "in this process, without ROS"),
    (_add_nodes, _nodes, "on a running simulation"),
)
