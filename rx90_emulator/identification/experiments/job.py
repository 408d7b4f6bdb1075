"""What `rx90_experiment` does, apart from its options: imported once these are understood, for it takes a second."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from tqdm import tqdm

from rx90_common.bags.topics import absolute
from rx90_common.bags.writing import string_message, write_joint_states
from rx90_common.base.errors import IdentificationError
from rx90_common.exchange.topics import MOTOR_NAMES
from rx90_emulator.identification.experiments.folder import TOPICS, make_folder, write_emulated, write_index
from rx90_emulator.identification.experiments.load import check_load
from rx90_emulator.identification.experiments.plan import Experiment, PlanOptions, Poses, make_plan
from rx90_emulator.loop.closed_loop import simulate
from rx90_emulator.loop.setup import Setup

_SETTLING_S = 0.2  # s, after the end


def run_on_engine(setup: Setup, experiment: Experiment, bag: Path, storage: str = "mcap") -> None:
    """Simulate one experiment and write its bag.

    Raises:
        BagError: if the bag exists or cannot be written.
        DivergenceError: naming joint and tick.
    """
    result = simulate(
        setup,
        experiment.points,
        duration=experiment.duration + _SETTLING_S,
        record_fast="motor_states" in TOPICS[experiment.kind],
    )
    wanted = [absolute(topic) for topic in TOPICS[experiment.kind]]
    series = [one for one in result.series.values() if one.topic in wanted]
    description = string_message("/robot_description", setup.robot.urdf)
    write_joint_states(bag, series, storage=storage, messages=[description])


_QUICK: dict[str, Any] = {
    "speeds": 8, "travel": 0.016, "presliding_cycles": (2e-3,), "tone_amplitudes": (4e-5,), "burst": 3.0
}  # fmt: skip


def plan_experiments(
    setup: Setup, groups: Sequence[str] = (), *, quick: bool = False, speeds: int | None = None
) -> tuple[Experiment, ...]:
    """Return the experiments for an arm.

    Args:
        setup: robot and drives, read from files, of which one holds the poses.
        groups: names of directions; all of them if empty.
        quick: whether fewer speeds, one pose and one micro-oscillation do.
        speeds: in each direction; None for the plan's own number.

    Raises:
        IdentificationError: for an unknown group or a number of speeds that is not acceptable.
        ConfigError: if the robot has no poses.
    """
    if setup.files is None:
        raise IdentificationError("the setup was not read from files; accepted: one of load_setup")
    poses = Poses.load(setup.files.required("poses"))
    if quick:
        poses = replace(poses, sweeps=poses.sweeps[:1])
    options = PlanOptions(poses=poses, groups=tuple(groups), **(_QUICK if quick else {}))
    return make_plan(setup.robot, setup.drives, options if speeds is None else replace(options, speeds=speeds))


def describe(plan: Sequence[Experiment], setup: Setup) -> str:
    """Return a table of the plan: runs, time, and how near each experiment comes to the arm's limits.

    Raises:
        IdentificationError: if an experiment leaves a limit.
    """
    lines = [f"{'experiment':<30}{'runs':>6}{'time s':>9}   most of the speed limit   most of the torque limit"]
    names = (*setup.robot.joint_names, *MOTOR_NAMES)
    for experiment in plan:
        load = check_load(experiment, setup.robot, setup.drives, setup.controller)
        speed, torque = np.append(load.speed, load.motor_speed), np.append(load.torque, load.motor_torque)
        fast, strong = int(np.argmax(speed)), int(np.argmax(torque))
        lines.append(
            f"{experiment.name:<30}{experiment.sweeps:>6}{experiment.duration:>9.1f}"
            f"   {speed[fast]:>6.0%} ({names[fast]})          {torque[strong]:>6.0%} ({names[strong]})"
        )
    total = sum(experiment.duration for experiment in plan)
    runs = sum(experiment.sweeps for experiment in plan)
    lines.append(f"{len(plan)} experiments, {runs} runs, {total:.0f} s of motion ({total / 60.0:.1f} min)")
    return "\n".join(lines)


def record_on_engine(setup: Setup, plan: Sequence[Experiment], folder: Path | str, storage: str = "mcap") -> None:
    """Run experiments in the closed loop without ROS, each into a bag of a new folder.

    Raises:
        Rx90Error: for what cannot be done; complete bags stay.
    """
    # An interrupt ends the bar's line.
    with _new_folder(Path(folder)) as new, tqdm(plan, desc="engine", unit="experiment", disable=None) as bar:
        for number, experiment in enumerate(bar):
            run_on_engine(setup, experiment, new / experiment.name, storage)
            if not number:
                write_emulated(new, setup.friction)
            write_index(new, plan[: number + 1])


def record_on_nodes(
    setup: Setup, plan: Sequence[Experiment], folder: Path, controller: str = "rx90_controller", timeout: float = 60.0
) -> None:
    """Run experiments on a controller node, each into a bag of a new folder; waits for the nodes for `timeout`, s.

    Raises:
        Rx90Error: for what cannot be done; complete bags stay.
    """
    with _new_folder(folder):
        from rx90_common.exchange.ros_start import prepare

        prepare()
        from rx90_emulator.identification.experiments.nodes import run_on_nodes

        run_on_nodes(setup, plan, folder, controller, timeout, lambda text: print(text, flush=True))


@contextmanager
def _new_folder(folder: Path) -> Iterator[Path]:
    make_folder(folder)
    try:
        yield folder
    finally:
        # A folder without any bag would refuse the next attempt.
        with suppress(OSError):
            folder.rmdir()
