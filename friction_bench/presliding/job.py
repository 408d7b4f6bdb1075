"""The run of `friction_presliding` without its options: they are checked first, as the import takes seconds."""

from __future__ import annotations

import argparse
import contextlib
import sys
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import NamedTuple, TypeVar

import numpy as np
from tqdm import tqdm

from friction_bench.experiment.session import Session, check_options, measuring, origin_of, wait_for_rest
from friction_bench.presliding import KINDS, USUAL_BLOCKS, USUAL_CYCLES, motions
from friction_bench.presliding.laws import FITS, LoopBlock, choose
from friction_bench.presliding.motions import Profile, Trace, follow
from friction_bench.presliding.report import PreslidingResult, write_result
from friction_bench.presliding.sliding import (
    HALF_CYCLE_TICKS,
    RATES,
    REPEATS,
    break_away_code,
    break_away_torque,
    evaluate_drift,
    evaluate_pull,
    fit_sliding_friction,
    sliding_readings,
    turning_codes,
)
from friction_bench.rig.rig_file import Rig, load_rig
from rx90_common.base.errors import DONE, VERDICT_NO, ConfigError, IdentificationError, Rx90Error
from rx90_common.base.quoting import one_line
from rx90_common.base.share import resolve_config
from rx90_common.process.interrupts import deferred_interrupts

SWEEP_SPEEDS = np.array([0.02, 0.035, 0.06, 0.1, 0.16, 0.24, 0.34, 0.45])
"""Of the sweep, in parts of the fastest that the rig allows."""
SPEED_TICKS = 75
"""Ticks for each speed."""
PULL_SPEEDS = np.array([0.04, 0.08, 0.12, 0.17, 0.24, 0.33])
"""Speeds of the stick-slip map, in parts of the same."""
PULL_STIFFNESSES = (4.0, 8.0, 16.0)
"""Of the map, Nm/rad: a joint on a spring of these oscillates slowly against the 20 ms tick."""
_STRIDES = 18
"""Strides from zero to break-away in loops."""
_SLIDE_START = 0.5
"""Of the break-away torque: where slides begin."""
_BANDWIDTH = 15.0
"""Bandwidth of the speed loop, rad/s: well below the limit set by the delay of a tick and a half."""
_USUAL_INERTIA = 0.4
"""kg m^2; the loop bears half of it and twice as much."""

_Part = TypeVar("_Part")


class Run(NamedTuple):
    """One experiment to run.

    Attributes:
        kind: ramps, or one of KINDS.
        label: in messages, files and plots.
        profile: of the torque.
        rate: of a ramp in codes a tick, of a pull its speed in rad/s.
        stiffness: of a pull, Nm/rad.
        backward: the profile and its readings are counted the other way.
    """

    kind: str
    label: str
    profile: Profile
    rate: float = 0.0
    stiffness: float = 0.0
    backward: bool = False


@dataclass
class Campaign:
    """Experiments on a rig: the planned ones, and those that have been run with their readings, in order.

    Attributes:
        rig: the rig.
        kinds: in the order of KINDS; the ramps come before them.
        blocks: number of blocks of loops.
        cycles: number of small cycles of the drift.
        origin: of the readings, in words.
        done: finished experiments with their readings.
        failures: in words.
    """

    rig: Rig
    kinds: tuple[str, ...] = KINDS
    blocks: int = USUAL_BLOCKS
    cycles: int = USUAL_CYCLES
    origin: str = ""
    done: list[tuple[Run, Trace]] = field(default_factory=list)
    failures: list[str] = field(default_factory=list)

    def __post_init__(self) -> None:
        self.slide = motions.SLIDE / self.rig.joint_step  # counts
        self.fastest = 0.9 * self.rig.speed_limit / self.rig.gear_ratio  # rad/s of the joint, with a reserve
        self.ways = (False, True) if self.rig.bipolar else (False,)

    def of(self, kind: str, backward: bool = False) -> list[tuple[Run, Trace]]:
        """Return the experiments of a kind and direction that have been run, counted in that direction."""
        chosen = [(run, trace) for run, trace in self.done if run.kind == kind and run.backward is backward]
        return [(run, trace.mirrored) for run, trace in chosen] if backward else chosen

    def remaining_time(self) -> float:
        """Return the longest remaining time, s, for a joint that breaks away at half of the torque."""
        pulls = [
            self._pull_ticks(speed, stiffness) for speed in PULL_SPEEDS * self.fastest for stiffness in PULL_STIFFNESSES
        ]
        ticks = {
            "loops": self.blocks * (650.0 if self.rig.bipolar else 420.0),
            "sweep": len(self.ways) * (2 * SWEEP_SPEEDS.size * SPEED_TICKS + 80),
            "stick_slip": sum(pulls),
            "drift": 2 * HALF_CYCLE_TICKS * self.cycles + 120,
        }
        ramps = sum(REPEATS * 130.0 / rate + 25.0 for rate in RATES)
        whole = len(self.ways) * ramps + sum(ticks[kind] for kind in self.kinds)
        return max(whole * self.rig.tick - float(sum(trace.time[-1] for _, trace in self.done)), 0.0)

    def _slid(self, backward: bool = False) -> list[tuple[float, Trace]]:
        """Return the ramps on which the joint broke away, each with its rate."""
        return [(run.rate, trace) for run, trace in self.of("ramps", backward) if trace.counts.max() >= self.slide]

    def slowest_ramps(self, backward: bool = False) -> list[Trace]:
        """Return the ramps of the slowest rate at which the joint breaks away in a direction.

        Raises:
            IdentificationError: if there are none.
        """
        ramps = self._slid(backward)
        if not ramps:
            raise IdentificationError("the joint breaks away on no ramp")
        slowest = min(rate for rate, _ in ramps)
        return [trace for rate, trace in ramps if rate == slowest]

    def break_away_code(self, backward: bool = False) -> float:
        """Return the size of the code at which the joint breaks away on the slowest of the ramps on which it does.

        Raises:
            IdentificationError: if there are none.
        """
        return float(np.median([break_away_code(trace, self.slide) for trace in self.slowest_ramps(backward)]))

    def runs(self, limit: int) -> Iterator[Run]:
        """Yield one experiment after the other, each when those before it are done.

        Args:
            limit: the highest code that the firmware accepts.

        Raises:
            IdentificationError: if the joint does not break away, or too early for small cycles in whole codes.
        """
        for backward in self.ways:
            for rate in RATES:
                for repeat in range(REPEATS):
                    label = f"ramp{' backward' * backward}, {rate:g} codes a tick, {repeat + 1}"
                    profile = motions.ramp(rate, self.slide, limit)
                    yield Run("ramps", label, motions.mirrored(profile) if backward else profile, rate, 0.0, backward)
                    break_away_code(self.of("ramps", backward)[-1][1], self.slide)  # refused now, if the joint sticks
        rig, slow = self.rig, self.break_away_code()
        start = int(_SLIDE_START * slow)
        counts = rig.tick / rig.joint_step  # per tick, of 1 rad/s
        if "loops" in self.kinds:
            stride = max(1, round(slow / _STRIDES))
            back = int(self.break_away_code(True)) if self.rig.bipolar else None
            for block in range(self.blocks):
                codes = motions.loop_codes(int(slow), block, stride, back)
                yield Run("loops", f"loops, block {block + 1}", motions.after_slide(start, self.slide, limit, codes))
        if "sweep" in self.kinds:
            speeds = SWEEP_SPEEDS * self.fastest
            counts_per_tick = [float(speed) * rig.tick / rig.joint_step for speed in (*speeds, *speeds[::-1])]
            gain = _USUAL_INERTIA * _BANDWIDTH / rig.joint_code / counts
            for backward in self.ways:
                begin = int(_SLIDE_START * self.break_away_code(backward))
                profile = motions.speeds(begin, counts_per_tick, SPEED_TICKS, gain, limit, rig.tick)
                mirrored = motions.mirrored(profile) if backward else profile
                yield Run("sweep", f"sweep{' backward' * backward}", mirrored, backward=backward)
        if "stick_slip" in self.kinds:
            for stiffness in PULL_STIFFNESSES:
                for speed in (PULL_SPEEDS * self.fastest).tolist():
                    spring, ticks = stiffness * rig.joint_step / rig.joint_code, self._pull_ticks(speed, stiffness)
                    profile = motions.pulled(spring, speed * rig.tick / rig.joint_step, ticks, limit, 0.8 * slow)
                    label = f"stick-slip, {speed:.3f} rad/s, {stiffness:g} Nm/rad"
                    yield Run("stick_slip", label, profile, speed, stiffness)
        if "drift" in self.kinds:
            low, high = turning_codes(slow)
            if high <= low:
                raise IdentificationError(
                    f"drift: the joint breaks away at code {slow:g}, which leaves no codes for small cycles below it"
                )
            codes = motions.cycle_codes(low, high, HALF_CYCLE_TICKS, self.cycles)
            yield Run("drift", "drift", motions.after_slide(start, self.slide, limit, codes))

    def _pull_ticks(self, speed: float, stiffness: float) -> int:
        """Return for how many ticks to pull: three cycles of a joint whose friction falls by 0.5 Nm, 8 s to 40 s."""
        travel = 0.7 * self.rig.load_travel * 2.0 * np.pi
        return round(min(max(8.0, 3.0 / (stiffness * speed)), 40.0, travel / speed) / self.rig.tick)

    def evaluate(self, on_fit: Callable[[], object] = lambda: None) -> PreslidingResult:
        """Evaluate all finished experiments; those that cannot be evaluated are named in the result's failures."""
        result = PreslidingResult(self.origin, self.rig, failures=list(self.failures))

        def attempt(part: Callable[..., _Part], *arguments: object) -> _Part | None:
            try:
                return part(*arguments)
            except IdentificationError as error:
                result.failures.append(str(error))
                return None

        for _, trace in self.of("sweep"):
            result.readings = sliding_readings(trace)
            result.sliding = attempt(fit_sliding_friction, result.readings)
        for _, trace in self.of("sweep", True):
            result.readings_backward = sliding_readings(trace)
            result.sliding_backward = attempt(fit_sliding_friction, result.readings_backward)
        ramps = self._slid()
        if ramps:
            slow = self.break_away_code()
            moved = [trace.counts[int(np.argmax(trace.code >= 0.9 * slow))] for trace in self.slowest_ramps()]
            result.deflection = float(np.median(moved)) * self.rig.joint_step
            if result.sliding is not None:
                result.break_away = [break_away_torque(*ramp, result.sliding.inertia) for ramp in ramps]
                inertia = result.sliding.inertia
                result.break_away_backward = [break_away_torque(*ramp, inertia) for ramp in self._slid(True)]
            for _, trace in self.of("drift"):
                result.drift = attempt(evaluate_drift, trace, *turning_codes(slow), slow)
        result.blocks = [LoopBlock.of(trace) for _, trace in self.of("loops")]
        if result.blocks and result.readings is not None:
            parts = result.blocks, result.readings, result.drift, on_fit, result.readings_backward
            result.choice = attempt(choose, *parts)
        result.pulls = [evaluate_pull(trace, run.rate, run.stiffness) for run, trace in self.of("stick_slip")]
        return result


def run(options: argparse.Namespace) -> int:
    """Run the experiments on a rig, evaluate them and write the report.

    Returns:
        The exit code: 1 if no law of friction could be chosen though loops were run.

    Raises:
        Rx90Error: for bad options or files; everything measured until then is in the folder.
    """
    rig = load_rig(resolve_config(options.rig))
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
    sizes = options.blocks or USUAL_BLOCKS, options.cycles or USUAL_CYCLES
    campaign = Campaign(rig, kinds, *sizes, origin_of(options))
    out: Path = options.output
    try:
        with measuring(options, rig, out, campaign.remaining_time(), "rig") as session:
            session.couple(True)
            _run_all(session, campaign, out)
    except (KeyboardInterrupt, Rx90Error):
        if campaign.done:
            print("evaluating what has been measured; Ctrl-C leaves that out", file=sys.stderr)
            with contextlib.suppress(Rx90Error):  # the first error is the one to report
                _report(campaign, out)
        raise
    result = _report(campaign, out)
    undecided = "loops" in kinds and (result.choice is None or len(result.choice.remaining) > 1)
    return VERDICT_NO if undecided or result.failures else DONE


def _run_all(session: Session, campaign: Campaign, out: Path) -> None:
    """Run the planned experiments; later ones are planned from the results of earlier ones.

    The readings of each are written as a CSV file, however it ends. Only a drift may be cut short: its completed cycles
    are as good as those that are missing.
    """
    client, bar, done = session.client, session.bar, campaign.done
    try:
        for what in campaign.runs(client.greeting.torque_limit_code):
            bar.total = round(bar.n + campaign.remaining_time(), 1)
            bar.set_postfix_str(what.label, refresh=False)
            wait_for_rest(client)
            first = len(session.samples)
            file = f"{len(done) + 1:03d}_{what.label.split(',')[0].replace(' ', '_')}"
            try:
                done.append((what, follow(client, what.profile, what.label, session.keep)))
            except (KeyboardInterrupt, Rx90Error):
                if len(session.samples) - first > 1:
                    with deferred_interrupts(), contextlib.suppress(Rx90Error):  # the first error is the one to report
                        unfinished = Trace.of(f"{what.label}, unfinished", session.samples[first:], campaign.rig)
                        if what.kind == "drift":
                            done.append((what, unfinished))
                        unfinished.write(out / f"{file}_unfinished.csv")
                raise
            done[-1][1].write(out / f"{file}.csv")
    except IdentificationError as error:  # earlier measurements are on disk, and are evaluated
        bar.write(f"{error}; no more experiments", sys.stderr)
        campaign.failures.append(str(error))


def _report(campaign: Campaign, out: Path) -> PreslidingResult:
    """Evaluate the measurements, print the results and write the report."""
    fits = FITS if campaign.of("loops") and campaign.of("sweep") else 0
    with tqdm(total=fits, desc="laws", disable=None, leave=False) as bar:
        result = campaign.evaluate(bar.update)
    write_result(out, result)
    print(one_line(f"report: {out / 'report.html'}"))
    return result
