"""How often the presliding experiments tell which kind of bristles a joint has, and how often they are wrong.

    python -m benchmarks.bristle_kinds [sets]

Random friction sets (every parameter of every element scaled by 0.5 to 1.5) with bristles of each kind in turn, the
presliding experiments of joints 1 and 2 on the engine, torques with the friction rig's noise, and the sliding regime
given with errors as it is identified. Merges the figures into out/bench.json.
"""

from __future__ import annotations

import sys
from collections import Counter
from dataclasses import replace
from itertools import product

import numpy as np
from tqdm import tqdm

from benchmarks.presliding_runs import measured_sliding, random_bristles, recorded, run_presliding
from benchmarks.report import merge, print_table
from benchmarks.synthetic_sweeps import Noise
from rx90_common.friction.parts.bristles import BristlesPart, ElastoPlastic, MaxwellSlip
from rx90_emulator.identification.experiments.plan import PlanOptions
from rx90_emulator.identification.model.rigid_arm import RigidArm
from rx90_emulator.identification.presliding.group_model import joint_groups
from rx90_emulator.identification.presliding.kinds import LEAST_MOTIONS, KindChoice, choose_kind
from rx90_emulator.identification.presliding.micro_motion import find_micro_motions, load_of
from rx90_emulator.loop.setup import Setup

SETS = 3
JOINTS = (0, 1)
KINDS = ("LuGre", "elasto-plastic", "Maxwell slip")


def random_kind(name: str, rng: np.random.Generator) -> BristlesPart | None:
    """Return bristles of a kind with random numbers."""
    if name == "elasto-plastic":
        return ElastoPlastic(rng.uniform(0.4, 0.8))
    if name == "Maxwell slip":
        stiffness, share = rng.dirichlet(np.full(3, 4.0), 2)
        return MaxwellSlip(tuple(sorted(stiffness, reverse=True)), tuple(sorted(share)), 5000.0)
    return None


def choices(setup: Setup, arm: RigidArm, name: str, seed: int) -> list[KindChoice | None]:
    """Return what is found for each of JOINTS; None where it made too few micro-motions."""
    rng = np.random.default_rng((seed, KINDS.index(name)))
    friction = random_bristles(setup.friction, rng)
    elements = tuple(replace(element, bristles=random_kind(name, rng)) for element in friction.elements)
    truth = replace(setup, friction=replace(friction, elements=elements))
    runs = run_presliding(truth, PlanOptions(groups=tuple(f"joint_{joint + 1}" for joint in JOINTS)))
    records = [recorded(setup, run, rng, Noise(Noise.torque)) for run in runs]
    known = measured_sliding([element.without_parts() for element in elements], rng)
    groups = [group.joints for group in joint_groups(arm)]
    found: list[KindChoice | None] = []
    for joint in JOINTS:
        motions = [m for r in records for m in find_micro_motions(r, arm, groups) if m.joints == (joint,)]
        largest = sorted(motions, key=lambda m: -load_of(m, np.array([known[joint].tau_c_positive])))
        enough = len(motions) >= LEAST_MOTIONS
        found.append(choose_kind(largest, known[joint], elements[joint].c0) if enough else None)
    return found


def main() -> int:
    """Print the figures and merge them."""
    sets = int(sys.argv[1]) if len(sys.argv) > 1 else SETS
    setup = Setup.load()
    arm = RigidArm.from_setup(setup)
    counts: dict[str, Counter[str]] = {name: Counter() for name in KINDS}
    with tqdm(total=sets * len(KINDS), file=sys.stderr) as bar:
        for seed, name in product(range(1, sets + 1), KINDS):
            for choice in choices(setup, arm, name, seed):
                found = "too few motions" if choice is None else choice.kind or "cannot tell"
                best = "" if choice is None else min(choice.trials, key=lambda t: t.behind).family.name
                counts[name].update([found, "best"] if best.startswith(name) else [found])
                bar.write(f"set {seed}, {name}: {found}; predicts best: {best or 'none'}")
            bar.update()
    shown = (*KINDS, "cannot tell", "too few motions", "best")
    rows = [(name, *(f"{counts[name][key]}" for key in shown)) for name in KINDS]
    right = sum(counts[name][name] for name in KINDS)
    wrong = sum(counts[name][key] for name, key in product(KINDS, KINDS)) - right
    print_table(("bristles", *KINDS, "cannot tell", "too few motions", "right one best"), rows)
    merge({"bristle_kinds_right": right, "bristle_kinds_wrong": wrong, "bristle_kinds_all": sets * len(KINDS) * 2})
    return 0


if __name__ == "__main__":
    sys.exit(main())
