"""Records of sweeps made without the code under test, and presliding experiments on the engine, both with noise.

Sweeps: an analytic Stribeck curve, Pinocchio, noise. Presliding: random friction, and what noisy sensors make of it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pinocchio as pin

from rx90_common.base.arrays import Array
from rx90_common.description.coupling import RX_WRIST
from rx90_common.friction import FrictionElement, FrictionSet
from rx90_common.rigid_torque import rigid_torque
from rx90_emulator.identification.estimates import PRESLIDING, SLIDING, Estimates
from rx90_emulator.identification.experiments.plan import Kind, PlanOptions, make_plan
from rx90_emulator.identification.records import JointRecord
from rx90_emulator.loop.closed_loop import simulate
from rx90_emulator.loop.setup import Setup

INPUT = RX_WRIST.element_matrix
WRIST = np.eye(6)
WRIST[5, 4] = 1.0
PERIOD = 1e-3
SLOWEST = 0.003
STUCK = np.array([5.0, 5.0, 3.0, 1.0, 0.5, 0.3, 0.2])
"""What elements at rest carry, Nm: any torque below the static one, and nobody knows it."""
STEADY_TORQUE = np.array([318.0, 166.0, 76.0, 34.0, 29.0, 11.0])


@dataclass(frozen=True)
class Noise:
    """Errors of the motors' sensors.

    Attributes:
        torque: standard deviation of a sample at 1 kHz, in parts of the steady torque. The friction rig's is
            0.002 Nm of 0.18 Nm.
        common: standard deviation of what all samples of a stretch at constant velocity have in common.
        counts: of the encoder, per motor revolution.
    """

    torque: float = 0.002 / 0.18
    common: float = 0.0
    counts: float = 65536.0


def drive_torque(
    setup: Setup, friction: FrictionSet, motion: tuple[Array, Array], payload: float = 0.0
) -> Array:
    """Return joint torques of the drives; elements at rest carry STUCK.

    Args:
        setup: robot and drives.
        friction: its elements.
        motion: positions and velocities.
        payload: a point mass on the flange that the setup knows nothing of, kg.
    """
    q, v = motion
    model = setup.robot.model.copy()
    if payload:
        point = pin.Inertia(payload, np.array([0.03, -0.02, 0.15]), np.zeros((3, 3)))
        model.inertias[6] = model.inertias[6] + point
    # Gravity and velocity torques are smooth: every tenth sample and straight lines between them.
    few = np.unique(np.append(np.arange(0, len(q), 10), len(q) - 1))
    coarse = rigid_torque(
        model, np.zeros((6, 6)), np.zeros(6), q[few], v[few], np.zeros((len(few), 6))
    )
    torque = np.column_stack([np.interp(np.arange(len(q)), few, column) for column in coarse.T])
    torque += setup.drives.spring_torque * np.sin(q)
    # Friction once for each stretch of constant velocity.
    first = np.flatnonzero(np.append(True, np.any(np.diff(v, axis=0) != 0.0, axis=1)))
    inputs = v[first] @ INPUT.T
    sliding = np.column_stack(
        [e.steady_torque(inputs[:, k]) for k, e in enumerate(friction.elements)]
    )
    stretch = np.where(inputs == 0.0, STUCK, sliding) @ INPUT
    return torque + np.repeat(stretch, np.diff(np.append(first, len(v))), axis=0)


def sweep(start: Array, velocity: Array, travel: float, longest: float) -> tuple[Array, Array]:
    """Return positions and velocities of a rest, a stretch at constant velocity and its way back."""
    fastest = np.abs(INPUT @ velocity).max()
    duration = min(travel / fastest, longest)
    moving = int(duration / PERIOD)
    profile = np.concatenate(
        [np.zeros(100), np.ones(moving), np.zeros(100), -np.ones(moving), np.zeros(100)]
    )
    v = profile[:, None] * velocity
    return start - velocity * duration / 2.0 + np.cumsum(v, axis=0) * PERIOD, v


@dataclass(frozen=True)
class Program:
    """Sweeps of single joints, and for the wrist of joints 5 and 6 together and against each other.

    Attributes:
        joints: which, counted from 0.
        count: speeds on a logarithmic range.
        poses: how often, at random poses.
        longest: s of a stretch at constant velocity.
        backward: whether the arm also goes back at the same speed.
    """

    joints: Sequence[int]
    count: int = 14
    poses: int = 2
    longest: float = 4.0
    backward: bool = True

    def motion(self, setup: Setup, seed: int = 0) -> tuple[Array, Array]:
        """Return positions and velocities at 1 kHz, shape (m, 6)."""
        rng = np.random.default_rng(seed)
        parts = []
        for joint in self.joints:
            directions = [np.eye(6)[joint]]
            if joint == 5:
                directions += [np.array([0, 0, 0, 0, 1.0, -1.0]), np.array([0, 0, 0, 0, 0.6, 0.4])]
            for direction in directions:
                moving = direction != 0.0
                fastest = 0.5 * (setup.robot.max_velocity[moving] / np.abs(direction[moving])).min()
                for _ in range(self.poses):
                    pose = rng.uniform(-0.8, 0.8, 6)
                    for speed in np.geomspace(SLOWEST, fastest, self.count):
                        parts.append(sweep(pose, direction * speed, 1.6, self.longest))
        q, v = (np.concatenate(columns) for columns in zip(*parts, strict=True))
        if not self.backward:
            kept = (v >= 0.0).all(axis=1)
            q, v = q[kept], v[kept]
        return q, v


def measured(
    setup: Setup, motion: tuple[Array, Array], torque: Array, rng: np.random.Generator, noise: Noise
) -> JointRecord:
    """Return what the encoders and current sensors of the motors make of it."""
    q, v = motion
    gear = setup.drives.gear
    step = 2.0 * np.pi / noise.counts
    motor = np.round((q @ WRIST.T) * gear / step) * step
    position = np.linalg.solve(WRIST, (motor / gear).T).T
    stretch = np.cumsum(np.append(0, np.any(np.diff(v, axis=0) != 0.0, axis=1)))
    common = rng.normal(size=(stretch[-1] + 1, 6))[stretch]
    errors = noise.torque * rng.normal(size=q.shape) + noise.common * common
    disturbed = torque + (errors * STEADY_TORQUE) @ WRIST
    velocity = np.gradient(position, PERIOD, axis=0)
    time = np.arange(len(q)) * PERIOD
    return JointRecord(
        setup.robot.joint_names, time, position, velocity, disturbed, Path("synthetic"), "0" * 64
    )


SCALES = (0.5, 1.5)
"""Every parameter of every element is scaled by a factor of its own between these."""
_SLIDING_ERROR = {"tau_c": 3e-3, "tau_s": 3e-3, "omega_s": 1e-2, "delta": 1.5e-2, "c2": 4e-3}
"""Standard deviations of what the sliding fit finds, in parts of the value: those of the shipped plan's joint 2."""


@dataclass(frozen=True, eq=False)
class Run:
    """One experiment on the engine.

    Attributes:
        name: the experiment's.
        time: s, shape (m,).
        motor: position and torque, motor side, shape (2, m, 6).
    """

    name: str
    time: Array
    motor: Array


class Outcome(NamedTuple):
    """One estimate against the truth: relative error, and error in standard deviations; NaN if not identifiable."""

    element: int
    parameter: str
    error: float
    score: float

    @property
    def identifiable(self) -> bool:
        """Return whether there is an estimate."""
        return self.error == self.error


def outcomes(estimates: Sequence[Estimates], truth: Sequence[FrictionElement]) -> list[Outcome]:
    """Return what became of c0 and c1 of every element."""
    found = []
    for number, (estimate, element) in enumerate(zip(estimates, truth, strict=True)):
        for name in PRESLIDING:
            one, true = estimate[name], element.parameters[name]
            error = one.value - true  # NaN if it is not identifiable
            score = error / one.deviation if one.identifiable else error
            found.append(Outcome(number, name, error / true, score))
    return found


def random_bristles(base: FrictionSet, rng: np.random.Generator) -> FrictionSet:
    """Return elements with every parameter scaled; the static torque by what it has above the Coulomb torque."""
    elements = []
    for element in base.elements:
        names = ("tau_c", "rise", "omega_s", "delta", "c0", "c1", "c2")
        scale = dict(zip(names, rng.uniform(*SCALES, len(names)), strict=True))
        changed: dict[str, float] = {
            name: scale[name] * element.parameters[name] for name in names[2:]
        }
        for sign in ("positive", "negative"):
            coulomb, static = (
                element.parameters[f"tau_c_{sign}"],
                element.parameters[f"tau_s_{sign}"],
            )
            changed[f"tau_c_{sign}"] = scale["tau_c"] * coulomb
            changed[f"tau_s_{sign}"] = scale["tau_c"] * coulomb + scale["rise"] * (static - coulomb)
        elements.append(element.with_parameters(changed))
    return FrictionSet(base.names, tuple(elements))


def run_presliding(setup: Setup, options: PlanOptions | None = None) -> list[Run]:
    """Run the presliding experiments of a plan."""
    runs = []
    for experiment in make_plan(setup.robot, setup.drives, options):
        if experiment.kind is not Kind.PRESLIDING:
            continue
        home = experiment.points.position[0]
        fast = simulate(setup, experiment.points, home, experiment.duration, record_fast=True).fast
        assert fast is not None
        time = np.arange(len(fast.motor_states)) * setup.rates.period
        runs.append(
            Run(
                experiment.name,
                time,
                np.ascontiguousarray(fast.motor_states[:, ::2].transpose(1, 0, 2)),
            )
        )
    return runs


def recorded(setup: Setup, run: Run, rng: np.random.Generator, noise: Noise) -> JointRecord:
    """Return the joint-side record of a run with the torque noise of the motors' sensors."""
    gear = setup.drives.gear
    # the rig's noise is that of 1 ms means
    per_sample = noise.torque * np.sqrt(1e-3 / setup.rates.period)
    position, torque = run.motor
    noisy = torque * gear + per_sample * STEADY_TORQUE * rng.standard_normal(torque.shape)
    joints = np.linalg.solve(WRIST, (position / gear).T).T
    velocity = np.gradient(joints, setup.rates.period, axis=0)
    return JointRecord(
        setup.robot.joint_names, run.time, joints, velocity, noisy @ WRIST, Path(run.name), run.name
    )


def measured_sliding(
    elements: Sequence[FrictionElement], rng: np.random.Generator
) -> list[FrictionElement]:
    """Return the sliding regime as it is identified: with errors."""
    found = []
    for element in elements:
        changed = {}
        for name, error in zip(SLIDING, rng.standard_normal(len(SLIDING)), strict=True):
            relative = _SLIDING_ERROR[name.removesuffix("_positive").removesuffix("_negative")]
            changed[name] = element.parameters[name] * (1.0 + relative * error)
        for sign in ("positive", "negative"):
            changed[f"tau_s_{sign}"] = max(changed[f"tau_s_{sign}"], changed[f"tau_c_{sign}"])
        found.append(element.with_parameters(changed))
    return found
