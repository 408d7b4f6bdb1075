"""Known friction in, known friction out: bias and coverage of the ramp test's estimates.

    python -m benchmarks.friction_ramp grid|random|spread [--rigs 200] [--seed 1]

grid: whole measurements on a grid of emulated rigs with the real firmware, in virtual time, each with a noise of its
own; also prints what the source's f_c is high by. random: rigs with Coulomb-viscous and with LuGre joints, with
friction, inertia and noise of their own, measured as the command `rx90 rig ramp` does it, without and with the joint,
ramps planned from the first one; prints what the source's formula f_c = m b / a gives on the same ramps, and every
refusal. spread: whole measurements on the source's rig, whose torque and joint differ from ramp to ramp. The ramps of
random and spread are run without firmware and line: the same plant and the same staircase, compiled, so that a ramp
costs milliseconds instead of seconds. The firmware's ramp in rig.c is written again here in three lines; a test holds
readings against those of the rig with the real firmware.

All print how often the 95 % intervals hold the truth. The exit code is 1 when a figure is not what is accepted.
"""

from __future__ import annotations

import math
import sys
from dataclasses import dataclass, field
from itertools import product
from typing import NamedTuple

import numpy as np

from benchmarks.random_rigs import random_rig, shipped_rig, truth_of
from benchmarks.report import accepted, arguments, in_processes, print_table
from friction_bench.experiment.identification import (
    IntervalEstimate,
    RampFriction,
    evaluate,
    identify_ramps,
)
from friction_bench.experiment.job import plan_from, run_planned, run_ramp
from friction_bench.experiment.record import RampRecord
from friction_bench.experiment.session import LIMITS_SHARE, SPEED_TICKS
from friction_bench.rig.client import RigClient
from friction_bench.rig.emulated import EmulatedRig, VirtualPort, native_library
from friction_bench.rig.plant import (
    SLICE,
    RigJoint,
    Shaft,
    joint_record,
    shaft_of,
    turn,
    turn_with_joint,
)
from friction_bench.rig.rig_file import (
    CODES,
    RAMP_FRACTION,
    TRAVEL_UNIT,
    Emulation,
    JointFriction,
    Rig,
    load_rig,
)
from rx90_common.base.arrays import Array, Mask
from rx90_common.base.errors import Rx90Error
from rx90_common.base.share import SOURCE_RIG, config_path
from rx90_common.friction.element import FrictionElement
from rx90_common.kernels.compiled import kernel

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
QUANTITIES = ("coulomb", "viscous")
COVERAGE = (0.90, 0.99)
BIAS = 0.01
KINDS = ("Coulomb-viscous", "LuGre")
SPREAD = "source's rig"
SLICES = 20
"""Slices of 1 ms in a tick."""


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
        rig = shipped_rig()
        assert rig.emulation is not None
        load = (
            (self.inertia - rig.emulation.motor.rotor_inertia)
            * rig.gear.ratio**2
            * rig.gear.efficiency
        )
        return rig.replaced(
            emulation={
                "motor_friction": {"coulomb": self.coulomb, "viscous": self.viscous},
                "load_inertia": load,
            }
        )


class GridOutcome(NamedTuple):
    """What one experiment gave: by quantity the relative error and whether the interval held the truth."""

    errors: dict[str, float]
    hits: dict[str, bool]
    excess: float
    """The source's f_c less the truth, Nm."""
    inertia_times_a: float
    """J a, mean over the ramps, Nm."""


def grid() -> list[Cell]:
    """Return the cells whose ramps carry an estimate."""
    cells = [Cell(*figures) for figures in product(COULOMB, VISCOUS, INERTIA, SLOPES)]
    return [cell for cell in cells if cell.long_enough]


def grid_experiment(job: tuple[Cell, int]) -> GridOutcome:
    """Measure one rig with one seed."""
    cell, seed = job
    rig = cell.rig()
    client = RigClient(VirtualPort(EmulatedRig(rig, seed)), rig)
    client.connect()
    records = [
        run_ramp(client, slope, cell.end_torque, False, f"{slope:g}")
        for _ in range(REPEATS)
        for slope in cell.slopes
    ]
    found = identify_ramps(records, rig.torque.scale_uncertainty)
    errors, hits = {}, {}
    for quantity in QUANTITIES:
        estimate = getattr(found.exact, quantity)
        truth = getattr(cell, quantity)
        errors[quantity] = estimate.value / truth - 1.0
        hits[quantity] = estimate.low <= truth <= estimate.high
    expected = np.mean([cell.inertia * record.slope / cell.viscous for record in records])
    return GridOutcome(errors, hits, found.source.coulomb.value - cell.coulomb, float(expected))


@kernel
def _ramp(
    torque: Array,
    noise: Array,
    electrics: tuple[float, float, float],
    shaft: Shaft,
    gear: tuple[float, float, float],
    joint: RigJoint,
    with_bristle: bool,
) -> tuple[Array, Array]:
    """Return angle at the beginning of each tick and motor torque of the slice before, each shape (n,)."""
    constant, resistance, supply = electrics
    angle = speed = bristle = motor = 0.0
    angles, motors = np.empty(torque.size), np.empty(torque.size)
    for k in range(torque.size):
        angles[k], motors[k] = angle, motor
        for i in range(SLICES):
            highest = (supply - constant * speed) / resistance * constant
            wanted = torque[k] + noise[k, i] if torque[k] > 0.0 else 0.0
            motor = max(0.0, min(wanted, highest))
            if with_bristle:
                angle, speed, bristle = turn_with_joint(
                    (angle, speed, bristle), motor, shaft, gear, joint, 1e-3
                )
            else:
                angle, speed = turn(angle, speed, motor, shaft, 1e-3)
    return angles, motors


def _near_limits(rig: Rig, counts: Array) -> Mask:
    """Tell for each reading of a motion, shape (n,), what `session.near_limits` tells for the last one."""
    travel, speed = rig.limit_codes()
    moved = counts - counts[0]
    before = np.concatenate((np.zeros(SPEED_TICKS), moved))[: moved.size]
    too_far = np.abs(moved) > LIMITS_SHARE * travel * TRAVEL_UNIT
    return too_far | (np.abs(moved - before) > LIMITS_SHARE * speed * SPEED_TICKS)


@dataclass
class QuickRig:
    """A rig that runs ramps; amplifier and noise are drawn from `seed`, once and for each ramp."""

    rig: Rig
    seed: int

    def __post_init__(self) -> None:
        assert self.rig.emulation is not None
        self.plant: Emulation = self.rig.emulation
        self._rng = np.random.default_rng(self.seed)
        self.gain = 1.0 + self.plant.amplifier.gain_error * self._rng.standard_normal()

    def _drawn(self, loaded: bool) -> tuple[float, Shaft]:
        """Draw what differs from ramp to ramp: the torque's gain, and the shaft with its joint's Coulomb friction."""
        gain, shaft, plant = self.gain, shaft_of(self.rig, loaded), self.plant
        if plant.amplifier.ramp_error:
            gain *= 1.0 + plant.amplifier.ramp_error * self._rng.standard_normal()
        if loaded and plant.joint_spread and isinstance(plant.joint, JointFriction):
            more = (
                plant.joint_spread
                * self._rng.standard_normal()
                * plant.joint.coulomb
                / self.rig.joint_scale
            )
            shaft = shaft._replace(coulomb=shaft.coulomb + more)
        return gain, shaft

    def ramp(self, slope: float, end_torque: float, loaded: bool, label: str) -> RampRecord:
        """Return one ramp; it ends, as that of the host, where the rig file's speed or travel is nearly reached."""
        rig, plant = self.rig, self.plant
        step = rig.ramp_step(slope)
        ticks = np.arange((rig.end_code(end_torque) * RAMP_FRACTION - 128 + step - 1) // step)
        command = rig.commanded_torque(1) * ((128 + ticks * step) // RAMP_FRACTION)
        noise = plant.amplifier.torque_noise * self._rng.standard_normal((ticks.size, SLICES))
        joint = plant.joint
        gain, shaft = self._drawn(loaded)
        element = (
            joint
            if isinstance(joint, FrictionElement)
            else FrictionElement(tau_c=1, tau_s=1, omega_s=1, delta=1, c0=1, c1=0, c2=0)
        )
        angle, motor = _ramp(
            gain * command,
            noise,
            (plant.motor.torque_constant, plant.motor.resistance, plant.motor.supply),
            shaft,
            (rig.gear.ratio, rig.gear.efficiency, plant.load_inertia + plant.joint_inertia),
            joint_record(element, rig.gear.ratio, SLICE, self.seed),
            loaded and isinstance(joint, FrictionElement),
        )
        scale = rig.counts_per_revolution / math.tau
        counts = np.floor(angle * scale + self._rng.random())
        beyond = _near_limits(rig, counts)
        end = int(np.argmax(beyond)) if beyond.any() else ticks.size
        reading = np.maximum(
            0.0, motor + plant.amplifier.adc_noise * self._rng.standard_normal(ticks.size)
        )
        codes = np.minimum(CODES, np.rint(reading / rig.torque.adc_full_scale * CODES))
        return RampRecord(
            time=ticks[:end] * rig.tick,
            angle=(counts[:end] - counts[0]) / scale,
            slope=rig.slope_of_step(step),
            angle_step=1 / scale,
            torque=command[:end],
            measured_torque=codes[:end] * rig.torque.adc_full_scale / CODES,
            loaded=loaded,
            label=label,
        )


@dataclass
class Outcome:
    """What one measurement gave: by name the relative error and whether the interval held; unused ramps; a refusal."""

    errors: dict[str, float] = field(default_factory=dict)
    hits: dict[str, bool] = field(default_factory=dict)
    unused: int = 0
    refusal: str = ""


def measure(rig: Rig, seed: int) -> list[RampRecord]:
    """Return all ramps of a measurement as `rx90 rig ramp` runs them."""
    quick = QuickRig(rig, seed)
    records: list[RampRecord] = []
    for loaded in (False, True):

        def one(slope: float, label: str, loaded: bool = loaded) -> RampRecord:
            records.append(quick.ramp(slope, rig.ramps.end(loaded), loaded, label))
            return records[-1]

        run_planned(one, rig.ramps, loaded, lambda first: plan_from(first, rig.ramps, rig))
    return records


def random_experiment(job: tuple[int, int, str]) -> Outcome:
    """Measure one random rig."""
    seed, number, kind = job
    rig = load_rig(config_path(SOURCE_RIG)) if kind == SPREAD else random_rig(seed, number, kind)
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
        note_all(f"{name}, source's m b / a", part.source, truths[name])
    outcome.refusal = "; ".join(result.failures)
    if result.joint is not None:
        joint = truths["loaded"] - truths["no-load"]
        note("f_c, joint", result.joint.coulomb, float(joint[0]))
        note("f_v, joint", result.joint.viscous, float(joint[1]))
    return outcome


def _covered(hits: list[bool]) -> tuple[float, str]:
    """Return the share of intervals that hold, and its text with the 95 % margin."""
    share = float(np.mean(hits))
    return share, f"{100 * share:.1f} ± {196 * math.sqrt(share * (1 - share) / len(hits)):.1f} %"


def measure_grid() -> tuple[list[str], bool]:
    """Print the figures of the grid; return what is not accepted, and whether all was measured."""
    cells = grid()
    native_library({})  # built once, before several processes want it
    jobs = [
        (cell, 1000 * number + seed) for number, cell in enumerate(cells) for seed in range(SEEDS)
    ]
    found = in_processes(grid_experiment, jobs, "grid", 4)
    outcomes, whole = [*found.values()], len(found) == len(jobs)
    by_cell: dict[Cell, list[GridOutcome]] = {}
    for (cell, _), outcome in found.items():
        by_cell.setdefault(cell, []).append(outcome)
    if not found:
        return [], whole
    cells, results = [*by_cell], [*by_cell.values()]
    print(
        f"{len(outcomes)} experiments: {len(cells)} rigs, {SEEDS} seeds, {REPEATS} repeats at 2 slopes"
    )
    rows, wrong = [], []
    for quantity in QUANTITIES:
        bias = np.array([np.mean([o.errors[quantity] for o in cell]) for cell in results])
        share, cover = _covered([o.hits[quantity] for o in outcomes])
        worst = float(np.abs(bias).max())
        rows.append((quantity, f"{100 * bias.mean():+.3f} %", f"{100 * worst:.2f} %", cover))
        if worst >= BIAS or not COVERAGE[0] <= share <= COVERAGE[1]:
            wrong.append(quantity)
    print_table(
        ("estimate", "mean bias", "worst rig's bias (< 1 %)", "coverage (90 to 99 %)"), rows
    )
    expected = np.array([np.mean([o.inertia_times_a for o in cell]) for cell in results])
    ratio = np.array([np.mean([o.excess for o in cell]) for cell in results]) / expected
    share_of_f_c = expected / [cell.coulomb for cell in cells]
    off = float(np.max(np.abs(ratio - 1.0) * share_of_f_c))
    print(
        f"source's f_c = m b / a: high by J a, {100 * share_of_f_c.min():.1f} to {100 * share_of_f_c.max():.1f} % of "
        f"f_c; found {ratio.mean():.3f} of J a in the mean, at worst off by {100 * off:.2f} % of f_c (< 1 %)"
    )
    return [*wrong, "the source's bias"] if off >= BIAS else wrong, whole


def measure_random(rigs: int, seed: int, kinds: tuple[str, ...]) -> tuple[list[str], bool]:
    """Print the figures of rigs, so many of each kind; return what is not accepted, and whether all was measured."""
    wrong, rows, whole = [], [], True
    for kind in kinds:
        outcomes = [
            *in_processes(
                random_experiment, [(seed, number, kind) for number in range(rigs)], kind, 4
            ).values()
        ]
        whole = len(outcomes) == rigs
        names = dict.fromkeys(name for outcome in outcomes for name in outcome.hits)
        for name in sorted(names, key=lambda name: ("source" in name, name)):
            having = [outcome for outcome in outcomes if name in outcome.hits]
            share, cover = _covered([outcome.hits[name] for outcome in having])
            errors = 100 * np.array([outcome.errors[name] for outcome in having])
            most = f"{np.percentile(np.abs(errors), 95):.2f} %"
            rows.append(
                (f"{kind}: {name}", str(len(having)), f"{errors.mean():+.2f} %", most, cover)
            )
            if "source" not in name and not COVERAGE[0] <= share <= COVERAGE[1] + 0.01:
                wrong.append(f"{kind}: {name}")
        refusals = [outcome.refusal for outcome in outcomes if outcome.refusal]
        unused = sum(outcome.unused for outcome in outcomes)
        print(f"{kind}: {len(refusals)} of {len(outcomes)} rigs refused, {unused} ramps not used")
        print(*sorted(set(refusals)), sep="\n")
        if not whole:
            break
    print_table(
        ("estimate", "rigs", "mean error", "95 % of errors below", "intervals that hold"), rows
    )
    return wrong, whole


def main() -> int:
    """Measure what is asked for; return 1 if a figure is not what is accepted."""
    options = arguments(
        __doc__,
        ("what", ("grid", "random", "spread"), "which rigs"),
        ("--rigs", 200, "random ones of each kind"),
        ("--seed", 1, "of random rigs"),
    )
    if options.what == "grid":
        return accepted(*measure_grid())
    kinds = KINDS if options.what == "random" else (SPREAD,)
    return accepted(*measure_random(options.rigs, options.seed, kinds))


if __name__ == "__main__":
    sys.exit(main())
