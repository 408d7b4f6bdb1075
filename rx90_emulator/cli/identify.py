"""`rx90_identify`: from recorded bags to a friction file, a report, and a verdict on a bag that was not used."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path

from rx90_common.base.errors import Rx90Error
from rx90_common.process.interrupts import terminations_as_interrupts
from rx90_emulator.cli.robot_options import add_robot_arguments, number
from rx90_emulator.identification.model.options import RobotOptions, ValidationTolerances

CONFIRMED, NOT_CONFIRMED, REFUSED, INTERRUPTED = 0, 1, 3, 130
_USAGE = """\
rx90_identify FOLDER --output FILE [options]
       rx90_identify --sliding BAG ... [--presliding BAG ...] [--validation BAG ...] --output FILE [options]
       rx90_identify --sliding BAG ... --output FILE --urdf FILE [--topic T] [--joints J ...] [options]"""
_EPILOG = """\
example of another robot, with currents of its motors on /arm/motors:
  rx90_identify --sliding sweeps.bag --presliding wiggle.bag --validation run.bag --output friction.yaml \\
      --urdf arm.urdf --topic arm/motors --joints shoulder elbow --names m1 m2 --gear 100 80 --torque-constant 0.12 0.1
a bag is a rosbag2 folder, an .mcap or .db3 file, or a .bag file of ROS 1; docs/identification.md says what the motions
should be.

exit status: 0 identified, and confirmed by the validation bag where there is one; 1 identified, but not confirmed;
2 wrong usage; 3 refused, nothing written; 130 interrupted, nothing written.
"""


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="rx90_identify",
        usage=_USAGE,
        description=__doc__,
        epilog=_EPILOG,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("folder", nargs="?", type=Path, help="folder that rx90_experiment wrote")
    bags = parser.add_argument_group("bags, instead of a folder")
    for name, what in (
        ("sliding", "sweeps at constant velocity: 5 speeds or more in both directions, at several poses"),
        (
            "presliding",
            "micro-oscillations, 500 samples per second or more; without them c0 and c1 are those of --fallback",
        ),
        ("validation", "a run to hold the result against, not used before"),
    ):
        bags.add_argument(f"--{name}", type=Path, nargs="+", default=[], metavar="BAG", help=what)
    result = parser.add_argument_group("result")
    result.add_argument("--output", type=Path, required=True, metavar="FILE", help="friction file to write (.yaml)")
    result.add_argument("--report", type=Path, metavar="FILE", help="report to write (beside the friction file, .html)")
    result.add_argument("--force", action="store_true", help="replace files that exist")
    limits = ValidationTolerances()
    share = number("a positive number", lambda value: value > 0.0)
    result.add_argument("--torque-tolerance", type=share, default=limits.torque, metavar="SHARE",
                        help="RMS difference over RMS torque, of each joint (%(default)s)")  # fmt: skip
    result.add_argument("--worst-torque-tolerance", type=share, default=limits.worst_torque, metavar="SHARE",
                        help="largest difference over largest torque, of each joint (%(default)s)")  # fmt: skip
    result.add_argument("--tip-tolerance", type=share, default=limits.tip, metavar="M",
                        help="largest distance of the tips, m (%(default)s)")  # fmt: skip
    add_robot_arguments(parser)
    return parser


def main(args: Sequence[str] | None = None) -> int:
    """Run `rx90_identify` and return its exit status."""
    options = _parser().parse_args(args)
    try:
        with terminations_as_interrupts():
            # Here, because --help must not wait for it.
            from rx90_emulator.identification.experiments.folder import IdentificationBags
            from rx90_emulator.identification.job import IdentificationJob, run_identification

            robot = RobotOptions(**{name: getattr(options, name) for name in RobotOptions.__dataclass_fields__})
            limits = options.torque_tolerance, options.worst_torque_tolerance, options.tip_tolerance
            job = IdentificationJob(
                options.folder,
                IdentificationBags.of(options.sliding, options.presliding, options.validation),
                robot,
                ValidationTolerances(*limits),
                options.output,
                options.report,
                options.force,
            )
            if run_identification(job):
                return CONFIRMED
    except KeyboardInterrupt:
        print("\nrx90_identify: interrupted; nothing was written", file=sys.stderr)
        return INTERRUPTED
    except Rx90Error as error:
        print(f"rx90_identify: {error}", file=sys.stderr)
        return REFUSED
    print("rx90_identify: the validation does not confirm the result", file=sys.stderr)
    return NOT_CONFIRMED


if __name__ == "__main__":
    sys.exit(main())
