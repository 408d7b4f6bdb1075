"""From ramps to friction: one fit of all ramps of a load, the source's formulas, and the joint's own friction.

The source's method: the velocity's asymptote a t - b gives f_v = m / a and f_c = m b / a, which is high by J a. The
exact f_c = m b / a - J a needs J, which needs two slopes. Both come from the same fit (`sliding_fit`), which uses each
ramp from the beginning of sliding. A ramp that cannot be used is left out, and the result gives the reason.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import NamedTuple, TypeVar

import numpy as np
from scipy.stats import norm

from friction_bench.experiment.four_way import FourWay, compare
from friction_bench.experiment.record import RampModel, RampRecord, break_away, sliding_window
from friction_bench.experiment.sliding_fit import find_bends, fit_sliding
from friction_bench.rig.plant import shaft_of
from friction_bench.rig.rig_file import Rig
from rx90_common.base.arrays import Array
from rx90_common.base.errors import VERDICT_NO, IdentificationError
from rx90_common.estimation.choose import Gain

LEVEL = 0.95
POORLY_KNOWN = 0.25
"""Standard uncertainty of f_v, relative, from which ramps of one slope are refused."""

_Item = TypeVar("_Item")
_Result = TypeVar("_Result")


class UnphysicalError(IdentificationError):
    """The ramps were evaluated, but the result is no valid friction: a verdict, not a refusal."""

    exit_code = VERDICT_NO


class IntervalEstimate(NamedTuple):
    """A value with its standard uncertainty and its 95 % interval."""

    value: float
    error: float
    low: float
    high: float

    def __str__(self) -> str:
        """Return value and interval."""
        return f"{self.value:.4g} [{self.low:.4g}, {self.high:.4g}]"


class RampFriction(NamedTuple):
    """Coulomb friction f_c, Nm, viscous friction f_v, Nm s/rad, inertia J, kg m², at the motor.

    `inertia` is None where one slope alone was run. `covariance`, in the order f_c, f_v (and J), is that of random
    errors, without the torque scale's.
    """

    coulomb: IntervalEstimate
    viscous: IntervalEstimate
    inertia: IntervalEstimate | None
    covariance: Array

    @classmethod
    def of(cls, values: Array, covariance: Array, scale: float) -> RampFriction:
        """Return the friction with intervals, for a relative uncertainty of the torque scale."""
        errors = np.sqrt(np.diag(covariance)).tolist()
        found = [
            interval(value, error, scale)
            for value, error in zip(values.tolist(), errors, strict=True)
        ]
        return cls(found[0], found[1], found[2] if len(found) > 2 else None, covariance)


class UsedRamp(NamedTuple):
    """One ramp that was used; time counts from the zero of the commanded torque.

    Attributes:
        break_away: time of break-away, s.
        time, velocity: times of the fit, s, and the fitted velocity, rad/s, shape (n,).
        asymptote: a, rad/s², and b, rad/s, of this ramp.
    """

    record: RampRecord
    break_away: float
    time: Array
    velocity: Array
    asymptote: tuple[float, float]

    @property
    def slope(self) -> float:
        """Return m, Nm/s."""
        return self.record.slope


class RampIdentification(NamedTuple):
    """Friction and inertia identified from a set of ramps under one load.

    Attributes:
        source: the source's f_c = m b / a and f_v = m / a of the fitted asymptotes, mean over the ramps.
        exact: f_c without J a, f_v and J; None with one slope.
        spread: standard deviations from ramp to ramp of the torque's scale and of f_c, relative, shape (2,).
        effect: what a Stribeck effect after break-away explains.
        unused: the reason for each ramp that could not be used, one line each.
    """

    ramps: tuple[UsedRamp, ...]
    source: RampFriction
    exact: RampFriction | None
    spread: Array
    effect: Gain
    unused: tuple[str, ...]

    @property
    def best(self) -> RampFriction:
        """Return the exact estimate, else the source's."""
        return self.exact or self.source


def interval(value: float, random: float, scale: float) -> IntervalEstimate:
    """Return an estimate from its random error and the torque scale's relative uncertainty, which are independent."""
    total = math.hypot(random, value * scale)
    reach = total * float(norm.ppf((1 + LEVEL) / 2))
    return IntervalEstimate(value, total, value - reach, value + reach)


def source_formulas(a: float, b: float, m: float) -> tuple[float, float]:
    """Return the source's f_c = m b / a and f_v = m / a (equations 4 and 5)."""
    return m * b / a, m / a


def slopes_of(ramps: Iterable[RampRecord | UsedRamp]) -> list[float]:
    """Return the different slopes of some ramps, ascending."""
    return sorted({ramp.slope for ramp in ramps})


def _usable(
    items: Iterable[_Item], evaluate: Callable[[_Item], _Result]
) -> tuple[list[_Item], list[_Result], list[IdentificationError]]:
    """Return the items that can be evaluated, their results, and why the others cannot."""
    used = []
    results = []
    reasons = []
    for item in items:
        try:
            results.append(evaluate(item))
            used.append(item)
        except IdentificationError as error:
            reasons.append(error)
    return used, results, reasons


def identify_ramps(records: Sequence[RampRecord], scale_uncertainty: float) -> RampIdentification:
    """Identify friction from the ramps of one rig under one load.

    Args:
        records: at least one ramp.
        scale_uncertainty: relative standard uncertainty of the torque scale, common to all ramps.
    """
    _, windows, unused = _usable(records, sliding_window)
    bends = find_bends(windows) if windows else []
    straight = []
    for window, bend in zip(windows, bends, strict=True):
        if bend is None:
            straight.append(window)
            continue
        fault = (
            f"{window.record.label}: the velocity follows no straight asymptote, its slope goes from "
            f"{bend[0]:.4g} to {bend[1]:.4g} rad/s²; saturation, or a transient that is not over"
        )
        unused.append(IdentificationError(fault))
    windows = straight
    if not windows:
        raise unused[0]
    fit = fit_sliding(windows)
    one_slope = len(slopes_of(window.record for window in windows)) == 1
    _, viscous, inertia = fit.values.tolist()
    error = math.sqrt(fit.covariance[1, 1])
    if one_slope and not error < POORLY_KNOWN * viscous:
        raise IdentificationError(
            f"{windows[0].record.label}: the ramp is too short, its viscous friction is {viscous:.3g} ± {error:.2g} "
            "Nm s/rad (standard uncertainty); take a slower ramp or a higher end torque"
        )
    if viscous <= 0.0:
        raise UnphysicalError(
            f"the ramps give a viscous friction of {viscous:.3g} Nm s/rad; "
            "accepted: > 0, by more repeats, or slopes farther apart"
        )
    ramps = []
    for window, velocity, asymptote in zip(windows, fit.velocities, fit.asymptotes, strict=True):
        start = break_away(window.record, asymptote, None if one_slope else inertia / viscous)
        ramps.append(UsedRamp(window.record, start, window.time, velocity, asymptote))
    mean_slope = float(np.mean([ramp.slope for ramp in ramps]))
    return RampIdentification(
        ramps=tuple(ramps),
        source=RampFriction.of(*fit.at_slope(mean_slope), scale_uncertainty),
        exact=None if one_slope else RampFriction.of(fit.values, fit.covariance, scale_uncertainty),
        spread=fit.spread,
        effect=fit.effect,
        unused=tuple(map(str, unused)),
    )


class JointFrictionEstimate(NamedTuple):
    """The joint alone: loaded less no-load, at the motor and carried to the joint's side of the gear."""

    coulomb: IntervalEstimate
    viscous: IntervalEstimate
    joint_side_coulomb: IntervalEstimate
    joint_side_viscous: IntervalEstimate


def difference(
    high: RampFriction, low: RampFriction, scale: float, factors: tuple[float, float] = (1.0, 1.0)
) -> tuple[IntervalEstimate, IntervalEstimate]:
    """Return the differences of f_c and f_v between two measurements on the same torque scale, at the joint.

    Args:
        high: at the motor.
        low: the other one, at the motor.
        scale: relative standard uncertainty of the conversion of torques, which scales the difference and counts once.
        factors: conversion factors of f_c and f_v.
    """
    estimates = []
    for index, factor in enumerate(factors):
        value = (high.coulomb, high.viscous)[index].value - (low.coulomb, low.viscous)[index].value
        random = math.sqrt(high.covariance[index, index] + low.covariance[index, index])
        estimates.append(interval(value * factor, random * factor, scale))
    return estimates[0], estimates[1]


def joint_friction(
    unloaded: RampIdentification, loaded: RampIdentification, rig: Rig
) -> JointFrictionEstimate:
    """Return f_joint = f_load - f_noload with propagated uncertainty.

    Both were measured on the same torque scale: its error scales the difference and counts once.
    The gear takes the torque to the joint's side with n eta, the viscous coefficient with n^2 eta.
    """
    factors = rig.joint_scale, rig.joint_scale * rig.gear.ratio
    motor = difference(loaded.best, unloaded.best, rig.torque.scale_uncertainty)
    return JointFrictionEstimate(
        *motor, *difference(loaded.best, unloaded.best, rig.joint_scale_uncertainty, factors)
    )


class SourceFigures(NamedTuple):
    """One load by the source's own evaluation; its angles are read as degrees.

    Attributes:
        a, b: of the velocity a t - b, deg/s² and deg/s, means over the ramps.
        coulomb: m b / a, Nm, mean over the ramps.
        viscous: m / a, mean over the ramps, Nm s/deg; the source gives it in Nm.
        spread: standard deviation of `coulomb` from ramp to ramp, Nm; 0 with one ramp.
        ramps: how many.
        total: f_noload or f_load, to the three digits that the source states.
    """

    a: float
    b: float
    coulomb: float
    viscous: float
    spread: float
    ramps: int
    total: float


class SourceEvaluation(NamedTuple):
    """The source's figures: loads by name, and f_joint = f_load - f_noload, Nm; None if a load is missing."""

    loads: dict[str, SourceFigures]
    joint: float | None


SOURCE_STATES = SourceEvaluation(
    {
        "no-load": SourceFigures(949.5407, 227.8898, 0.1464, 6.4e-4, math.nan, 1, 0.147),
        "loaded": SourceFigures(981.3603, 412.1713, 0.231, 5.6e-4, math.nan, 1, 0.231),
    },
    0.084,
)
"""What it does state."""


def evaluate_as_source(loads: Mapping[str, Sequence[RampRecord]]) -> SourceEvaluation:
    """Evaluate as the source does: a line through each ramp's velocities, counts of a tick divided by its time.

    Each velocity belongs to the middle of its tick, and the line is fitted to those of a sliding shaft; the source
    states neither. The source adds f_v to f_c without load but not with it, a sum of different quantities, and
    subtracts rounded figures: so does this function.
    """
    figures = {}
    for name, records in loads.items():
        rows = []
        for window in _usable(records, sliding_window)[1]:
            record = window.record
            time = record.time - record.origin
            angle = np.degrees(record.angle)
            middle = (time[1:] + time[:-1]) / 2
            velocity = np.diff(angle) / np.diff(time)
            sliding = middle > window.time[0]
            a, minus_b = np.polyfit(middle[sliding], velocity[sliding], 1)
            rows.append((a, -minus_b, *source_formulas(a, -minus_b, record.slope)))
        if rows:
            a, b, coulomb, viscous = np.mean(rows, axis=0).tolist()
            spread = float(np.std([row[2] for row in rows], ddof=1)) if len(rows) > 1 else 0.0
            total = round(coulomb + (viscous if name == "no-load" else 0.0), 3)
            figures[name] = SourceFigures(a, b, coulomb, viscous, spread, len(rows), total)
    joint = (
        round(figures["loaded"].total - figures["no-load"].total, 3) if len(figures) == 2 else None
    )
    return SourceEvaluation(figures, joint)


class RampTestResult(NamedTuple):
    """The result of a measurement.

    Attributes:
        parts: the identified loads, by name.
        joint, comparison: None if they cannot be computed.
        failures: the reason for each load that was run without an estimate, one line each.
        as_source: by the source's own evaluation, if it was requested.
    """

    parts: list[tuple[str, RampIdentification]]
    joint: JointFrictionEstimate | None
    comparison: FourWay | None
    failures: tuple[str, ...] = ()
    as_source: SourceEvaluation | None = None

    @property
    def written(self) -> tuple[IntervalEstimate, IntervalEstimate]:
        """Return Coulomb and viscous friction as a friction file gets them: the joint's, else those of the one load."""
        best = self.parts[0][1].best
        return self.joint[2:] if self.joint is not None else (best.coulomb, best.viscous)

    @property
    def unphysical(self) -> tuple[str, ...]:
        """Return the invalid values among the joint's estimates, or those of the only load: value, cause and remedy."""
        of = "the joint's" if self.joint is not None else f"the {self.parts[0][0]}"
        remedy = (
            "the difference of the loads is below what they tell; run more repeats, or more load"
        )
        single = " and ".join(name for name, part in self.parts if part.exact is None)
        if single:
            remedy = (
                f"{single} had one slope: f_c contains J a, whose size is unknown; "
                "run two slopes, and each several times"
            )
        quantities = zip(("Coulomb", "viscous"), self.written, ("Nm", "Nm s/rad"), strict=True)
        return tuple(
            f"{of} {name} friction is {estimate} {unit}; accepted: > 0. {remedy}"
            for name, estimate, unit in quantities
            if estimate.value <= 0.0
        )


def evaluate(records: Sequence[RampRecord], rig: Rig, as_source: bool = False) -> RampTestResult:
    """Identify friction from all ramps of a measurement, and compare one ramp with the models.

    Args:
        records: all ramps.
        rig: on which they were run.
        as_source: also evaluate them as the source does.
    """
    loads = {
        "no-load": [r for r in records if not r.loaded],
        "loaded": [r for r in records if r.loaded],
    }
    names, parts, refusals = _usable(
        [name for name in loads if loads[name]],
        lambda name: identify_ramps(loads[name], rig.torque.scale_uncertainty),
    )
    if not parts:
        raise refusals[0]
    joint = joint_friction(parts[0], parts[1], rig) if len(parts) == 2 else None
    comparison = _compare_models(parts[-1], rig)
    by_source = evaluate_as_source(loads) if as_source else None
    named = list(zip(names, parts, strict=True))
    return RampTestResult(named, joint, comparison, tuple(map(str, refusals)), by_source)


def _compare_models(part: RampIdentification, rig: Rig) -> FourWay | None:
    """Compare the slowest ramp with the models; None if neither ramps nor rig file determine the inertia.

    With one slope the inertia is unknown, and the models use that of an emulated rig's file.
    """
    best = part.best
    ramp = min(part.ramps, key=lambda ramp: ramp.slope)
    if best.inertia is not None:
        inertia = best.inertia.value
    elif rig.emulation is not None:
        inertia = shaft_of(rig, ramp.record.loaded).inertia
    else:
        return None
    if not (inertia > 0.0 and best.coulomb.value > 0.0 and best.viscous.value > 0.0):
        return None
    release = max(ramp.break_away * ramp.slope - best.coulomb.value, 0.0)
    model = RampModel(best.coulomb.value, best.viscous.value, inertia, ramp.slope, release)
    return compare(ramp.record, model, rig.gear.ratio)
