"""Presliding experiments on the engine with random friction, and what noisy sensors make of them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from benchmarks.synthetic_sweeps import STEADY_TORQUE, WRIST, Noise
from rx90_common.friction import FrictionElement, FrictionSet
from rx90_emulator.identification.estimates import PRESLIDING, SLIDING, ElementEstimate
from rx90_emulator.identification.experiments.plan import Kind, PlanOptions, make_plan
from rx90_emulator.identification.records import JointRecord
from rx90_emulator.loop.closed_loop import simulate
from rx90_emulator.loop.setup import Setup

Array = NDArray[np.float64]

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

    element: str
    parameter: str
    error: float
    score: float

    @property
    def identifiable(self) -> bool:
        """Return whether there is an estimate."""
        return self.error == self.error


def outcomes(estimates: Sequence[ElementEstimate], truth: Sequence[FrictionElement]) -> list[Outcome]:
    """Return what became of c0 and c1 of every element."""
    found = []
    for estimate, element in zip(estimates, truth, strict=True):
        for name in PRESLIDING:
            one, true = estimate.parameters[name], getattr(element, name)
            error = one.value - true  # NaN if it is not identifiable
            score = error / one.deviation if one.identifiable else error
            found.append(Outcome(estimate.element, name, error / true, score))
    return found


def random_bristles(base: FrictionSet, rng: np.random.Generator) -> FrictionSet:
    """Return elements with every parameter scaled; the static torque by what it has above the Coulomb torque."""
    elements = []
    for element in base.elements:
        names = ("tau_c", "rise", "omega_s", "delta", "c0", "c1", "c2")
        scale = dict(zip(names, rng.uniform(*SCALES, len(names)), strict=True))
        changed: dict[str, float] = {name: scale[name] * getattr(element, name) for name in names[2:]}
        for sign in ("positive", "negative"):
            coulomb, static = getattr(element, f"tau_c_{sign}"), getattr(element, f"tau_s_{sign}")
            changed[f"tau_c_{sign}"] = scale["tau_c"] * coulomb
            changed[f"tau_s_{sign}"] = scale["tau_c"] * coulomb + scale["rise"] * (static - coulomb)
        elements.append(replace(element, **changed))
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
        runs.append(Run(experiment.name, time, np.ascontiguousarray(fast.motor_states[:, ::2].transpose(1, 0, 2))))
    return runs


def recorded(setup: Setup, run: Run, rng: np.random.Generator, noise: Noise) -> JointRecord:
    """Return the joint-side record of a run with the torque noise of the motors' sensors."""
    gear = setup.drives.gear
    per_sample = noise.torque * np.sqrt(1e-3 / setup.rates.period)  # the rig's noise is that of 1 ms means
    position, torque = run.motor
    noisy = torque * gear + per_sample * STEADY_TORQUE * rng.standard_normal(torque.shape)
    joints = np.linalg.solve(WRIST, (position / gear).T).T
    velocity = np.gradient(joints, setup.rates.period, axis=0)
    return JointRecord(setup.robot.joint_names, run.time, joints, velocity, noisy @ WRIST, Path(run.name), run.name)


def sliding_covariance(element: FrictionElement) -> Array:
    """Return the covariance of a sliding regime as it is identified, in the order of SLIDING, shape (7, 7)."""
    names = [name.removesuffix("_positive").removesuffix("_negative") for name in SLIDING]
    deviation = [_SLIDING_ERROR[name] * getattr(element, full) for name, full in zip(names, SLIDING, strict=True)]
    return np.diag(np.square(deviation))


def measured_sliding(elements: Sequence[FrictionElement], rng: np.random.Generator) -> list[FrictionElement]:
    """Return the sliding regime as it is identified: with errors."""
    found = []
    for element in elements:
        errors = np.sqrt(np.diag(sliding_covariance(element))) * rng.standard_normal(len(SLIDING))
        changed = {name: getattr(element, name) + error for name, error in zip(SLIDING, errors, strict=True)}
        for sign in ("positive", "negative"):
            changed[f"tau_s_{sign}"] = max(changed[f"tau_s_{sign}"], changed[f"tau_c_{sign}"])
        found.append(replace(element, **changed))
    return found
