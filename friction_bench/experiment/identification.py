"""From ramps to friction: the source's formulas, the exact fit, their uncertainties, and the joint's own friction.

The source's method, for each ramp with a visible asymptote a t - b: f_v = m / a and f_c = m b / a, which is biased high
by J a. The exact f_c = m b / a - J a needs J, which needs two slopes; it comes from all ramps in one fit
(`sliding_fit`), which uses each ramp from the beginning of sliding. A ramp that cannot be used is left out, and the
result gives the reason.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import NamedTuple, TypeVar

import numpy as np
from numpy.typing import ArrayLike
from scipy import stats

from friction_bench.experiment.asymptote import RampFit, ShortRampError, fit_asymptote
from friction_bench.experiment.four_way import FourWay, compare
from friction_bench.experiment.record import RampModel, RampRecord, break_away, sliding_window
from friction_bench.experiment.sliding_fit import RampsFit, fit_sliding
from friction_bench.rig.plant import shaft_of
from friction_bench.rig.rig_file import Rig
from rx90_common.base.arrays import Array
from rx90_common.base.errors import VERDICT_NO, IdentificationError
from rx90_common.base.quoting import counted

LEVEL = 0.95
SLOPE_TOLERANCE = 0.02
"""Slopes closer than this, relative, are one slope."""

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


@dataclass(frozen=True)
class RampFriction:
    """Coulomb friction f_c, Nm, viscous friction f_v, Nm s/rad, inertia J, kg m², at the motor.

    `inertia` is None where one slope alone was run. The covariance is that of random errors, without the torque
    scale's: `covariance` in the order f_c, f_v (and J), `freedom` the degrees of freedom of its diagonal.
    """

    coulomb: IntervalEstimate
    viscous: IntervalEstimate
    inertia: IntervalEstimate | None
    covariance: Array
    freedom: Array

    @classmethod
    def of(cls, values: Array, covariance: Array, scale: float, freedom: ArrayLike = math.inf) -> RampFriction:
        """Return the friction with intervals, for a relative uncertainty of the torque scale."""
        errors = np.sqrt(np.diag(covariance))
        freedoms = np.broadcast_to(np.asarray(freedom, float), values.shape)
        coulomb, viscous, *inertia = (
            interval(float(v), float(e), float(f), scale) for v, e, f in zip(values, errors, freedoms, strict=True)
        )
        return cls(coulomb, viscous, inertia[0] if inertia else None, covariance, freedoms)


@dataclass(frozen=True)
class UsedRamp:
    """One ramp that was used; time counts from the zero of the commanded torque.

    Attributes:
        break_away: time of break-away, s.
        time, velocity: times of the fit, s, and the fitted velocity, rad/s, shape (n,).
        asymptote: by the source's method; None if the ramp is too short for it.
    """

    record: RampRecord
    break_away: float
    time: Array
    velocity: Array
    asymptote: RampFit | None

    @property
    def slope(self) -> float:
        """Return m, Nm/s."""
        return self.record.slope


@dataclass(frozen=True)
class RampIdentification:
    """Friction and inertia identified from a set of ramps under one load.

    Attributes:
        source: the source's f_c = m b / a and f_v = m / a, mean over the ramps long enough for it; None without any.
        exact: fit of all ramps, intervals from its covariance, which contains the differences from ramp to ramp; None
            with one slope.
        repeated: from each repeat alone, intervals from their scatter, for comparison; None with fewer than 2 repeats.
        consistency: p-value of the chi-square test that the ramps differ only by torque noise and counts.
        spread: standard deviations from ramp to ramp of the torque's scale and of f_c, relative, shape (2,); None with
            one slope.
        stribeck: probability that the friction falls with the velocity after break-away; None with one slope.
        unused: the reason for each ramp that could not be used, one line each.
    """

    ramps: tuple[UsedRamp, ...]
    source: RampFriction | None
    exact: RampFriction | None
    repeated: RampFriction | None
    consistency: float
    spread: Array | None
    stribeck: float | None
    unused: tuple[str, ...]

    @property
    def best(self) -> RampFriction:
        """Return the exact estimate, else the source's."""
        found = self.exact or self.source
        assert found is not None  # one of them there is: identify_ramps refuses otherwise
        return found


def interval(value: float, random: float, freedom: float, scale: float) -> IntervalEstimate:
    """Return an estimate from its random error and the torque scale's relative uncertainty.

    The two are independent; the degrees of freedom are combined after Welch and Satterthwaite.
    """
    systematic = abs(value) * scale
    total = math.hypot(random, systematic)
    effective = freedom if random == 0.0 else freedom * (total / random) ** 4
    share = (1 + LEVEL) / 2
    reach = total * float(stats.t.ppf(share, effective) if effective < 1e6 else stats.norm.ppf(share))
    return IntervalEstimate(value, total, value - reach, value + reach)


def source_formulas(a: float, b: float, m: float) -> tuple[float, float]:
    """Return the source's f_c = m b / a and f_v = m / a (equations 4 and 5)."""
    return m * b / a, m / a


def slopes_of(ramps: Iterable[RampRecord | UsedRamp]) -> list[float]:
    """Return the slopes of some ramps that differ by more than SLOPE_TOLERANCE, ascending."""
    distinct: list[float] = []
    for slope in sorted(ramp.slope for ramp in ramps):
        if not distinct or slope > distinct[-1] * (1 + SLOPE_TOLERANCE):
            distinct.append(slope)
    return distinct


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
    records, windows, unused = _usable(records, sliding_window)
    if len(slopes_of(records)) == 1:
        return _one_slope(records, scale_uncertainty, unused)
    while len(slopes_of(records)) > 1:
        fit = fit_sliding(windows)
        coulomb, viscous, inertia = fit.values.tolist()
        T = max(inertia / viscous, records[0].tick / 4)
        straight, asymptotes, unfitted = _usable(windows, lambda window, T=T: _asymptote(window.record, T))  # type: ignore[misc]
        unused += unfitted
        if not unfitted:
            break
        windows = straight
        records = [window.record for window in straight]
    else:
        raise _no_ramp_left(unused)
    if not (viscous > 0.0 and inertia > 0.0):
        raise UnphysicalError(
            f"the ramps give a viscous friction of {viscous:.3g} Nm s/rad and an inertia of {inertia:.3g} kg m²; "
            "accepted: > 0, by more repeats, or slopes farther apart"
        )
    ramps = []
    for window, velocity, asymptote in zip(windows, fit.velocities, asymptotes, strict=True):
        start = break_away(window.record, RampModel(coulomb, viscous, inertia, window.record.slope))
        ramps.append(UsedRamp(window.record, start, window.time, velocity, asymptote))
    return RampIdentification(
        ramps=tuple(ramps),
        source=_by_source(ramps, scale_uncertainty),
        exact=RampFriction.of(fit.values, fit.covariance, scale_uncertainty, fit.freedom),
        repeated=_by_repeats(fit, ramps, scale_uncertainty),
        consistency=float(stats.chi2.sf(*fit.chi_square())),
        spread=fit.spread,
        stribeck=fit.stribeck,
        unused=tuple(map(str, unused)),
    )


def _no_ramp_left(reasons: Sequence[IdentificationError]) -> IdentificationError:
    more = f" (and {counted(len(reasons) - 1, 'more ramp')} that cannot be used)" if len(reasons) > 1 else ""
    return IdentificationError(f"{reasons[0]}{more}" if reasons else "no ramp to identify from")


def _one_slope(
    records: Sequence[RampRecord], scale: float, unused: Sequence[IdentificationError]
) -> RampIdentification:
    """Identify by the source's method alone: with one slope J is unknown."""
    used, fits, reasons = _usable(records, fit_asymptote)
    if not used:
        raise _no_ramp_left([*unused, *reasons])
    ramps = []
    for record, fit in zip(used, fits, strict=True):
        time = record.time - record.origin
        time = time[time >= fit.window[0]]
        ramps.append(UsedRamp(record, fit.break_away, time, fit.a * time - fit.b, fit))
    why = tuple(map(str, (*unused, *reasons)))
    return RampIdentification(tuple(ramps), _by_source(ramps, scale), None, None, 1.0, None, None, why)


def _asymptote(record: RampRecord, T: float) -> RampFit | None:
    """Return the asymptote by the source's method, with T of all ramps; None if the ramp is too short for it."""
    try:
        return fit_asymptote(record, T)
    except ShortRampError:
        return None


def _by_source(ramps: Sequence[UsedRamp], scale: float) -> RampFriction | None:
    """Return the source's f_c = m b / a and f_v = m / a (equations 4 and 5), mean over the ramps with an asymptote.

    The covariance of several ramps of one slope is that of their scatter, which contains the differences from ramp to
    ramp;
    otherwise it is that of their fits, because ramps of other slopes also differ by J a.
    """
    fits = [(ramp.slope, ramp.asymptote) for ramp in ramps if ramp.asymptote is not None]
    if not fits:
        return None
    values = np.array([source_formulas(fit.a, fit.b, m) for m, fit in fits])
    if len(fits) > 1 and len(slopes_of(ramps)) == 1:
        return RampFriction.of(values.mean(axis=0), np.cov(values.T) / len(fits), scale, len(fits) - 1)
    covariance = np.zeros((2, 2))
    for m, fit in fits:
        to_friction = m * np.array([[-fit.b / fit.a**2, 1 / fit.a], [-1 / fit.a**2, 0.0]])
        covariance += to_friction @ fit.covariance @ to_friction.T / len(fits) ** 2
    return RampFriction.of(values.mean(axis=0), covariance, scale)


def _by_repeats(fit: RampsFit, ramps: Sequence[UsedRamp], scale: float) -> RampFriction | None:
    """Identify each repeat by itself and take the intervals from their scatter, without a model of the noise.

    A slope that was run once, as the first ramp of a measurement may be, belongs to no repeat.
    """
    groups: dict[float, list[int]] = {slope: [] for slope in slopes_of(ramps)}
    for k, ramp in enumerate(ramps):
        groups[min(groups, key=lambda slope: abs(slope - ramp.slope))].append(k)
    repeated = [group for group in groups.values() if len(group) > 1]
    if len(repeated) < 2:
        return None
    values = np.array([fit.subset(chosen) for chosen in zip(*repeated, strict=False)])
    return RampFriction.of(values.mean(axis=0), np.cov(values.T) / len(values), scale, len(values) - 1)


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
    found = []
    for index, factor in enumerate(factors):
        value = (high.coulomb, high.viscous)[index].value - (low.coulomb, low.viscous)[index].value
        variances = high.covariance[index, index], low.covariance[index, index]
        random = math.sqrt(sum(variances))
        shares = variances[0] ** 2 / high.freedom[index] + variances[1] ** 2 / low.freedom[index]
        freedom = float(sum(variances)) ** 2 / shares if shares > 0.0 else math.inf
        found.append(interval(value * factor, random * factor, freedom, scale))
    return found[0], found[1]


def joint_friction(unloaded: RampIdentification, loaded: RampIdentification, rig: Rig) -> JointFrictionEstimate:
    """Return f_joint = f_load - f_noload with propagated uncertainty.

    Both were measured on the same torque scale: its error scales the difference and counts once.
    The gear takes the torque to the joint's side with n eta, the viscous coefficient with n^2 eta.
    """
    factors = rig.joint_scale, rig.joint_scale * rig.gear.ratio
    motor = difference(loaded.best, unloaded.best, rig.torque.scale_uncertainty)
    return JointFrictionEstimate(*motor, *difference(loaded.best, unloaded.best, rig.joint_scale_uncertainty, factors))


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
    joint = round(figures["loaded"].total - figures["no-load"].total, 3) if len(figures) == 2 else None
    return SourceEvaluation(figures, joint)


@dataclass(frozen=True)
class RampTestResult:
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
        single = [name for name, part in self.parts if part.exact is None]
        if single:
            remedy = (
                f"{' and '.join(single)} had one slope: f_c contains J a, whose size is unknown, and a single ramp "
                "does not show what differs from ramp to ramp; run two slopes, and each several times"
            )
        else:
            remedy = "the difference of the loads is below what they tell; run more repeats, or more load"
        quantities = zip(("Coulomb", "viscous"), self.written, ("Nm", "Nm s/rad"), strict=True)
        return tuple(
            f"{of} {name} friction is {one} {unit}; accepted: > 0. {remedy}"
            for name, one, unit in quantities
            if one.value <= 0.0
        )


def evaluate(records: Sequence[RampRecord], rig: Rig, as_source: bool = False) -> RampTestResult:
    """Identify friction from all ramps of a measurement, and compare one ramp with the models.

    Args:
        records: all ramps.
        rig: on which they were run.
        as_source: also evaluate them as the source does.
    """
    loads = {"no-load": [r for r in records if not r.loaded], "loaded": [r for r in records if r.loaded]}
    names, parts, refusals = _usable(
        [name for name in loads if loads[name]], lambda name: identify_ramps(loads[name], rig.torque.scale_uncertainty)
    )
    if not parts:
        raise refusals[0] if refusals else IdentificationError("no ramp to identify from")
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
