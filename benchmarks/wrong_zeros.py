"""How often are right encoder zeros called wrong, and how large must an error be to be found?

    python -m benchmarks.wrong_zeros [arms] [--largest 4] [--first 0]

Random arms of 2 to 4 joints, and both searches. That of excitation runs knows the kinematics alone and gets two runs of
24 s; that of sweeps also knows the URDF's inertials, which are 10 % off, and gets each joint at four poses and seven
speeds in both directions. Both get noise alone; torque ripple of 2 % and Coulomb friction that grows by 5 % with the
load; and also a payload of a fifth of the arm's mass that no file tells of, in all sweeps, but in one of the two runs
alone: in both it would be part of the last link. Then one joint that the torques tell has a wrong zero. Merges the
figures into out/bench.json.
"""

from __future__ import annotations

import sys
import tempfile
from collections import defaultdict
from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pinocchio as pin
from tqdm import tqdm

from benchmarks.excitation_coverage import Case
from benchmarks.excitation_runs import MISFIT, NOISE, Disturbances, measured
from benchmarks.random_arms import Link, SyntheticArm, random_arm
from benchmarks.report import arguments, merge, print_table
from rx90_common.base.arrays import Array
from rx90_emulator.identification.arm import RigidArm
from rx90_emulator.identification.excitation.checks import check_zeros as check_runs
from rx90_emulator.identification.excitation.problem import ExcitationProblem
from rx90_emulator.identification.zeros import Instants, ZeroCheck
from rx90_emulator.identification.zeros import check_zeros as check_sweeps

ERRORS = {"2 hundredths": 0.02, "5 hundredths": 0.05, "a tenth": 0.1, "a quarter turn": 0.5 * np.pi}
"""Of one joint's zero, rad."""
CONDITIONS = {"noise": (NOISE, 0.0), "misfit": (MISFIT, 0.0), "payload": (MISFIT, 0.2)}
"""Disturbances, and a payload in parts of the arm's mass."""
RATE = 250.0
POSES, SPEEDS, EACH = 4, np.geomspace(0.01, 1.0, 7), 4
COMMON = 0.01
"""Error that all samples of a sweep have in common, in parts of the joint's torque."""


def with_payload(arm: SyntheticArm, share: float) -> SyntheticArm:
    """Return an arm that carries a ball of `share` of its mass, 0.1 m before the last link's centre."""
    if not share:
        return arm
    last = arm.links[-1]
    mass = share * sum(link.mass for link in arm.links)
    ball = pin.Inertia(mass, last.center + np.array([0.0, 0.0, 0.1]), 0.4 * mass * 0.05**2 * np.eye(3))
    both = pin.Inertia(last.mass, last.center, last.inertia) + ball
    loaded = Link(last.xyz, last.rpy, both.mass, np.array(both.lever), np.array(both.inertia))
    return replace(arm, links=(*arm.links[:-1], loaded))


def excitation(seed: int, arm: SyntheticArm, disturbances: Disturbances, payload: float) -> ExcitationProblem:
    """Return the equations of two runs; the second one carries the payload."""
    case = Case.of(arm, disturbances, RATE, 1, seed)
    number = 1000 * seed + 1
    loaded = measured(with_payload(arm, payload), case.motion(number), RATE, number, disturbances)
    return case.problem([case.run(0), loaded])


def turned(problem: ExcitationProblem, error: Array) -> ExcitationProblem:
    """Return the equations with encoders that say so much more, rad, shape (n,)."""
    runs = [replace(run, position=run.position + error) for run in problem.runs]
    return ExcitationProblem.of(problem.arm, runs)


def sweeps(seed: int, arm: SyntheticArm, disturbances: Disturbances) -> Instants:
    """Return plateaus of constant velocity of one joint after the other, the others at rest."""
    rng, n = np.random.default_rng((seed, 50)), len(arm.links)
    position, velocity, block = [], [], []
    for joint in range(n):
        for pose in rng.uniform(-1.5, 1.5, (POSES, n)):
            for speed in np.append(SPEEDS, -SPEEDS):
                one = np.eye(n)[joint] * speed
                way = min(1.0, 0.6 / abs(speed)) * np.linspace(-0.5, 0.5, EACH)[:, None]
                position.append(pose + way * one)
                velocity.append(np.tile(one, (EACH, 1)))
                block += [len(position)] * EACH
    q, v = np.concatenate(position), np.concatenate(velocity)
    bare = arm.frictionless(q, v, np.zeros_like(q))
    inputs = v @ arm.element_matrix.T
    size = np.append(arm.torque, arm.torque[-1])[: len(arm.friction)]
    load = disturbances.load * np.abs(np.column_stack([bare, bare[:, -1]])[:, : len(size)]) / size
    laws = enumerate(arm.friction)
    friction = np.column_stack([law.steady(inputs[:, k], load[:, k]) for k, law in laws])
    # The motor's torque ripple; at rest nobody knows what an element carries, and such joints do not count.
    angle = q @ arm.coupling.T * arm.gear
    noise = (
        disturbances.white * rng.normal(size=q.shape)
        + COMMON * rng.normal(size=(len(position), n))[np.array(block) - 1]
    )
    ripple = disturbances.ripple * np.sin(angle + rng.uniform(0.0, 6.0, n))
    torque = bare + friction @ arm.element_matrix + arm.torque * (noise + ripple)
    return Instants(q, v, np.zeros_like(q), torque, inputs != 0.0, np.array(block))


def described(arm: SyntheticArm, seed: int) -> RigidArm:
    """Return the arm by a URDF whose masses and inertias are 10 % off."""
    with tempfile.TemporaryDirectory() as folder:
        urdf = Path(folder) / "arm.urdf"
        urdf.write_text(arm.urdf(wrong=0.1, seed=seed), encoding="utf-8")
        return RigidArm.from_urdf(urdf, coupling=arm.coupling, rotor_inertia=arm.rotor, spring=arm.spring)


def searches(seed: int, largest: int) -> Iterator[tuple[str, str, Array, ZeroCheck]]:
    """Yield search, condition, true errors, and what was found, for one arm."""
    rng = np.random.default_rng((seed, 60))
    arm = random_arm(seed, int(rng.integers(2, largest + 1)))
    rigid = described(arm, seed)
    for condition, (disturbances, payload) in CONDITIONS.items():
        problem = excitation(seed, arm, disturbances, payload)
        instants = sweeps(seed, with_payload(arm, payload), disturbances)

        def of_run(error: Array, problem: ExcitationProblem = problem) -> ZeroCheck:
            return check_runs(turned(problem, error))

        def of_sweeps(error: Array, instants: Instants = instants) -> ZeroCheck:
            return check_sweeps(replace(instants, position=instants.position + error), rigid)

        for name, search in (("excitation", of_run), ("sweeps", of_sweeps)):
            none = np.zeros(len(arm.links))
            first = search(none)
            yield name, condition, none, first
            if not first.identifiable.any():
                continue
            same = np.random.default_rng((seed, 70))  # one joint for all conditions, as far as they tell the same
            axis = np.eye(len(arm.links))[same.choice(np.flatnonzero(first.identifiable))] * same.choice([-1.0, 1.0])
            for size in ERRORS.values():
                yield name, condition, size * axis, search(size * axis)


def right(error: Array, found: Array) -> bool:
    """Return whether the wrong joint and no other one is named, with an error that is right within a third."""
    away = np.abs(np.angle(np.exp(1j * (found - error))))
    return bool(((found != 0.0) == (error != 0.0)).all() and away.max() < max(0.02, np.abs(error).max() / 3.0))


def main() -> int:
    """Print the shares and merge them."""
    options = arguments(
        __doc__, ("arms", 40, "how many"), ("--first", 0, "seed of the first"), ("--largest", 4, "joints at most")
    )
    tally: dict[tuple[str, str, float], list[tuple[bool, bool]]] = defaultdict(list)
    for seed in tqdm(range(options.first, options.first + options.arms), unit="arm"):
        for name, condition, error, check in searches(seed, options.largest):
            size = float(np.abs(error).max())
            tally[name, condition, size].append((bool(check.text), right(error, check.error)))
            if check.text and not size:
                tqdm.write(f"false alarm, {name}, {condition}, seed {seed}: {check.text}")
    for name in ("excitation", "sweeps"):
        report(name, tally)
    return 0


def report(name: str, tally: dict[tuple[str, str, float], list[tuple[bool, bool]]]) -> None:
    """Print and merge the shares of one search."""
    rows: list[Sequence[str]] = []
    for condition in CONDITIONS:
        alarms = [said for said, _ in tally[name, condition, 0.0]]
        cells = [f"{sum(alarms)} of {len(alarms)}"]
        merge({f"zeros_{name}_{condition}_false": float(np.mean(alarms))})
        for label, size in ERRORS.items():
            both = np.array(tally[name, condition, size])
            cells.append(f"{np.mean(both[:, 0]):.0%} ({np.mean(both[:, 1]):.0%})")
            merge({f"zeros_{name}_{condition}_{label.replace(' ', '_')}": float(np.mean(both[:, 0]))})
        rows.append((condition, *cells))
    print_table((f"{name}: alarms", "right zeros", *ERRORS), rows)
    print("in brackets: the wrong joint and no other is named, its error right within a third")


if __name__ == "__main__":
    sys.exit(main())
