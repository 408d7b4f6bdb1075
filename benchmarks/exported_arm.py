"""The reference line on the engine and on the exported MJCF in MuJoCo, under the same control law: path error and time.

    python -m benchmarks.exported_arm [--robot tx40] [--factor 2] [--steps 16 | --tune]

The law is the controller itself, called from Python in each tick, behind encoders like those of the engine. With --tune
its gains are chosen in MuJoCo, for the least path error, and taken here.
"""

from __future__ import annotations

import dataclasses
import sys
import time
from typing import NamedTuple

import mujoco
import numpy as np

from benchmarks.report import arguments, merge, print_table
from rx90_common.base.arrays import Array
from rx90_common.base.errors import FailureError
from rx90_common.description.robot_files import DEFAULT_ROBOT, RobotFiles
from rx90_controller.lines.task import LineTask, load_task
from rx90_emulator.export.export import export_robot
from rx90_emulator.loop.line import path_accuracy, plan_line, run_line
from rx90_emulator.loop.setup import Setup

TARGETS = ("mujoco", "mujoco-classic")
FACTORS = (0.5, 0.7, 1.0, 1.4, 2.0, 2.8, 4.0, 5.6)
"""On kv and ki, of which the best is looked for; what cannot be run is left out."""


class ExportedRun(NamedTuple):
    """Joint positions on position ticks, rad, shape (m, n), and s of processor time for a tick."""

    position: Array
    seconds: float


class Encoders:
    """Resolvers with their converters, for any coupling: what the controller measures of joint positions, rad, (n,)."""

    def __init__(self, setup: Setup, position: Array) -> None:
        drives, self._period = setup.drives, setup.rates.period
        self._turns = drives.gear[:, None] * drives.turning.turns
        self._step = 2.0 * np.pi / drives.encoder_counts
        pole = float(np.exp(-2.0 * np.pi * drives.velocity_bandwidth * self._period))
        self._gains = 1.0 - pole**2, (1.0 - pole) ** 2 / self._period
        self._observed, self.velocity = self._turns @ position, np.zeros(len(position))
        self.position = np.round(self._observed / self._step) * self._step

    def sample(self, position: Array) -> None:
        """Sample the joint positions, and move the observer of the velocity on by a tick."""
        angle = self._turns @ position
        self.position = np.round(angle / self._step) * self._step
        predicted = self._observed + self._period * self.velocity
        self._observed = predicted + self._gains[0] * (angle - predicted)
        self.velocity = self.velocity + self._gains[1] * (angle - predicted)


def run_exported(setup: Setup, task: LineTask, target: str, steps: int = 1) -> ExportedRun:
    """Run the line in MuJoCo on what is exported to a target, with so many of MuJoCo's steps in a tick."""
    (text,) = export_robot(setup, target).files.values()
    model = mujoco.MjModel.from_xml_string(text)
    model.opt.timestep /= steps
    data = mujoco.MjData(model)
    plan, ratio = plan_line(setup, task), setup.rates.ratio
    data.qpos[:] = plan.start_pose
    controller, encoders = setup.cs7b(), Encoders(setup, plan.start_pose)
    controller.reset(encoders.position)
    controller.trajectory.reset(plan.start_pose)
    controller.trajectory.accept(plan.points, 0, 0)
    position, began = (
        np.empty((round(plan.duration * setup.rates.position_hz), data.qpos.size)),
        time.process_time(),
    )
    for k in range(len(position) * ratio):
        if k % ratio == 0:
            position[k // ratio] = data.qpos
        data.ctrl[:] = controller.step(encoders.position, encoders.velocity)
        mujoco.mj_step(model, data, nstep=steps)
        encoders.sample(data.qpos)
    return ExportedRun(position, (time.process_time() - began) / (len(position) * ratio))


def compare(
    setup: Setup, task: LineTask, steps: int = 1
) -> dict[str, tuple[float, float, float, float]]:
    """Return for here and each target: s per tick, path error, its RMS, m, and how far the joints are apart, rad."""
    ours = run_line(setup, task)
    began = time.process_time()
    run_line(setup, task)
    seconds = (time.process_time() - began) / (len(ours.times) * setup.rates.ratio)
    found = {"here": (seconds, ours.path_accuracy.worst, ours.path_accuracy.rms, 0.0)}
    for target in TARGETS:
        run = run_exported(setup, task, target, steps)
        count = min(len(run.position), len(ours.times))
        path = path_accuracy(setup.robot, task, ours.times[:count], run.position[:count])
        apart = float(np.abs(run.position[:count] - ours.slow.joint_states[:count, 0]).max())
        found[target] = (run.seconds, path.worst, path.rms, apart)
    return found


def with_gains(setup: Setup, factor: float) -> Setup:
    """Return the setup with kv and ki times a factor."""
    given = setup.controller
    return dataclasses.replace(
        setup, controller=given.replaced(servo={"kv": factor * given.kv, "ki": factor * given.ki})
    )


def tune(setup: Setup, task: LineTask) -> list[tuple[str, ...]]:
    """Return for each target the factor on kv and ki that is best there, path errors with it there and here, in mm."""
    rows = []
    for target in (None, *TARGETS):
        found = []
        for factor in FACTORS:
            tuned = with_gains(setup, factor)
            try:
                here = run_line(tuned, task)
            except FailureError:  # unstable, or cut off by the supervision
                continue
            there = here.path_accuracy.worst
            if target is not None:
                position = run_exported(tuned, task, target).position
                there = path_accuracy(
                    tuned.robot, task, here.times[: len(position)], position
                ).worst
            found.append((there, here.path_accuracy.worst, factor))
        there, worst, factor = min(found)
        rows.append((target or "here", f"{factor:g}", f"{there * 1e3:.4f}", f"{worst * 1e3:.4f}"))
    return rows


def main() -> int:
    """Print the table and merge the figures."""
    options = arguments(
        __doc__,
        ("--robot", DEFAULT_ROBOT, "robot whose arm, law and line are taken"),
        ("--factor", 1.0, "on kv and ki"),
        ("--steps", 1, "of MuJoCo in a tick"),
        ("--tune", False, "choose the gains in MuJoCo, and take them here"),
    )
    files = RobotFiles.named(options.robot)
    setup, task = Setup.load(files), load_task(files.required("task"))
    if options.tune:
        print_table(
            ("tuned in", "factor on kv, ki", "path error there mm", "here mm"), tune(setup, task)
        )
        return 0
    found = compare(with_gains(setup, options.factor), task, options.steps)
    rows = [
        (name, f"{seconds * 1e6:.1f}", f"{worst * 1e3:.4f}", f"{rms * 1e3:.4f}", f"{apart:.1e}")
        for name, (seconds, worst, rms, apart) in found.items()
    ]
    print_table(("", "us per tick", "path error mm", "RMS mm", "joints apart rad"), rows)
    if (options.robot, options.factor, options.steps) == (DEFAULT_ROBOT, 1.0, 1):
        here, lugre, classic = (found[name] for name in ("here", *TARGETS))
        merge(
            {
                "exported_speed": lugre[0] / here[0],
                "exported_path_here_mm": here[1] * 1e3,
                "exported_path_mujoco_mm": lugre[1] * 1e3,
                "exported_path_classic_mm": classic[1] * 1e3,
                "exported_apart_mrad": lugre[3] * 1e3,
                "exported_apart_classic_mrad": classic[3] * 1e3,
            }
        )
    return 0


if __name__ == "__main__":
    sys.exit(main())
