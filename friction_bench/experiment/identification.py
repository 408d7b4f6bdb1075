"""From ramps to friction: the source's formulas, the exact fit, their uncertainties, and the joint's own friction.

By the source, for each ramp whose asymptote a t - b shows: f_v = m / a and f_c = m b / a, which is biased high by J a.
The exact f_c = m b / a - J a needs J, which needs two slopes; it comes from all ramps in one fit (`sliding_fit`), which
uses a ramp from where the shaft slides. A ramp that cannot be used is left out, and the result says which and why.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np
from scipy import stats

from friction_bench.experiment.asymptote import RampFit, ShortRampError, fit_asymptote
from friction_bench.experiment.four_way import FourWay, compare
from friction_bench.experiment.record import RampModel, RampRecord, SlidingWindow, break_away, sliding_window
from friction_bench.experiment.sliding_fit import RampsFit, fit_sliding
from friction_bench.rig.rig_file import Rig
from rx90_common.base.arrays import Array
from rx90_common.base.errors import IdentificationError

LEVEL = 0.95
INCONSISTENT = 0.01
"""Below this p-value the intervals come from the repeats' scatter, not from the fits' covariances."""
SAME_SLOPE = 0.02
"""Slopes closer than this, relative, are one slope."""


@dataclass(frozen=True)
class IntervalEstimate:
    """A value with its standard uncertainty and its 95 % interval."""

    value: float
    error: float
    low: float
    high: float


@dataclass(frozen=True)
class RampFriction:
    """Coulomb friction f_c, Nm, viscous friction f_v, Nm s/rad, inertia J, kg m², at the motor.

    `inertia` is None where one slope alone was run. The covariance is that of random errors, without the torque
    scale's: `covariance` in the order f_c, f_v (and J), `freedom` its degrees of freedom.
    """

    coulomb: IntervalEstimate
    viscous: IntervalEstimate
    inertia: IntervalEstimate | None
    covariance: Array
    freedom: float = math.inf


@dataclass(frozen=True)
class UsedRamp:
    """One ramp that was used; time counts from the zero of the commanded torque.

    Attributes:
        break_away: time of break-away, s.
        time, velocity: where it was fitted, s, and the fitted velocity, rad/s, shape (n,).
        asymptote: by the source's method; None where the ramp is too short for it.
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
    """What was identified from a set of ramps under one load.

    Attributes:
        source: the source's f_c = m b / a and f_v = m / a, mean over the ramps long enough for it; None without any.
        exact: fit of all ramps, intervals from its covariance; None with one slope.
        repeated: the same, intervals from the scatter of the repeats; None with fewer than 2 repeats.
        consistency: p-value of the chi-square test of the ramps' scatter against the fit's covariance.
        stribeck: probability that the friction falls with the velocity after break-away; None with one slope.
        unused: why each ramp was left out that could not be used, one line each.
    """

    ramps: tuple[UsedRamp, ...]
    source: RampFriction | None
    exact: RampFriction | None
    repeated: RampFriction | None
    consistency: float
    stribeck: float | None
    unused: tuple[str, ...]

    @property
    def best(self) -> RampFriction:
        """Return the exact estimate, else the source's.

        Its interval is the covariance's, unless the repeats scatter more than that can explain.
        """
        if self.exact is None:
            assert self.source is not None  # one of them there is: identify_ramps refuses otherwise
            return self.source
        if self.repeated is not None and self.consistency < INCONSISTENT:
            return self.repeated
        return self.exact


def interval(value: float, random: float, freedom: float, scale: float) -> IntervalEstimate:
    """Return an estimate from its random error and the torque scale's relative uncertainty.

    The two are independent; the degrees of freedom are combined after Welch and Satterthwaite.
    """
    systematic = abs(value) * scale
    total = math.hypot(random, systematic)
    effective = freedom if math.isinf(freedom) or random == 0.0 else freedom * (total / random) ** 4
    factor = (
        float(stats.t.ppf((1 + LEVEL) / 2, effective)) if effective < 1e6 else float(stats.norm.ppf((1 + LEVEL) / 2))
    )
    return IntervalEstimate(value, total, value - factor * total, value + factor * total)


def source_formulas(a: float, b: float, m: float) -> tuple[float, float]:
    """Return the source's f_c = m b / a and f_v = m / a (equations 4 and 5)."""
    return m * b / a, m / a


def slopes_of(ramps: Iterable[RampRecord | UsedRamp]) -> list[float]:
    """Return the slopes of some ramps that differ by more than SAME_SLOPE, ascending."""
    distinct: list[float] = []
    for slope in sorted(ramp.slope for ramp in ramps):
        if not distinct or slope > distinct[-1] * (1 + SAME_SLOPE):
            distinct.append(slope)
    return distinct


def identify_ramps(records: Sequence[RampRecord], scale_uncertainty: float) -> RampIdentification:
    """Identify friction from the ramps of one rig under one load.

    Args:
        records: at least one ramp.
        scale_uncertainty: relative standard uncertainty of the torque scale, common to all ramps.

    Raises:
        IdentificationError: if there is no ramp, none can be used, or the result is not physical.
    """
    if not records:
        raise IdentificationError("no ramp to identify from")
    windows: list[SlidingWindow] = []
    unused: list[str] = []
    for record in records:
        try:
            windows.append(sliding_window(record))
        except IdentificationError as error:
            unused.append(str(error))
    if not windows:
        raise _no_ramp_left(unused)
    if len(slopes_of(window.record for window in windows)) < 2:
        return _one_slope(records, scale_uncertainty)
    while True:
        fit = fit_sliding(windows)
        asymptotes, straight = [], []
        for window in windows:
            try:
                asymptotes.append(_asymptote(window.record, fit))
                straight.append(window)
            except IdentificationError as error:
                unused.append(str(error))
        if len(straight) == len(windows):
            return _from_fit(windows, fit, asymptotes, scale_uncertainty, tuple(unused))
        windows = straight
        if len(slopes_of(window.record for window in windows)) < 2:
            raise _no_ramp_left(unused)


def _no_ramp_left(reasons: Sequence[str]) -> IdentificationError:
    more = f" (and {len(reasons) - 1} more ramps that cannot be used)" if len(reasons) > 1 else ""
    return IdentificationError(reasons[0] + more)


def _one_slope(records: Sequence[RampRecord], scale: float) -> RampIdentification:
    """Identify by the source's method alone: with one slope J is unknown."""
    ramps, unused = [], []
    for record in records:
        try:
            fit = fit_asymptote(record)
        except IdentificationError as error:
            unused.append(str(error))
            continue
        time = record.time - record.origin
        time = time[time >= fit.window[0]]
        ramps.append(UsedRamp(record, fit.break_away, time, fit.a * time - fit.b, fit))
    if not ramps:
        raise _no_ramp_left(unused)
    return RampIdentification(tuple(ramps), _by_source(ramps, scale), None, None, 1.0, None, tuple(unused))


def _asymptote(record: RampRecord, fit: RampsFit) -> RampFit | None:
    """Return the asymptote by the source's method, with T of all ramps; None where the ramp is too short for it."""
    _, viscous, inertia = fit.values
    try:
        return fit_asymptote(record, max(float(inertia / viscous), record.tick / 4))
    except ShortRampError:
        return None


def _from_fit(
    windows: Sequence[SlidingWindow],
    fit: RampsFit,
    of_ramps: Sequence[RampFit | None],
    scale: float,
    unused: tuple[str, ...],
) -> RampIdentification:
    coulomb, viscous, inertia = (float(value) for value in fit.values)
    if not (viscous > 0.0 and inertia > 0.0):
        raise IdentificationError(
            f"the ramps give a viscous friction of {viscous:.3g} Nm s/rad and an inertia of {inertia:.3g} kg m²; "
            "accepted: > 0"
        )
    ramps = []
    for window, velocity, asymptote in zip(windows, fit.velocities, of_ramps, strict=True):
        model = RampModel(coulomb, viscous, inertia, window.record.slope)
        start = break_away(window.record, model)
        ramps.append(UsedRamp(window.record, start, window.time, velocity, asymptote))
    square, freedom = fit.chi_square()
    return RampIdentification(
        ramps=tuple(ramps),
        source=_by_source(ramps, scale),
        exact=_friction(fit.values, fit.covariance, math.inf, scale),
        repeated=_by_repeats(fit, ramps, scale),
        consistency=float(stats.chi2.sf(square, freedom)),
        stribeck=fit.stribeck,
        unused=unused,
    )


def _by_source(ramps: Sequence[UsedRamp], scale: float) -> RampFriction | None:
    """Return the source's f_c = m b / a and f_v = m / a (equations 4 and 5), mean over the ramps with an asymptote."""
    fits = [(ramp.slope, ramp.asymptote) for ramp in ramps if ramp.asymptote is not None]
    if not fits:
        return None
    covariance = np.zeros((2, 2))
    for m, fit in fits:
        to_friction = m * np.array([[-fit.b / fit.a**2, 1 / fit.a], [-1 / fit.a**2, 0.0]])
        covariance += to_friction @ fit.covariance @ to_friction.T / len(fits) ** 2
    values = np.array([source_formulas(fit.a, fit.b, m) for m, fit in fits]).mean(axis=0)
    return _friction(values, covariance, math.inf, scale)


def _friction(values: Array, covariance: Array, freedom: float, scale: float) -> RampFriction:
    errors = np.sqrt(np.diag(covariance))
    estimates = [interval(float(v), float(e), freedom, scale) for v, e in zip(values, errors, strict=True)]
    return RampFriction(estimates[0], estimates[1], estimates[2] if len(estimates) > 2 else None, covariance, freedom)


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
    repeats = min(len(group) for group in repeated)
    values = np.array([fit.subset([group[i] for group in repeated]) for i in range(repeats)])
    covariance = np.cov(values.T) / repeats
    return _friction(values.mean(axis=0), covariance, repeats - 1, scale)


@dataclass(frozen=True)
class JointFrictionEstimate:
    """The joint alone: loaded less no-load, at the motor and carried to the joint's side of the gear."""

    coulomb: IntervalEstimate
    viscous: IntervalEstimate
    joint_side_coulomb: IntervalEstimate
    joint_side_viscous: IntervalEstimate


def joint_friction(unloaded: RampIdentification, loaded: RampIdentification, rig: Rig) -> JointFrictionEstimate:
    """Return f_joint = f_load - f_noload with propagated uncertainty.

    Both were measured on the same torque scale: its error scales the difference and counts once.
    The gear takes the torque to the joint's side with n eta, the viscous coefficient with n^2 eta.
    """
    motor, joint = [], []
    scales = (rig.gear_ratio * rig.gear_efficiency, rig.gear_ratio**2 * rig.gear_efficiency)
    relative = math.hypot(rig.scale_uncertainty, rig.efficiency_uncertainty / rig.gear_efficiency)
    high, low = loaded.best, unloaded.best
    values = high.coulomb.value - low.coulomb.value, high.viscous.value - low.viscous.value
    for index, (value, factor) in enumerate(zip(values, scales, strict=True)):
        variances = high.covariance[index, index], low.covariance[index, index]
        random = math.sqrt(sum(variances))
        shares = variances[0] ** 2 / high.freedom + variances[1] ** 2 / low.freedom
        freedom = float(sum(variances)) ** 2 / shares if shares > 0.0 else math.inf
        motor.append(interval(value, random, freedom, rig.scale_uncertainty))
        joint.append(interval(value * factor, random * factor, freedom, relative))
    return JointFrictionEstimate(motor[0], motor[1], joint[0], joint[1])


@dataclass(frozen=True)
class RampTestResult:
    """The result of a measurement; each part None where it was not run."""

    unloaded: RampIdentification | None
    loaded: RampIdentification | None
    joint: JointFrictionEstimate | None
    comparison: FourWay | None
    failures: tuple[str, ...] = ()
    """Why a load that was run carries no estimate, one line each."""

    @property
    def parts(self) -> list[tuple[str, RampIdentification]]:
        """Return the identified loads by name."""
        both = (("no-load", self.unloaded), ("loaded", self.loaded))
        return [(name, part) for name, part in both if part is not None]


def evaluate(records: Sequence[RampRecord], rig: Rig) -> RampTestResult:
    """Identify friction from all ramps of a measurement, and compare one ramp with the models.

    Raises:
        IdentificationError: if no load carries an estimate.
    """
    parts: dict[bool, RampIdentification] = {}
    failures = []
    for loaded in (False, True):
        chosen = [record for record in records if record.loaded is loaded]
        try:
            if chosen:
                parts[loaded] = identify_ramps(chosen, rig.scale_uncertainty)
        except IdentificationError as error:
            failures.append(str(error))
    if not parts:
        raise IdentificationError(failures[0] if failures else "no ramp to identify from")
    joint = joint_friction(parts[False], parts[True], rig) if len(parts) == 2 else None
    comparison = _comparison(parts[max(parts)], rig)
    return RampTestResult(parts.get(False), parts.get(True), joint, comparison, tuple(failures))


def _comparison(part: RampIdentification, rig: Rig) -> FourWay | None:
    """Compare the first ramp of the slowest slope; without an identified inertia there is no model of it."""
    best = part.best
    if best.inertia is None or best.inertia.value <= 0.0:
        return None
    slowest = slopes_of(part.ramps)[0]
    ramp = min(part.ramps, key=lambda r: abs(r.slope - slowest))
    release = max(ramp.break_away * ramp.slope - best.coulomb.value, 0.0)
    model = RampModel(best.coulomb.value, best.viscous.value, best.inertia.value, ramp.slope, release)
    return compare(ramp.record, model, rig.gear_ratio)
