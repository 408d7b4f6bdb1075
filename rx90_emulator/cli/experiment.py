"""`rx90_experiment`: plan the motions that friction is identified from, and run them on the engine or the nodes."""

from __future__ import annotations

import argparse
import os
import sys
from collections.abc import Sequence
from pathlib import Path

from rx90_common.base.errors import ExchangeError, Rx90Error
from rx90_common.process.interrupts import terminations_as_interrupts
from rx90_emulator.cli.robot_options import number

REFUSED, NOT_RUN, INTERRUPTED = 1, 3, 130
_EPILOG = """\
exit status: 0 done, 1 refused, 2 wrong usage, 3 the nodes did not run it, 130 interrupted; complete bags stay.
No motion is checked for collisions. Set-points keep the joints' ranges and speed limits, and the expected torque
keeps what the URDF allows.
"""


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="rx90_experiment",
        description=__doc__,
        epilog=_EPILOG,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    verbs = parser.add_subparsers(dest="verb", required=True, metavar="plan|run")
    plan = verbs.add_parser("plan", help="show the experiments, their time and number of runs; moves nothing")
    run = verbs.add_parser("run", help="run the experiments and record a bag of each")
    for verb in (plan, run):
        verb.add_argument("--group", action="append", default=[], metavar="NAME",
                          help="only this group (joint_3, joints_5_6_against ...); may be repeated")  # fmt: skip
        verb.add_argument("--quick", action="store_true", help="fewer speeds, one pose, one micro-oscillation")
        verb.add_argument("--speeds", type=int, metavar="N",
                          help="speeds in each direction (28); the more, the smaller the deviations")  # fmt: skip
        verb.add_argument("--urdf", help="robot (shipped RX90B)")
        verb.add_argument("--tool", help="tool file, or none (shipped laser head)")
        verb.add_argument("--drives", help="drives file")
        verb.add_argument("--friction", help="friction file, for --engine")
        verb.add_argument("--controller-file", help="controller file")
    where = run.add_mutually_exclusive_group(required=True)
    where.add_argument("--engine", action="store_true", help="in the closed loop without ROS, fast")
    where.add_argument("--nodes", action="store_true", help="on the controller node, in its time")
    run.add_argument("--output", type=Path, required=True, metavar="FOLDER", help="folder for the bags; must not exist")
    run.add_argument(
        "--storage", choices=("mcap", "sqlite3"), default="mcap", help="of the engine's bags (%(default)s)"
    )
    run.add_argument("--controller", default="rx90_controller", help="name of the node (%(default)s)")
    seconds = number("a positive number", lambda value: value > 0.0)
    run.add_argument("--timeout", type=seconds, default=60.0, metavar="S", help="s to wait for the nodes (%(default)s)")
    return parser


def main(args: Sequence[str] | None = None) -> int:
    """Run `rx90_experiment` and return its exit status."""
    options = _parser().parse_args(args)
    try:
        with terminations_as_interrupts():
            # Here, because --help must not wait for it.
            from rx90_common.description.robot_files import RobotFiles
            from rx90_emulator.identification.experiments.job import ExperimentJob, run_experiments

            files = RobotFiles.named(
                tool=options.tool,
                urdf=options.urdf,
                drives=options.drives,
                friction=options.friction,
                controller=options.controller_file,
            )
            names = ("output", "engine", "storage", "controller", "timeout") if options.verb == "run" else ()
            where = {name: getattr(options, name) for name in names}
            run_experiments(ExperimentJob(files, tuple(options.group), options.quick, options.speeds, **where))
    except KeyboardInterrupt:
        # A bar that was drawn ends without a line's end.
        print(f"{os.linesep}rx90_experiment: interrupted; complete bags stay", file=sys.stderr)
        return INTERRUPTED
    except Rx90Error as error:
        print(f"rx90_experiment: {error}", file=sys.stderr)
        return NOT_RUN if isinstance(error, ExchangeError) else REFUSED
    return 0


if __name__ == "__main__":
    sys.exit(main())
