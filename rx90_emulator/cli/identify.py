"""From recorded bags to a friction file, a report, and a verdict on a bag that was not used.

A given friction file is held against bags with --friction.
"""

from __future__ import annotations

import argparse
import sys
from dataclasses import fields
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
    is_given,
    place,
)
from rx90_emulator.identification.options import (
    COULOMB_VISCOUS,
    EMULATED,
    MODEL_PARTS,
    RECORDED,
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
                      "positions, a third of it for torques (twenty times the band of the motion)")  # fmt: skip
    bags.add_argument("--friction", metavar="FILE", help="a given friction file, or a shipped one "
                      "(robots/tx40/friction.yaml): it is "
                      "held against the --validation bags, and nothing is identified")  # fmt: skip
    result = parser.add_argument_group("result")
    result.add_argument("--output", type=place, metavar="FILE", help="friction file to write (.yaml); with "
                        "--excitation a folder for robot files, report and parameters")  # fmt: skip
    result.add_argument("--report", type=place, metavar="FILE", help="with --friction: report to write; that of an "
                        "identification is beside its files")  # fmt: skip
    result.add_argument("--force", action="store_true", help="replace files that exist")
    own = "where a bag holds set-points of this project's controller"
    result.add_argument("--torque-tolerance", type=POSITIVE, metavar="SHARE",
                        help=f"RMS difference over RMS torque, of each joint ({RECORDED.torque}; without --excitation "
                        f"{EMULATED.torque} {own})")  # fmt: skip
    result.add_argument("--total-torque-tolerance", type=POSITIVE, metavar="SHARE",
                        help=f"the same of all joints together ({RECORDED.total})")  # fmt: skip
    add_arm_arguments(parser)


_UNUSED = {
    "excitation": ("folder", "sliding", "presliding", "friction", "report"),
    "sweeps": ("bristles", "bandwidth", "no_rotors", "report"),
    "check": ("folder", "sliding", "presliding", "output", "model", "bristles", "bandwidth", "no_rotors"),
}
"""Options without an effect, by what a command line is for."""
_ACCEPTED = {
    "excitation": "--excitation BAG ..., --validation BAG ..., and --output FOLDER",
    "sweeps": "with --excitation BAG ..., or --report with --friction",
    "check": "--friction FILE and --validation BAG ... alone, for nothing is identified or written",
}


def main(options: argparse.Namespace) -> int:
    """Return 0 where the validation confirms the result, or there is none, else 1."""
    use = "excitation" if _holds_excitation(options) else "sweeps" if options.friction is None else "check"
    given = next((name for name in _UNUSED[use] if is_given(options, name)), None)
    if given is not None:
        word = options.folder if given == "folder" else f"--{given.replace('_', '-')}"
        raise IdentificationError(f"{word} with what is of {use} runs; accepted: {_ACCEPTED[use]}")
    if use != "check" and options.output is None:
        asked = "FOLDER, which the robot's files are written into" if use == "excitation" else "FILE, a friction file"
        raise IdentificationError(f"no --output; accepted: --output {asked}")
    # Here, because --help must not wait for it.
    from rx90_emulator.identification import excitation, identify, job

    stated = {field.name for field in fields(RobotOptions)}
    robot = RobotOptions(**{name: value for name, value in vars(options).items() if name in stated})
    limits = {"torque": options.torque_tolerance, "total": options.total_torque_tolerance}
    tolerances = {name: value for name, value in limits.items() if value is not None}
    whose = "the result"
    if use == "check":
        whose = options.friction
        against = job.run_check(
            options.friction, options.validation, robot, tolerances, options.report, force=options.force
        )
    elif use == "sweeps":
        bags = _bags(options)
        against = job.run_identification(
            lambda step: identify.identify_friction(bags, robot, tolerances, step, model=options.model),
            options.output,
            folder=False,
            force=options.force,
        )
    else:
        against = job.run_identification(
            lambda step: excitation.identify_excitation(
                options.excitation, robot, options.validation, tolerances,
                bristles=options.bristles, model=options.model, rotors=not options.no_rotors,
                bandwidth=options.bandwidth, progress=step,
            ),
            options.output,
            folder=True,
            force=options.force,
        )  # fmt: skip
    if not against:
        return DONE
    print(one_line(f"rx90_identify: {against} {whose}"), file=sys.stderr)
    return VERDICT_NO


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
