"""Plan the motions that friction is identified from, and run them on the engine or the nodes."""

from __future__ import annotations

import argparse
from pathlib import Path

from rx90_common.base.quoting import one_line
from rx90_common.description.robot_files import MODEL_FILES
from rx90_emulator.cli.options import add_node_arguments, add_robot_arguments

_EPILOG = """\
Bags that are complete stay, whatever ends the run. No motion is checked for collisions. Set-points keep the joints'
ranges and speed limits, and the expected torque keeps what the URDF allows.
"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the verbs and their options."""
    parser.epilog = _EPILOG
    parser.set_defaults(interrupted="complete bags stay")
    verbs = parser.add_subparsers(dest="verb", required=True, metavar="plan|run")
    plan = verbs.add_parser("plan", help="show the experiments, their time and number of runs; moves nothing")
    run = verbs.add_parser("run", help="run the experiments and record a bag of each")
    for verb in (plan, run):
        verb.add_argument("--group", action="append", default=[], metavar="NAME",
                          help="only this group (joint_3, joints_5_6_against ...); may be repeated")  # fmt: skip
        verb.add_argument("--quick", action="store_true", help="fewer speeds, one pose, one micro-oscillation")
        verb.add_argument("--speeds", type=int, metavar="N",
                          help="speeds in each direction (28); the more, the smaller the deviations")  # fmt: skip
        add_robot_arguments(verb, *MODEL_FILES, "poses")
    where = run.add_mutually_exclusive_group(required=True)
    where.add_argument("--engine", action="store_true", help="in the closed loop without ROS, fast")
    where.add_argument("--nodes", action="store_true", help="on the controller node, in its time")
    run.add_argument("--output", type=Path, required=True, metavar="FOLDER", help="folder for the bags; must not exist")
    run.add_argument(
        "--storage", choices=("mcap", "sqlite3"), default="mcap", help="of the engine's bags (%(default)s)"
    )
    add_node_arguments(run, timeout=60.0)


def main(options: argparse.Namespace) -> None:
    """Plan, and run if asked to.

    Raises:
        Rx90Error: for what cannot be done; complete bags stay.
    """
    # Here, because --help must not wait for them.
    from rx90_common.description.robot_files import RobotFiles
    from rx90_emulator.identification.experiments.job import (
        describe,
        plan_experiments,
        record_on_engine,
        record_on_nodes,
    )
    from rx90_emulator.loop.setup import Setup

    setup = Setup.load(RobotFiles.of_options(options))
    plan = plan_experiments(setup, options.group, quick=options.quick, speeds=options.speeds)
    print(describe(plan, setup), flush=True)
    if options.verb == "plan":
        return
    if options.engine:
        record_on_engine(setup, plan, options.output, options.storage)
    else:
        record_on_nodes(setup, plan, options.output, options.node, options.timeout)
    print(one_line(f"bags: {options.output}"))
