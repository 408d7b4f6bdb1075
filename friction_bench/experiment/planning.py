"""Which ramps to run: the first one shows the friction, and slopes and repeats follow from it.

Friction and inertia are told apart where the shaft slides for several of its time constants, with readings enough
against the noise, at two slopes that differ; slower ramps than that only turn the shaft further.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace

from friction_bench.experiment.ramp import Guard
from friction_bench.experiment.record import RampRecord
from friction_bench.experiment.sliding_fit import fit_sliding
from friction_bench.experiment.window import SlidingWindow, sliding_window
from friction_bench.rig.rig_file import RampPlan, Rig
from rx90_common.base.errors import IdentificationError

LEAST_SLIDING = 1.5
"""Shortest time for which the shaft slides in the fastest ramp, s."""
LEAST_CONSTANTS = 8.0
"""The same in time constants; the longer of the two counts."""
LONGEST_CONSTANT = 0.5
"""The time constant, s, that is taken if the first ramp shows a longer one: a single ramp tells it poorly."""
LEAST_RATIO = 1.8
"""Smallest ratio of fastest to slowest slope."""
RATIO = 2.5
"""The ratio where the slopes are chosen here."""
READINGS = 300
"""Fewest readings of a sliding shaft at the fastest slope, all repeats together."""
MOST_REPEATS = 20


def plan_from(first: RampRecord, plan: RampPlan, rig: Rig) -> RampPlan:
    """Return the plan, with other slopes and more repeats where the first ramp shows that its own do not do.

    Args:
        first: a ramp of the plan's slowest slope.
        plan: slopes and end torques to begin with; the end torques are kept.
        rig: for the limits of travel and speed.

    Raises:
        IdentificationError: if the first ramp cannot be used, for then the others cannot either.
    """
    window = sliding_window(first)
    coulomb, viscous, constant = _roughly(window)
    limits = Guard.of(rig)
    top = limits.speed * first.angle_step / rig.tick
    rise = min(plan.end(first.loaded) - coulomb, viscous * top)
    if rise <= 0.0:
        return plan
    sliding = max(LEAST_SLIDING, LEAST_CONSTANTS * min(constant, LONGEST_CONSTANT))
    fastest = rise / sliding
    slowest = rise**2 / (2.0 * viscous * limits.travel * first.angle_step)  # slower ones turn the shaft too far
    slopes = plan.slopes
    kept = max(slopes) <= fastest and min(slopes) >= slowest and max(slopes) >= LEAST_RATIO * min(slopes)
    if not kept:
        high = min(max(fastest, RATIO * slowest), max(slopes))
        low = max(high / RATIO, rig.slope_of_step(1))
        slopes = (_rounded(low), _rounded(high))
    readings = rise / max(slopes) / rig.tick
    repeats = min(max(plan.repeats, math.ceil(READINGS / readings)), MOST_REPEATS)
    return replace(plan, slopes=slopes, repeats=repeats)


def _roughly(window: SlidingWindow) -> tuple[float, float, float]:
    """Return f_c, Nm, f_v, Nm s/rad, and a time constant, s, that is hardly exceeded, by one ramp."""
    fit = fit_sliding([window])
    coulomb, viscous, inertia = (float(value) for value in fit.values)
    if not (viscous > 0.0 and inertia > 0.0):
        raise IdentificationError(
            f"{window.record.label}: the shaft does not slide as a ramp torque lets it, the viscous friction would be "
            f"{viscous:.3g} Nm s/rad; saturation, or the joint runs against a stop"
        )
    spread = math.sqrt(max(float(fit.covariance[2, 2]), 0.0))
    return coulomb, viscous, (inertia + 2.0 * spread) / viscous


def _rounded(slope: float) -> float:
    return float(f"{slope:.3g}")


Run = Callable[[float, str], RampRecord]
"""Runs one ramp of a slope, Nm/s, with a label."""


def run_planned(run: Run, plan: RampPlan, loaded: bool, choose: Callable[[RampRecord], RampPlan]) -> RampPlan:
    """Run all ramps under one load: the first of the slowest slope, then those of the plan that is chosen by it.

    Args:
        run: one ramp.
        plan: for the first ramp.
        loaded: for the labels.
        choose: the plan for the rest, from the first ramp; the first ramp counts where it has one of its slopes.

    Raises:
        IdentificationError: of `choose`; RigError: of `run`.
    """
    load = "loaded" if loaded else "no-load"
    slowest = min(plan.slopes)
    first = run(slowest, f"{load} {slowest:g} Nm/s #1")
    chosen = choose(first)
    for repeat in range(chosen.repeats):
        for slope in sorted(chosen.slopes):
            if (repeat, slope) != (0, slowest):
                run(slope, f"{load} {slope:g} Nm/s #{repeat + 1}")
    return chosen
