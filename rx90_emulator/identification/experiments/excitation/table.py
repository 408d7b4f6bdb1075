"""What `rx90_experiment --excitation` does, apart from its options: plan with a progress bar, and print the plan."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from contextlib import ExitStack
from typing import Any

import numpy as np
from tqdm import tqdm

from rx90_common.base.arrays import Array
from rx90_common.exchange.topics import MOTOR_NAMES
from rx90_emulator.identification.experiments.excitation.design import ExcitationPlan, PlannedRun, plan_excitation
from rx90_emulator.identification.experiments.excitation.information import (
    ROWS,
    condition_number,
    deviations,
    log_determinant,
)
from rx90_emulator.identification.experiments.excitation.options import ExcitationOptions
from rx90_emulator.identification.experiments.load import Motors, check_load, planned_setpoints
from rx90_emulator.loop.setup import Setup

_PER_LINE = 3
_SMALL = 1e-3  # of the largest parameter of its kind: an expected value below it is as good as zero


def describe_excitation(plan: ExcitationPlan) -> str:
    """Return the table of a plan.

    Raises:
        IdentificationError: if a run leaves a limit.
    """
    lines = [f"{'run':<16}{'time s':>7}  {'share of the limits: position, speed, acceleration, torque'}"]
    for run in plan.runs:
        lines += _run_lines(plan, run)
    shared = Motors.of(plan.setup.robot, plan.setup.drives).shared
    lines.append(
        f"{', '.join(MOTOR_NAMES[number] for number in shared)}: through their gears; accepted are the speed of their "
        "joint alone (assumed) and the drive's peak torque"
    )
    information = plan.information
    lines.append(
        f"condition number {condition_number(information):.3g}, log det of the information "
        f"{log_determinant(information):.4g} ({len(information)} parameters; without the validation)"
    )
    noise = "as given" if plan.options.torque_noise else "1 % of the URDF's effort, assumed"
    lines.append(
        f"expected deviations at a torque noise ({noise}) of "
        f"{', '.join(f'{value:.3g}' for value in plan.columns.noise)} Nm in {ROWS:g} independent samples per second; "
        "in % of the value in the robot's files, else in SI units:"
    )
    lines += _parameter_lines(plan)
    if plan.workspace.shapes.meshes:
        lines.append(f"meshes do not count for collisions: those of {', '.join(plan.workspace.shapes.meshes)}")
    if plan.workspace.arm.uncounted:
        lines.append(f"too near to each other at home to count: {', '.join(plan.workspace.arm.uncounted)}")
    total = sum(run.experiment.duration for run in plan.runs)
    lines.append(f"{len(plan.runs)} runs, {total:.0f} s of motion ({total / 60.0:.1f} min)")
    return "\n".join(lines)


def _run_lines(plan: ExcitationPlan, run: PlannedRun) -> Iterator[str]:
    setup, experiment = plan.setup, run.experiment
    robot = setup.robot
    load = check_load(experiment, robot, setup.drives, setup.controller)
    setpoints = planned_setpoints(experiment, setup.controller.limits(robot))
    middle, reach = 0.5 * (robot.lower + robot.upper), 0.5 * (robot.upper - robot.lower)
    position = np.abs(setpoints[:, 0] - middle).max(axis=0) / reach
    acceleration = np.abs(setpoints[:, 2]).max(axis=0) / setup.controller.max_acceleration
    for number, name in enumerate(robot.joint_names):
        head = f"{experiment.name:<16}{experiment.duration:>7.1f}" if number == 0 else f"{'':<23}"
        shares = (position[number], load.speed[number], acceleration[number], load.torque[number])
        yield f"{head}  {name:<10}{''.join(f'{share:>6.0%}' for share in shares)}   {_speeds(setpoints[:, 1, number])}"
    motors = Motors.of(robot, setup.drives)
    for number in motors.shared:
        speeds = _speeds(setpoints[:, 1] @ motors.turns[number])
        used = f"{load.motor_speed[number]:>12.0%}{load.motor_torque[number]:>12.0%}"
        yield f"{'':<25}{MOTOR_NAMES[number]:<10}{used}   {speeds}"
    for wall, (distance, name) in zip(plan.options.walls, plan.workspace.lowest(setpoints[::5, 0]), strict=True):
        yield f"{'':<25}{wall.name}: {name} comes as near as {distance:.3f} m"


def _speeds(velocity: Array) -> str:
    """Return the speeds of nine tenths of the moving time in each direction."""
    parts = []
    for sign in (1.0, -1.0):
        speed = np.abs(velocity[sign * velocity > 0.0])
        low, high = np.percentile(speed, (5.0, 95.0)) if len(speed) else (0.0, 0.0)
        parts.append(f"{'+' if sign > 0.0 else '-'}{low:.2g} to {high:.2g}")
    return f"{', '.join(parts)} rad/s"


def _parameter_lines(plan: ExcitationPlan) -> Iterator[str]:
    expected = expected_values(plan)
    cells = []
    for name, value, deviation in zip(plan.columns.names, expected, deviations(plan.information), strict=True):
        kind = name.split(".")[-1].split("_")[0].rstrip("R")[:1]
        same = [abs(v) for n, v in zip(plan.columns.names, expected, strict=True)
                if n.split(".")[-1].split("_")[0].rstrip("R")[:1] == kind]  # fmt: skip
        known = abs(value) > _SMALL * max(same)
        cells.append(f"{name:<17}{f'{deviation / abs(value):.2%}' if known else f'{deviation:.2g}':>10}")
    for first in range(0, len(cells), _PER_LINE):
        yield "  " + "   ".join(cells[first : first + _PER_LINE])


def expected_values(plan: ExcitationPlan) -> list[float]:
    """Return the parameters as the robot's files have them, shape (p,)."""
    base = plan.columns.base.combination @ plan.columns.standard.values()
    elements = plan.setup.friction.elements
    coulomb = [0.5 * (one.tau_c_positive + one.tau_c_negative) for one in elements]
    return [*base.tolist(), *coulomb, *(one.c2 for one in elements)]


_BAR = "{desc:<16}{bar}| {n_fmt}/{total_fmt} steps [{elapsed}<{remaining}]"


def plan_with_progress(setup: Setup, options: ExcitationOptions) -> ExcitationPlan:
    """Plan with a progress bar.

    Raises:
        Rx90Error: as `plan_excitation`.
    """
    total = (options.runs + options.validation) * options.steps
    names: list[str] = []
    with ExitStack() as shown:
        bars: list[tqdm[Any]] = []

        def step(name: str) -> None:
            if not bars:  # only now: what is refused before the first step needs no bar
                bars.append(shown.enter_context(tqdm(total=total, bar_format=_BAR, disable=None, file=sys.stderr)))
            if name not in names:  # the search before may have needed fewer steps
                names.append(name)
                bars[0].set_description_str(name, refresh=False)
                bars[0].update((len(names) - 1) * options.steps - bars[0].n)
            bars[0].update()

        return plan_excitation(setup, options, step)
