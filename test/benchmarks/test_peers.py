"""The closed loop's peers in the benchmark do the same work: the same arm, the same drives, the same law."""

from __future__ import annotations

import dataclasses

import mujoco
import numpy as np
import pytest

from benchmarks.closed_loop import PinocchioArm, PythonDrives, PythonLaw, check_same_arm
from benchmarks.hybrid_reference import Work
from benchmarks.mujoco_lugre import mujoco_arm
from rx90_common.description.coupling import to_joint_torque
from rx90_emulator.loop.setup import Setup


def test_the_peers_have_the_same_arm(shipped: Setup) -> None:
    """Mass matrix and bias of MuJoCo's and Pinocchio's arms equal the plant's at random states."""
    check_same_arm(shipped, samples=20)


def test_motor_torques_reach_the_same_joints(shipped: Setup) -> None:
    """MuJoCo's motors make the joint torques of gears and wrist coupling."""
    model = mujoco_arm(shipped)
    data = mujoco.MjData(model)
    motor = 0.5 * shipped.drives.peak_torque * [1, -1, 1, -1, 1, -1]
    data.ctrl[:6] = motor
    mujoco.mj_forward(model, data)
    joint = np.empty(6)
    to_joint_torque(shipped.drives.gear, motor, joint)
    assert data.qfrc_actuator == pytest.approx(joint, rel=1e-12)


def test_friction_parameters_reach_mujoco(shipped: Setup) -> None:
    """Held at constant velocity long enough, element 7 gives its Stribeck torque on both wrist joints."""
    alone = [
        e.with_parameters({"c0": 1e-6, "c1": 0.0, "c2": 0.0, "tau_c_positive": 1e-9, "tau_s_positive": 1e-9})
        if i < 6
        else e
        for i, e in enumerate(shipped.friction.elements)
    ]
    setup = dataclasses.replace(shipped, friction=dataclasses.replace(shipped.friction, elements=tuple(alone)))
    model = mujoco_arm(setup)
    data = mujoco.MjData(model)
    last = alone[6]
    data.qvel[4:] = 5.0, 3.0  # so fast that nothing of the Stribeck effect is left
    data.act[6] = last.tau_c.positive / last.c0
    mujoco.mj_forward(model, data)
    assert data.qfrc_actuator[4:] == pytest.approx(-last.tau_c.positive, rel=1e-6)
    assert data.qfrc_damper[4:] == pytest.approx(-last.c2 * 8.0, rel=1e-9)


def test_drives_and_law_in_python_are_those_of_the_plant_and_the_cs7b(shipped: Setup) -> None:
    """Along the reference line, encoder values, observed velocities and torques equal the compiled ones."""
    work = Work.load()
    ticks, ratio = 4800, shipped.rates.ratio
    rows = work.setpoints(0.0, ticks).tolist()
    plant, controller = shipped.plant(), shipped.cs7b()
    plant.reset(work.start)
    controller.reset(plant.motor_states()[0])
    controller.trajectory.accept(work.points, 0, 0)
    drives, law = PythonDrives(shipped, work.start.tolist()), PythonLaw(shipped)
    off = np.zeros(3)  # largest differences; compared once, for 4,800 comparisons by pytest take a minute
    for tick in range(ticks):
        position, velocity, _ = plant.motor_states()
        if tick % ratio == 0:
            law.position_loop(rows[tick // ratio], drives.position)
        seen = drives.position - position, drives.velocity - velocity
        command = controller.step(position, velocity)
        differences = *seen, law.velocity_loop(drives.velocity) - command
        off = np.maximum(off, [np.abs(each).max() for each in differences])
        plant.step(command)
        drives.sample(plant.joint_states()[0].tolist())
    assert (off < [1e-12, 1e-9, 1e-9]).all()
    assert np.abs(plant.joint_states()[1]).max() > 0.01


def test_pinocchio_s_step_follows_the_plant(shipped: Setup) -> None:
    """Under the same motor torques the first-order peer stays close to the plant."""
    start = np.array([0.3, 0.5, 1.0, -0.4, 0.6, 0.2])
    plant, peer = shipped.plant(), PinocchioArm(shipped, start)
    plant.reset(start)
    motor = 0.4 * shipped.drives.peak_torque * [1, -1, 1, -1, 1, -1]
    for _ in range(400):
        plant.step(motor)
        peer.step(motor)
    q, v, _ = plant.joint_states()
    assert np.abs(v).max() > 0.5
    assert np.abs(q - start).max() > 0.3
    assert peer.q == pytest.approx(q, abs=5e-3)
    assert peer.z == pytest.approx(plant.friction_states()[0], abs=1e-6)
