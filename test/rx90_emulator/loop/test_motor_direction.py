"""A motor that turns against its joint: its gear ratio is negative, and nothing else differs."""

from __future__ import annotations

import dataclasses
from dataclasses import replace

import numpy as np
import pytest

from benchmarks.perturbation import agreement
from rx90_common.base.errors import SupervisionError
from rx90_controller.lines.task import LineTask, load_task
from rx90_emulator.identification.robot import arm_layout
from rx90_emulator.loop.line import plan_line, run_line
from rx90_emulator.loop.setup import Setup
from rx90_emulator.perturbation.model import prepare_perturbation as prepare

TURNED = {"motor 4": [1, 1, 1, -1, 1, 1], "all but motor 5": [-1, -1, -1, -1, 1, -1], "motor 5": [1, 1, 1, 1, -1, 1]}


def with_motors(setup: Setup, signs: list[int]) -> Setup:
    """Return the setup with motors turned round where the sign is -1."""
    return dataclasses.replace(setup, drives=dataclasses.replace(setup.drives, gear=setup.drives.gear * signs))


@pytest.mark.parametrize("which", TURNED)
def test_a_motor_turned_round_changes_its_own_signs_and_nothing_else(
    shipped: Setup, task: LineTask, which: str
) -> None:
    """Motor positions, velocities, torques and currents change their signs; what joints do keeps its bits."""
    signs = TURNED[which]
    setup = with_motors(shipped, signs)
    usual, turned = (run_line(s, task, record_fast=True).series for s in (shipped, setup))
    for topic, series in usual.items():
        for quantity in ("position", "velocity", "effort"):
            want, got = getattr(series, quantity), getattr(turned[topic], quantity)
            if want is not None:
                factor = signs if series.names[0].startswith("motor") else 1
                np.testing.assert_array_equal(got, want * factor, err_msg=f"{topic} {quantity}")


def test_bags_of_turned_motors_are_read(shipped: Setup, task: LineTask) -> None:
    """What the identification makes of motor states is the joints' motion, to the encoders' resolution."""
    setup = with_motors(shipped, TURNED["motor 4"])
    series = run_line(setup, task, record_fast=True).series
    layout = arm_layout("motor_states", setup.robot.joint_names, own_drives=lambda: setup.drives)
    assert layout.turns is not None
    motors, joints = series["motor_states"], series["joint_states"]
    assert motors.position is not None
    assert joints.position is not None
    at = np.searchsorted(motors.time, joints.time)
    read = np.linalg.solve(layout.turns, motors.position[at].T).T
    assert np.abs(read - joints.position).max() < 4e-6


def test_the_supervision_and_the_perturbation_method_take_it_too(shipped: Setup, task: LineTask) -> None:
    """The power is cut at the same tick with the same words; the perturbation method's deviations keep their bits."""
    strict = dataclasses.replace(shipped.controller, following_error=np.full(6, 2e-5))
    weak = dataclasses.replace(shipped, controller=strict)
    said = []
    for setup in (weak, with_motors(weak, [-1] * 6)):
        with pytest.raises(SupervisionError, match="following error") as caught:
            run_line(setup, task)
        said.append(str(caught.value))
    assert said[0] == said[1]
    plan = plan_line(shipped, task)
    both = (shipped, with_motors(shipped, [-1] * 6))
    usual, turned = (prepare(s, plan.points, plan.start_pose, 0.3).run_one().joint_deviation for s in both)
    assert np.abs(usual).max() > 1e-6
    np.testing.assert_array_equal(turned, usual)


def test_the_perturbation_method_takes_the_tx40(tx40: Setup) -> None:
    """Along its line at 0.2 m/s, the tip's worst deviation is that of the full simulation within 1 %.

    Along its reference line its flange stays within 0.09 mm, as its controller file says, with no drive at its limit.
    """
    run = run_line(tx40, load_task(robot="tx40"))
    assert run.path_accuracy.worst < 9e-5
    assert not run.saturated.any()
    task = replace(load_task(robot="tx40"), end=(0.343, -0.095, 0.288), speed=0.2, rest_before=0.1, rest_after=0.1)
    plan, full = plan_line(tx40, task), run_line(tx40, task)
    result = prepare(tx40, plan.points, plan.start_pose, full.times[-1] + 1e-3).run_one()
    compared = agreement(full, result)
    assert compared.worst[0] > 1e-5
    assert compared.relative_worst < 0.01
