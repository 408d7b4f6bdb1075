"""The battery: the table of cases, what they are made of, and their run with the CS7B."""

from __future__ import annotations

import math
from collections.abc import Callable, Collection
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from rx90_common.base.arrays import Array
from rx90_common.base.config import read_yaml, yaml_text
from rx90_common.base.errors import DivergenceError
from rx90_common.process.files import write_text
from rx90_controller.lines.task import load_task
from rx90_controller.trajectory.motion import Motion
from rx90_emulator.conformance import metrics
from rx90_emulator.conformance.case import START, Case, Record
from rx90_emulator.loop.line import plan_line
from rx90_emulator.loop.setup import Setup

_SETTLED = 1.0  # s, of observation after a step

_STEP = math.radians(2.0)
_STEP_ACCELERATION = 0.8  # times the least of the joints' largest accelerations
_REST_SPEED = 0.02  # rad/s
_WATCHED_REST = 6.0  # s
_DERATED = 0.8  # of the torque that the CS7B needs
_LINE_REST = 0.3  # s, before and after a line
_PAYLOAD = ("mass", "inertia")
_FRICTION = ("tau_c", "tau_s", "c2")


class Nominal(NamedTuple):
    """The basis of the cases.

    Attributes:
        setup: the nominal arm and the CS7B.
        folder: for the files of modified arms.
    """

    setup: Setup
    folder: Path

    @property
    def acceleration(self) -> float:
        """Return the least of the joints' largest accelerations, rad/s²."""
        return float(self.setup.controller.max_acceleration.min())

    def motion(self) -> tuple[Motion, Array]:
        """Return a motion from the line's beginning, and the direction of each joint away from its nearer limit."""
        pose = line(self).points.position[0]
        robot = self.setup.robot
        return Motion(pose), np.where(pose > 0.5 * (robot.lower + robot.upper), -1.0, 1.0)

    def scaled(self, case: str, role: str, keys: Collection[str], factor: float | Array) -> Setup:
        """Return the arm with all values of these keys in one of its files times a factor, or one for each motor.

        Without such a file, as where it carries no tool, it is the nominal arm.
        """
        nominal: Path | None = getattr(self.setup.files, role)
        if nominal is None:
            return self.setup
        file = self.folder / f"{case}_{role}.yaml"
        write_text(file, yaml_text(_scaled(read_yaml(nominal), keys, factor)))
        return Setup.load(replace(self.setup.files, **{role: file}))


def _scaled(
    content: Any, keys: Collection[str], factor: float | Array, inside: bool = False
) -> Any:
    if isinstance(content, dict):
        return {
            key: _scaled(value, keys, factor, inside or key in keys)
            for key, value in content.items()
        }
    return (np.asarray(content) * factor).tolist() if inside else content


def step(nominal: Nominal, name: str) -> Case:
    """Make a small motion that is as fast as the accelerations allow."""
    motion, direction = nominal.motion()
    acceleration = _STEP_ACCELERATION * nominal.acceleration
    motion.move(motion.pose + _STEP * direction, nominal.setup.robot.max_velocity, acceleration)
    about = f"all joints {math.degrees(_STEP):g} deg, as fast as {acceleration:g} rad/s² allow"
    points = motion.points(nominal.setup.robot.joint_names)
    return Case(name, about, nominal.setup, points, _SETTLED, metrics.STEP)


def line(nominal: Nominal, name: str = "line", about: str = "of the nominal arm") -> Case:
    """Follow the robot's reference line, with short rests."""
    task = replace(
        load_task(nominal.setup.files.required("task")),
        rest_before=_LINE_REST,
        rest_after=_LINE_REST,
    )
    points = plan_line(nominal.setup, task).points
    about = f"the robot's reference line, in which joints reverse: {about}"
    return Case(name, about, nominal.setup, points, 0.2, metrics.LINE, task)


def other_arm(nominal: Nominal, name: str, role: str, keys: Collection[str], factor: float) -> Case:
    """Follow the line with another payload, or other friction."""
    case = line(nominal, name, f"{', '.join(keys)} of the {role} times {factor:g}")
    return replace(case, setup=nominal.scaled(name, role, keys, factor))


def rest(nominal: Nominal, name: str) -> Case:
    """Creep to a set-point and hold it."""
    motion, direction = nominal.motion()
    motion.sweep(direction, _REST_SPEED, 0.5, nominal.acceleration)
    about = f"all joints creep to a set-point at {_REST_SPEED:g} rad/s and hold it for {_WATCHED_REST:g} s"
    points = motion.points(nominal.setup.robot.joint_names)
    return Case(name, about, nominal.setup, points, _WATCHED_REST, metrics.REST)


def saturation(nominal: Nominal, name: str) -> Case:
    """Make the step with drives that are too weak for it."""
    case = step(nominal, name)
    needed = np.nanmax(np.abs(run_cs7b(case, nominal.setup).sent), axis=0)
    share = np.minimum(1.0, _DERATED * needed / nominal.setup.drives.peak_torque)
    about = f"the step with drives that give {_DERATED:g} of the torques that the CS7B needs for it"
    weak = nominal.scaled(name, "drives", ("peak_current",), share)
    return replace(case, about=about, setup=weak)


CASES: dict[str, Callable[[Nominal, str], Case]] = {
    "step": step,
    "line": line,
    "payload_0.7": partial(other_arm, role="tool", keys=_PAYLOAD, factor=0.7),
    "payload_1.3": partial(other_arm, role="tool", keys=_PAYLOAD, factor=1.3),
    "friction_0.7": partial(other_arm, role="friction", keys=_FRICTION, factor=0.7),
    "friction_1.3": partial(other_arm, role="friction", keys=_FRICTION, factor=1.3),
    "rest": rest,
    "saturation": saturation,
}
"""The functions that make the cases, by name."""


def run_cs7b(case: Case, nominal: Setup) -> Record:
    """Run a case with the CS7B of the nominal arm, without ROS; the numbers equal those of its node bit for bit."""
    plant = case.setup.plant()
    law = nominal.cs7b()
    record = Record(case)
    plant.reset(case.points.position[0])
    states = plant.motor_states()
    law.reset(states[0])
    law.trajectory.accept(case.points, 0, case.setup.rates.start_tick(START))
    try:
        for tick in range(case.ticks):
            command = law.step(*states)
            torque = None if law.fault else command
            record.note(tick, states[0], torque)
            plant.step(torque)
    except DivergenceError as error:
        record.fault = str(error)
    return record
