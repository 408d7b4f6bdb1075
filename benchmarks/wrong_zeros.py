"""How often are right encoder zeros called wrong, and how often is a quarter turn found?

    python -m benchmarks.wrong_zeros [arms] [--first 0]

Random arms of 3 and 4 joints: two excitation runs of 24 s, and sweeps of each joint at four poses and seven speeds in
both directions, with noise alone, and with torque ripple of 2 % and Coulomb friction that grows by 5 % with the load.
Then a joint between the first and the last, whose zeros may change no torque, is a quarter turn off. Merges the figures
into out/bench.json.
"""

from __future__ import annotations

import sys
from collections import defaultdict
from dataclasses import replace

import numpy as np
from tqdm import tqdm

from benchmarks.excitation_coverage import Case
from benchmarks.excitation_runs import MISFIT, NOISE, Disturbances
from benchmarks.random_arms import SyntheticArm, random_arm
from benchmarks.report import arguments, merge, print_table
from rx90_emulator.identification.sanity import Recorded, find_mistakes

CONDITIONS = {"noise": NOISE, "misfit": MISFIT}
RATE = 250.0
POSES, SPEEDS, EACH = 4, np.geomspace(0.01, 1.0, 7), 4
COMMON = 0.01
"""Error that all samples of a sweep have in common, in parts of the joint's torque."""


def sweeps(seed: int, arm: SyntheticArm, disturbances: Disturbances) -> Recorded:
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
    used = ~((inputs == 0.0) @ (arm.element_matrix != 0.0))
    return Recorded(np.stack([q, v, np.zeros_like(q)]), torque[None], used, np.array(block))


def main() -> int:
    """Print the shares and merge them."""
    options = arguments(__doc__, ("arms", 40, "how many"), ("--first", 0, "seed of the first"))
    alarms: dict[str, list[bool]] = defaultdict(list)
    found: dict[str, list[bool]] = defaultdict(list)
    for seed in tqdm(range(options.first, options.first + options.arms), unit="arm"):
        rng = np.random.default_rng((seed, 60))
        arm = random_arm(seed, int(rng.integers(3, 5)))
        joint, turn = int(rng.integers(1, len(arm.links) - 1)), rng.choice([-0.5, 0.5]) * np.pi
        for condition, disturbances in CONDITIONS.items():
            case = Case.of(arm, disturbances, RATE, 1, seed)
            runs = Recorded.of([case.run(0).record(arm), case.run(1).record(arm)], case.rigid)
            for name, recorded in (
                ("excitation", runs),
                ("sweeps", sweeps(seed, arm, disturbances)),
            ):
                key = f"zeros_{name}_{condition}"
                alarms[key].append(bool(find_mistakes(case.rigid, recorded)[0]))
                motion = recorded.motion.copy()
                motion[0, :, joint] += turn
                mistakes, _ = find_mistakes(case.rigid, replace(recorded, motion=motion))
                found[key].append(
                    [(mistake.quantity, mistake.motors) for mistake in mistakes]
                    == [("zero", (joint,))]
                )
    rows = [(key, f"{np.mean(alarms[key]):.0%}", f"{np.mean(found[key]):.0%}") for key in alarms]
    print_table(("recording", "alarms with right zeros", "quarter turns named"), rows)
    merge({f"{key}_false": float(np.mean(said)) for key, said in alarms.items()})
    merge({f"{key}_a_quarter_turn": float(np.mean(said)) for key, said in found.items()})
    return 0


if __name__ == "__main__":
    sys.exit(main())
