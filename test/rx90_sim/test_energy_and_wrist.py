"""Energy of the free arm, and the wrist coupling in positions and torques."""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np
import pytest

from rx90_common.description.coupling import to_joint, to_joint_torque, to_motor
from rx90_common.friction import FrictionSet
from rx90_emulator.loop.setup import Setup

POSE = np.array([0.4, 0.9, -0.6, 0.5, 0.3, -0.3])


def test_energy_is_kept_without_friction_to_second_order(
    shipped: Setup, frictionless: FrictionSet, arm_oracle: Any
) -> None:
    """A free arm keeps its energy, spring and rotors included; the error falls fourfold per halving."""
    setup = dataclasses.replace(shipped, friction=frictionless)
    drift, counts = [], np.array([1, 2, 4, 8])
    for substeps in counts:
        plant = setup.plant(int(substeps))
        plant.reset(POSE)
        start = arm_oracle.energy(POSE, np.zeros(6))
        worst = 0.0
        for k in range(1600):
            plant.step(np.zeros(6))
            if k % 16 == 15:
                q, v, _ = plant.joint_states()
                worst = max(worst, abs(arm_oracle.energy(q, v) - start))
        drift.append(worst)
        assert np.all(q > setup.robot.lower + 0.1)
        assert np.all(q < setup.robot.upper - 0.1)
    _, v, _ = plant.joint_states()
    kinetic = 0.5 * v @ arm_oracle.mass_and_bias(q, v)[0] @ v
    assert kinetic > 10.0
    assert -np.polyfit(np.log(counts), np.log(drift), 1)[0] == pytest.approx(2.0, abs=0.25)
    assert drift[0] < 1e-3 * kinetic


def test_what_the_drives_put_in_is_what_the_arm_has(shipped: Setup, frictionless: FrictionSet, arm_oracle: Any) -> None:
    """Without friction the work of the drives, torque times joint velocity, is the gain in energy."""
    plant = dataclasses.replace(shipped, friction=frictionless).plant(4)
    plant.reset(POSE)
    start = arm_oracle.energy(POSE, np.zeros(6))
    motor = 0.4 * shipped.drives.peak_torque * np.array([1, -1, 1, 1, -1, -1])
    work, last = 0.0, POSE.copy()
    for _ in range(600):
        plant.step(motor)
        q, v, drive = plant.joint_states()
        work += drive @ (q - last)
        last = q.copy()
    gain = arm_oracle.energy(q, v) - start
    assert abs(gain) > 5.0
    assert work == pytest.approx(gain, rel=1e-4)


def test_moving_joint_5_alone_turns_motor_6(shipped: Setup) -> None:
    """Motor 6 turns by n6 q5 when only joint 5 moves, and the encoder of motor 6 says so."""
    plant = shipped.plant()
    gear = shipped.drives.gear
    plant.reset(np.array([0.0, 0.0, 0.0, 0.0, 0.7, 0.0]))
    encoder, _, _ = plant.motor_states()
    count = 2 * np.pi / shipped.drives.encoder_counts
    assert np.abs(encoder - [0, 0, 0, 0, gear[4] * 0.7, gear[5] * 0.7]).max() <= count[0] / 2
    plant.reset(np.array([0.0, 0.0, 0.0, 0.0, 0.7, -0.7]))
    assert plant.motor_states()[0][5] == 0.0


def test_motor_6_moves_joints_5_and_6_apart(shipped: Setup, frictionless: FrictionSet) -> None:
    """Torque of motor 6 alone acts on both wrist joints: tau5 = tau6 = n6 tm6."""
    plant = dataclasses.replace(shipped, friction=frictionless).plant()
    motor = np.array([0.0, 0.0, 0.0, 0.0, 0.0, 0.3])
    plant.step(motor)
    torque = plant.joint_states()[2]
    assert torque == pytest.approx([0, 0, 0, 0, 25 * 0.3, 25 * 0.3])
    plant.step(np.array([0.0, 0.0, 0.0, 0.0, 0.2, 0.0]))
    assert plant.joint_states()[2] == pytest.approx([0, 0, 0, 0, 45 * 0.2, 0])


def test_torques_are_the_transpose_of_velocities(shipped: Setup) -> None:
    """Power, torque times speed, is the same on the motor and the joint side of the gears."""
    rng = np.random.default_rng(5)
    gear = shipped.drives.gear
    for _ in range(50):
        joint_velocity, motor_torque = rng.normal(size=6), rng.normal(size=6)
        motor_velocity, joint_torque, back = np.empty(6), np.empty(6), np.empty(6)
        to_motor(gear, joint_velocity, motor_velocity)
        to_joint_torque(gear, motor_torque, joint_torque)
        to_joint(gear, motor_velocity, back)
        assert joint_torque @ joint_velocity == pytest.approx(motor_torque @ motor_velocity, rel=1e-12)
        assert back == pytest.approx(joint_velocity, rel=1e-13, abs=1e-14)


def test_element_7_sees_the_sum_and_acts_on_both_rows(shipped: Setup) -> None:
    """Element 7 has input dq5 + dq6; its torque slows both wrist joints, and neither when they oppose."""
    names = shipped.friction.names
    quiet = dataclasses.replace(
        shipped.friction.elements[0],
        tau_c_positive=1e-12,
        tau_c_negative=1e-12,
        tau_s_positive=1e-12,
        tau_s_negative=1e-12,
        c0=1e-9,
        c1=0.0,
        c2=0.0,
    )
    strong = dataclasses.replace(quiet, c2=50.0)
    setup = dataclasses.replace(shipped, friction=FrictionSet(names, (quiet,) * 6 + (strong,)))
    free = dataclasses.replace(shipped, friction=FrictionSet(names, (quiet,) * 7))
    for wrist, torque in (((1.0, 0.5), 75.0), ((1.0, -1.0), 0.0)):
        accelerations = []
        for case in (setup, free):
            plant = case.plant()
            plant.state["v"][0, 4:] = wrist
            plant.step(np.zeros(6))
            accelerations.append(plant.state["acceleration"][0].copy())
            if case is setup:
                _, velocity, friction = plant.friction_states()
                assert velocity[6] == plant.state["v"][0, 4] + plant.state["v"][0, 5]
                assert friction[6] == pytest.approx(50.0 * velocity[6], abs=1e-9)
        mass = plant.state["mass_matrix"][0]
        slowed = mass @ (accelerations[1] - accelerations[0])
        assert slowed == pytest.approx([0, 0, 0, 0, torque, torque], rel=0.1, abs=0.02)
