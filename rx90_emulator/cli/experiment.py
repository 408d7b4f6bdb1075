"""Plan the motions that friction or the whole dynamics are identified from, and run them on the engine or the nodes."""

from __future__ import annotations

import argparse
from pathlib import Path

from rx90_common.base.errors import IdentificationError
from rx90_common.base.quoting import one_line
from rx90_common.base.share import resolve_config
from rx90_common.description.robot_files import MODEL_FILES, NO_TOOL
from rx90_common.description.wall import Wall
from rx90_emulator.cli.options import (
    FINITE,
    POSITIVE,
    add_node_arguments,
    add_robot_arguments,
    check_apart,
    check_needs,
    is_given,
    new_folder,
    node_of,
    whole_number,
)
from rx90_emulator.identification.experiments.options import QUICK, RANGES, ExcitationOptions

_EPILOG = """\
Bags that are complete stay, whatever ends the run. No motion is checked for collisions, but for those of --excitation
of the arm with itself and with the planes given by --keep-above and --wall, by the shapes of <collision> in the URDF.
Set-points keep the joints' ranges and speed limits, and the expected torque keeps what the URDF allows.
plan --excitation --urdf FILE without other files of a robot is for any arm, of which no more is known than its URDF:
example: rx90_experiment plan --excitation --urdf panda.urdf --output motions
"""
_TIMEOUT = 60.0  # s
_RATE = 1000.0  # Hz, of written set-points
_OF_A_ROBOT = ("robot", "drives", "friction", "controller", "poses")
"""Options that name a robot of this project, or a file that arms of which only the URDF is known do not have."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the verbs and their options."""
    parser.epilog = _EPILOG
    verbs = parser.add_subparsers(dest="verb", required=True, metavar="plan|run")
    plan = verbs.add_parser("plan", help="show the experiments, their time and number of runs; moves nothing")
    run = verbs.add_parser("run", help="run the experiments and record a bag of each")
    for verb in (plan, run):
        verb.add_argument("--group", action="append", default=[], metavar="NAME",
                          help="only this group (joint_3, joints_5_6_against ...); may be repeated")  # fmt: skip
        verb.add_argument("--quick", action="store_true", help="fewer speeds, one pose, one micro-oscillation")
        verb.add_argument("--speeds", type=whole_number, metavar="N",
                          help="speeds in each direction (28); the more, the smaller the deviations")  # fmt: skip
        _add_excitation(verb)
        add_robot_arguments(verb, *MODEL_FILES, "poses")
    plan.add_argument("--joints", nargs="+", metavar="NAME",
                      help="with --urdf of any arm: its joints of interest from base to tip; the others are held at 0 "
                      "(all that turn and mimic no other)")  # fmt: skip
    plan.add_argument("--acceleration", type=POSITIVE, metavar="A",
                      help="with --urdf of any arm: limit of each joint, rad/s^2 (speed limit in 0.5 s)")  # fmt: skip
    plan.add_argument("--output", type=new_folder, metavar="FOLDER",
                      help="write each motion there, for any controller: NAME.yaml, a trajectory, and NAME.csv, its "
                      "set-points; must not exist")  # fmt: skip
    plan.add_argument("--rate", type=POSITIVE, metavar="HZ", help=f"of the set-points in NAME.csv, Hz ({_RATE:g})")
    run.set_defaults(interrupted="complete bags stay")
    where = run.add_mutually_exclusive_group(required=True)
    where.add_argument("--engine", action="store_true", help="in the closed loop without ROS, fast")
    where.add_argument("--nodes", action="store_true", help="on the controller node, in its time")
    run.add_argument(
        "--output", type=new_folder, required=True, metavar="FOLDER", help="folder for the bags; must not exist"
    )
    add_node_arguments(run, _TIMEOUT)


def _add_excitation(verb: argparse.ArgumentParser) -> None:
    verb.add_argument("--excitation", action="store_true", help="instead: a Fourier series of all joints at once, for "
                      "rx90_identify --excitation")  # fmt: skip
    group = verb.add_argument_group("with --excitation")
    for name, (_, _, meaning) in RANGES.items():
        default = vars(ExcitationOptions)[name]
        kind = whole_number if isinstance(default, int) else FINITE
        group.add_argument(f"--{name}", type=kind, metavar="N", help=f"{meaning} ({default})")
    group.add_argument("--keep-above", type=FINITE, metavar="Z", help="a table: links and tool stay above this height "
                       "over the base's origin, m")  # fmt: skip
    group.add_argument("--wall", type=FINITE, nargs=4, action="append", metavar=("NX", "NY", "NZ", "D"),
                       help="a wall: links and tool stay where NX x + NY y + NZ z > D in the base's frame, m; may be "
                       "repeated")  # fmt: skip
    group.add_argument("--home", type=FINITE, nargs="+", metavar="RAD",
                       help="where every run begins and ends, one value per joint (the home of the robot's poses; the "
                       "middle of the joints' ranges where there are none)")  # fmt: skip


def _excitation_options(options: argparse.Namespace) -> ExcitationOptions | None:
    """Return the options of excitation runs; None without --excitation."""
    check_needs(options, (*RANGES, "keep_above", "wall", "home"), ("excitation",))
    check_apart(options, ("group", "speeds"), "excitation", "without it, all joints move at once")
    if not options.excitation:
        return None
    walls = [Wall.through(numbers) for numbers in options.wall or ()]
    if options.keep_above is not None:
        walls.append(Wall.above(options.keep_above))
    given = {name: value for name in RANGES if (value := vars(options)[name]) is not None}
    return ExcitationOptions(walls=tuple(walls), **given, **(QUICK if options.quick else {}))


def main(options: argparse.Namespace) -> None:
    """Plan, and run if asked to."""
    # Here, because --help must not wait for them.
    from rx90_common.description.robot_files import RobotFiles
    from rx90_emulator.identification.experiments import series
    from rx90_emulator.identification.experiments.arms import PlannedArm
    from rx90_emulator.identification.experiments.plan import plan_experiments
    from rx90_emulator.loop.setup import Setup

    if options.verb == "run":
        check_needs(options, ("node", "timeout"), ("nodes",))
    else:
        check_needs(options, ("rate",), ("output",))
    excitation = _excitation_options(options)
    any_arm = excitation is not None and options.urdf is not None and not any(is_given(options, x) for x in _OF_A_ROBOT)
    if any_arm and options.verb == "run":
        raise IdentificationError("run --excitation --urdf without --robot; accepted: plan, whose files other "
                                  "controllers play, or a robot of this project")  # fmt: skip
    if not any_arm and options.verb == "plan":
        check_needs(options, ("joints", "acceleration"), ("urdf",))
        check_apart(options, ("joints", "acceleration"), "robot", "--urdf alone, with --excitation")
    if any_arm:
        tool = None if options.tool in (None, NO_TOOL) else resolve_config(options.tool)
        arm = PlannedArm.from_urdf(Path(options.urdf), options.joints, tool, options.home, options.acceleration)
    else:
        setup = Setup.load(RobotFiles.of_options(options))
        arm = PlannedArm.from_setup(setup, options.home)
    if excitation is None:
        plan = plan_experiments(setup, options.group, quick=options.quick, speeds=options.speeds)
        print(series.describe(plan, arm), flush=True)
    else:
        plan, remarks = series.plan_with_progress(arm, excitation)
        print(series.describe(plan, arm, remarks), flush=True)
    if options.verb == "plan":
        if options.output is not None:
            series.write_motions(options.output, plan, arm, options.rate or _RATE)
            print(one_line(f"motions: {options.output}, from home and back; bring the arm there first"))
        return
    if options.engine:
        series.record_on_engine(setup, plan, options.output)
    else:
        series.record_on_nodes(setup, plan, options.output, node_of(options), options.timeout or _TIMEOUT)
    print(one_line(f"bags: {options.output}"))
