"""Load parts from runs with and without a known payload: errors, coverage and false findings over seeded arms.

    python -m benchmarks.load_parts [--arms N] [--runs N]

The shipped arms without their tools, with rotors, springs and coupled wrist; the inertias count as unknown. Each
element has coefficients of its own for both directions, 2 to 12 %, or none has any. The motions are those that
`rx90_experiment run --excitation` plans for the loaded arm; each is run without and with the payload. Torques are
Pinocchio's with Coulomb and viscous friction, and noise of 1 % of each joint's standard deviation. Beside the errors
stands the least standard deviation that an unbiased estimate from these torques can have (Cramer and Rao), inertias
and other friction unknown.
"""

from __future__ import annotations

import sys
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

import numpy as np
import pinocchio as pin

import rx90_emulator as rx
from benchmarks.report import arguments
from rx90_common.base.arrays import Array
from rx90_common.description.coupling import RX_WRIST
from rx90_emulator.identification.arm import RigidArm, rigid_torque
from rx90_emulator.identification.excitation.choice import select_parts
from rx90_emulator.identification.excitation.filtering import Bandwidths, filter_record
from rx90_emulator.identification.excitation.known_payload import LoadParts, identify_load_parts
from rx90_emulator.identification.excitation.problem import (
    BaseGroups,
    ExcitationProblem,
    Motion,
    Payload,
    StandardColumns,
)
from rx90_emulator.identification.experiments.excitation import plan_excitation
from rx90_emulator.identification.options import ExcitationOptions
from rx90_emulator.identification.records import JointRecord
from rx90_emulator.loop.setup import Setup

MASS = {"rx90b": 6.0, "tx40": 2.0}
"""Of the payload, kg: what the arms are rated for."""
NOISE = 0.01
RATE = 200.0
"""Samples per second."""
_WITHIN = 0.05  # of the coefficient


def payload_of(mass: float) -> Payload:
    """Return a body before the flange and 0.09 m beside the last axis, so that the wrist carries a load, too."""
    return Payload(mass, [0.08, -0.05, 0.12], np.diag([0.03, 0.02, 0.025]) * mass / 4.0)


def loaded(model: pin.Model, body: Payload) -> pin.Model:
    """Return the model of an arm with a body at its last link."""
    other = model.copy()
    other.inertias[6] += pin.Inertia(body.mass, np.asarray(body.centre), np.asarray(body.inertia))
    return other


def planned_motions(setup: Setup, body: Payload, runs: int) -> list[Motion]:
    """Return the periodic parts of the runs that `rx90_experiment run --excitation` plans for the arm with a body."""
    heavier = replace(setup, robot=replace(setup.robot, model=loaded(setup.robot.model, body)))
    options = ExcitationOptions(runs=runs, validation=False)
    time = np.arange(round(RATE * options.period * options.periods)) / RATE
    plan = plan_excitation(heavier, options)
    return [tuple(plan.basis(time) @ coefficients.T) for coefficients in plan.coefficients]


def transmitted_of(setup: Setup, motion: Motion, body: Payload | None) -> tuple[Array, Array]:
    """Return the joints' torques without friction, shape (m, 6), and what the elements transmit of them, (m, 7); Nm."""
    drives, model = setup.drives, setup.robot.model if body is None else loaded(setup.robot.model, body)
    rigid = rigid_torque(model, drives.rotor_matrix, drives.spring_torque, *motion)
    link = rigid - motion[2] @ drives.rotor_matrix
    # Motor 6 turns joint 5 as well, so that the gear of joint 5 carries the rest.
    return rigid, np.column_stack([link[:, :4], link[:, 4] - link[:, 5], link[:, 5], link[:, 5]])


def torque_of(setup: Setup, motion: Motion, body: Payload | None, coefficients: Array) -> Array:
    """Return joint torques, Nm: rigid bodies, rotors, springs, and friction with load parts, shape (7, 2)."""
    matrix, laws = RX_WRIST.element_matrix, setup.friction.elements
    inputs, (rigid, carried) = motion[1] @ matrix.T, transmitted_of(setup, motion, body)
    share = np.where(carried * inputs >= 0.0, coefficients[:, 0], coefficients[:, 1])
    coulomb = [law.tau_c_positive for law in laws] + share * np.abs(carried)
    return np.asarray(rigid + (np.sign(inputs) * coulomb + inputs * [law.c2 for law in laws]) @ matrix)


def least_deviation(setup: Setup, motions: Sequence[Motion], body: Payload, coefficients: Array) -> Array:
    """Return the Cramer-Rao bounds of the coefficients' standard deviations, shape (7, 2).

    Unknown besides are base parameters, Coulomb and viscous torques; what the elements transmit counts as known.
    """
    arm, share = RigidArm.from_setup(setup), RX_WRIST.element_matrix.T
    standard = StandardColumns(arm)
    leading = list(BaseGroups.of(standard).leading)
    information: Array | float = 0.0
    for motion in motions:
        rigid, inputs = standard.torque(*motion)[:, :, leading], motion[1] @ share
        for carried_body in (None, body):
            torque = torque_of(setup, motion, carried_body, coefficients)
            load = transmitted_of(setup, motion, carried_body)[1]
            size, drives = np.sign(inputs) * np.abs(load), load * inputs >= 0.0
            own = np.stack([np.sign(inputs), inputs, size * drives, size * ~drives], axis=2)
            friction = (share[None, :, :, None] * own[:, None]).reshape(*torque.shape, -1)
            rows = np.concatenate([rigid, friction], axis=2) / (NOISE * torque.std(axis=0))[:, None]
            flat = rows.reshape(-1, rows.shape[2])
            information = information + flat.T @ flat
    variance = np.diag(np.linalg.pinv(np.asarray(information), hermitian=True))
    return np.asarray(np.sqrt(variance[-28:].reshape(7, 4)[:, 2:]))


def problem_of(
    setup: Setup, seed: int, coefficients: Array, motions: Sequence[Motion], mass: float
) -> ExcitationProblem:
    """Return the equations of motions that are run without and then with a payload of a mass, kg."""
    rng = np.random.default_rng((seed, 6))
    records, carried = [], []
    for number, motion in enumerate(motions):
        for body in (None, payload_of(mass)):
            torque = torque_of(setup, motion, body, coefficients)
            torque = torque + NOISE * torque.std(axis=0) * rng.normal(size=torque.shape)
            time = np.arange(len(torque)) / RATE
            name = f"run_{number}{'' if body is None else '_loaded'}"
            records.append(JointRecord(setup.robot.joint_names, time, motion[0], motion[1], torque, Path(name), name))
            carried.append(body)
    bandwidths = Bandwidths.of(records)
    filtered = [filter_record(record, bandwidths) for record in records]
    bodies = [body for body, pieces in zip(carried, filtered, strict=True) for _ in pieces]
    runs_of = [piece for pieces in filtered for piece in pieces]
    return ExcitationProblem.of(RigidArm.from_setup(setup), runs_of, payloads=bodies)


def coefficients_of(seed: int) -> Array:
    """Return coefficients of 2 to 12 % by element and direction, shape (7, 2)."""
    return np.random.default_rng((seed, 7)).uniform(0.02, 0.12, (7, 2))


@dataclass(frozen=True, eq=False)
class Experiment:
    """What all arms of a kind go through."""

    setup: Setup
    motions: Sequence[Motion]
    mass: float

    @classmethod
    def of(cls, robot: str, runs: int) -> Experiment:
        """Return so many planned motions of a shipped robot without its tool, and the payload that it is rated for."""
        setup = rx.load_setup(robot=robot, tool="none")
        return cls(setup, planned_motions(setup, payload_of(MASS[robot]), runs), MASS[robot])

    def outcome(self, seed: int, *, there: bool) -> Outcome:
        """Return what is found on a seeded arm with load parts on all elements, or on none."""
        true = coefficients_of(seed) if there else np.zeros((7, 2))
        problem = problem_of(self.setup, seed, true, self.motions, self.mass)
        return Outcome(true, identify_load_parts(problem, partial(select_parts, parts=())))

    def bound(self) -> Array:
        """Return the Cramer-Rao bounds of an arm in the middle of the coefficients, shape (7, 2)."""
        return least_deviation(self.setup, self.motions, payload_of(self.mass), np.full((7, 2), 0.07))


@dataclass(frozen=True, eq=False)
class Outcome:
    """One arm: what is true, shape (7, 2), and what was found."""

    true: Array
    found: LoadParts


def report(robot: str, with_parts: Sequence[Outcome], without: Sequence[Outcome], bound: Array) -> list[str]:
    """Return lines with what was found, by element and of all."""
    lines = [
        f"{robot}: element, load RMS Nm, found, median and largest error, within 5 %, in their 95 % interval, "
        "RMS error and its Cramer-Rao bound in % of the load"
    ]
    largest, all_inside = [0.0], []
    for e in range(7):
        have = [one for one in with_parts if e in one.found.kept]
        true, value, deviation = (
            np.array([values[e] for values in column]).reshape(-1, 2)
            for column in (
                [one.true for one in have], [one.found.value for one in have], [one.found.deviation for one in have]
            )
        )  # fmt: skip
        share, inside = np.abs(value - true) / true, np.abs(value - true) <= 1.96 * deviation
        line = f"{e + 1:>3} {np.mean([one.found.transmitted[e] for one in with_parts]):8.2f}"
        line += f" {len(have):>4} of {len(with_parts)}"
        if have:
            largest.append(share.max())
            all_inside += inside.ravel().tolist()
            line += (
                f" {np.median(share):8.1%} {share.max():8.1%} {np.mean(share <= _WITHIN):6.0%} {np.mean(inside):6.0%}"
                f" {100.0 * np.sqrt(np.mean((value - true) ** 2)):8.3f} {100.0 * np.sqrt(np.mean(bound[e] ** 2)):.3f}"
            )
        lines.append(line)
    false = sum(len(one.found.kept) for one in without)
    return [
        *lines, f"    without load parts: {false} found of {7 * len(without)}",
        f"    largest error of all coefficients {max(largest):.1%}, in their interval {np.mean(all_inside):.1%}",
    ]  # fmt: skip


def main() -> int:
    """Print the tables."""
    options = arguments(
        __doc__, ("--arms", 6, "of each kind"), ("--runs", 6, "motions, each without and with the payload")
    )
    for robot in MASS:
        experiment = Experiment.of(robot, options.runs)
        found = [[experiment.outcome(seed, there=there) for seed in range(options.arms)] for there in (True, False)]
        print("\n".join(report(robot, *found, experiment.bound())), flush=True)
    return 0


if __name__ == "__main__":
    sys.exit(main())
