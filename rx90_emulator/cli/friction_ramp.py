"""Measure Coulomb and viscous friction with torque ramps on a friction rig, or read old ramps."""

from __future__ import annotations

import argparse

from friction_bench.experiment.record import TEXT_KINDS, VELOCITIES
from rx90_common.base.share import SHIPPED_RIG
from rx90_emulator.cli.options import FINITE, add_rig_arguments, add_robot_argument, whole_from


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the command's options."""
    parser.add_argument(
        "--slopes", type=FINITE, nargs="+", metavar="M", help="slopes, Nm/s (default: by the first ramp)"
    )
    parser.add_argument("--repeats", type=whole_from(1, 1000), help="ramps of each slope (default: by the first ramp)")
    parser.add_argument("--end-torque", type=FINITE, help="end of each ramp, Nm at the motor")
    parser.add_argument(
        "--load", choices=("none", "joint", "both"), default="both", help="joint coupled? (default: %(default)s)"
    )
    parser.add_argument(
        "--source",
        action="store_true",
        help="the source's experiment on rig/source.yaml: no-load at its first slope, loaded at its second, "
        "and the source's evaluation beside this one's",
    )
    add_rig_arguments(parser, SHIPPED_RIG, "out/friction")
    parser.add_argument("--element", default="joint_6", help="friction element that the joint stands for")
    add_robot_argument(parser)
    files = parser.add_argument_group("old data instead of a rig")
    files.add_argument("--no-load-file", action="append", default=[], metavar="M:FILE", help="slope and file")
    files.add_argument("--loaded-file", action="append", default=[], metavar="M:FILE", help="slope and file")
    files.add_argument("--text", choices=TEXT_KINDS, help="files are plain text of this kind, not CSV")
    files.add_argument(
        "--velocity",
        choices=VELOCITIES,
        help="what --text velocity is: mean since the last reading, as pulses give it (default), or at the reading",
    )


def main(options: argparse.Namespace) -> int:
    """Measure or read ramps, identify friction, and write the report; 1 where a load carries no estimate.

    Raises:
        Rx90Error: for what is refused; what has been measured until then stands in the folder.
    """
    from friction_bench.experiment.job import run  # here, because --help must not wait for it

    return run(options)
