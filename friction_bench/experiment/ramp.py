"""Run ramps on a rig: one of them, and all of a load, planned by what the first one shows."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace

from friction_bench.experiment.record import RampRecord, sliding_window
from friction_bench.experiment.session import (
    LIMITS_SHARE,
    armed,
    last_near_limits,
    refuse_fault,
    sample_columns,
    wait_for_rest,
)
from friction_bench.experiment.sliding_fit import fit_sliding
from friction_bench.protocol.messages import Command, RigError, State
from friction_bench.rig.client import RigClient, Sample
from friction_bench.rig.rig_file import TRAVEL_UNIT, RampPlan, Rig
from rx90_common.base.errors import IdentificationError

LEAST_SLIDING = 1.5
"""Shortest time for which the shaft slides in the fastest ramp, s."""
LEAST_CONSTANTS = 8.0
"""The same in time constants; the longer of the two counts."""
LONGEST_CONSTANT = 0.5
"""The time constant, s, that is taken if the first ramp shows a longer one: a single ramp shows it poorly."""
LEAST_RATIO = 1.8
"""Smallest ratio of fastest to slowest slope."""
RATIO = 2.5
"""The ratio where the slopes are chosen here."""
READINGS = 300
"""Fewest readings of a sliding shaft at the fastest slope, all repeats together."""
MOST_REPEATS = 20


def run_ramp(
    client: RigClient,
    slope: float,
    end_torque: float,
    loaded: bool,
    label: str,
    on_sample: Callable[[Sample], None] = lambda _: None,
) -> RampRecord:
    """Arm the rig, run one ramp of `slope` Nm/s up to `end_torque` Nm and return its record.

    A ramp that comes near the limits of travel or speed is ended there. The rig is disarmed again when this returns,
    and stopped when it raises.

    Raises:
        RigError: refused, faulted, lost or reset.
    """
    rig = client.rig
    slope = rig.slope_of_step(rig.ramp_step(slope))
    client.end_code(end_torque)  # refused before anything is switched on
    wait_for_rest(client)
    with armed(client):
        samples = _follow(client, client.start_ramp(slope, end_torque), on_sample)
    if len(samples) < 2:
        raise RigError(f"{label}: {len(samples)} readings during the ramp; accepted: at least 2")
    ticks, counts, dac, adc = sample_columns(samples)
    return RampRecord(
        time=ticks * rig.tick - samples[0].time,
        angle=(counts - counts[0]) * rig.angle_step,
        slope=slope,
        angle_step=rig.angle_step,
        torque=rig.torque(dac),
        measured_torque=rig.measured_torque(adc),
        loaded=loaded,
        label=label,
    )


def _follow(client: RigClient, first: list[Sample], on_sample: Callable[[Sample], None]) -> list[Sample]:
    samples = [sample for sample in first if sample.report.state == State.RAMPING]
    while True:
        for sample in client.pump():
            refuse_fault(sample)
            if sample.report.ramp_done:
                return samples
            if sample.report.state != State.RAMPING:
                raise RigError("the ramp was stopped before its end")
            samples.append(sample)
            on_sample(sample)
        if last_near_limits(client.rig, samples):
            client.request(Command.STOP)
            return samples


def run_planned(
    run: Callable[[float, str], RampRecord], plan: RampPlan, loaded: bool, choose: Callable[[RampRecord], RampPlan]
) -> RampPlan:
    """Run all ramps under one load: the first of the slowest slope, then those of the plan that is chosen by it.

    Args:
        run: one ramp of a slope, Nm/s, with a label.
        plan: for the first ramp.
        loaded: for the labels.
        choose: the plan for the rest, from the first ramp; the first ramp counts where it has one of its slopes.

    Raises:
        IdentificationError: of `choose`; RigError: of `run`.
    """
    load = "loaded" if loaded else "no-load"
    slowest = min(plan.slopes)
    chosen = choose(run(slowest, f"{load} {slowest:g} Nm/s #1"))
    for repeat in range(chosen.repeats):
        for slope in sorted(chosen.slopes):
            if (repeat, slope) != (0, slowest):
                run(slope, f"{load} {slope:g} Nm/s #{repeat + 1}")
    return chosen


def plan_from(first: RampRecord, plan: RampPlan, rig: Rig) -> RampPlan:
    """Return the plan, with other slopes and more repeats where the first ramp shows that its own do not do.

    Args:
        first: a ramp of the plan's slowest slope.
        plan: slopes and end torques to begin with; the end torques are kept.
        rig: for the limits of travel and speed.

    Raises:
        IdentificationError: if the first ramp cannot be used, for then the others cannot either.
    """
    fit = fit_sliding([sliding_window(first)])
    coulomb, viscous, inertia = (float(value) for value in fit.values)
    if not (viscous > 0.0 and inertia > 0.0):
        raise IdentificationError(
            f"{first.label}: the shaft does not slide as a ramp torque lets it, the viscous friction would be "
            f"{viscous:.3g} Nm s/rad; saturation, or the joint runs against a stop"
        )
    # One ramp shows the time constant poorly: this one is hardly exceeded.
    constant = (inertia + 2.0 * math.sqrt(max(float(fit.covariance[2, 2]), 0.0))) / viscous
    travel, speed = rig.limit_codes()
    top = LIMITS_SHARE * speed * first.angle_step / rig.tick
    rise = min(plan.end(first.loaded) - coulomb, viscous * top)
    if rise <= 0.0:
        return plan
    sliding = max(LEAST_SLIDING, LEAST_CONSTANTS * min(constant, LONGEST_CONSTANT))
    fastest = rise / sliding
    farthest = LIMITS_SHARE * travel * TRAVEL_UNIT * first.angle_step
    slowest = rise**2 / (2.0 * viscous * farthest)  # slower ones turn the shaft too far
    slopes = plan.slopes
    kept = max(slopes) <= fastest and min(slopes) >= slowest and max(slopes) >= LEAST_RATIO * min(slopes)
    if not kept:
        high = min(max(fastest, RATIO * slowest), max(slopes))
        low = max(high / RATIO, rig.slope_of_step(1))
        slopes = (float(f"{low:.3g}"), float(f"{high:.3g}"))
    readings = rise / max(slopes) / rig.tick
    repeats = min(max(plan.repeats, math.ceil(READINGS / readings)), MOST_REPEATS)
    return replace(plan, slopes=slopes, repeats=repeats)
