"""The node of the friction rig, real or emulated, and without ROS the check of a board that has just been built."""

from __future__ import annotations

import argparse

from rx90_common.base.errors import DONE, ConfigError
from rx90_common.base.quoting import plain
from rx90_common.base.share import SHIPPED_RIG
from rx90_emulator.cli import node
from rx90_emulator.cli.options import BAUD, add_verbs, new_file

BOARDS = ("8051", "nano")


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Accept arguments for ROS, or the verb."""
    add_verbs(
        parser, ((_add_check, check, "check each line, sign, scale and the watchdog of a board"),), required=False
    )
    node.add_arguments(parser)
    parser.usage = f"{parser.usage}\n       {parser.prog} check --port PORT ..."


def _add_check(parser: argparse.ArgumentParser) -> None:
    parser.set_defaults(interrupted="the torque is off")
    parser.add_argument("--port", required=True, help="serial device or URL")
    parser.add_argument("--baud", type=BAUD, help="line rate (the rig file's)")
    parser.add_argument("--rig", default=SHIPPED_RIG, metavar="FILE", help="rig file (%(default)s)")
    parser.add_argument("--board", choices=BOARDS, help="whose points are measured (the one of the processor)")
    parser.add_argument("--output", type=new_file, metavar="FILE", help="new YAML file of what was found")


def main(options: argparse.Namespace) -> int:
    """Run the node, or the verb.

    Raises:
        Rx90Error: as those say.
    """
    if options.verb is None:
        node.main(options)
        return DONE
    if options.ros_args:
        raise ConfigError(f"{plain(' '.join(options.ros_args))} with {options.verb}; accepted: with the node alone")
    return options.run(options)  # type: ignore[no-any-return]


def check(options: argparse.Namespace) -> int:
    """Check a freshly built board step by step: what to measure, what to expect, and a verdict.

    Before the stage is switched on the command asks. A line on standard input answers a question: Enter goes on, or
    leaves a measurement out; s skips the step. The exit code is 0 if all is as expected, 1 if something is not or was
    not measured, 3 if the rig does not answer.
    """
    from friction_bench.experiment.bring_up import run  # here, because --help must not wait for it

    return run(options)
