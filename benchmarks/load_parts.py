"""Load parts from runs with and without a known payload: errors, coverage and false findings over seeded arms.

    python -m benchmarks.load_parts [--arms N]

The shipped arms with rotors, springs and coupled wrist; the inertias count as unknown. Each element has coefficients of
its own for both directions, 2 to 12 %, or none has any. Torques are Pinocchio's with Coulomb and viscous friction, and
noise of 1 % of each joint's standard deviation.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pinocchio as pin

import rx90_emulator as rx
from rx90_common.base.arrays import Array
from rx90_common.description.rigid_torque import rigid_torque
from rx90_common.description.wrist import element_matrix
from rx90_emulator.identification.excitation.filtering import Bandwidths, filter_record
from rx90_emulator.identification.excitation.friction.load_parts import identify_load_parts
from rx90_emulator.identification.excitation.load_parts import LoadParts
from rx90_emulator.identification.excitation.payload import Payload
from rx90_emulator.identification.excitation.problem import ExcitationProblem, Motion
from rx90_emulator.identification.model.rigid_arm import RigidArm
from rx90_emulator.identification.records.record import JointRecord
from rx90_emulator.loop.setup import Setup

MASS = {"rx90b": 9.0, "tx40": 2.0}
"""Of the payload, kg."""
NOISE = 0.01
_HARMONICS = np.arange(1, 6)
_BASE = 2.0 * np.pi * 1.6 / 15.0  # rad/s
_WITHIN = 0.05  # of the coefficient


def payload_of(mass: float) -> Payload:
    """Return a body beside and before the flange."""
    return Payload(mass, [0.03, -0.02, 0.12], np.diag([0.03, 0.02, 0.025]) * mass / 4.0)


def motion_of(seed: int, duration: float, rate: float) -> Motion:
    """Return five sines in each joint, to 1.5 rad."""
    rng = np.random.default_rng((seed, 5))
    phase, size = rng.uniform(0.0, 2.0 * np.pi, (6, 5)), rng.uniform(0.5, 1.0, (6, 5)) / np.sqrt(_HARMONICS)
    size *= 1.5 / size.sum(axis=1, keepdims=True)
    turn = _BASE * _HARMONICS
    angle = np.arange(0.0, duration, 1.0 / rate)[:, None, None] * turn + phase
    return (
        (size * np.sin(angle)).sum(axis=2),
        (size * turn * np.cos(angle)).sum(axis=2),
        (-size * turn**2 * np.sin(angle)).sum(axis=2),
    )


def torque_of(setup: Setup, motion: Motion, body: Payload | None, coefficients: Array) -> Array:
    """Return joint torques, Nm: rigid bodies, rotors, springs, and friction with load parts, shape (7, 2)."""
    model, drives, matrix = setup.robot.model.copy(), setup.drives, element_matrix()
    if body is not None:
        model.inertias[6] = model.inertias[6] + pin.Inertia(
            body.mass, np.asarray(body.centre), np.asarray(body.inertia)
        )
    inputs, laws = motion[1] @ matrix.T, setup.friction.elements
    rigid = rigid_torque(model, drives.rotor_matrix, drives.spring_torque, *motion)
    link = rigid - motion[2] @ drives.rotor_matrix
    # Motor 6 turns joint 5 as well, so that the gear of joint 5 carries the rest.
    carried = np.column_stack([link[:, :4], link[:, 4] - link[:, 5], link[:, 5], link[:, 5]])
    share = np.where(carried * inputs >= 0.0, coefficients[:, 0], coefficients[:, 1])
    coulomb = [law.tau_c_positive for law in laws] + share * np.abs(carried)
    return np.asarray(rigid + (np.sign(inputs) * coulomb + inputs * [law.c2 for law in laws]) @ matrix)


def problem_of(
    robot: str, seed: int, coefficients: Array, runs: int = 4, duration: float = 20.0, rate: float = 200.0
) -> ExcitationProblem:
    """Return the equations of runs, every second one with the payload."""
    setup, body = rx.load_setup(robot=robot), payload_of(MASS[robot])
    rng = np.random.default_rng((seed, 6))
    records, carried = [], []
    for number in range(runs):
        carried.append(body if number % 2 else None)
        motion = motion_of(1000 * seed + number, duration, rate)
        torque = torque_of(setup, motion, carried[-1], coefficients)
        torque = torque + NOISE * torque.std(axis=0) * rng.normal(size=torque.shape)
        time = np.arange(len(torque)) / rate
        name = f"run_{number}"
        records.append(JointRecord(setup.robot.joint_names, time, motion[0], motion[1], torque, Path(name), name))
    bandwidths = Bandwidths.of(records)
    filtered = [filter_record(record, bandwidths) for record in records]
    bodies = [body for body, pieces in zip(carried, filtered, strict=True) for _ in pieces]
    runs_of = [piece for pieces in filtered for piece in pieces]
    return ExcitationProblem.of(RigidArm.from_setup(setup), runs_of, payloads=bodies)


def coefficients_of(seed: int) -> Array:
    """Return coefficients of 2 to 12 % by element and direction, shape (7, 2)."""
    return np.random.default_rng((seed, 7)).uniform(0.02, 0.12, (7, 2))


@dataclass(frozen=True, eq=False)
class Outcome:
    """One arm: what is true, shape (7, 2), and what was found."""

    true: Array
    found: LoadParts


def outcome(robot: str, seed: int, *, there: bool) -> Outcome:
    """Return what is found on a seeded arm with load parts on all elements, or on none."""
    true = coefficients_of(seed) if there else np.zeros((7, 2))
    return Outcome(true, identify_load_parts(problem_of(robot, seed, true), ()))


def report(robot: str, with_parts: Sequence[Outcome], without: Sequence[Outcome]) -> list[str]:
    """Return lines with what was found, by element."""
    lines = [f"{robot}: element, load RMS Nm, found, median and largest error, within 5 %, in their 95 % interval"]
    for e in range(7):
        have = [one for one in with_parts if e in one.found.kept]
        errors = np.array([one.found.value[e] - one.true[e] for one in have]).reshape(-1, 2)
        share = np.abs(errors / np.array([one.true[e] for one in have]).reshape(-1, 2))
        inside = np.abs(errors) <= 1.96 * np.array([one.found.deviation[e] for one in have]).reshape(-1, 2)
        size = np.mean([one.found.transmitted[e] for one in with_parts])
        if have:
            lines.append(
                f"{e + 1:>3} {size:8.2f} {len(have):>4} of {len(with_parts)} {np.median(share):8.1%} "
                f"{share.max():8.1%} {np.mean(share <= _WITHIN):6.0%} {np.mean(inside):6.0%}"
            )
        else:
            lines.append(f"{e + 1:>3} {size:8.2f}    0 of {len(with_parts)}")
    false = sum(len(one.found.kept) for one in without)
    return [*lines, f"    without load parts: {false} found of {7 * len(without)}"]


def main() -> int:
    """Print the tables."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--arms", type=int, default=10, help="of each kind (%(default)s)")
    arms = parser.parse_args().arms
    for robot in MASS:
        found = [[outcome(robot, seed, there=there) for seed in range(arms)] for there in (True, False)]
        print("\n".join(report(robot, *found)), flush=True)
    return 0


if __name__ == "__main__":
    sys.exit(main())
