"""How often the presliding experiments tell which kind of bristles an element has, and how often they are wrong.

    python -m benchmarks.bristle_kinds [sets]

Random friction sets (every parameter of every element scaled by 0.5 to 1.5) with bristles of each kind in turn, the
presliding experiments of joints 1 and 2 on the engine, torques with the friction rig's noise, and the sliding regime
given with errors as it is identified. Wrists the same, their three elements with kinds of their own each. How far the
numbers of bristles are off in their deviations is counted, too.
"""

from __future__ import annotations

import sys
from collections import Counter, defaultdict
from collections.abc import Sequence
from dataclasses import replace
from itertools import product

import numpy as np
from tqdm import tqdm

from benchmarks.report import arguments, print_table
from benchmarks.synthetic_sweeps import Noise, measured_sliding, random_bristles, recorded, run_presliding
from rx90_common.friction.parts.bristles import BristlesPart, ElastoPlastic, MaxwellSlip
from rx90_emulator.identification.arm import RigidArm
from rx90_emulator.identification.experiments.plan import PlanOptions
from rx90_emulator.identification.presliding.fit import identify_presliding
from rx90_emulator.identification.presliding.kinds import ElementKind, choose_kinds
from rx90_emulator.loop.setup import Setup

SETS = 3
WRISTS = 1
"""Sets of three wrists: one takes more than a minute."""
JOINTS = ("joint_1", "joint_2")
WRIST = ("joint_5", "joint_6", "joints_5_6_against")
KINDS = ("LuGre", "elasto-plastic", "Maxwell slip")
ANSWERS = (*KINDS, "cannot tell", "not compared")
TWO = 2.0
"""Deviations, within which 95 % of the errors should be."""


def random_kind(name: str, rng: np.random.Generator) -> BristlesPart | None:
    """Return bristles of a kind with random numbers."""
    if name == "elasto-plastic":
        return ElastoPlastic(rng.uniform(0.4, 0.8))
    if name == "Maxwell slip":
        stiffness, share = rng.dirichlet(np.full(3, 4.0), 2)
        return MaxwellSlip(tuple(sorted(stiffness, reverse=True)), tuple(sorted(share)), 5000.0)
    return None


def found_kinds(
    setup: Setup, arm: RigidArm, groups: Sequence[str], kinds: Sequence[str], seed: int
) -> list[tuple[ElementKind, dict[str, float]]]:
    """Return what is found for each element that moves, and the true values of its numbers.

    Args:
        setup: of the shipped robot.
        arm: its.
        groups: directions of the experiments.
        kinds: of the bristles of all seven elements.
        seed: of friction and noise.
    """
    rng = np.random.default_rng((seed, *(KINDS.index(name) for name in kinds)))
    friction = random_bristles(setup.friction, rng)
    pairs = zip(friction.elements, kinds, strict=True)
    elements = tuple(replace(element, bristles=random_kind(name, rng)) for element, name in pairs)
    truth = replace(setup, friction=replace(friction, elements=elements))
    runs = run_presliding(truth, PlanOptions(groups=tuple(groups)))
    records = [recorded(setup, run, rng, Noise(Noise.torque)) for run in runs]
    known = measured_sliding([element.without_parts() for element in elements], rng)
    fit = identify_presliding(records, arm, known, plant_period=setup.rates.period)
    moved = {e for group in fit.groups for e in group.elements}
    found = []
    for e, (kind, element) in enumerate(zip(choose_kinds(fit, arm), elements, strict=True)):
        if e in moved and (e < len(JOINTS)) == (groups is JOINTS):
            numbers = {} if element.bristles is None else element.bristles.numbers()
            true = {"c0": element.c0, "c1": element.c1, **{f"bristles.{key}": each for key, each in numbers.items()}}
            found.append((kind, true))
    return found


def within(kind: ElementKind, true: dict[str, float]) -> list[tuple[str, bool]]:
    """Return which numbers of bristles lie within two deviations of the truth; none where LuGre's stay."""
    if kind.trial is None:
        return []
    known = {name: one for name, one in kind.trial.estimates.items() if one.identifiable}
    if not set(known) <= set(true):  # another number of blocks
        known = {name: one for name, one in known.items() if "." not in name}
    return [(name, abs(one.value - true[name]) <= TWO * one.deviation) for name, one in known.items()]


def main() -> int:
    """Print the figures."""
    sets = arguments(__doc__, ("sets", SETS, "random sets of joints 1 and 2")).sets
    setup = Setup.load()
    arm = RigidArm.from_setup(setup)
    counts: dict[tuple[str, str], Counter[str]] = defaultdict(Counter)
    held: dict[str, list[bool]] = defaultdict(list)
    robots = [*product(("joints",), range(1, sets + 1), KINDS), *product(("wrist",), range(1, WRISTS + 1), KINDS)]
    with tqdm(total=len(robots), file=sys.stderr) as bar:
        for where, seed, first in robots:
            # Each element of a wrist has another kind.
            shift = seed if where == "wrist" else 0
            kinds = [KINDS[(KINDS.index(first) + shift * e) % len(KINDS)] for e in range(len(arm.element_names))]
            groups = JOINTS if where == "joints" else WRIST
            for kind, true in found_kinds(setup, arm, groups, kinds, seed):
                name = kinds[arm.element_names.index(kind.element)]
                best = kind.best.family.name if kind.trials else ""
                counts[where, name].update([kind.decision, "best"] if best.startswith(name) else [kind.decision])
                if kind.decision == name:
                    for number, good in within(kind, true):
                        held[number.partition("[")[0]].append(good)
                bar.write(f"set {seed}, {kind.element}, {name}: {kind.text}; predicts best: {best or 'none'}")
            bar.update()
    shown = (*ANSWERS, "best")
    rows = [(f"{name}, {where}", *(f"{count[key]}" for key in shown)) for (where, name), count in counts.items()]
    print_table(("bristles", *ANSWERS, "right one best"), rows)
    print_table(
        ("number", "within two deviations"), [(name, f"{sum(good)} of {len(good)}") for name, good in held.items()]
    )
    return 0


if __name__ == "__main__":
    sys.exit(main())
