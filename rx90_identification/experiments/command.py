"""`rx90_experiment`: plan the motions that friction is identified from, and run them on the engine or the nodes."""

from __future__ import annotations

import argparse
import os
import sys
from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path

import numpy as np
from tqdm import tqdm

from rx90_common.compiled import announce_compilation
from rx90_common.errors import ExchangeError, Rx90Error
from rx90_common.interrupts import terminations_as_interrupts
from rx90_common.share import resolve_config
from rx90_identification.experiments.engine import run_on_engine
from rx90_identification.experiments.folder import make_folder, write_index
from rx90_identification.experiments.load import check_load
from rx90_identification.experiments.plan import Experiment, PlanOptions, make_plan
from rx90_loop.setup import Setup, SetupFiles

REFUSED, NOT_RUN, INTERRUPTED = 1, 3, 130
_QUICK = PlanOptions(
    speeds=8,
    travel=0.016,
    poses=PlanOptions().poses[:1],
    presliding_cycles=(2e-3,),
    tone_amplitudes=(4e-5,),
    burst=3.0,
)
_EPILOG = """\
exit status: 0 done, 1 refused, 2 wrong usage, 3 the nodes did not run it, 130 interrupted; complete bags stay.
No motion is checked for collisions. Set-points keep the joints' ranges and speed limits, and the expected torque
keeps what the URDF allows.
"""


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="rx90_experiment",
        description=__doc__,
        epilog=_EPILOG,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    verbs = parser.add_subparsers(dest="verb", required=True, metavar="plan|run")
    plan = verbs.add_parser("plan", help="show the experiments, their time and number of runs; moves nothing")
    run = verbs.add_parser("run", help="run the experiments and record a bag of each")
    for verb in (plan, run):
        verb.add_argument("--group", action="append", default=[], metavar="NAME",
                          help="only this group (joint_3, joints_5_6_against ...); may be repeated")  # fmt: skip
        verb.add_argument("--quick", action="store_true", help="fewer speeds, one pose, one micro-oscillation")
        verb.add_argument("--speeds", type=int, metavar="N",
                          help="speeds in each direction (28); the more, the smaller the deviations")  # fmt: skip
        verb.add_argument("--urdf", help="robot (shipped RX90B)")
        verb.add_argument("--tool", help="tool file, or none (shipped laser head)")
        verb.add_argument("--drives", help="drives file")
        verb.add_argument("--friction", help="friction file, for --engine")
        verb.add_argument("--controller-file", help="controller file")
    where = run.add_mutually_exclusive_group(required=True)
    where.add_argument("--engine", action="store_true", help="in the closed loop without ROS, fast")
    where.add_argument("--nodes", action="store_true", help="on the controller node, in its time")
    run.add_argument("--output", type=Path, required=True, metavar="FOLDER", help="folder for the bags; must not exist")
    run.add_argument(
        "--storage", choices=("mcap", "sqlite3"), default="mcap", help="of the engine's bags (%(default)s)"
    )
    run.add_argument("--controller", default="rx90_controller", help="name of the node (%(default)s)")
    run.add_argument("--timeout", type=float, default=60.0, metavar="S", help="s to wait for the nodes (%(default)s)")
    return parser


def _setup(options: argparse.Namespace) -> Setup:
    given = {
        "urdf": options.urdf,
        "drives": options.drives,
        "friction": options.friction,
        "controller": options.controller_file,
    }
    files: dict[str, Path | None] = {key: resolve_config(value) for key, value in given.items() if value is not None}
    if options.tool is not None:
        files["tool"] = None if options.tool == "none" else resolve_config(options.tool)
    return Setup.load(SetupFiles(**files))  # type: ignore[arg-type]


def _plan(options: argparse.Namespace, setup: Setup) -> tuple[Experiment, ...]:
    values = vars(_QUICK if options.quick else PlanOptions()) | {"groups": tuple(options.group)}
    if options.speeds is not None:
        values["speeds"] = options.speeds
    return make_plan(setup.robot, setup.drives, PlanOptions(**values))


def describe(plan: Sequence[Experiment], setup: Setup) -> str:
    """Return a table of the plan: runs, time, and how near each experiment comes to the arm's limits.

    Raises:
        IdentificationError: if an experiment leaves a limit.
    """
    lines = [f"{'experiment':<30}{'runs':>6}{'time s':>9}   most of the speed limit   most of the torque limit"]
    names = setup.robot.joint_names
    for experiment in plan:
        load = check_load(experiment, setup.robot, setup.drives, setup.controller)
        fast, strong = int(np.argmax(load.speed)), int(np.argmax(load.torque))
        lines.append(
            f"{experiment.name:<30}{experiment.sweeps:>6}{experiment.duration:>9.1f}"
            f"   {load.speed[fast]:>6.0%} ({names[fast]})          {load.torque[strong]:>6.0%} ({names[strong]})"
        )
    total = sum(experiment.duration for experiment in plan)
    runs = sum(experiment.sweeps for experiment in plan)
    lines.append(f"{len(plan)} experiments, {runs} runs, {total:.0f} s of motion ({total / 60.0:.1f} min)")
    return "\n".join(lines)


def _run(options: argparse.Namespace) -> None:
    setup = _setup(options)
    plan = _plan(options, setup)
    announce_compilation("rx90_experiment")
    print(describe(plan, setup), flush=True)
    if options.verb == "plan":
        return
    make_folder(options.output)
    try:
        _record(plan, setup, options)
    finally:
        # Where no bag came about, the folder would refuse the next attempt.
        with suppress(OSError):
            options.output.rmdir()
    print(f"bags: {options.output}")


def _record(plan: Sequence[Experiment], setup: Setup, options: argparse.Namespace) -> None:
    if options.engine:
        for number, experiment in enumerate(tqdm(plan, desc="engine", unit="experiment")):
            run_on_engine(setup, experiment, options.output / experiment.name, options.storage)
            write_index(options.output, plan[: number + 1])
    else:
        _run_on_nodes(plan, setup, options)


def _run_on_nodes(plan: Sequence[Experiment], setup: Setup, options: argparse.Namespace) -> None:
    from rx90_exchange.environment import prepare

    prepare()
    try:
        from rx90_identification.experiments.nodes import ExperimentRunner
    except ImportError as error:
        raise ExchangeError(f"--nodes needs ROS 2's rclpy, which is not installed ({error})") from error
    runner = ExperimentRunner(setup.robot, options.controller, options.timeout)
    runner.run(plan, options.output, lambda text: print(text, flush=True))


def main(args: Sequence[str] | None = None) -> int:
    """Run `rx90_experiment` and return its exit status."""
    options = _parser().parse_args(args)
    try:
        with terminations_as_interrupts():
            _run(options)
    except KeyboardInterrupt:
        # A bar that was drawn ends without a line's end.
        print(f"{os.linesep}rx90_experiment: interrupted; complete bags stay", file=sys.stderr)
        return INTERRUPTED
    except Rx90Error as error:
        print(f"rx90_experiment: {error}", file=sys.stderr)
        return NOT_RUN if isinstance(error, ExchangeError) else REFUSED
    return 0


if __name__ == "__main__":
    sys.exit(main())
