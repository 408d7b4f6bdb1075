"""The exported arm in MuJoCo, an independent implementation of arm and LuGre friction, beside the engine."""

import dataclasses
import math
from pathlib import Path
from typing import NamedTuple

import mujoco
import numpy as np
import pytest

from benchmarks.any_arm import write_arm
from benchmarks.exported_arm import compare
from rx90_common.base.arrays import Array
from rx90_common.description.drives import COLD, Cogging
from rx90_controller.lines.task import LineTask
from rx90_emulator.export.export import export_robot
from rx90_emulator.loop.setup import Setup, load_setup

START = np.array([0.3, 0.5, 1.0, -0.4, 0.6, 0.2])
TICKS = 2400
_SETTLED = 20  # ticks: the brakes open in the first one
_STEPS = 8


class Motion(NamedTuple):
    """Joint positions, rad, and friction torques, Nm, after each tick."""

    q: Array
    friction: Array


def holdable(setup: Setup) -> Setup:
    """Return the setup with elements that MuJoCo can hold: delta 2, the same for both signs, a constant c1."""
    elements = [e.replaced(delta=2.0, omega_d=math.inf) for e in setup.friction.elements]
    return dataclasses.replace(setup, friction=dataclasses.replace(setup.friction, elements=tuple(elements)))


def held_torque(setup: Setup, start: Array) -> Array:
    model = mujoco.MjModel.from_xml_string(*export_robot(setup, "mujoco").files.values())
    data = mujoco.MjData(model)
    data.qpos[:] = start
    mujoco.mj_forward(model, data)
    return np.asarray(data.qfrc_bias - data.qfrc_spring)


def torques(setup: Setup, scenario: str) -> Array:
    """Return motor torques about those that hold the arm at START, shape (TICKS, 6)."""
    time = np.arange(TICKS)[:, None] * setup.rates.period
    joint = held_torque(setup, START)
    static = np.array([e.tau_s.positive for e in setup.friction.elements[:6]])
    hold, break_away = ((setup.drives.turning.joint_turns.T @ torque) / setup.drives.gear for torque in (joint, static))
    shapes = {
        "sticking": 0.5 * np.minimum(1.0, time / 0.1),
        "break-away": 2.5 * time,
        "reversals": 1.6 * np.sin(4.0 * np.pi * time),
    }
    return np.asarray(hold + shapes[scenario] * break_away)


def in_engine(setup: Setup, commands: Array, start: Array = START) -> Motion:
    plant = setup.plant()
    plant.reset(start)
    q, friction = np.empty(commands.shape), np.empty((len(commands), len(setup.friction.elements)))
    for k, command in enumerate(commands):
        plant.step(command)
        q[k], friction[k] = plant.joint_states()[0], plant.friction_states()[2]
    return Motion(q, friction)


def in_mujoco(setup: Setup, commands: Array, target: str = "mujoco", steps: int = 1, start: Array = START) -> Motion:
    """Run the exported file under the same torques, with so many steps in a tick."""
    (text,) = export_robot(setup, target).files.values()
    model = mujoco.MjModel.from_xml_string(text)
    model.opt.timestep /= steps
    data = mujoco.MjData(model)
    data.qpos[:] = start
    elements = len(setup.friction.elements)
    lugre = slice(len(start), len(start) + elements)
    q, friction = np.empty(commands.shape), np.zeros((len(commands), elements))
    for k, command in enumerate(commands):
        data.ctrl[:] = command
        mujoco.mj_step(model, data, nstep=steps)
        q[k] = data.qpos
        if target == "mujoco":
            mujoco.mj_forward(model, data)
            damper = model.actuator_damping[lugre] * data.actuator_velocity[lugre]
            friction[k] = damper - data.actuator_force[lugre]
    return Motion(q, friction)


@pytest.mark.parametrize(("scenario", "q_bound", "friction_bound"), [
    ("sticking", 1e-4, 0.3), ("break-away", 1e-3, 0.3), ("reversals", 1e-3, 2.0)])  # fmt: skip
def test_what_mujoco_can_hold_moves_alike(shipped: Setup, scenario: str, q_bound: float, friction_bound: float) -> None:
    """Positions and friction torques agree to the order of MuJoCo's step: with 8 steps a tick they differ by an 8th."""
    setup = holdable(shipped)
    commands = torques(setup, scenario)
    ours = in_engine(setup, commands)
    coarse, fine = (in_mujoco(setup, commands, steps=steps) for steps in (1, _STEPS))
    off, less = (
        np.array([np.abs(a - b)[_SETTLED:].max() for a, b in zip(ours, theirs, strict=True)])
        for theirs in (coarse, fine)
    )
    moved = np.abs(ours.q - START).max()
    assert moved < 1e-3 if scenario == "sticking" else moved > 0.05
    assert (off < [q_bound, friction_bound]).all()
    assert (less < off / [0.6 * _STEPS, 0.3 * _STEPS]).all()


def test_what_mujoco_cannot_hold_costs_what_the_export_says(shipped: Setup) -> None:
    """Elements with delta 1 at constant speeds: MuJoCo's torque differs from theirs by as much as the fit says."""
    export = export_robot(shipped, "mujoco", speeds=(1e-2, 2.0))
    model = mujoco.MjModel.from_xml_string(next(iter(export.files.values())))
    model.opt.timestep = 1.0  # in which a bristle comes to rest: its step is exact
    data = mujoco.MjData(model)
    inputs, worst = np.hstack([np.eye(6), np.eye(6)[:, [5]]]), np.zeros(7)
    for k, fit in enumerate(export.fits):
        for speed in np.geomspace(1e-2, 2.0, 60):
            for _ in range(3):
                data.qpos[:], data.qvel[:] = 0.0, speed * inputs[:, k]
                mujoco.mj_step(model, data)
            data.qpos[:], data.qvel[:] = 0.0, speed * inputs[:, k]
            mujoco.mj_forward(model, data)
            damper = model.actuator_damping[6 + k] * data.actuator_velocity[6 + k]
            torque = damper - data.actuator_force[6 + k]
            worst[k] = max(worst[k], abs(torque - float(shipped.friction.elements[k].steady_torque(speed))))
        assert worst[k] == pytest.approx(fit.largest, rel=0.05)


@pytest.mark.filterwarnings("ignore::rx90_common.base.errors.Rx90Warning")  # of a constant c1
def test_a_line_under_the_same_law(shipped: Setup, task: LineTask) -> None:
    """Fitted, the shipped elements keep joints within 0.3 mrad; friction as a constraint is farther off."""
    found = compare(holdable(shipped), task)
    (_, here, _, _), (_, there, _, apart), (_, _, _, classic) = found["here"], found["mujoco"], found["mujoco-classic"]
    assert here > 1e-5
    assert there == pytest.approx(here, rel=0.02)
    assert apart < 1e-4 < classic
    _, _, _, fitted = compare(shipped, task)["mujoco"]
    assert fitted < 3e-4


def test_friction_as_a_constraint_creeps_as_said(shipped: Setup) -> None:
    """Where the engine rests, the classic arm creeps at constant speed, below 10 µrad/s as the page says."""
    commands = torques(shipped, "sticking")
    ours, theirs = in_engine(shipped, commands), in_mujoco(shipped, commands, "mujoco-classic")
    half = TICKS // 2
    speed = np.abs(theirs.q[-1] - theirs.q[-half]) / ((half - 1) * shipped.rates.period)
    assert 0.0 < speed.max() < 1e-5
    assert np.abs(theirs.q - ours.q).max() < 1e-3


def test_cogging_and_windings_are_the_engine_s(shipped: Setup) -> None:
    """MuJoCo's motors have the cogging torque at an angle, and warm up under I^2 R with the time constant."""
    full = np.full(6, 1.0)
    cogging = Cogging(harmonic=[4.0, 12.0], amplitude=[[0.03] * 6, [0.01] * 6], phase=[[0.2] * 6, [0.7] * 6])
    winding = COLD.replaced(
        resistance=0.4 * full, thermal_resistance=2.0 * full, heat_capacity=30.0 * full, derating=150.0, limit=180.0
    )
    setup = dataclasses.replace(shipped, drives=shipped.drives.replaced(cogging=cogging, winding=winding))
    assert "dcmotor" not in next(iter(export_robot(setup, "mujoco-classic").files.values()))  # which it cannot read
    model = mujoco.MjModel.from_xml_string(next(iter(export_robot(setup, "mujoco").files.values())))
    data = mujoco.MjData(model)
    data.qpos[:] = START
    data.ctrl[:] = 0.5
    mujoco.mj_forward(model, data)
    angle = setup.drives.gear * [*START[:5], START[4] + START[5]]
    waves = np.array(cogging.harmonic)[:, None] * angle + np.array(cogging.phase)
    motor = 0.5 + np.sum(np.array(cogging.amplitude) * np.cos(waves), axis=0)
    joint = setup.drives.gear * motor
    joint[4] += joint[5]
    assert data.qfrc_actuator == pytest.approx(joint, rel=1e-9)
    model.opt.timestep = 0.1
    for _ in range(600):  # one time constant, 60 s, the arm held
        data.qpos[:], data.qvel[:] = START, 0.0
        mujoco.mj_step(model, data)
    heat = 0.4 * (0.5 / setup.drives.torque_constant) ** 2
    assert data.act[:6] == pytest.approx(heat * 2.0 * (1.0 - math.exp(-1.0)), rel=2e-3)


def test_seven_joints_with_a_motor_that_turns_with_three(tmp_path: Path) -> None:
    """Under the same motor torques, with reversals, an arm with another coupling moves in MuJoCo as in the engine."""
    coupling = [*np.eye(7)[:6].tolist(), [0, 0, 0, 0, 1, -1, 1]]
    setup = holdable(load_setup(robot=write_arm(tmp_path / "arm", 7, coupling)))
    start = np.linspace(-0.4, 0.5, 7)
    swing = 1.6 * np.array([e.tau_s.positive for e in setup.friction.elements[:7]])
    time = np.arange(TICKS)[:, None] * setup.rates.period
    joint = held_torque(setup, start) + swing * np.sin(4.0 * np.pi * time)
    commands = joint @ setup.drives.turning.joint_turns / setup.drives.gear
    ours = in_engine(setup, commands, start).q
    coarse, fine = (in_mujoco(setup, commands, steps=steps, start=start).q for steps in (1, _STEPS))
    off, less = (np.abs(theirs - ours)[_SETTLED:].max() for theirs in (coarse, fine))
    assert np.abs(fine - start).max() > 0.01
    assert off < 1e-3
    assert less < off / (0.6 * _STEPS)
