"""Known friction in, known friction out: bias and coverage of the ramp test's estimates over a grid of rigs.

    python -m benchmarks.friction_ramp

Each experiment is a whole measurement on an emulated rig with the real firmware, in virtual time, with a noise of its
own. Prints bias and coverage of the 95 % intervals, and what the source's f_c is high by, and merges them into
out/bench.json. The exit code is 1 when a figure is not what is accepted.
"""

from __future__ import annotations

import math
import os
import sys
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, replace
from functools import cache
from itertools import product
from multiprocessing import get_context
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from tqdm import tqdm

from benchmarks.report import merge, print_table
from friction_bench.experiment.identification import identify_ramps
from friction_bench.experiment.ramp import run_ramp
from friction_bench.rig.client import RigClient
from friction_bench.rig.emulated import EmulatedRig, VirtualPort
from friction_bench.rig.native import native_library
from friction_bench.rig.rig_file import Rig, load_rig
from rx90_common.base.share import config_path

COULOMB = (0.012, 0.03, 0.06, 0.1)
VISCOUS = (5.5e-4, 7e-4, 1e-3)
INERTIA = (1.3e-5, 4e-5, 9e-5)
SLOPES = ((0.02, 0.05), (0.015, 0.03), (0.025, 0.06))
SEEDS = 12
REPEATS = 3
END_TORQUE = 0.178
TOP_SPEED = 230.0
LEAST_LENGTH = 14.0
"""Time constants that the faster ramp must last after break-away; shorter ones are refused by design."""
METHODS = ("exact", "repeated")
QUANTITIES = ("coulomb", "viscous")
COVERAGE = (0.90, 0.99)
BIAS = 0.01
Array = NDArray[np.float64]


@dataclass(frozen=True)
class Cell:
    """One rig of the grid, at the motor: f_c Nm, f_v Nm s/rad, J kg m², and two slopes, Nm/s."""

    coulomb: float
    viscous: float
    inertia: float
    slopes: tuple[float, float]

    @property
    def end_torque(self) -> float:
        """Return where the ramps end, Nm: below the firmware's limits of torque and speed."""
        return min(END_TORQUE, self.coulomb + self.viscous * TOP_SPEED)

    @property
    def long_enough(self) -> bool:
        """Return whether the faster ramp shows enough of its asymptote."""
        lasts = (self.end_torque - self.coulomb) / self.slopes[1]
        return lasts >= LEAST_LENGTH * self.inertia / self.viscous

    def rig(self) -> Rig:
        """Return the shipped rig with this friction and inertia, without a joint."""
        rig = _shipped()
        assert rig.plant is not None
        load = (self.inertia - rig.plant.rotor_inertia) * rig.gear_ratio**2 * rig.gear_efficiency
        return replace(rig, plant=replace(rig.plant, coulomb=self.coulomb, viscous=self.viscous, load_inertia=load))


class Outcome(NamedTuple):
    """What one experiment gave: by method and quantity the relative error and whether the interval held the truth."""

    errors: dict[tuple[str, str], float]
    hits: dict[tuple[str, str], bool]
    excess: float
    """The source's f_c less the truth, Nm."""
    inertia_times_a: float
    """J a, mean over the ramps, Nm."""


@cache
def _shipped() -> Rig:
    return load_rig(config_path("rig/gm8224.yaml"))


def grid() -> list[Cell]:
    """Return the cells whose ramps carry an estimate."""
    cells = [Cell(*figures) for figures in product(COULOMB, VISCOUS, INERTIA, SLOPES)]
    return [cell for cell in cells if cell.long_enough]


def experiment(job: tuple[Cell, int]) -> Outcome:
    """Measure one rig with one seed."""
    cell, seed = job
    rig = cell.rig()
    client = RigClient(VirtualPort(EmulatedRig(rig, seed)), rig)
    client.connect()
    records = [
        run_ramp(client, slope, cell.end_torque, False, f"{slope:g}") for _ in range(REPEATS) for slope in cell.slopes
    ]
    found = identify_ramps(records, rig.scale_uncertainty)
    errors, hits = {}, {}
    for method, quantity in product(METHODS, QUANTITIES):
        estimate = getattr(getattr(found, method), quantity)
        truth = getattr(cell, quantity)
        errors[method, quantity] = estimate.value / truth - 1.0
        hits[method, quantity] = estimate.low <= truth <= estimate.high
    assert found.source is not None  # `long_enough` sees to it
    expected = np.mean([cell.inertia * record.slope / cell.viscous for record in records])
    return Outcome(errors, hits, found.source.coulomb.value - cell.coulomb, float(expected))


def run(cells: Sequence[Cell], seeds: int) -> list[list[Outcome]]:
    """Return the outcomes of all cells, each with all seeds; progress and time left go to the terminal."""
    native_library()  # built once, before several processes want it
    jobs = [(cell, 1000 * number + seed) for number, cell in enumerate(cells) for seed in range(seeds)]
    # Not forked: numba and BLAS may hold threads already.
    with ProcessPoolExecutor(os.cpu_count(), get_context("spawn")) as pool:
        outcomes = list(tqdm(pool.map(experiment, jobs, chunksize=4), total=len(jobs), unit="experiment"))
    return [outcomes[k : k + seeds] for k in range(0, len(outcomes), seeds)]


def margin(share: float, count: int) -> float:
    """Return the 95 % margin of a share found in `count` independent trials."""
    return 1.96 * math.sqrt(share * (1.0 - share) / count)


def main() -> int:
    """Print the figures and merge them; return 1 if one is not what is accepted."""
    cells = grid()
    results = run(cells, SEEDS)
    count = len(cells) * SEEDS
    print(f"{count} experiments: {len(cells)} rigs, {SEEDS} seeds, {REPEATS} repeats at 2 slopes")
    rows, figures, wrong = [], {}, []
    for method, quantity in product(METHODS, QUANTITIES):
        bias = np.array([np.mean([o.errors[method, quantity] for o in cell]) for cell in results])
        share = float(np.mean([o.hits[method, quantity] for cell in results for o in cell]))
        worst = float(np.abs(bias).max())
        cover = f"{100 * share:.1f} ± {100 * margin(share, count):.1f} %"
        rows.append((f"{quantity}, {method}", f"{100 * bias.mean():+.3f} %", f"{100 * worst:.2f} %", cover))
        figures[f"friction_{method}_{quantity}_coverage"] = share
        figures[f"friction_{method}_{quantity}_worst_bias"] = worst
        if worst >= BIAS or not COVERAGE[0] <= share <= COVERAGE[1]:
            wrong.append(f"{quantity}, {method}")
    print_table(("estimate", "mean bias", "worst rig's bias (< 1 %)", "coverage (90 to 99 %)"), rows)
    ratio = np.array([np.mean([o.excess for o in c]) / np.mean([o.inertia_times_a for o in c]) for c in results])
    share = np.array([np.mean([o.inertia_times_a for o in c]) for c in results]) / [c.coulomb for c in cells]
    off = np.array([abs(r - 1.0) * s for r, s in zip(ratio, share, strict=True)])
    print(
        f"source's f_c = m b / a: high by J a, {100 * share.min():.1f} to {100 * share.max():.1f} % of f_c; "
        f"found {ratio.mean():.3f} of J a in the mean, at worst off by {100 * off.max():.2f} % of f_c (< 1 %)"
    )
    figures["friction_source_bias_over_J_a"] = float(ratio.mean())
    if off.max() >= BIAS:
        wrong.append("the source's bias")
    merge(figures)
    for name in wrong:
        print(f"{name}: not what is accepted", file=sys.stderr)
    return 1 if wrong else 0


if __name__ == "__main__":
    sys.exit(main())
