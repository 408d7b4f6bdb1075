"""Plan the motions that friction or the whole dynamics are identified from, and run them on the engine or the nodes."""

from __future__ import annotations

from argparse import ArgumentParser, Namespace
from pathlib import Path
from typing import TYPE_CHECKING

import rx90_emulator as rx
from rx90_common.base.quoting import one_line
from rx90_common.base.share import resolve_config
from rx90_common.description.robot_files import MODEL_FILES, NO_TOOL
from rx90_common.description.wall import Wall
from rx90_emulator.cli.options import (
    FINITE,
    POSITIVE,
    URDF,
    Verb,
    add_joints_argument,
    add_node_arguments,
    add_output,
    add_rate,
    add_robot_arguments,
    add_verbs,
    new_folder,
    setup_of,
    whole_number,
)
from rx90_emulator.identification.experiments.options import QUICK, RANGES, ExcitationOptions

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from rx90_emulator.identification.experiments.arms import PlannedArm
    from rx90_emulator.identification.experiments.plan import Experiment

_EPILOG = """\
Bags that are complete stay, whatever ends the run. No motion is checked for collisions, but for those of excitation:
of the arm with itself and with the planes given by --keep-above and --wall, by the shapes of <collision> in the URDF.
Set-points keep the joints' ranges and speed limits, and the expected torque keeps what the URDF allows.
"""


def _add_sliding(parser: ArgumentParser) -> None:
    add_verbs(parser, _verbs(_add_sliding_options))


def _sliding(_: Namespace) -> None:
    """Sweeps at constant velocity and micro-oscillations, joint after joint, for rx90 identify sliding."""


def _add_excitation(parser: ArgumentParser) -> None:
    any_arm = (_add_any, _any, "plan them for any arm, of which no more is known than its URDF")
    add_verbs(parser, (*_verbs(_add_robot_excitation), any_arm))


def _excitation(_: Namespace) -> None:
    """A Fourier series of all joints at once, for rx90 identify excitation."""


def _verbs(add_options: Callable[[ArgumentParser], None]) -> tuple[Verb, ...]:
    """Return the verbs of a kind of experiments, whose own options `add_options` adds."""

    def add_plan(parser: ArgumentParser) -> None:
        add_options(parser)
        _add_motions(parser)

    def add_engine(parser: ArgumentParser) -> None:
        add_options(parser)
        parser.set_defaults(interrupted="complete bags stay")
        about = "folder for the bags; must not exist"
        add_output(parser, new_folder, about, metavar="FOLDER", required=True)

    def add_nodes(parser: ArgumentParser) -> None:
        add_engine(parser)
        add_node_arguments(parser, 60.0)

    return (
        (add_plan, _plan, "show the experiments, their time and number of runs; moves nothing"),
        (
            add_engine,
            _engine,
            "run them in the closed loop without ROS, fast, and write a bag of each",
        ),
        (
            add_nodes,
            _nodes,
            "run them on the controller node, in its time, and record a bag of each",
        ),
    )


def _add_robot_excitation(parser: ArgumentParser) -> None:
    _add_excitation_options(parser)
    add_robot_arguments(parser, *MODEL_FILES, "poses")


def _add_any(parser: ArgumentParser) -> None:
    _add_excitation_options(parser)
    parser.add_argument("--urdf", type=Path, metavar="FILE", required=True, help=URDF)
    parser.add_argument("--tool", metavar="FILE", help="tool file (none)")
    add_joints_argument(parser)
    parser.add_argument("--acceleration", type=POSITIVE, metavar="A",
                        help="limit of each joint, rad/s^2 (speed limit in 0.5 s)")  # fmt: skip
    _add_motions(parser)


def _add_sliding_options(parser: ArgumentParser) -> None:
    parser.set_defaults(excitation=False, home=None)
    parser.epilog = _EPILOG
    parser.add_argument("--group", action="append", default=[], metavar="NAME",
                        help="only this group (joint_3, joints_5_6_against ...); may be repeated")  # fmt: skip
    _add_quick(parser, "fewer speeds, one pose, one micro-oscillation")
    add_robot_arguments(parser, *MODEL_FILES, "poses")


def _add_excitation_options(parser: ArgumentParser) -> None:
    parser.set_defaults(excitation=True)
    parser.epilog = _EPILOG
    _add_quick(parser, "one tempo, a short search")
    for name, (_, _, meaning) in RANGES.items():
        default = vars(ExcitationOptions)[name]
        kind = whole_number if isinstance(default, int) else FINITE
        parser.add_argument(
            f"--{name}", type=kind, default=default, metavar="N", help=f"{meaning} (%(default)s)"
        )
    parser.add_argument("--keep-above", type=FINITE, metavar="Z", help="a table: links and tool stay above this height "
                        "over the base's origin, m")  # fmt: skip
    parser.add_argument("--wall", type=FINITE, nargs=4, action="append", default=[], metavar=("NX", "NY", "NZ", "D"),
                        help="a wall: links and tool stay where NX x + NY y + NZ z > D in the base's frame, m; may be "
                        "repeated")  # fmt: skip
    parser.add_argument("--home", type=FINITE, nargs="+", metavar="RAD",
                        help="where every run begins and ends, one value per joint (the home of the robot's poses; the "
                        "middle of the joints' ranges where there are none)")  # fmt: skip


def _add_quick(parser: ArgumentParser, text: str) -> None:
    parser.add_argument("--quick", action="store_true", help=text)


def _add_motions(parser: ArgumentParser) -> None:
    text = (
        "write each motion there, for any controller: NAME.yaml, a trajectory, and NAME.csv, its set-points; must not "
        "exist"
    )
    add_output(parser, new_folder, text, metavar="FOLDER")
    add_rate(parser)


def _plan(options: Namespace) -> None:
    """Show the experiments, and write their motions if asked to; nothing moves."""
    _, arm, plan = _planned(options)
    _write(options, arm, plan)


def _any(options: Namespace) -> None:
    """Plan excitation runs for an arm of which only the URDF is known, and write them for its own controller."""
    # Here, because --help must not wait for it.
    from rx90_emulator.identification.experiments.arms import PlannedArm

    tool = None if options.tool in (None, NO_TOOL) else resolve_config(options.tool)
    arm = PlannedArm.from_urdf(
        options.urdf, options.joints, tool, options.home, options.acceleration
    )
    _write(options, arm, _described(options, arm, None))


def _engine(options: Namespace) -> None:
    """Run the experiments in the closed loop without ROS, and write a bag of each."""
    setup, _, plan = _planned(options)
    rx.record_on_engine(setup, plan, options.output)
    print(one_line(f"bags: {options.output}"))


def _nodes(options: Namespace) -> None:
    """Run the experiments on the controller node, and record a bag of each."""
    from rx90_common.exchange.ros_start import prepare
    from rx90_common.process.files import made_folder

    setup, _, plan = _planned(options)
    with made_folder(options.output):
        prepare()
        from rx90_emulator.identification.experiments.nodes import run_on_nodes

        run_on_nodes(setup, plan, options.output, options.node, options.timeout)
    print(one_line(f"bags: {options.output}"))


def _planned(
    options: Namespace,
) -> tuple[rx.Setup, PlannedArm, Sequence[Experiment]]:
    """Return the setup of a robot, its arm, and the experiments, which are shown."""
    from rx90_emulator.identification.experiments.arms import PlannedArm

    setup = setup_of(options)
    arm = PlannedArm.from_setup(setup, options.home)
    return setup, arm, _described(options, arm, setup)


def _described(options: Namespace, arm: PlannedArm, setup: rx.Setup | None) -> Sequence[Experiment]:
    """Return the experiments, which are shown: sweeps of a setup, or excitation runs of an arm."""
    from tqdm import tqdm

    from rx90_emulator.identification.experiments import series
    from rx90_emulator.identification.experiments.excitation import plan_excitation

    remarks: Sequence[str] = ()
    if options.excitation or setup is None:
        chosen = _excitation_options(options)
        # what is refused at once needs no progress line
        with tqdm(desc="search", unit="step", disable=None, delay=1e-9) as bar:
            plan, remarks = plan_excitation(arm, chosen, bar.update)
    else:
        plan = rx.plan_experiments(setup, options.group, quick=options.quick)
    print(series.describe(plan, arm, remarks), flush=True)
    return plan


def _excitation_options(options: Namespace) -> ExcitationOptions:
    walls = [Wall.through(numbers) for numbers in options.wall]
    if options.keep_above is not None:
        walls.append(Wall.above(options.keep_above))
    given = {name: vars(options)[name] for name in RANGES}
    return ExcitationOptions(walls=tuple(walls), **given, **(QUICK if options.quick else {}))


def _write(options: Namespace, arm: PlannedArm, plan: Sequence[Experiment]) -> None:
    """Write the motions of a plan, where it was asked for."""
    from rx90_emulator.identification.experiments import series

    if options.output is not None:
        series.write_motions(options.output, plan, arm, options.rate)
        print(one_line(f"motions: {options.output}, from home and back; bring the arm there first"))


SUBCOMMANDS = (
    (_add_sliding, _sliding, "one joint after the other: sweeps and micro-oscillations"),
    (_add_excitation, _excitation, "a Fourier series of all joints at once"),
)
