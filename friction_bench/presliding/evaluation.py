"""What follows from a campaign of experiments: each kind's result, and the law that the readings ask for."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import TypeVar

import numpy as np

from friction_bench.presliding.break_away import BreakAway, evaluate_break_away
from friction_bench.presliding.campaign import Campaign
from friction_bench.presliding.choice import Choice, choose
from friction_bench.presliding.drift import DriftResult, evaluate_drift, turning_codes
from friction_bench.presliding.five_laws import LoopBlock, loop_block
from friction_bench.presliding.laws import slide_counts
from friction_bench.presliding.sliding import (
    SlidingFriction,
    SlidingReadings,
    fit_sliding_friction,
    sliding_readings,
)
from friction_bench.presliding.stick_slip import PulledJoint, pulled_joint
from friction_bench.rig.rig_file import Rig
from rx90_common.base.errors import IdentificationError


@dataclass(frozen=True, eq=False)
class PreslidingResult:
    """The result of a campaign; parts are None or empty where they were not run, or carry nothing.

    Attributes:
        step: of the encoder at the joint, rad.
        code: of the torque at the joint, Nm.
        deflection: of the joint up to break-away, rad, on the slowest ramps; None if it does not break away.
        failures: why a part that was run carries nothing, one line each.
    """

    origin: str
    step: float
    code: float
    deflection: float | None
    break_away: BreakAway | None
    sliding: SlidingFriction | None
    readings: SlidingReadings | None
    blocks: tuple[LoopBlock, ...]
    choice: Choice | None
    pulls: tuple[PulledJoint, ...]
    drift: DriftResult | None
    failures: tuple[str, ...]

    @property
    def deflection_counts(self) -> float | None:
        """Return the deflection up to break-away in counts, None if the joint does not break away."""
        return None if self.deflection is None else self.deflection / self.step


_Part = TypeVar("_Part")


def evaluate(campaign: Campaign, rig: Rig, on_fit: Callable[[], object] = lambda: None) -> PreslidingResult:
    """Evaluate all experiments of a campaign; what cannot be is named in the result's failures."""
    failures = list(campaign.failures)
    slid = slide_counts(rig.joint_step)

    def attempt(part: Callable[[], _Part]) -> _Part | None:
        try:
            return part()
        except IdentificationError as error:
            failures.append(str(error))
            return None

    readings = _readings(campaign)
    sliding = None if readings is None else attempt(lambda: fit_sliding_friction(readings))
    ramps = [(run.rate, trace) for run, trace in campaign.of("ramps") if trace.counts.max() >= slid]
    broken = evaluate_break_away(ramps, sliding.inertia) if ramps and sliding is not None else None
    drift = attempt(lambda: _drift(campaign, slid))
    blocks = tuple(loop_block(trace) for _, trace in campaign.of("loops"))
    choice = None
    if blocks and readings is not None:
        choice = attempt(lambda: choose(blocks, readings, drift, on_fit))
    return PreslidingResult(
        origin=campaign.origin,
        step=rig.joint_step,
        code=rig.torque(1) * rig.joint_scale,
        deflection=_deflection(campaign, rig, slid) if ramps else None,
        break_away=broken,
        sliding=sliding,
        readings=readings,
        blocks=blocks,
        choice=choice,
        pulls=tuple(pulled_joint(trace, run.rate, run.stiffness) for run, trace in campaign.of("stick_slip")),
        drift=drift,
        failures=tuple(failures),
    )


def _readings(campaign: Campaign) -> SlidingReadings | None:
    sweeps = [sliding_readings(trace) for _, trace in campaign.of("sweep")]
    return sweeps[0] if sweeps else None


def _drift(campaign: Campaign, slid: float) -> DriftResult | None:
    cycled = campaign.of("drift")
    if not cycled:
        return None
    slow = campaign.break_away_code(slid)
    return evaluate_drift(cycled[0][1], *turning_codes(slow), slow)


def _deflection(campaign: Campaign, rig: Rig, slid: float) -> float:
    """Return how far the joint moves, rad, up to nine tenths of the break-away torque on the slowest ramps."""
    code = 0.9 * campaign.break_away_code(slid)
    slowest = min(run.rate for run, _ in campaign.of("ramps"))
    moved = [
        trace.counts[int(np.argmax(trace.code >= code))] for run, trace in campaign.of("ramps") if run.rate == slowest
    ]
    return float(np.median(moved)) * rig.joint_step
