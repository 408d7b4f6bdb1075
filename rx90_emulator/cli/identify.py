"""Identify friction, or the whole dynamics, from recorded bags and tables, and hold models against bags."""

from __future__ import annotations

import sys
from argparse import ArgumentParser, Namespace, RawDescriptionHelpFormatter
from collections.abc import Callable
from dataclasses import fields
from pathlib import Path
from typing import TYPE_CHECKING, TypeVar

import rx90_emulator as rx
from rx90_common.base.errors import DONE, VERDICT_NO
from rx90_common.base.quoting import one_line
from rx90_common.description.robot_files import FILES
from rx90_emulator.cli.options import (
    POSITIVE,
    add_arm_arguments,
    add_force,
    add_message_arguments,
    add_output,
    add_robot_arguments,
    add_zero_argument,
    place,
    setup_of,
)
from rx90_emulator.identification.options import (
    COULOMB_VISCOUS,
    EMULATED,
    MODEL_PARTS,
    RECORDED,
    MeasuredLayout,
    MeasuredTolerances,
    Progress,
    RobotOptions,
)

if TYPE_CHECKING:
    from rx90_emulator.identification.result import (
        ExcitationIdentification,
        FrictionIdentification,
    )

_Stated = TypeVar("_Stated", RobotOptions, MeasuredLayout)
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


def _add_sliding(parser: ArgumentParser) -> None:
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


def _add_excitation(parser: ArgumentParser) -> None:
    parser.epilog = _EPILOG
    _add_bags(
        parser,
        "runs in which all joints move, without plateaus, or a folder that rx90 experiment wrote",
    )
    parser.set_defaults(presliding=[])
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


def _add_check(parser: ArgumentParser) -> None:
    parser.epilog = _EPILOG
    parser.add_argument(
        "friction",
        metavar="FILE",
        help="friction file, or a shipped one (robots/tx40/friction.yaml)",
    )
    _add_bags(parser, "bags of the arm")
    _add_report(parser)
    _add_tolerances(parser, _TORQUE, RECORDED.total)
    add_arm_arguments(parser)


def _add_bags(parser: ArgumentParser, text: str) -> None:
    parser.formatter_class = RawDescriptionHelpFormatter
    parser.set_defaults(interrupted="nothing was written")
    parser.add_argument("bags", type=Path, nargs="+", metavar="BAG", help=text)


def _add_identification(parser: ArgumentParser, output: str) -> None:
    parser.add_argument("--validation", type=Path, nargs="+", default=[], metavar="BAG",
                        help="a run to hold the result against, not used before")  # fmt: skip
    add_output(parser, place, output, metavar="FILE", required=True)


def _add_report(parser: ArgumentParser) -> None:
    parser.add_argument("--report", type=place, metavar="FILE", help="report to write (none)")
    add_force(parser)


def _add_bandwidth(parser: ArgumentParser, text: str) -> None:
    parser.add_argument("--bandwidth", type=POSITIVE, metavar="HZ", help=text)


def _add_tolerances(parser: ArgumentParser, torque: float | str, total: float) -> None:
    parser.add_argument("--torque-tolerance", type=POSITIVE, metavar="SHARE",
                        help=f"RMS difference over RMS torque, of each joint ({torque})")  # fmt: skip
    parser.add_argument("--total-torque-tolerance", type=POSITIVE, metavar="SHARE",
                        help=f"the same of all joints together ({total})")  # fmt: skip


def _sliding(options: Namespace) -> int:
    """Identify friction from sweeps at constant velocity, and its bristles from micro-oscillations."""
    bags = _bags(options)
    robot = _stated(RobotOptions, options)
    tolerances = _tolerances(options)
    return _identified(
        options, lambda step: rx.identify_friction(bags, robot, tolerances, step), folder=False
    )


def _excitation(options: Namespace) -> int:
    """Identify dynamics and friction of the whole arm from runs in which all joints move."""
    bags = _bags(options)
    robot = _stated(RobotOptions, options)
    tolerances = _tolerances(options)

    def identify(step: Progress) -> ExcitationIdentification:
        return rx.identify_excitation(
            bags.excitation, robot, bags.validation, tolerances,
            model=options.model, rotors=not options.no_rotors,
            bandwidth=options.bandwidth, progress=step,
        )  # fmt: skip

    return _identified(options, identify, folder=True)


def _identified(
    options: Namespace,
    identify: Callable[[Progress], FrictionIdentification | ExcitationIdentification],
    *,
    folder: bool,
) -> int:
    """Identify with a progress line, write the files or the folder, print a summary, and return the exit code."""
    # Here, because --help must not wait for them.
    from rx90_emulator.identification.job import identification_targets, steps
    from rx90_emulator.identification.output.robot_files import folder_base
    from rx90_emulator.identification.result import ExcitationIdentification, objection

    identification_targets(options.output, folder=folder, force=options.force)
    with steps() as step:
        result = identify(step)
    files = rx.write_identification(result, options.output, force=options.force)
    print(rx.identification_summary(result))
    print(f"files: {', '.join(sorted(map(str, files)))}")
    if isinstance(result, ExcitationIdentification) and result.robot.setup is None:
        print(f"{options.output}: {folder_base(result.arm, options.urdf)[1]}")
    against = objection(result.validations, result.alarms)
    return _verdict(against and f"{against} the result")


def _check(options: Namespace) -> int:
    """Hold a friction file against bags; nothing is identified."""
    from rx90_common.process.files import write_text
    from rx90_emulator.identification.job import check_targets, steps
    from rx90_emulator.identification.output.report import check_page
    from rx90_emulator.identification.output.summary import check_summary
    from rx90_emulator.identification.result import objection

    friction = options.friction
    check_targets(options.report, force=options.force)
    robot = _stated(RobotOptions, options)
    with steps() as step:
        checks = rx.check_friction(friction, options.bags, robot, _tolerances(options), step)
    lines = [check_summary(checks)]
    against = objection(checks)
    beside = Path(friction).with_name(FILES["urdf"])
    if (
        against
        and options.urdf
        and beside.is_file()
        and beside.read_bytes() != options.urdf.read_bytes()
    ):
        lines.append(f"hint: {beside} stands beside {friction}, and is not what --urdf gave")
    if options.report is not None:
        write_text(options.report, check_page(checks, friction))
        lines.append(f"report: {options.report}")
    print("\n".join(lines))
    return _verdict(against and f"{against} {friction}")


def _bags(options: Namespace) -> rx.IdentificationBags:
    """Return bags by use: of a folder that `rx90 experiment` wrote as its index says, others as sweeps and runs."""
    from rx90_emulator.identification.experiments.plan import INDEX, read_index

    single = tuple(path for path in options.bags if not (path / INDEX).exists())
    parts = [read_index(path) for path in options.bags if (path / INDEX).exists()]
    parts.append(
        rx.IdentificationBags(
            single, tuple(options.presliding), tuple(options.validation), excitation=single
        )
    )
    bags: dict[str, tuple[Path, ...]] = {}
    for part in parts:
        for use, paths in vars(part).items():
            bags[use] = (*bags.get(use, ()), *paths)
    return rx.IdentificationBags(**bags)


def _stated(kind: type[_Stated], options: Namespace) -> _Stated:
    """Return what the options state of an arm, or of the layout of its bags."""
    names = {field.name for field in fields(kind)}
    return kind(**{name: value for name, value in vars(options).items() if name in names})


def _tolerances(options: Namespace) -> dict[str, float]:
    limits = {"torque": options.torque_tolerance, "total": options.total_torque_tolerance}
    return {name: value for name, value in limits.items() if value is not None}


def _verdict(against: str) -> int:
    """Return the exit code, and say what speaks against a result, if anything does."""
    if not against:
        return DONE
    print(one_line(f"rx90 identify: {against}"), file=sys.stderr)
    return VERDICT_NO


def _add_compare(parser: ArgumentParser) -> None:
    parser.epilog = _COMPARE_EPILOG
    parser.set_defaults(interrupted="nothing was written")
    parser.add_argument(
        "bag", type=Path, metavar="BAG", help="measured: folder, .mcap, .db3 or ROS 1 .bag file"
    )
    _add_report(parser)
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


def _compare(options: Namespace) -> int:
    """A measured bag against the closed loop without ROS along the same set-points: torques, positions, a verdict."""
    from rx90_emulator.identification.job import check_targets, steps

    tolerances = MeasuredTolerances(
        options.torque_tolerance, options.total_torque_tolerance, options.position_tolerance
    )
    check_targets(options.report, force=options.force)
    setup = setup_of(options)
    layout = _stated(MeasuredLayout, options)
    with steps() as step:
        result = rx.compare_measured(
            options.bag, setup, layout, tolerances, bandwidth=options.bandwidth, progress=step
        )
    print(rx.measured_summary(result))
    if options.report is not None:
        print(f"report: {rx.write_measured(result, setup, options.report, force=options.force)}")
    return _verdict("" if result.passed else f"{options.bag} and the simulation do not agree")


SUBCOMMANDS = (
    (_add_sliding, _sliding, "friction from sweeps at constant velocity"),
    (_add_excitation, _excitation, "dynamics and friction from runs in which all joints move"),
    (_add_check, _check, "hold a friction file against bags"),
    (_add_compare, _compare, "hold the simulated arm, with its controller, against a measured bag"),
)
