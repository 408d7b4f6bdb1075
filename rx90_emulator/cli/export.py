"""Write a robot's friction, and its arm, for another simulator, with what that costs: in Nm, and what is lost.

The friction torque is compared at constant velocity, without load, at the reference temperature. docs/howto/export.md
shows what each simulator can hold.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path

from rx90_common.base.errors import DONE, VERDICT_NO, ConfigError
from rx90_common.base.quoting import listed
from rx90_emulator.cli.options import (
    POSITIVE,
    add_output,
    add_plot,
    add_robot_arguments,
    check_picture,
    new_folder,
    place,
)
from rx90_emulator.export.targets import TARGETS


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the options."""
    parser.set_defaults(interrupted="nothing was written")
    parser.add_argument(
        "target", metavar="TARGET", choices=tuple(TARGETS), help=f"simulator: {', '.join(TARGETS)}"
    )
    about = "new folder for the simulator's files, and export.yaml on what they cost"
    add_output(parser, new_folder, about, metavar="FOLDER", required=True)
    parser.add_argument("--within", type=POSITIVE, metavar="NM",
                        help="exit code 1 if a friction torque differs by more than this, Nm")  # fmt: skip
    add_plot(parser, place, "picture to write: the curves, and what the simulator gets")
    parser.add_argument("--speeds", nargs="+", default=(), metavar="LOW HIGH|BAG",
                        help="over which friction is fitted and compared: a range, rad/s, or those in the joint_states "
                        "of a bag, as often as they are there (identified, else 0.001 to the largest of each "
                        "joint)")  # fmt: skip
    add_robot_arguments(parser, "urdf", "tool", "drives", "friction")


def _speeds(words: Sequence[str]) -> tuple[tuple[float, float] | None, Path | None]:
    """Return the range and the bag that --speeds names: one of them, or neither."""
    if len(words) < 2:
        return None, Path(words[0]) if words else None
    speeds: list[float] = []
    with suppress(argparse.ArgumentTypeError):
        speeds = [POSITIVE(word) for word in words]
    if len(speeds) != 2:
        raise ConfigError(f"--speeds {listed(words)}; accepted: LOW and HIGH, rad/s, or BAG")
    return (speeds[0], speeds[1]), None


def main(options: argparse.Namespace) -> int:
    """Write the files, and print what they cost."""
    # Here, because --help must not wait for them.
    from rx90_common.description.robot_files import RobotFiles
    from rx90_emulator.export.export import export_robot, write_export
    from rx90_emulator.loop.setup import load_arm

    if options.plot is not None:
        check_picture(options.plot)
    speeds, bag = _speeds(options.speeds)
    done = export_robot(
        load_arm(RobotFiles.of_options(options)), options.target, speeds=speeds, bag=bag
    )
    write_export(done, options.output)
    print(done.text)
    print(f"\nwritten: {', '.join(done.files)} and export.yaml in {options.output}")
    if options.plot is not None:
        from rx90_emulator.export.plots import draw_fits

        draw_fits({fit.name: fit for fit in done.fits}, options.plot)
    if options.within is not None and done.largest > options.within:
        worst = max(done.fits, key=lambda fit: fit.worst)
        line = (
            f"{worst.name} differs by up to {worst.worst:.3g} Nm; accepted: {options.within:g} Nm"
        )
        print(f"rx90 export: {line}", file=sys.stderr)
        return VERDICT_NO
    return DONE
