"""What `rx90_experiment` does, apart from its options: imported once these are understood, for it takes a second."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
from tqdm import tqdm

from rx90_common.base.errors import ExchangeError
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


@dataclass(frozen=True)
class ExperimentJob:
    """Which experiments to plan, and where to run them.

    Attributes:
        files: the robot's; by default the shipped ones.
        groups: names of directions; all of them if empty.
        quick: whether fewer speeds, one pose and one micro-oscillation do.
        speeds: in each direction; None for the plan's own number.
        output: folder for the bags; None to plan only.
        engine: whether to run in the closed loop without ROS, else on the controller node.
        storage: of the engine's bags, mcap or sqlite3.
        controller: name of the controller node.
        timeout: longest wait for the nodes, s.
    """

    files: RobotFiles = field(default_factory=RobotFiles)
    groups: tuple[str, ...] = ()
    quick: bool = False
    speeds: int | None = None
    output: Path | None = None
    engine: bool = True
    storage: str = "mcap"
    controller: str = "rx90_controller"
    timeout: float = 60.0

    def plan_options(self) -> PlanOptions:
        """Return the options of the plan.

        Raises:
            IdentificationError: for a number of speeds that is not acceptable.
        """
        options = replace(_QUICK if self.quick else PlanOptions(), groups=self.groups)
        return options if self.speeds is None else replace(options, speeds=self.speeds)


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


def run_experiments(job: ExperimentJob) -> None:
    """Print the plan, and run it if there is a folder for the bags.

    Raises:
        Rx90Error: for what cannot be done; complete bags stay.
    """
    setup = Setup.load(job.files)
    plan = make_plan(setup.robot, setup.drives, job.plan_options())
    print(describe(plan, setup), flush=True)
    if job.output is None:
        return
    make_folder(job.output)
    try:
        if job.engine:
            for number, experiment in enumerate(tqdm(plan, desc="engine", unit="experiment")):
                run_on_engine(setup, experiment, job.output / experiment.name, job.storage)
                write_index(job.output, plan[: number + 1])
        else:
            _run_on_nodes(setup, plan, job.output, job)
    finally:
        # A folder without any bag would refuse the next attempt.
        with suppress(OSError):
            job.output.rmdir()
    print(f"bags: {job.output}")


def _run_on_nodes(setup: Setup, plan: Sequence[Experiment], folder: Path, job: ExperimentJob) -> None:
    from rx90_common.exchange.environment import prepare

    prepare()
    try:
        from rx90_emulator.identification.experiments.nodes import run_on_nodes
    except ImportError as error:
        raise ExchangeError(f"--nodes needs ROS 2's rclpy, which is not installed ({error})") from error
    run_on_nodes(setup, plan, folder, job.controller, job.timeout, lambda text: print(text, flush=True))
