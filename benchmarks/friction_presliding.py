"""Does the bench tell laws of friction apart? Whole measurements of random rigs with the real firmware.

    python -m benchmarks.friction_presliding [--rigs 8] [--seed 1] [--cycles 10000]

For each of five kinds of joints so many rigs with friction, presliding and damping of their own are measured as
`friction_presliding` does it, with ramps, loops, a sweep and small cycles. Prints what loops and sliding alone, the
drift alone, and both decided, and how often that was wrong. Merges the figures into out/bench.json. The exit code is 1
when a decision is wrong more often than is accepted.
"""

from __future__ import annotations

import argparse
import math
import sys
from dataclasses import replace

import numpy as np
from tqdm import tqdm

from benchmarks.report import merge, print_table
from friction_bench.presliding.campaign import Campaign
from friction_bench.presliding.drift import DriftVerdict
from friction_bench.presliding.evaluation import PreslidingResult, evaluate
from friction_bench.presliding.follow import follow
from friction_bench.presliding.planning import CampaignPlan, runs
from friction_bench.rig.client import RigClient
from friction_bench.rig.emulated import EmulatedRig, VirtualPort
from friction_bench.rig.plant import JointFriction
from friction_bench.rig.rig_file import Rig, load_rig
from rx90_common.base.share import PRESLIDING_RIG, config_path
from rx90_common.friction.element import FrictionElement
from rx90_common.friction.parts.bristles import ElastoPlastic, MaxwellSlip

KINDS = ("Coulomb and viscous", "Stribeck", "LuGre", "elasto-plastic", "Maxwell slip")
ACCEPTED = 0.05
"""Share of wrong decisions; 'cannot tell' is none."""
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
    campaign = Campaign()
    plan = CampaignPlan(rig, ("loops", "sweep", "drift"), 10, cycles)
    for what in runs(plan, campaign, hello.torque_limit_code):
        campaign.add(what, follow(client, what.law, what.label))
    return evaluate(campaign, rig)


def _right(kind: str, text: str) -> str:
    """Return 'right', 'wrong' or 'cannot tell' for a verdict in words."""
    if text.startswith("cannot tell"):
        return "cannot tell"
    return "right" if text.removesuffix(", by its drift") == kind else "wrong"


def _drift_right(kind: str, verdict: DriftVerdict) -> str:
    if verdict is DriftVerdict.UNKNOWN:
        return "right" if kind == "Coulomb and viscous" else "cannot tell"
    expected = DriftVerdict.DRIFTS if kind in ("LuGre", "Stribeck") else DriftVerdict.STAYS
    return "right" if verdict is expected else "wrong"


def main() -> int:
    """Measure all rigs and print what was decided."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--rigs", type=int, default=8, help="of each kind (default: %(default)s)")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--cycles", type=int, default=10_000)
    options = parser.parse_args()
    methods = ("loops and sliding", "drift", "both")
    counted = {
        (kind, method): dict.fromkeys(("right", "cannot tell", "wrong"), 0) for kind in KINDS for method in methods
    }
    for number, kind in tqdm([(n, kind) for n in range(options.rigs) for kind in KINDS], disable=None):
        result = measured(random_rig(options.seed, number, kind), number, options.cycles)
        assert result.choice is not None
        left = result.choice.by_loops
        loops = left[0] if len(left) == 1 else "cannot tell"
        assert result.drift is not None
        for method, verdict in (
            ("loops and sliding", _right(kind, loops)),
            ("drift", _drift_right(kind, result.drift.verdict)),
            ("both", _right(kind, result.choice.text)),
        ):
            counted[kind, method][verdict] += 1
            if verdict == "wrong":
                what = result.drift.verdict.value if method == "drift" else f"{loops}; {result.choice.text}"
                tqdm.write(f"rig {number}, {kind}, {method}: {what} ({result.drift.reason})")
    rows = [(kind, *(" / ".join(map(str, counted[kind, method].values())) for method in methods)) for kind in KINDS]
    print_table(("joint", *(f"{method}: right / cannot tell / wrong" for method in methods)), rows)
    total = options.rigs * len(KINDS)
    wrong = {method: sum(counted[kind, method]["wrong"] for kind in KINDS) / total for method in methods}
    print(", ".join(f"{method}: {100 * share:.1f} % wrong" for method, share in wrong.items()), f"of {total} rigs")
    keys = ("loops", "drift", "both")
    shares = {f"presliding_wrong_{key}": share for key, share in zip(keys, wrong.values(), strict=True)}
    merge({"presliding_rigs": float(total), **shares})
    return int(max(wrong.values()) > ACCEPTED)


if __name__ == "__main__":
    sys.exit(main())
