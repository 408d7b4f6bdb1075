"""Which experiments to run: ramps first; torques and gains of the others follow from where the joint breaks away."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from friction_bench.presliding import laws
from friction_bench.presliding.break_away import RATES, REPEATS, break_away_code
from friction_bench.presliding.campaign import Campaign, Run
from friction_bench.presliding.drift import HALF, turning_codes
from friction_bench.rig.rig_file import Rig
from rx90_common.base.errors import IdentificationError

SPEEDS = np.array([0.02, 0.035, 0.06, 0.1, 0.16, 0.24, 0.34, 0.45])
"""Of the sweep, in parts of the fastest that the rig allows."""
HELD = 75
"""Ticks for each speed."""
SETTLED = 30
"""Of them until the speed is held."""
PULLS = np.array([0.04, 0.08, 0.12, 0.17, 0.24, 0.33])
"""Speeds of the stick-slip map, in parts of the same."""
STIFFNESSES = (4.0, 8.0, 16.0)
"""Of the map, Nm/rad: a joint on a spring of these oscillates slowly against the 20 ms tick."""
_STRIDES = 18
"""Strides from zero to break-away in loops."""
_START = 0.5
"""Of the break-away torque: where slides begin."""
_BANDWIDTH = 15.0
"""Of the speed's loop, rad/s: well below what the delay of a tick and a half allows."""
_USUAL_INERTIA = 0.4
"""kg m^2; the loop bears half of it and twice as much."""


@dataclass(frozen=True)
class CampaignPlan:
    """What to run: kinds in the order of KINDS, so many blocks of loops, so many small cycles."""

    rig: Rig
    kinds: tuple[str, ...]
    blocks: int
    cycles: int

    @property
    def slide(self) -> float:
        """Return the counts of a slide."""
        return laws.slide_counts(self.rig.joint_step)

    @property
    def fastest(self) -> float:
        """Return the fastest speed of the joint that the rig allows, with a reserve, rad/s."""
        return 0.9 * self.rig.speed_limit / self.rig.gear_ratio

    def duration(self) -> float:
        """Return how long everything may take, s, for a joint that breaks away at half of the motor's torque."""
        ticks = sum(REPEATS * 130.0 / rate + 25.0 for rate in RATES)
        if "loops" in self.kinds:
            ticks += self.blocks * 420.0
        if "sweep" in self.kinds:
            ticks += 2 * SPEEDS.size * HELD + 80
        if "stick_slip" in self.kinds:
            ticks += sum(self.pull_ticks(speed, k) for speed in PULLS * self.fastest for k in STIFFNESSES)
        if "drift" in self.kinds:
            ticks += 2 * HALF * self.cycles + 120
        return ticks * self.rig.tick

    def pull_ticks(self, speed: float, stiffness: float) -> int:
        """Return for how many ticks to pull: three cycles of a joint whose friction falls by 0.5 Nm, 8 s to 40 s."""
        cycle = 2.0 * 0.5 / (stiffness * speed)
        travel = 0.7 * self.rig.load_travel * 2.0 * np.pi
        return round(min(max(8.0, 3.0 * cycle), 40.0, travel / speed) / self.rig.tick)

    def left(self, campaign: Campaign) -> float:
        """Return how long what is not done yet may take, s."""
        return max(self.duration() - campaign.seconds, 0.0)


def runs(plan: CampaignPlan, campaign: Campaign, limit: int) -> Iterator[Run]:
    """Yield one experiment after the other, each when those before it are in the campaign.

    Args:
        plan: which.
        campaign: what has been measured so far.
        limit: the highest code that the firmware accepts.

    Raises:
        IdentificationError: if the joint does not break away, or so early that codes are too coarse for small cycles.
    """
    for rate in RATES:
        for repeat in range(REPEATS):
            label = f"ramp, {rate:g} codes a tick, {repeat + 1}"
            yield Run("ramps", label, laws.ramp(rate, plan.slide, limit), rate=rate)
            break_away_code(campaign.traces[-1], plan.slide)  # refused now, if the joint sticks
    slow = campaign.break_away_code(plan.slide)
    start = int(_START * slow)
    for kind in plan.kinds:
        if kind == "loops":
            yield from _loops(plan, slow, start, limit)
        elif kind == "sweep":
            yield _sweep(plan, start, limit)
        elif kind == "stick_slip":
            yield from _pulls(plan, slow, limit)
        elif kind == "drift":
            low, high = turning_codes(slow)
            if high <= low:
                raise IdentificationError(
                    f"drift: the joint breaks away at code {slow:g}, which leaves no codes for small cycles below it"
                )
            law = laws.cycles(start, plan.slide, limit, low, high, HALF, plan.cycles)
            yield Run("drift", "drift", law)


def _loops(plan: CampaignPlan, break_away: float, start: int, limit: int) -> Iterator[Run]:
    stride = max(1, round(break_away / _STRIDES))
    for block in range(plan.blocks):
        levels = laws.loop_levels(int(break_away), block)
        yield Run("loops", f"loops, block {block + 1}", laws.loops(start, plan.slide, limit, levels, stride))


def _counts_per_tick(plan: CampaignPlan, speed: float) -> float:
    return speed * plan.rig.tick / plan.rig.joint_step


def _sweep(plan: CampaignPlan, start: int, limit: int) -> Run:
    speeds = SPEEDS * plan.fastest
    wanted = [_counts_per_tick(plan, float(speed)) for speed in (*speeds, *speeds[::-1])]
    gain = _USUAL_INERTIA * _BANDWIDTH / _code_step(plan) / _counts_per_tick(plan, 1.0)
    return Run("sweep", "sweep", laws.speeds(start, wanted, HELD, gain, limit, plan.rig.tick), wanted=tuple(wanted))


def _code_step(plan: CampaignPlan) -> float:
    return plan.rig.torque(1) * plan.rig.joint_scale


def _pulls(plan: CampaignPlan, break_away: float, limit: int) -> Iterator[Run]:
    for stiffness in STIFFNESSES:
        for speed in (PULLS * plan.fastest).tolist():
            law = laws.pulled(
                stiffness * plan.rig.joint_step / _code_step(plan),
                _counts_per_tick(plan, speed),
                plan.pull_ticks(speed, stiffness),
                limit,
                0.8 * break_away,
            )
            label = f"stick-slip, {speed:.3f} rad/s, {stiffness:g} Nm/rad"
            yield Run("stick_slip", label, law, rate=speed, stiffness=stiffness)
