"""From recorded bags to a friction file, a report, and a verdict on a bag that was not used.

A given friction file is held against bags with --friction.
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path
from typing import Any

from rx90_common.base.errors import DONE, VERDICT_NO, IdentificationError
from rx90_common.base.quoting import one_line
from rx90_emulator.cli.options import (
    POSITIVE,
    add_arm_arguments,
    add_message_arguments,
    add_robot_arguments,
    add_zero_argument,
    place,
)
from rx90_emulator.identification.options import (
    COULOMB_VISCOUS,
    EMULATED,
    MODEL_PARTS,
    RECORDED,
    ExcitationTolerances,
    MeasuredLayout,
    MeasuredTolerances,
    RobotOptions,
)

_USAGE = """\
rx90_identify FOLDER --output FILE [options]          (FOLDER of excitation runs: --output FOLDER)
       rx90_identify --sliding BAG ... [--presliding BAG ...] [--validation BAG ...] --output FILE [options]
       rx90_identify --sliding BAG ... --output FILE --urdf FILE [--topic T] [--joints J ...] [options]
       rx90_identify --excitation BAG ... [--validation BAG ...] --output FOLDER [--urdf FILE] [options]
       rx90_identify --friction FILE --validation BAG ... [--report FILE] [options]"""
_EPILOG = """\
example of another robot, with currents of its motors on /arm/motors:
  rx90_identify --sliding sweeps.bag --presliding wiggle.bag --validation run.bag --output friction.yaml \\
      --urdf arm.urdf --topic arm/motors --joints shoulder elbow --gear 100 80 --torque-constant 0.12 0.1
a bag is a rosbag2 folder, an .mcap or .db3 file, or a .bag file of ROS 1; docs/howto/identification.md says what the
motions should be. Where the validation bag does not confirm the result, it is written all the same, and the verdict is
no.
"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the command's options."""
    parser.usage = _USAGE
    parser.epilog = _EPILOG
    parser.formatter_class = argparse.RawDescriptionHelpFormatter
    parser.set_defaults(interrupted="nothing was written")
    parser.add_argument("folder", nargs="?", type=Path, help="folder that rx90_experiment wrote")
    bags = parser.add_argument_group("bags, instead of a folder")
    for name, what in (
        ("sliding", "sweeps at constant velocity: 5 speeds or more in both directions, at several poses"),
        (
            "presliding",
            "micro-oscillations, 500 samples per second or more; else c0 and c1 are those of --fallback, or assumed",
        ),
        ("excitation", "runs in which all joints move, without plateaus: dynamics and friction of the whole arm"),
        ("validation", "a run to hold the result against, not used before"),
    ):
        bags.add_argument(f"--{name}", type=Path, nargs="+", default=[], metavar="BAG", help=what)
    bags.add_argument("--bristles", action="store_true", help="with --excitation: try bristles along the motion, too, "
                      "where neither a Stribeck rise nor the rows of reversals ask for them")  # fmt: skip
    bags.add_argument("--model", nargs="+", choices=(COULOMB_VISCOUS, *MODEL_PARTS), metavar="PART",
                      help="give these parts to the friction of all elements, without a choice: "
                      f"{', '.join((COULOMB_VISCOUS, *MODEL_PARTS))}; Coulomb and viscous friction are always there, "
                      "and a part that ends at a bound of its range goes; bristles are of excitation runs alone (what "
                      "predicts better is chosen)")  # fmt: skip
    bags.add_argument("--no-rotors", action="store_true", help="with --excitation and --urdf: leave the inertias of "
                      "rotors out, for torques of sensors between gear and link")  # fmt: skip
    bags.add_argument("--bandwidth", type=POSITIVE, metavar="HZ", help="with --excitation: of the low-pass of the "
                      "positions, a third of it for torques (the widest with clean accelerations)")  # fmt: skip
    bags.add_argument("--friction", metavar="FILE", help="a given friction file, or a shipped one "
                      "(robots/tx40/friction.yaml): it is "
                      "held against the --validation bags, and nothing is identified")  # fmt: skip
    result = parser.add_argument_group("result")
    result.add_argument("--output", type=place, metavar="FILE", help="friction file to write (.yaml); with "
                        "--excitation a folder for robot files, report and parameters")  # fmt: skip
    result.add_argument("--report", type=place, metavar="FILE", help="report to write (beside the friction file, "
                        ".html; with --friction none)")  # fmt: skip
    result.add_argument("--force", action="store_true", help="replace files that exist")
    own = "where a bag holds set-points of this project's controller"
    result.add_argument("--torque-tolerance", type=POSITIVE, metavar="SHARE",
                        help=f"RMS difference over RMS torque, of each joint ({RECORDED.torque}; without --excitation "
                        f"{EMULATED.torque} {own})")  # fmt: skip
    result.add_argument("--total-torque-tolerance", type=POSITIVE, metavar="SHARE",
                        help=f"the same of all joints together ({RECORDED.total})")  # fmt: skip
    add_arm_arguments(parser)


_WITHOUT = "without excitation runs"
_UNUSED = (
    ("excitation", "folder sliding presliding friction report", "with --excitation",
     "--validation BAG ... alone, and --output FOLDER"),
    ("check sweeps", "bristles bandwidth no_rotors", _WITHOUT, "with --excitation BAG ..."),
    ("check", "folder sliding presliding output model", "with --friction",
     "--validation BAG ... alone, for nothing is identified or written"),
)  # fmt: skip
"""What a command line is for, options that do not count for it, what it is with, and what is accepted instead."""


def main(options: argparse.Namespace) -> int:
    """Return 0 where the validation confirms the result, or there is none, else 1."""
    what = "excitation" if _holds_excitation(options) else "sweeps" if options.friction is None else "check"
    for whats, names, how, accepted in _UNUSED:
        given = next(filter(None, (_given(options, name) for name in names.split())), "")
        if given and what in whats:
            raise IdentificationError(f"{given} {how}; accepted: {accepted}")
    if what != "check" and options.output is None:
        other = "--output FOLDER, which the robot's files are written into"
        asked = other if what == "excitation" else "--output FILE, the friction file to write"
        raise IdentificationError(f"no --output; accepted: {asked}")
    # Here, because --help must not wait for it.
    from rx90_emulator.identification import job

    robot = RobotOptions(
        **{name: getattr(options, name) for name in RobotOptions.__dataclass_fields__ if hasattr(options, name)}
    )
    limits = {"torque": options.torque_tolerance, "total": options.total_torque_tolerance}
    tolerances = {name: value for name, value in limits.items() if value is not None}
    if what == "check":
        confirmed = job.run_check(
            options.friction, options.validation, robot, tolerances, options.report, force=options.force
        )
    elif what == "sweeps":
        confirmed = job.run_identification(
            _bags(options), robot, tolerances, options.output, options.report,
            model=options.model, force=options.force,
        )  # fmt: skip
    else:
        wider = ExcitationTolerances(tolerances.get("total", RECORDED.total), tolerances.get("torque", RECORDED.torque))
        confirmed = job.run_excitation(
            options.excitation, robot, options.validation, wider, options.output,
            bristles=options.bristles, model=options.model, rotors=not options.no_rotors,
            bandwidth=options.bandwidth, force=options.force,
        )  # fmt: skip
    if confirmed:
        return DONE
    whose = options.friction if what == "check" else "the result"
    print(one_line(f"rx90_identify: the validation does not confirm {whose}"), file=sys.stderr)
    return VERDICT_NO


def _given(options: argparse.Namespace, name: str) -> str:
    """Return an option as it was given, with its first value; "" where it was not."""
    value = getattr(options, name)
    if value in (None, False, []):
        return ""
    option = f"--{name.replace('_', '-')} " * (name != "folder")
    return option.strip() if value is True else f"{option}{value[0] if isinstance(value, list) else value}"


def _holds_excitation(options: argparse.Namespace) -> bool:
    """Return whether the bags, or those of the folder, are excitation runs; those of a folder then are as if named."""
    single = [options.friction, *options.sliding, *options.presliding, *options.validation]
    if options.excitation or options.folder is None or any(single):
        return bool(options.excitation)
    from rx90_emulator.identification.experiments.plan import read_index

    bags = read_index(options.folder)
    if bags.excitation:
        options.folder = None
        options.excitation = bags.excitation
        options.validation = bags.validation
    return bool(bags.excitation)


def _bags(options: argparse.Namespace) -> Any:
    """Return the folder, or the single bags by use."""
    from rx90_emulator.identification.experiments.plan import IdentificationBags

    single = [*options.sliding, *options.presliding, *options.validation]
    if options.folder is not None and single:
        raise IdentificationError(f"{options.folder} and {single[0]}; accepted: a folder or single bags, not both")
    return options.folder or IdentificationBags.of(options.sliding, options.presliding, options.validation)


_MEASURED_EPILOG = """\
set-points are those of the bag (rx90_controller/reference), else its measured path, smoothed without delay. Arms of
another structure: rx90_identify --friction FILE --validation BAG --urdf URDF. docs/howto/measured_path.md says more.
"""


def add_compare_measured(parser: argparse.ArgumentParser) -> None:
    """Add the options of `rx90_compare_measured`."""
    parser.epilog = _MEASURED_EPILOG
    parser.set_defaults(interrupted="nothing was written")
    parser.add_argument("bag", type=Path, metavar="BAG", help="measured: folder, .mcap, .db3 or ROS 1 .bag file")
    parser.add_argument("--report", type=place, metavar="FILE", help="report to write (.html)")
    parser.add_argument("--force", action="store_true", help="replace a report that exists")
    parser.add_argument("--bandwidth", type=POSITIVE, metavar="HZ",
                        help="of the measured path as set-points; torques and positions are compared below a third of "
                        "it (from the data)")  # fmt: skip
    limits = MeasuredTolerances()
    parser.add_argument("--torque-tolerance", type=POSITIVE, default=limits.torque, metavar="SHARE",
                        help="RMS difference over RMS torque, of each joint (%(default)s)")  # fmt: skip
    parser.add_argument("--total-torque-tolerance", type=POSITIVE, default=limits.total_torque, metavar="SHARE",
                        help="the same of all joints together (%(default)s)")  # fmt: skip
    parser.add_argument("--position-tolerance", type=POSITIVE, default=limits.position, metavar="RAD",
                        help="largest difference of a joint's position, rad (%(default)s)")  # fmt: skip
    add_robot_arguments(parser)
    layout = parser.add_argument_group("what the bag holds", "by default motor_states or joint_states as here")
    add_message_arguments(layout, "motor_states, else joint_states")
    add_zero_argument(layout)


def compare_measured(options: argparse.Namespace) -> int:
    """A measured bag against the closed loop without ROS along the same set-points: torques, positions, a verdict."""
    # Here, because --help must not wait for them.
    from rx90_common.description.robot_files import RobotFiles
    from rx90_emulator.identification.job import run_comparison

    layout = MeasuredLayout(
        topic=options.topic,
        gear=options.gear,
        torque_constant=options.torque_constant,
        zero=options.zero,
        signals=options.signals,
    )
    tolerances = MeasuredTolerances(
        options.torque_tolerance, options.total_torque_tolerance, options.position_tolerance
    )
    files = RobotFiles.of_options(options)
    if run_comparison(
        options.bag, files, layout, tolerances, options.bandwidth, options.report, force=options.force
    ):  # fmt: skip
        return DONE
    print(one_line(f"rx90_compare_measured: {options.bag} and the simulation do not agree"), file=sys.stderr)
    return VERDICT_NO
