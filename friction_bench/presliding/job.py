"""The run of `friction_presliding`, apart from its options: they are checked first, as the import takes seconds."""

from __future__ import annotations

import argparse
import contextlib
import sys
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from tqdm import tqdm

from friction_bench.experiment.session import Session, check_options, measuring, origin_of, wait_for_rest
from friction_bench.presliding import laws
from friction_bench.presliding.break_away import RATES, REPEATS, break_away_code
from friction_bench.presliding.campaign import Campaign, Run
from friction_bench.presliding.drift import HALF, turning_codes
from friction_bench.presliding.evaluation import PreslidingResult, evaluate
from friction_bench.presliding.follow import follow
from friction_bench.presliding.kinds import KINDS, USUAL_BLOCKS, USUAL_CYCLES
from friction_bench.presliding.report import result_text, write_estimates, write_html
from friction_bench.presliding.trace import trace_of, write_trace
from friction_bench.rig.client import Sample
from friction_bench.rig.rig_file import Rig, load_rig
from rx90_common.base.errors import DONE, VERDICT_NO, ConfigError, IdentificationError, Rx90Error
from rx90_common.base.quoting import one_line
from rx90_common.base.share import resolve_config
from rx90_common.process.interrupts import interrupts_later

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


def run(options: argparse.Namespace) -> int:
    """Run the experiments on a rig, evaluate them and write the report.

    Returns:
        The exit code: 1 where no law of friction could be chosen though loops were run.

    Raises:
        Rx90Error: for what is refused; what has been measured until then stands in the folder.
    """
    rig = load_rig(resolve_config(options.rig))
    plan = _plan(options, rig)
    out: Path = options.output
    campaign = Campaign(origin=origin_of(options))
    try:
        _measure(options, rig, plan, out, campaign)
    except (KeyboardInterrupt, Rx90Error):
        if campaign.traces:
            print("evaluating what has been measured; Ctrl-C leaves that out", file=sys.stderr)
            with contextlib.suppress(Rx90Error):  # the first reason is the one to tell
                _evaluate(campaign, rig, out)
        raise
    result = _evaluate(campaign, rig, out)
    undecided = "loops" in plan.kinds and (result.choice is None or result.choice.law is None)
    return VERDICT_NO if undecided or result.failures else DONE


def _evaluate(campaign: Campaign, rig: Rig, out: Path) -> PreslidingResult:
    """Evaluate what was measured, write the report and print the results."""
    with tqdm(total=campaign.fits, desc="laws", disable=None, leave=False) as bar:
        result = evaluate(campaign, rig, bar.update)
    print(result_text(result))  # first: a disk that is full takes no report
    write_html(out / "report.html", result, rig)
    write_estimates(out / "estimates.yaml", result, rig)
    print(one_line(f"report: {out / 'report.html'}"))
    return result


def _plan(options: argparse.Namespace, rig: Rig) -> CampaignPlan:
    """Refuse now what would otherwise be noticed after minutes."""
    check_options(options)
    if not rig.counts_down:
        raise ConfigError(
            f"{rig.file}: counts_down is false, and its encoder counts up in both directions; accepted: a rig whose "
            "counts go down when the motor turns back, such as rig/presliding.yaml"
        )
    kinds = tuple(kind for kind in KINDS if kind in (options.kinds or KINDS))
    for name, kind in (("blocks", "loops"), ("cycles", "drift")):
        value = getattr(options, name)
        if value is not None and kind not in kinds:
            raise ConfigError(f"--{name} {value} without {kind}; accepted: with --kinds {kind}, or without --kinds")
    return CampaignPlan(rig, kinds, options.blocks or USUAL_BLOCKS, options.cycles or USUAL_CYCLES)


def _measure(options: argparse.Namespace, rig: Rig, plan: CampaignPlan, out: Path, campaign: Campaign) -> None:
    with measuring(options, rig, out, plan.duration(), "rig") as session:
        session.couple(True)
        _run_all(session, plan, campaign, out)


def _run_all(session: Session, plan: CampaignPlan, campaign: Campaign, out: Path) -> None:
    """Run what is planned; a later experiment is planned by what earlier ones showed."""
    client, bar = session.client, session.bar
    assert client.hello is not None  # it has been greeted
    try:
        for what in runs(plan, campaign, client.hello.torque_limit_code):
            bar.total = round(bar.n + plan.left(campaign), 1)
            bar.set_postfix_str(what.label, refresh=False)
            wait_for_rest(client)
            _run_one(session, what, campaign, out)
    except IdentificationError as error:  # what was measured before stands, and is evaluated
        bar.write(f"{error}; no more experiments", sys.stderr)
        campaign.failures.append(str(error))


def _run_one(session: Session, what: Run, campaign: Campaign, out: Path) -> None:
    """Run an experiment; its readings stand as a CSV file, however it ends.

    One that is cut short counts where it is a drift, whose cycles so far are as good as those that are missing.
    """
    client = session.client
    samples: list[Sample] = []

    def keep(sample: Sample) -> None:
        samples.append(sample)
        session.keep(sample)

    name = f"{len(campaign.traces) + 1:03d}_{what.label.split(',')[0].replace(' ', '_')}"
    try:
        trace = follow(client, what.law, what.label, keep)
    except (KeyboardInterrupt, Rx90Error):
        if len(samples) > 1:
            with interrupts_later(), contextlib.suppress(Rx90Error):  # the first reason is the one to tell
                unfinished = trace_of(f"{what.label}, unfinished", samples, client.rig)
                if what.kind == "drift":
                    campaign.add(what, unfinished)
                write_trace(unfinished, out / f"{name}_unfinished.csv")
        raise
    campaign.add(what, trace)
    write_trace(trace, out / f"{name}.csv")
