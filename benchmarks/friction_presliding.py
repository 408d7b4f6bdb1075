"""Does the bench tell laws of friction apart? Whole measurements of random rigs with the real firmware.

    python -m benchmarks.friction_presliding [--rigs 8] [--seed 1] [--cycles 10000]

For each of five kinds of joints so many rigs with friction, presliding and damping of their own are measured as
`friction_presliding` does it, with ramps, loops, a sweep and small cycles. Prints what loops and sliding alone, the
drift alone, and both decided, and how often that was wrong. The exit code is 1 when a decision is wrong more often than
is accepted. Ctrl-C leaves the verdicts on the rigs that were measured.
"""

from __future__ import annotations

import math
import sys
from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np
from scipy.stats import binomtest

from benchmarks.report import arguments, in_processes, print_table
from friction_bench.presliding import USUAL_CYCLES
from friction_bench.presliding.job import Campaign
from friction_bench.presliding.motions import follow
from friction_bench.presliding.report import PreslidingResult
from friction_bench.presliding.sliding import DriftVerdict
from friction_bench.rig.client import RigClient
from friction_bench.rig.emulated import EmulatedRig, VirtualPort, native_library
from friction_bench.rig.rig_file import JointFriction, Rig, load_rig
from rx90_common.base.errors import INTERRUPTED
from rx90_common.base.share import PRESLIDING_RIG, config_path
from rx90_common.friction.element import FrictionElement
from rx90_common.friction.parts.bristles import ElastoPlastic, MaxwellSlip

KINDS = ("Coulomb and viscous", "Stribeck", "LuGre", "elasto-plastic", "Maxwell slip")
ACCEPTED = 0.05
"""Share of wrong decisions; 'cannot tell' is none."""
METHODS = ("loops and sliding", "drift", "both")
VERDICTS = ("right", "cannot tell", "wrong")
CONFIDENCE = 0.95
STIFF = 1e-6
"""Presliding of a joint whose loops cannot be seen, rad: a twentieth of a count. Its law is LuGre's all the same."""


def random_rig(seed: int, number: int, kind: str) -> Rig:
    """Return the shipped rig with a joint of this kind, drawn at random."""
    rig = load_rig(config_path(PRESLIDING_RIG))
    assert rig.plant is not None
    rng = np.random.default_rng((seed, number, KINDS.index(kind)))
    coulomb, rise = rng.uniform(1.2, 2.4), rng.uniform(1.1, 1.4)
    viscous, slope = rng.uniform(0.3, 1.5), rng.uniform(2.0, 6.0)
    if kind == "Coulomb and viscous":
        return replace(rig, plant=replace(rig.plant, joint=JointFriction(coulomb, viscous)))
    static = coulomb * rise
    presliding = STIFF if kind == "Stribeck" else math.exp(rng.uniform(math.log(1.5e-4), math.log(1e-3)))
    stiffness = coulomb / presliding
    inertia = rig.plant.load_inertia + rig.plant.joint_inertia
    damping = 2.0 * rng.uniform(0.5, 0.9) * math.sqrt(stiffness * inertia)
    joint = FrictionElement(
        coulomb, coulomb, static, static, (static - coulomb) / slope, 1.0, stiffness, damping, viscous, 0.02
    )
    if kind == "elasto-plastic":
        joint = replace(joint, bristles=ElastoPlastic(float(rng.uniform(0.4, 0.8))))
    if kind == "Maxwell slip":
        count = int(rng.integers(4, 9))
        reach = np.geomspace(0.2, 3.0, count) * np.exp(rng.normal(0.0, 0.1, count))
        springs = rng.dirichlet(np.full(count, 4.0))
        share = springs * reach / float(springs @ reach)
        joint = replace(joint, bristles=MaxwellSlip(tuple(springs.tolist()), tuple(share.tolist()), 30.0))
    return replace(rig, plant=replace(rig.plant, joint=joint))


def measured(rig: Rig, seed: int, cycles: int) -> PreslidingResult:
    """Return the result of a whole measurement."""
    emulated = EmulatedRig(rig, seed)
    emulated.plant.load(True)
    client = RigClient(VirtualPort(emulated), rig)
    hello = client.connect()
    campaign = Campaign(rig, ("loops", "sweep", "drift"), cycles=cycles)
    for what in campaign.runs(hello.torque_limit_code):
        campaign.done.append((what, follow(client, what.profile, what.label)))
    return campaign.evaluate()


def _right(kind: str, text: str) -> str:
    """Return 'right', 'wrong' or 'cannot tell' for a verdict in words."""
    if text.startswith("cannot tell"):
        return "cannot tell"
    return "right" if text.removesuffix(", by its drift") == kind else "wrong"


def _drift_right(kind: str, verdict: DriftVerdict) -> str:
    if verdict is DriftVerdict.UNKNOWN:
        return "right" if kind == "Coulomb and viscous" else "cannot tell"
    expected = DriftVerdict.DRIFTS if kind in ("LuGre", "Stribeck") else DriftVerdict.NO_DRIFT
    return "right" if verdict is expected else "wrong"


def decided(kind: str, result: PreslidingResult) -> dict[str, str]:
    """Return what became of each of METHODS, and what was found, in words."""
    assert result.choice is not None
    assert result.drift is not None
    left = [law.name for law in result.choice.by_loops]
    return {
        "loops and sliding": _right(kind, left[0] if len(left) == 1 else "cannot tell"),
        "drift": _drift_right(kind, result.drift.verdict),
        "both": _right(kind, result.choice.text),
        "found": f"{result.choice.text}; loops and sliding: {' or '.join(left)}; drift: {result.drift.reason}",
    }


def job(arguments: tuple[int, int, str, int]) -> dict[str, str]:
    """Measure a rig by its seed, number and kind with so many cycles; return what was decided about it."""
    seed, number, kind, cycles = arguments
    result = measured(random_rig(seed, number, kind), number, cycles)
    return {"rig": str(number), "joint": kind, **decided(kind, result)}


def count(rows: Sequence[Mapping[str, str]]) -> dict[str, float]:
    """Print what became of rigs, and return which share of them each of METHODS decided wrongly."""
    table = []
    for kind in KINDS:
        verdicts = {method: [row[method] for row in rows if row["joint"] == kind] for method in METHODS}
        table.append((kind, *(" / ".join(str(verdicts[m].count(one)) for one in VERDICTS) for m in METHODS)))
    print_table(("joint", *(f"{method}: {' / '.join(VERDICTS)}" for method in METHODS)), table)
    shares = {}
    for method in METHODS:
        wrong = [row for row in rows if row[method] == "wrong"]
        test = binomtest(len(wrong), len(rows), alternative="less")
        shares[method], most = len(wrong) / len(rows), 100.0 * test.proportion_ci(CONFIDENCE).high
        print(f"{method}: {len(wrong)} of {len(rows)} wrong; below {most:.1f} % with {100 * CONFIDENCE:g} % confidence")
        for row in wrong:
            print(f"  rig {row['rig']}, {row['joint']}: {row['found']}")
    return shares


def main() -> int:
    """Measure all rigs and print what was decided."""
    options = arguments(
        __doc__, ("--rigs", 8, "of each kind"), ("--seed", 1, "of all rigs"), ("--cycles", USUAL_CYCLES, "small ones")
    )
    native_library()  # built once, before several processes want it
    jobs = [(options.seed, number, kind, options.cycles) for number in range(options.rigs) for kind in KINDS]
    rows = [*in_processes(job, jobs, "rigs").values()]
    shares = count(rows) if rows else {}
    return INTERRUPTED if len(rows) < len(jobs) else int(max(shares.values()) > ACCEPTED)


if __name__ == "__main__":
    sys.exit(main())
