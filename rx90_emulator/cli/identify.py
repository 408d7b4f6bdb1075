"""Identify friction, or the whole dynamics, from recorded bags and tables, and hold models against bags."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from dataclasses import fields
from pathlib import Path
from typing import TYPE_CHECKING

from rx90_common.base.errors import DONE, VERDICT_NO
from rx90_common.base.quoting import one_line
from rx90_emulator.cli.options import (
    POSITIVE,
    add_arm_arguments,
    add_force,
    add_message_arguments,
    add_output,
    add_robot_arguments,
    add_verbs,
    add_zero_argument,
    place,
)
from rx90_emulator.identification.options import (
    COULOMB_VISCOUS,
    EMULATED,
    MODEL_PARTS,
    RECORDED,
    MeasuredLayout,
    RobotOptions,
)
from rx90_emulator.measured_runs.options import MeasuredTolerances

if TYPE_CHECKING:
    from rx90_emulator.identification.experiments.plan import IdentificationBags

_EPILOG = """\
a bag is a rosbag2 folder, an .mcap or .db3 file, a .bag file of ROS 1, or a table with a signal map beside it;
docs/howto/identification.md says what the motions should be. Where the validation bag does not confirm the result, it
is written all the same, and the verdict is no.
"""
_SLIDING_EPILOG = f"""\
example of another robot, with currents of its motors on /arm/motors:
  rx90 identify sliding sweeps.bag --presliding wiggle.bag --validation run.bag --output friction.yaml \\
      --urdf arm.urdf --topic arm/motors --joints shoulder elbow --gear 100 80 --torque-constant 0.12 0.1
{_EPILOG}"""
_COMPARE_EPILOG = """\
set-points are those of the bag (rx90_controller/reference), else its measured path, smoothed without delay. Arms of
another structure: rx90 identify check FILE BAG ... --urdf URDF. docs/howto/measured_path.md says more.
"""


_TORQUE = f"{RECORDED.torque}; {EMULATED.torque} where a bag holds set-points of this project's controller"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the verbs and their options."""
    add_verbs(parser, _VERBS)


def _add_sliding(parser: argparse.ArgumentParser) -> None:
    parser.epilog = _SLIDING_EPILOG
    _add_bags(parser, "sweeps at constant velocity, 5 speeds or more in both directions, at several poses, or a folder "
              "that rx90 experiment wrote")  # fmt: skip
    parser.add_argument("--presliding", type=Path, nargs="+", default=[], metavar="BAG",
                        help="micro-oscillations, 500 samples per second or more; else c0 and c1 are those of "
                        "--fallback, or assumed")  # fmt: skip
    _add_identification(parser, "friction file to write (.yaml), with the report beside it (.html)")
    add_force(parser)
    _add_tolerances(parser, _TORQUE, RECORDED.total)
    add_arm_arguments(parser)


def _add_excitation(parser: argparse.ArgumentParser) -> None:
    parser.epilog = _EPILOG
    _add_bags(
        parser,
        "runs in which all joints move, without plateaus, or a folder that rx90 experiment wrote",
    )
    _add_identification(parser, "folder for robot files, report and parameters")
    parts = (COULOMB_VISCOUS, *MODEL_PARTS)
    parser.add_argument("--model", nargs="+", choices=parts, metavar="PART",
                        help="give these parts to the friction of all elements, without a choice: "
                        f"{', '.join(parts)}; Coulomb and viscous friction are always there, and "
                        "a part that ends at a bound of its range goes (what predicts better is chosen)")  # fmt: skip
    parser.add_argument("--no-rotors", action="store_true", help="of an arm of --urdf: leave the inertias of rotors "
                        "out, for torques of sensors between gear and link")  # fmt: skip
    _add_bandwidth(parser, "of the low-pass of the positions, a third of it for torques (the widest with clean "
                   "accelerations)")  # fmt: skip
    add_force(parser)
    _add_tolerances(parser, RECORDED.torque, RECORDED.total)
    add_arm_arguments(parser)


def _add_check(parser: argparse.ArgumentParser) -> None:
    parser.epilog = _EPILOG
    parser.add_argument(
        "friction",
        metavar="FILE",
        help="friction file, or a shipped one (robots/tx40/friction.yaml)",
    )
    _add_bags(parser, "bags of the arm")
    _add_report(parser, "none")
    _add_tolerances(parser, _TORQUE, RECORDED.total)
    add_arm_arguments(parser)


def _add_bags(parser: argparse.ArgumentParser, text: str) -> None:
    parser.formatter_class = argparse.RawDescriptionHelpFormatter
    parser.set_defaults(interrupted="nothing was written")
    parser.add_argument("bags", type=Path, nargs="+", metavar="BAG", help=text)


def _add_identification(parser: argparse.ArgumentParser, output: str) -> None:
    parser.add_argument("--validation", type=Path, nargs="+", default=[], metavar="BAG",
                        help="a run to hold the result against, not used before")  # fmt: skip
    add_output(parser, place, output, metavar="FILE", required=True)


def _add_report(parser: argparse.ArgumentParser, default: str) -> None:
    parser.add_argument("--report", type=place, metavar="FILE", help=f"report to write ({default})")
    add_force(parser)


def _add_bandwidth(parser: argparse.ArgumentParser, text: str) -> None:
    parser.add_argument("--bandwidth", type=POSITIVE, metavar="HZ", help=text)


def _add_tolerances(parser: argparse.ArgumentParser, torque: float | str, total: float) -> None:
    parser.add_argument("--torque-tolerance", type=POSITIVE, metavar="SHARE",
                        help=f"RMS difference over RMS torque, of each joint ({torque})")  # fmt: skip
    parser.add_argument("--total-torque-tolerance", type=POSITIVE, metavar="SHARE",
                        help=f"the same of all joints together ({total})")  # fmt: skip


def _sliding(options: argparse.Namespace) -> int:
    """Identify friction from sweeps at constant velocity, and its bristles from micro-oscillations."""
    # Here, because --help must not wait for it.
    from rx90_emulator.identification import identify, job
    from rx90_emulator.identification.experiments.plan import IdentificationBags

    series = _series(options.bags)
    bags = IdentificationBags(
        sliding=series.sliding,
        presliding=(*series.presliding, *options.presliding),
        validation=(*series.validation, *options.validation),
    )
    robot = _robot(options)
    tolerances = _tolerances(options)
    against = job.run_identification(
        lambda step: identify.identify_friction(bags, robot, tolerances, step),
        options.output,
        folder=False,
        force=options.force,
    )
    return _verdict(against and f"{against} the result")


def _excitation(options: argparse.Namespace) -> int:
    """Identify dynamics and friction of the whole arm from runs in which all joints move."""
    from rx90_emulator.identification import excitation, job

    series = _series(options.bags)
    validation = (*series.validation, *options.validation)
    robot = _robot(options)
    tolerances = _tolerances(options)
    against = job.run_identification(
        lambda step: excitation.identify_excitation(
            series.excitation, robot, validation, tolerances,
            model=options.model, rotors=not options.no_rotors,
            bandwidth=options.bandwidth, progress=step,
        ),
        options.output,
        folder=True,
        force=options.force,
    )  # fmt: skip
    return _verdict(against and f"{against} the result")


def _check(options: argparse.Namespace) -> int:
    """Hold a friction file against bags; nothing is identified."""
    from rx90_emulator.identification import job

    against = job.run_check(
        options.friction,
        options.bags,
        _robot(options),
        _tolerances(options),
        options.report,
        force=options.force,
    )
    return _verdict(against and f"{against} {options.friction}")


def _series(paths: Sequence[Path]) -> IdentificationBags:
    """Return bags by use: of a folder that `rx90 experiment` wrote as its index says, others as sweeps and runs."""
    from rx90_emulator.identification.experiments.plan import INDEX, IdentificationBags, read_index

    sliding: list[Path] = []
    presliding: list[Path] = []
    validation: list[Path] = []
    excitation: list[Path] = []
    for path in paths:
        if (path / INDEX).exists():
            series = read_index(path)
            sliding.extend(series.sliding)
            presliding.extend(series.presliding)
            validation.extend(series.validation)
            excitation.extend(series.excitation)
        else:
            sliding.append(path)
            excitation.append(path)
    return IdentificationBags(
        tuple(sliding), tuple(presliding), tuple(validation), tuple(excitation)
    )


def _robot(options: argparse.Namespace) -> RobotOptions:
    stated = {field.name for field in fields(RobotOptions)}
    return RobotOptions(**{name: value for name, value in vars(options).items() if name in stated})


def _tolerances(options: argparse.Namespace) -> dict[str, float]:
    limits = {"torque": options.torque_tolerance, "total": options.total_torque_tolerance}
    return {name: value for name, value in limits.items() if value is not None}


def _verdict(against: str) -> int:
    """Return the exit code, and say what speaks against a result, if anything does."""
    if not against:
        return DONE
    print(one_line(f"rx90 identify: {against}"), file=sys.stderr)
    return VERDICT_NO


def _add_compare(parser: argparse.ArgumentParser) -> None:
    parser.epilog = _COMPARE_EPILOG
    parser.set_defaults(interrupted="nothing was written")
    parser.add_argument(
        "bag", type=Path, metavar="BAG", help="measured: folder, .mcap, .db3 or ROS 1 .bag file"
    )
    _add_report(parser, "none")
    _add_bandwidth(parser, "of the measured path as set-points; torques and positions are compared below a third of it "
                   "(from the data)")  # fmt: skip
    limits = MeasuredTolerances()
    _add_tolerances(parser, limits.torque, limits.total_torque)
    parser.set_defaults(torque_tolerance=limits.torque, total_torque_tolerance=limits.total_torque)
    parser.add_argument("--position-tolerance", type=POSITIVE, default=limits.position, metavar="RAD",
                        help="largest difference of a joint's position, rad (%(default)s)")  # fmt: skip
    add_robot_arguments(parser)
    layout = parser.add_argument_group(
        "what the bag holds", "by default motor_states or joint_states as here"
    )
    add_message_arguments(layout, "motor_states, else joint_states")
    add_zero_argument(layout)


def _compare(options: argparse.Namespace) -> int:
    """A measured bag against the closed loop without ROS along the same set-points: torques, positions, a verdict."""
    # Here, because --help must not wait for them.
    from rx90_common.description.robot_files import RobotFiles
    from rx90_emulator.measured_runs.output import run_comparison

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
    agrees = run_comparison(
        options.bag,
        files,
        layout,
        tolerances,
        options.bandwidth,
        options.report,
        force=options.force,
    )
    return _verdict("" if agrees else f"{options.bag} and the simulation do not agree")


_VERBS = (
    (_add_sliding, _sliding, "friction from sweeps at constant velocity"),
    (_add_excitation, _excitation, "dynamics and friction from runs in which all joints move"),
    (_add_check, _check, "hold a friction file against bags"),
    (_add_compare, _compare, "hold the simulated arm, with its controller, against a measured bag"),
)
