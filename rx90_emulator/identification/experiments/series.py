"""The work of `rx90 experiment` with a plan: show it, search for excitation runs with a progress bar, and record it."""

from __future__ import annotations

import io
import math
from collections.abc import Iterable, Sequence
from pathlib import Path

import numpy as np
from tqdm import tqdm

from rx90_common.bags.topics import absolute
from rx90_common.bags.writing import string_message, write_joint_states
from rx90_common.base.config import yaml_text
from rx90_common.base.quoting import counted, plain
from rx90_common.friction.friction_file import FrictionFile
from rx90_common.process.files import made_folder, write_all, write_text
from rx90_controller.trajectory.points import message_content
from rx90_controller.trajectory.spline import interpolate
from rx90_emulator.identification.experiments.arms import PlannedArm
from rx90_emulator.identification.experiments.plan import (
    TOPICS,
    Experiment,
    write_index,
)
from rx90_emulator.loop.closed_loop import simulate
from rx90_emulator.loop.setup import Setup


def describe(plan: Sequence[Experiment], arm: PlannedArm, remarks: Iterable[str] = ()) -> str:
    """Return a table of the plan: runs, time, and the largest use of the arm's limits in each experiment."""
    lines = [
        f"{'experiment':<30}{'runs':>6}{'time s':>9}   most of the limits of position, speed and torque"
    ]
    for experiment in plan:
        used = arm.check(experiment)
        limits = (
            used["position"],
            max(used["speed"], used["motor speed"]),
            max(used["torque"], used["motor torque"]),
        )
        cells = (f"{share:.0%} ({whose})" for share, whose in limits)
        lines.append(
            f"{experiment.name:<30}{experiment.sweeps:>6}{experiment.duration:>9.1f}   {'  '.join(cells)}"
        )
    runs = counted(sum(experiment.sweeps for experiment in plan), "run")
    total = sum(experiment.duration for experiment in plan)
    whole = f"{counted(len(plan), 'experiment')}, {runs}, {total:.0f} s of motion ({total / 60.0:.1f} min)"
    return "\n".join([*lines, *remarks, whole])


def write_motions(folder: Path, plan: Sequence[Experiment], arm: PlannedArm, rate: float) -> None:
    """Write motions for a controller that is not this project's, two files for each, all or none.

    `NAME.yaml` is a trajectory_msgs/JointTrajectory with knots to be joined by quintics. `NAME.csv` contains the
    set-points at an even rate: time, and position, velocity and acceleration of each joint, named as in exported bags.

    Args:
        folder: made if it is not there.
        plan: the motions.
        arm: for the joints' names.
        rate: of the set-points, Hz.
    """
    names = arm.robot.joint_names
    files = dict[Path, bytes]()
    head = ["time [s]"]
    for quantity in ("position [rad]", "velocity [rad/s]", "acceleration [rad/s^2]"):
        head += [plain(f"{name} {quantity}") for name in names]
    for experiment in plan:
        points = experiment.points
        assert points.velocity is not None  # a Motion has all three
        curve = interpolate(points.times, points.position, points.velocity, points.acceleration)
        time = np.arange(math.floor(experiment.duration * rate) + 1) / rate
        rows = np.column_stack([time, curve.sample(time).reshape(len(time), -1)])
        table = io.StringIO()
        np.savetxt(table, rows, fmt="%.12g", delimiter=",", header=",".join(head), comments="")
        files[folder / f"{experiment.name}.csv"] = table.getvalue().encode()
        files[folder / f"{experiment.name}.yaml"] = yaml_text(
            message_content(names, points)
        ).encode()
    with made_folder(folder):
        write_all(files)


_SETTLING_S = 0.2  # s, after the end


def run_on_engine(setup: Setup, experiment: Experiment, bag: Path) -> None:
    """Simulate one experiment and write its bag.

    Raises:
        DivergenceError: naming joint and tick.
    """
    topics = TOPICS[experiment.kind]
    result = simulate(
        setup,
        experiment.points,
        duration=experiment.duration + _SETTLING_S,
        record_fast="motor_states" in topics,
    )
    recorded = set(map(absolute, topics))
    series = [series for series in result.series.values() if series.topic in recorded]
    description = string_message("/robot_description", setup.robot.urdf)
    write_joint_states(bag, series, messages=[description])


def record_on_engine(setup: Setup, plan: Sequence[Experiment], folder: Path | str) -> None:
    """Run experiments in the closed loop without ROS, each into a bag of a new folder.

    Raises:
        Rx90Error: for every refusal and failure; complete bags stay.
    """
    elements = dict(zip(setup.friction.names, setup.friction.elements, strict=True))
    source = "the emulator made the runs beside this file with it"
    friction = FrictionFile.of(elements, provenance="assumed", source=source)
    # An interrupt ends the bar's line.
    with (
        made_folder(Path(folder)) as new,
        tqdm(plan, desc="engine", unit="experiment", disable=None) as bar,
    ):
        for number, experiment in enumerate(bar):
            run_on_engine(setup, experiment, new / experiment.name)
            write_index(new, plan[: number + 1])
            write_text(new / "emulated_friction.yaml", friction.text())
