"""From recorded bags to a friction file, a report, and a verdict on a bag that was not used.

A given friction file is held against bags with --friction.
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

from rx90_common.base.errors import DONE, VERDICT_NO, IdentificationError
from rx90_common.base.quoting import one_line
from rx90_emulator.cli.options import POSITIVE, add_arm_arguments, place
from rx90_emulator.identification.options import ExcitationTolerances, RobotOptions, ValidationTolerances

_USAGE = """\
rx90_identify FOLDER --output FILE [options]          (FOLDER of excitation runs: --output FOLDER)
       rx90_identify --sliding BAG ... [--presliding BAG ...] [--validation BAG ...] --output FILE [options]
       rx90_identify --sliding BAG ... --output FILE --urdf FILE [--topic T] [--joints J ...] [options]
       rx90_identify --excitation BAG ... [--validation BAG ...] --output FOLDER [--urdf FILE] [options]
       rx90_identify --friction FILE --validation BAG ... [--report FILE] [options]"""
_EPILOG = """\
example of another robot, with currents of its motors on /arm/motors:
  rx90_identify --sliding sweeps.bag --presliding wiggle.bag --validation run.bag --output friction.yaml \\
      --urdf arm.urdf --topic arm/motors --joints shoulder elbow --names m1 m2 --gear 100 80 --torque-constant 0.12 0.1
a bag is a rosbag2 folder, an .mcap or .db3 file, or a .bag file of ROS 1; docs/howto/identification.md says what the
motions should be. Where the validation bag does not confirm the result, it is written all the same, and the verdict is
no.
"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the command's options."""
    parser.usage, parser.epilog = _USAGE, _EPILOG
    parser.formatter_class = argparse.RawDescriptionHelpFormatter
    parser.set_defaults(interrupted="nothing was written")
    parser.add_argument("folder", nargs="?", type=Path, help="folder that rx90_experiment wrote")
    bags = parser.add_argument_group("bags, instead of a folder")
    for name, what in (
        ("sliding", "sweeps at constant velocity: 5 speeds or more in both directions, at several poses"),
        (
            "presliding",
            "micro-oscillations, 500 samples per second or more; without them c0 and c1 are those of --fallback",
        ),
        ("excitation", "runs in which all joints move, without plateaus: dynamics and friction of the whole arm"),
        ("validation", "a run to hold the result against, not used before"),
    ):
        bags.add_argument(f"--{name}", type=Path, nargs="+", default=[], metavar="BAG", help=what)
    bags.add_argument("--bristles", action="store_true", help="with --excitation: try bristles along the motion, too, "
                      "where neither a Stribeck rise nor the rows of reversals ask for them")  # fmt: skip
    bags.add_argument("--bristle-kinds", action="store_true", help="with micro-oscillations: choose LuGre, "
                      "elasto-plastic or Maxwell-slip bristles for each joint by what predicts them best, or say that "
                      "they cannot tell; takes some seconds for each joint (docs/explanation/bristles.md)")  # fmt: skip
    bags.add_argument("--payload", type=Path, metavar="FILE", help="with --excitation: YAML that names the bags whose "
                      "run carried a known body, with its mass, centre and inertia; runs with and without one tell the "
                      "drive gains (docs/explanation/excitation.md)")  # fmt: skip
    bags.add_argument("--load-part", action="store_true", help="with --payload: let the payloads tell how friction "
                      "grows with the load, each element's load part, in place of the drive gains, which count as "
                      "right")  # fmt: skip
    bags.add_argument("--prior", type=POSITIVE, metavar="SHARE", help="with --excitation: let the inertials of the "
                      "description count, with this relative standard deviation (they do not)")  # fmt: skip
    bags.add_argument("--friction", metavar="FILE", help="a given friction file, or a shipped one "
                      "(robots/tx40/friction.yaml): it is "
                      "held against the --validation bags, and nothing is identified")  # fmt: skip
    result = parser.add_argument_group("result")
    result.add_argument("--output", type=place, metavar="FILE", help="friction file to write (.yaml); with "
                        "--excitation a folder for robot files, report and parameters")  # fmt: skip
    result.add_argument("--report", type=place, metavar="FILE", help="report to write (beside the friction file, "
                        ".html; with --friction none)")  # fmt: skip
    result.add_argument("--force", action="store_true", help="replace files that exist")
    limits, wider = ValidationTolerances(), ExcitationTolerances()
    result.add_argument("--torque-tolerance", type=POSITIVE, metavar="SHARE",
                        help=f"RMS difference over RMS torque, of each joint ({limits.torque}; with --excitation "
                        f"{wider.joint})")  # fmt: skip
    result.add_argument("--total-torque-tolerance", type=POSITIVE, metavar="SHARE",
                        help=f"with --excitation: the same of all joints together ({wider.total})")  # fmt: skip
    result.add_argument("--worst-torque-tolerance", type=POSITIVE, metavar="SHARE",
                        help=f"without --excitation: largest difference over largest torque, of each joint "
                        f"({limits.worst_torque})")  # fmt: skip
    result.add_argument("--tip-tolerance", type=POSITIVE, metavar="M",
                        help=f"without --excitation: largest distance of the tips, m ({limits.tip})")  # fmt: skip
    add_arm_arguments(parser)


def main(options: argparse.Namespace) -> int:
    """Return 0 where the validation confirms the result, or there is none, else 1.

    Raises:
        Rx90Error: for what cannot be done; nothing has been written then.
    """
    robot = RobotOptions(**{name: getattr(options, name) for name in RobotOptions.__dataclass_fields__})
    what = "the result"
    if options.excitation or _holds_excitation(options):
        confirmed = _excitation(options, robot)
    elif given := _for_excitation_alone(options):
        other = ", or --bristle-kinds for micro-oscillations" if given == "--bristles" else ""
        raise IdentificationError(f"{given} without excitation runs; accepted: with --excitation BAG ...{other}")
    elif options.friction is not None:
        confirmed, what = _check(options, robot), options.friction
    else:
        confirmed = _identify(options, robot)
    if confirmed:
        return DONE
    print(one_line(f"rx90_identify: the validation does not confirm {what}"), file=sys.stderr)
    return VERDICT_NO


def _for_excitation_alone(options: argparse.Namespace) -> str:
    """Return the first option given, with its value, that counts for excitation runs alone; "" for none."""
    for name in ("bristles", "load_part"):
        if getattr(options, name):
            return f"--{name.replace('_', '-')}"
    given = [(name, getattr(options, name)) for name in ("payload", "prior", "total_torque_tolerance")]
    return next((f"--{name.replace('_', '-')} {value}" for name, value in given if value is not None), "")


def _holds_excitation(options: argparse.Namespace) -> bool:
    """Return whether the folder is one of excitation runs, whose bags then are as if named."""
    if options.folder is None or options.friction is not None:
        return False
    if options.sliding or options.presliding or options.validation:
        return False  # refused where the bags are put together
    from rx90_emulator.identification.experiments.folder import read_index

    bags = read_index(options.folder)
    if bags.excitation:
        options.folder, options.excitation, options.validation = None, bags.excitation, bags.validation
    return bool(bags.excitation)


def _tolerances(options: argparse.Namespace) -> ValidationTolerances:
    usual = ValidationTolerances
    return usual(
        options.torque_tolerance or usual.torque,
        options.worst_torque_tolerance or usual.worst_torque,
        options.tip_tolerance or usual.tip,
    )


def _excitation(options: argparse.Namespace, robot: RobotOptions) -> bool:
    from rx90_emulator.identification.job import run_excitation

    others = [options.folder, *options.sliding, *options.presliding, options.friction, options.report]
    unused = [str(one) for one in others if one is not None]
    if options.bristle_kinds:
        raise IdentificationError(
            "--bristle-kinds with excitation runs; accepted: with --presliding BAG ..., or --bristles, which tries "
            "LuGre's along such runs"
        )
    for name in ("worst_torque_tolerance", "tip_tolerance"):
        if (value := getattr(options, name)) is not None:
            told = f"--{name.replace('_', '-')} {value} with excitation runs"
            raise IdentificationError(f"{told}; accepted: --torque-tolerance and --total-torque-tolerance")
    if unused:
        raise IdentificationError(
            f"{unused[0]} with --excitation; accepted: --validation BAG ... alone, and --output FOLDER"
        )
    if options.output is None:
        raise IdentificationError("no --output; accepted: --output FOLDER, which the robot's files are written into")
    if options.load_part and options.payload is None:
        raise IdentificationError("--load-part without --payload; accepted: with --payload FILE")
    joint = options.torque_tolerance or ExcitationTolerances.joint
    tolerances = ExcitationTolerances(options.total_torque_tolerance or ExcitationTolerances.total, joint)
    return run_excitation(
        options.excitation, robot, options.validation, tolerances, options.output,
        bristles=options.bristles, payload=options.payload, load_part=options.load_part,
        prior=options.prior, force=options.force,
    )  # fmt: skip


def _identify(options: argparse.Namespace, robot: RobotOptions) -> bool:
    # Here, because --help must not wait for them.
    from rx90_emulator.identification.experiments.folder import IdentificationBags
    from rx90_emulator.identification.job import run_identification

    if options.output is None:
        raise IdentificationError("no --output; accepted: --output FILE, the friction file to write")
    single = [*options.sliding, *options.presliding, *options.validation]
    if options.folder is not None and single:
        raise IdentificationError(f"{options.folder} and {single[0]}; accepted: a folder or single bags, not both")
    bags = options.folder or IdentificationBags.of(options.sliding, options.presliding, options.validation)
    return run_identification(
        bags, robot, _tolerances(options), options.output, options.report,
        bristle_kinds=options.bristle_kinds, force=options.force,
    )  # fmt: skip


def _check(options: argparse.Namespace, robot: RobotOptions) -> bool:
    from rx90_emulator.identification.job import run_check

    others = [options.folder, *options.sliding, *options.presliding, options.output]
    unused = ["--bristle-kinds"] * options.bristle_kinds + [str(one) for one in others if one is not None]
    if unused:
        raise IdentificationError(
            f"{unused[0]} with --friction; accepted: --validation BAG ... alone, for nothing is identified or written"
        )
    tolerances, report = _tolerances(options), options.report
    return run_check(options.friction, options.validation, robot, tolerances, report, force=options.force)
