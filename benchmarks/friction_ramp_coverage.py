"""Do the ramp test's 95 % intervals hold? Whole measurements of random rigs, Coulomb-viscous and LuGre joints.

    python -m benchmarks.friction_ramp_coverage [--rigs 200] [--seed 1]

Each rig has friction, inertia and noise of its own and is measured as `friction_ramp` does it: without and with the
joint, ramps planned from the first one. Prints how often the intervals hold the truth, what the source's formula
f_c = m b / a gives on the same ramps, and every refusal. Merges the figures into out/bench.json. The exit code is 1
when a figure is not what is accepted.
"""

from __future__ import annotations

import argparse
import math
import os
import sys
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, field, replace
from functools import cache
from multiprocessing import get_context

import numpy as np
from numpy.typing import NDArray
from tqdm import tqdm

from benchmarks.quick_ramps import QuickRig
from benchmarks.report import merge, print_table
from friction_bench.experiment.identification import IntervalEstimate, RampFriction, evaluate
from friction_bench.experiment.ramp import plan_from, run_planned
from friction_bench.experiment.record import RampRecord
from friction_bench.rig.plant import shaft_of
from friction_bench.rig.rig_file import JointFriction, Rig, load_rig
from rx90_common.base.errors import Rx90Error
from rx90_common.base.share import config_path
from rx90_common.friction.element import FrictionElement

KINDS = ("Coulomb-viscous", "LuGre")
HEAVIEST = 0.11
"""Break-away torque of the heaviest rigs, Nm: the ramps end at 0.15 and 0.16 Nm."""
ACCEPTED = (0.90, 0.99)
Array = NDArray[np.float64]


@dataclass
class Outcome:
    """What one measurement gave: by name the relative error and whether the interval held; unused ramps; a refusal."""

    errors: dict[str, float] = field(default_factory=dict)
    hits: dict[str, bool] = field(default_factory=dict)
    unused: int = 0
    refusal: str = ""


@cache
def _shipped() -> Rig:
    return load_rig(config_path("rig/gm8224.yaml"))


def random_rig(seed: int, number: int, kind: str) -> Rig:
    """Return the shipped rig with random friction and inertia; equal numbers share all but the joint's law."""
    rig = _shipped()
    assert rig.plant is not None
    rng = np.random.default_rng((seed, number))

    def between(low: float, high: float) -> float:
        return float(np.exp(rng.uniform(math.log(low), math.log(high))))

    ratio, torque = rig.gear_ratio, rig.gear_ratio * rig.gear_efficiency
    own, viscous = between(0.006, 0.05), between(4e-4, 1.2e-3)
    inertia, more = between(6e-6, 6e-5), between(1e-5, 2e-4)
    coulomb, slope = between(0.01, 0.05) * torque, viscous * between(0.1, 0.6) * torque * ratio
    rise = min(rng.uniform(1.05, 1.6), (HEAVIEST - own) * torque / coulomb)
    bristle, damping = between(2e-4, 1e-3), between(3e-4, 3e-3)
    stribeck, exponent = between(0.02, 0.2), rng.uniform(0.7, 2.0)
    joint: JointFriction | FrictionElement = JointFriction(coulomb, slope)
    if kind == "LuGre":
        static, stiffness = coulomb * max(rise, 1.0), coulomb / bristle
        torques = coulomb, coulomb, static, static
        joint = FrictionElement(*torques, stribeck, exponent, stiffness, damping * stiffness, slope, 1.0)
    plant = replace(
        rig.plant,
        coulomb=own,
        viscous=viscous,
        load_inertia=(inertia - rig.plant.rotor_inertia) * ratio * torque,
        joint_inertia=more * ratio * torque,
        joint=joint,
    )
    return replace(rig, plant=plant)


def measure(rig: Rig, seed: int) -> list[RampRecord]:
    """Return all ramps of a measurement as `friction_ramp` runs them."""
    quick = QuickRig(rig, seed)
    records: list[RampRecord] = []
    for loaded in (False, True):

        def one(slope: float, label: str, loaded: bool = loaded) -> RampRecord:
            records.append(quick.ramp(slope, rig.ramps.end(loaded), loaded, label))
            return records[-1]

        run_planned(one, rig.ramps, loaded, lambda first: plan_from(first, rig.ramps, rig))
    return records


def truth_of(rig: Rig, loaded: bool) -> Array:
    """Return the true f_c, f_v and J at the motor."""
    assert rig.plant is not None
    shaft = shaft_of(rig, loaded)
    values = np.array([shaft.coulomb, shaft.viscous, shaft.inertia])
    if loaded and isinstance(rig.plant.joint, FrictionElement):
        torque = rig.gear_ratio * rig.gear_efficiency
        values += rig.plant.joint.tau_c_positive / torque, rig.plant.joint.c2 / (torque * rig.gear_ratio), 0.0
    return values


def experiment(job: tuple[int, int, str]) -> Outcome:
    """Measure one random rig."""
    seed, number, kind = job
    rig = random_rig(seed, number, kind)
    outcome = Outcome()
    try:
        result = evaluate(measure(rig, 10_000 * seed + number), rig)
    except Rx90Error as error:
        outcome.refusal = str(error)
        return outcome

    def note(name: str, estimate: IntervalEstimate, truth: float) -> None:
        outcome.errors[name] = estimate.value / truth - 1.0
        outcome.hits[name] = estimate.low <= truth <= estimate.high

    def note_all(name: str, friction: RampFriction, truth: Array) -> None:
        estimates = (friction.coulomb, friction.viscous, friction.inertia)
        for quantity, estimate, value in zip(("f_c", "f_v", "J"), estimates, truth, strict=True):
            if estimate is not None:
                note(f"{quantity}, {name}", estimate, float(value))

    truths = {"no-load": truth_of(rig, False), "loaded": truth_of(rig, True)}
    for name, part in result.parts:
        outcome.unused += len(part.unused)
        note_all(name, part.best, truths[name])
        if part.source is not None:
            note_all(f"{name}, source's m b / a", part.source, truths[name])
    outcome.refusal = "; ".join(result.failures)
    if result.joint is not None:
        joint = truths["loaded"] - truths["no-load"]
        note("f_c, joint", result.joint.coulomb, float(joint[0]))
        note("f_v, joint", result.joint.viscous, float(joint[1]))
    return outcome


def main() -> int:
    """Print the figures and merge them; return 1 if one is not what is accepted."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--rigs", type=int, default=200, help="of each kind (default: %(default)s)")
    parser.add_argument("--seed", type=int, default=1, help="(default: %(default)s)")
    options = parser.parse_args()
    figures, wrong, rows = {}, [], []
    for kind in KINDS:
        jobs = [(options.seed, number, kind) for number in range(options.rigs)]
        # Not forked: numba and BLAS may hold threads already.
        with ProcessPoolExecutor(os.cpu_count(), get_context("spawn")) as pool:
            outcomes = list(tqdm(pool.map(experiment, jobs, chunksize=4), total=len(jobs), unit="rig", desc=kind))
        names = dict.fromkeys(name for outcome in outcomes for name in outcome.hits)
        for name in sorted(names, key=lambda name: ("source" in name, name)):
            hits = [outcome.hits[name] for outcome in outcomes if name in outcome.hits]
            errors = 100 * np.array([outcome.errors[name] for outcome in outcomes if name in outcome.errors])
            share = float(np.mean(hits))
            margin = 196 * math.sqrt(share * (1 - share) / len(hits))
            spread = float(np.percentile(np.abs(errors), 95))
            cover = f"{100 * share:.1f} ± {margin:.1f} %"
            rows.append((f"{kind}: {name}", str(len(hits)), f"{errors.mean():+.2f} %", f"{spread:.2f} %", cover))
            if "source" not in name:
                figures[f"friction_coverage_{kind}_{name.replace(', ', '_')}".replace("-", "_")] = share
                if not ACCEPTED[0] <= share <= ACCEPTED[1] + 0.01:
                    wrong.append(f"{kind}: {name}")
        refusals = [outcome.refusal for outcome in outcomes if outcome.refusal]
        figures[f"friction_refusals_{kind}".replace("-", "_")] = len(refusals)
        unused = sum(outcome.unused for outcome in outcomes)
        print(f"{kind}: {len(refusals)} of {options.rigs} rigs refused, {unused} ramps not used")
        print(*sorted(set(refusals)), sep="\n")
    print_table(("estimate", "rigs", "mean error", "95 % of errors below", "intervals that hold"), rows)
    merge(figures)
    for name in wrong:
        print(f"{name}: not what is accepted", file=sys.stderr)
    return 1 if wrong else 0


if __name__ == "__main__":
    sys.exit(main())
