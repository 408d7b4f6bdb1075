"""The closed loop about elastic gears: its resonance and its records."""

from __future__ import annotations

import dataclasses
import math
from pathlib import Path

import numpy as np
import pytest
from elastic_arms import POSE, WRIST, elastic, floating, link_mass
from numpy.typing import NDArray
from scipy.linalg import expm

from rx90_common.bags.reading import read_joint_states
from rx90_controller.trajectory import TrajectoryPoints
from rx90_emulator.loop.closed_loop import simulate
from rx90_emulator.loop.recorded_run import read_run, replay
from rx90_emulator.loop.result import write_bag
from rx90_emulator.loop.setup import Setup

Array = NDArray[np.float64]
KP, KV, KI, INERTIA, BANDWIDTH, OBSERVER = 40.0, 80.0, 5e3, 8.0, 800.0, 400.0
STIFFNESS, DAMPING, ROTOR = 4e4, 8.0, 3.0


def soft_joint(shipped: Setup) -> Setup:
    """Return a setup in which joint 1 alone moves, on a soft gear without friction, under slow gains."""
    stiffness, damping, rotor = np.full(6, np.inf), np.zeros(6), np.full(6, 1e12)
    stiffness[0], damping[0], rotor[0] = STIFFNESS, DAMPING, ROTOR
    setup = elastic(floating(shipped), stiffness, damping)
    drives = dataclasses.replace(
        setup.drives, rotor_inertia=rotor, encoder_counts=np.full(6, 2.0**40), velocity_bandwidth=OBSERVER
    )
    six = np.ones(6)
    controller = dataclasses.replace(
        setup.controller,
        kp=KP * six,
        kv=KV * six,
        ki=KI * six,
        inertia=INERTIA * six,
        current_bandwidth=BANDWIDTH,
        following_error=1e3 * six,
        over_speed=1e3,
    )
    return dataclasses.replace(setup, drives=drives, controller=controller)


def loop_matrix(link: float, period: float, ratio: int) -> Array:
    """Return the change of (q, v, twist, rate, observer's angle and speed, torque, PI, integral) in a position tick.

    Written from the description of the law: PI at the position rate, D and a current loop of first order at the base
    rate, the velocity from a critically damped tracking loop; spring, damper and both masses by the matrix exponential.
    """
    s, d = STIFFNESS, DAMPING
    plant = np.array(
        [
            [0, 1, 0, 0, 0],
            [0, 0, s / link, d / link, 0],
            [0, 0, 0, 1, 0],
            [0, 0, -s / ROTOR - s / link, -d / ROTOR - d / link, 1 / ROTOR],
            [0, 0, 0, 0, 0],
        ]
    )
    held = expm(plant * period)
    pole, lag = math.exp(-2 * math.pi * OBSERVER * period), math.exp(-2 * math.pi * BANDWIDTH * period)

    def advance(x: Array) -> Array:
        x = x.copy()
        error = -(x[0] + x[2])
        x[8] += error * ratio * period
        x[7] = INERTIA * (KV * KP * error + KI * x[8])
        for _ in range(ratio):
            asked = x[7] - INERTIA * KV * x[5]
            x[6] = lag * x[6] + (1 - lag) * asked
            x[:4] = (held @ [*x[:4], x[6]])[:4]
            ahead = x[4] + period * x[5]
            innovation = x[0] + x[2] - ahead
            x[4] = ahead + (1 - pole**2) * innovation
            x[5] += (1 - pole) ** 2 / period * innovation
        return x

    return np.array([advance(unit) for unit in np.eye(9)]).T


def test_the_velocity_loop_sees_the_resonance(shipped: Setup) -> None:
    """After a push the link rings on its gear, and both follow the linear loop: frequency, decay, phase."""
    setup = soft_joint(shipped)
    link, rates = link_mass(setup, POSE)[0, 0], setup.rates
    matrix = loop_matrix(link, rates.period, rates.ratio)
    plant, law = setup.plant(), setup.cs7b()
    plant.reset(POSE)
    law.reset(plant.motor_states()[0])
    state, want, found, expected = plant.state[0], np.zeros(9), [], []
    want[1], want[3] = 0.02, -0.02  # the link is pushed, its motor rests
    for k in range(2400):
        if k == rates.ratio:
            state["v"][0], state["transmission"]["rate"][0] = want[1], want[3]
        elif k % rates.ratio == 0 and k > 0:
            want = matrix @ want
            found.append([state["q"][0] - POSE[0], state["transmission"]["twist"][0]])
            expected.append(want[[0, 2]])
        position, velocity, _ = plant.motor_states()
        plant.step(law.step(position, velocity))
    got, answer = np.array(found), np.array(expected)
    assert np.abs(got - answer).max() < 2e-4 * np.abs(answer).max()
    poles = np.linalg.eigvals(matrix)
    ringing = max(poles, key=lambda pole: abs(pole) * (pole.imag > 0))
    twist = got[:300, 1]
    crossings = np.flatnonzero(np.signbit(twist[1:]) != np.signbit(twist[:-1]))
    instants = crossings + twist[crossings] / (twist[crossings] - twist[crossings + 1])
    assert np.pi / np.diff(instants) == pytest.approx(abs(np.angle(ringing)), rel=3e-3)
    # The integral and the lag of the motor put it below the resonance of a link on a motor that is held.
    assert abs(np.angle(ringing)) < rates.position_period * math.sqrt(STIFFNESS / link)


def test_joint_states_are_the_links_and_motor_states_the_motors(shipped: Setup, tmp_path: Path) -> None:
    """A recorded run tells link from motor by the load over the stiffness, and done again it has the same bits."""
    stiffness = np.array([4e4, 4e4, 2e4, 5e3, 3e3, 1e3])
    setup = elastic(shipped, stiffness, 5e-4 * stiffness)
    rest = TrajectoryPoints.create(
        setup.robot.joint_names, setup.robot.joint_names, [0.0, 0.2], [POSE] * 2, [np.zeros(6)] * 2, [[]] * 2
    )
    run = simulate(setup, rest, record_fast=True)
    write_bag(run, tmp_path / "bag")
    links = read_joint_states(tmp_path / "bag", "joint_states")
    motors = read_joint_states(tmp_path / "bag", "motor_states")
    assert links.position is not None
    assert motors.position is not None
    twist = motors.position[0] / setup.drives.gear - WRIST @ links.position[0]
    plant = setup.plant()
    plant.reset(POSE)
    load = np.linalg.solve(WRIST.T, plant.state["bias"][0])
    assert np.abs(load[1:3] / stiffness[1:3]).max() > 1e-4
    assert twist == pytest.approx(load / stiffness, abs=2e-6)  # a count of motor 6 is 4 urad at the joint
    again = replay(setup, read_run(tmp_path / "bag", setup))
    assert again.slow.joint_states.tobytes() == run.slow.joint_states.tobytes()
