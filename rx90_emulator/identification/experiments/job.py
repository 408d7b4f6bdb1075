"""What `rx90_experiment` does, apart from its options: imported once these are understood, for it takes a second."""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from contextlib import suppress

import numpy as np
from tqdm import tqdm

from rx90_common.description.robot_files import RobotFiles
from rx90_emulator.identification.experiments.engine import run_on_engine
from rx90_emulator.identification.experiments.folder import make_folder, write_index
from rx90_emulator.identification.experiments.load import check_load
from rx90_emulator.identification.experiments.plan import Experiment, PlanOptions, make_plan
from rx90_emulator.loop.setup import Setup

_QUICK = PlanOptions(
    speeds=8,
    travel=0.016,
    poses=PlanOptions().poses[:1],
    presliding_cycles=(2e-3,),
    tone_amplitudes=(4e-5,),
    burst=3.0,
)


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


def run(options: argparse.Namespace) -> None:
    """Show the plan and run it, if asked to.

    Raises:
        Rx90Error: for what cannot be done; complete bags stay.
    """
    setup = Setup.load(RobotFiles.of_options(options))
    plan = _plan(options, setup)
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
        with tqdm(plan, desc="engine", unit="experiment") as bar:  # an interrupt ends its line
            for number, experiment in enumerate(bar):
                run_on_engine(setup, experiment, options.output / experiment.name, options.storage)
                write_index(options.output, plan[: number + 1])
    else:
        _run_on_nodes(plan, setup, options)


def _run_on_nodes(plan: Sequence[Experiment], setup: Setup, options: argparse.Namespace) -> None:
    from rx90_common.exchange.environment import prepare

    prepare()
    from rx90_emulator.identification.experiments.nodes import run_on_nodes

    run_on_nodes(setup, plan, options.output, options.node, options.timeout, lambda text: print(text, flush=True))
