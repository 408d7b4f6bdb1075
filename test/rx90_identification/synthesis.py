"""Records of sweeps made without the code under test: an analytic Stribeck curve, Pinocchio, noise."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from rx90_identification.record import JointRecord
from rx90_loop.setup import Setup
from rx90_sim.friction import FrictionSet, LuGreElement

Array = NDArray[np.float64]

INPUT = np.vstack([np.eye(6), [0, 0, 0, 0, 1, 1]])
WRIST = np.eye(6)
WRIST[5, 4] = 1.0
PERIOD = 1e-3


def stribeck(element: LuGreElement, velocity: Array) -> Array:
    """Return the torque of steady sliding by equations 17 to 19, Nm; none at rest."""
    up = velocity > 0
    coulomb = np.where(up, element.tau_c_positive, element.tau_c_negative)
    static = np.where(up, element.tau_s_positive, element.tau_s_negative)
    decay = np.exp(-((np.abs(velocity) / element.omega_s) ** element.delta))
    return np.sign(velocity) * (coulomb + (static - coulomb) * decay) + element.c2 * velocity


def drive_torque(setup: Setup, friction: FrictionSet, q: Array, v: Array, stuck: Array, payload: float = 0.0) -> Array:
    """Return joint torques of the drives; a resting element carries `stuck`, Nm, shape (m, 7)."""
    model = setup.robot.model.copy()
    if payload:
        point = pin.Inertia(payload, np.array([0.03, -0.02, 0.15]), np.zeros((3, 3)))
        model.inertias[6] = model.inertias[6] + point
    data, zero = model.createData(), np.zeros(6)
    # Gravity and velocity torques are smooth: every tenth sample and straight lines between them.
    few = np.unique(np.append(np.arange(0, len(q), 10), len(q) - 1))
    coarse = np.array([pin.rnea(model, data, q[k], v[k], zero) for k in few])
    torque = np.column_stack([np.interp(np.arange(len(q)), few, column) for column in coarse.T])
    torque[:, 1] += setup.drives.spring_torque * np.sin(q[:, 1])
    inputs = v @ INPUT.T
    sliding = np.column_stack([stribeck(e, inputs[:, k]) for k, e in enumerate(friction.elements)])
    return torque + np.where(inputs == 0.0, stuck, sliding) @ INPUT


def sweep(start: Array, velocity: Array, travel: float, longest: float = 4.0) -> tuple[Array, Array]:
    """Return positions and velocities of a rest, a stretch at constant velocity and its way back."""
    fastest = np.abs(INPUT @ velocity).max()
    duration = min(travel / fastest, longest)
    moving = int(duration / PERIOD)
    profile = np.concatenate([np.zeros(200), np.ones(moving), np.zeros(200), -np.ones(moving), np.zeros(100)])
    v = profile[:, None] * velocity
    return start - velocity * duration / 2.0 + np.cumsum(v, axis=0) * PERIOD, v


def speeds(fastest: float, count: int = 16) -> Array:
    """Return speeds on a logarithmic range, rad/s."""
    return np.geomspace(0.003, fastest, count)


def motions(setup: Setup, joints: Sequence[int], count: int = 16, poses: int = 2, seed: int = 0) -> tuple[Array, Array]:
    """Return a program of sweeps of single joints, and for the wrist of joints 5 and 6 together and against."""
    rng = np.random.default_rng(seed)
    parts = []
    for joint in joints:
        directions = [np.eye(6)[joint]]
        if joint == 5:
            directions += [np.array([0, 0, 0, 0, 1.0, -1.0]), np.array([0, 0, 0, 0, 0.6, 0.4])]
        for direction in directions:
            fastest = 0.5 * (setup.robot.max_velocity[np.abs(direction) > 0] / np.abs(direction[direction != 0])).min()
            for _ in range(poses):
                pose = rng.uniform(-0.8, 0.8, 6)
                parts += [sweep(pose, direction * speed, 1.6) for speed in speeds(fastest, count)]
    return np.concatenate([p for p, _ in parts]), np.concatenate([v for _, v in parts])


def measured(
    setup: Setup, q: Array, torque: Array, noise: float, rng: np.random.Generator, counts: float = 65536.0
) -> JointRecord:
    """Return what encoders and current sensors make of it; `noise` in parts of the motors' steady torque."""
    gear = setup.drives.gear
    step = 2.0 * np.pi / counts
    motor = np.round((q @ WRIST.T) * gear / step) * step
    position = np.linalg.solve(WRIST, (motor / gear).T).T
    steady = np.array([318.0, 166.0, 76.0, 34.0, 29.0, 11.0])
    disturbed = torque + (rng.normal(size=q.shape) * noise * steady) @ WRIST
    velocity = np.gradient(position, PERIOD, axis=0)
    time = np.arange(len(q)) * PERIOD
    return JointRecord(setup.robot.joint_names, time, position, velocity, disturbed, Path("synthetic"), "0" * 64)


def random_friction(names: tuple[str, ...], base: FrictionSet, rng: np.random.Generator) -> FrictionSet:
    """Return elements with every parameter moved at random, the signs of the velocity told apart."""
    elements = []
    for name, element in zip(names, base.elements, strict=True):
        up, down = rng.uniform(0.7, 1.4, 2) * element.tau_c_positive
        if name == "joint_5_6":
            down = up  # the difference is a constant torque that joints 5 and 6 may as well have
        rise = rng.uniform(0.2, 0.5, 2)
        elements.append(
            LuGreElement(
                tau_c_positive=up,
                tau_c_negative=down,
                tau_s_positive=up * (1 + rise[0]),
                tau_s_negative=down * (1 + rise[1]),
                omega_s=element.omega_s * rng.uniform(0.7, 1.5),
                delta=rng.uniform(0.8, 1.8),
                c0=element.c0,
                c1=element.c1,
                c2=element.c2 * rng.uniform(0.6, 1.5),
            )
        )
    return FrictionSet(names, tuple(elements))
