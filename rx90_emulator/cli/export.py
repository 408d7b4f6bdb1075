"""Write a robot's friction, and its arm, for another simulator, with what that costs: in Nm, and what is lost.

The friction torque is compared at constant velocity, without load, at the reference temperature. docs/howto/export.md
shows what each simulator can hold.
"""

from __future__ import annotations

import sys
from argparse import ArgumentParser, Namespace

import rx90_emulator as rx
from rx90_common.base.errors import DONE, VERDICT_NO
from rx90_emulator.cli.options import (
    POSITIVE,
    add_output,
    add_robot_arguments,
    new_folder,
)
from rx90_emulator.export.targets import TARGETS


def add_arguments(parser: ArgumentParser) -> None:
    """Add the options."""
    parser.set_defaults(interrupted="nothing was written")
    parser.add_argument(
        "target", metavar="TARGET", choices=tuple(TARGETS), help=f"simulator: {', '.join(TARGETS)}"
    )
    about = "new folder for the simulator's files, and export.yaml on what they cost"
    add_output(parser, new_folder, about, metavar="FOLDER", required=True)
    parser.add_argument("--within", type=POSITIVE, metavar="NM",
                        help="exit code 1 if a friction torque differs by more than this, Nm")  # fmt: skip
    parser.add_argument("--speeds", nargs=2, type=POSITIVE, metavar=("LOW", "HIGH"),
                        help="over which friction is fitted and compared, rad/s (identified, else 0.001 to the largest "
                        "of each joint)")  # fmt: skip
    add_robot_arguments(parser, "urdf", "tool", "drives", "friction")


def main(options: Namespace) -> int:
    """Write the files, and print what they cost."""
    # Here, because --help must not wait for it.
    from rx90_emulator.loop.setup import load_arm

    done = rx.export_robot(
        load_arm(rx.RobotFiles.of_options(options)), options.target, speeds=options.speeds
    )
    rx.write_export(done, options.output)
    print(done.text)
    print(f"\nwritten: {', '.join(done.files)} and export.yaml in {options.output}")
    if options.within is not None and done.largest > options.within:
        worst = max(done.fits, key=lambda fit: fit.worst)
        line = (
            f"{worst.name} differs by up to {worst.worst:.3g} Nm; accepted: {options.within:g} Nm"
        )
        print(f"rx90 export: {line}", file=sys.stderr)
        return VERDICT_NO
    return DONE
