"""From fitted asymptotes to friction: the source's formulas, the exact ones, and their uncertainties.

Per ramp: f_v = m / a, and by the source f_c = m b / a, which is high by J a. The exact f_c = m b / a - J a
needs J, which needs two slopes. With alpha = 1 / f_v, beta = f_c / f_v, gamma = J / f_v^2 the asymptotes are
linear, a = alpha m and b = beta + gamma m, so that any number of ramps at any slopes is one least squares
problem.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np
from scipy import stats

from friction_bench.experiment.asymptote import RampFit, fit_asymptote
from friction_bench.experiment.record import RampRecord
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
class RampIdentification:
    """What was identified from a set of ramps under one load.

    Attributes:
        source: the source's f_c = m b / a and f_v = m / a, mean over all ramps.
        exact: with J from two slopes, intervals from the fits' covariance; None with one slope.
        repeated: the same, intervals from the scatter of the repeats; None with fewer than 2 repeats.
        consistency: p-value of the chi-square test of the ramps' scatter against the fits' covariances.
    """

    fits: tuple[RampFit, ...]
    source: RampFriction
    exact: RampFriction | None
    repeated: RampFriction | None
    consistency: float

    @property
    def break_away_torque(self) -> float:
        """Return the mean torque at break-away, Nm: the static friction where it exceeds f_c."""
        return float(np.mean([fit.break_away * fit.slope for fit in self.fits]))

    @property
    def best(self) -> RampFriction:
        """Return the exact estimate, else the source's.

        Its interval is the covariance's, unless the repeats scatter more than that can explain.
        """
        if self.exact is None:
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


def slopes_of(ramps: Iterable[RampRecord | RampFit]) -> list[float]:
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
        IdentificationError: if there is no ramp, one cannot be used, or the result is not physical.
    """
    if not records:
        raise IdentificationError("no ramp to identify from")
    two_slopes = len(slopes_of(records)) >= 2
    fits = [fit_asymptote(record, preliminary=two_slopes) for record in records]
    exact = None
    consistency = 1.0
    if two_slopes:
        fits = _with_common_time_constant(fits)
        linear, covariance, consistency = _least_squares(fits)
        exact = _exact(linear, covariance, math.inf, scale_uncertainty)
    return RampIdentification(
        fits=tuple(fits),
        source=_by_source(fits, scale_uncertainty),
        exact=exact,
        repeated=_by_repeats(fits, scale_uncertainty) if two_slopes else None,
        consistency=consistency,
    )


def _with_common_time_constant(fits: Sequence[RampFit]) -> list[RampFit]:
    """Fit again with J / f_v from all ramps: from one ramp alone it is a small difference of large numbers."""
    alpha, _, gamma = _least_squares(fits)[0]
    shortest = max(fit.record.tick for fit in fits) / 4
    return [fit_asymptote(fit.record, max(gamma / alpha, shortest)) for fit in fits]


def _by_source(fits: Sequence[RampFit], scale: float) -> RampFriction:
    values = np.zeros((len(fits), 2))
    covariance = np.zeros((2, 2))
    for row, fit in enumerate(fits):
        values[row] = source_formulas(fit.a, fit.b, fit.slope)
        to_friction = fit.slope * np.array([[-fit.b / fit.a**2, 1 / fit.a], [-1 / fit.a**2, 0.0]])
        covariance += to_friction @ fit.covariance @ to_friction.T / len(fits) ** 2
    coulomb, viscous = values.mean(axis=0)
    errors = np.sqrt(np.diag(covariance))
    return RampFriction(
        interval(float(coulomb), float(errors[0]), math.inf, scale),
        interval(float(viscous), float(errors[1]), math.inf, scale),
        None,
        covariance,
    )


def _least_squares(fits: Sequence[RampFit]) -> tuple[Array, Array, float]:
    """Return (alpha, beta, gamma), their covariance, and the p-value of the residuals' chi-square."""
    information = np.zeros((3, 3))
    right = np.zeros(3)
    rows = []
    for fit in fits:
        design = np.array([[fit.slope, 0.0, 0.0], [0.0, 1.0, fit.slope]])
        weight = np.linalg.inv(fit.covariance)
        information += design.T @ weight @ design
        right += design.T @ weight @ (fit.a, fit.b)
        rows.append((design, weight, np.array([fit.a, fit.b])))
    covariance = np.linalg.inv(information)
    linear = covariance @ right
    square = sum(float((y - X @ linear) @ W @ (y - X @ linear)) for X, W, y in rows)
    freedom = 2 * len(fits) - 3
    return linear, np.asarray(covariance), float(stats.chi2.sf(square, freedom))


def _friction_of(linear: Array) -> Array:
    alpha, beta, gamma = linear
    return np.array([beta / alpha, 1.0 / alpha, gamma / alpha**2])


def _exact(linear: Array, covariance: Array, freedom: float, scale: float) -> RampFriction:
    alpha, beta, gamma = linear
    if alpha <= 0.0:
        raise IdentificationError(f"the asymptotes give a negative viscous friction (1 / f_v = {alpha:.3g})")
    to_friction = np.array(
        [
            [-beta / alpha**2, 1 / alpha, 0.0],
            [-1 / alpha**2, 0.0, 0.0],
            [-2 * gamma / alpha**3, 0.0, 1 / alpha**2],
        ]
    )
    return _friction(_friction_of(linear), to_friction @ covariance @ to_friction.T, freedom, scale)


def _friction(values: Array, covariance: Array, freedom: float, scale: float) -> RampFriction:
    errors = np.sqrt(np.diag(covariance))
    estimates = [interval(float(v), float(e), freedom, scale) for v, e in zip(values, errors, strict=True)]
    return RampFriction(estimates[0], estimates[1], estimates[2], covariance, freedom)


def _by_repeats(fits: Sequence[RampFit], scale: float) -> RampFriction | None:
    """Identify each repeat by itself and take the intervals from their scatter, without a model of the noise."""
    groups: dict[float, list[RampFit]] = {slope: [] for slope in slopes_of(fits)}
    for fit in fits:
        nearest = min(groups, key=lambda slope: abs(slope - fit.slope))
        groups[nearest].append(fit)
    repeats = min(len(group) for group in groups.values())
    if repeats < 2:
        return None
    sets = [[group[i] for group in groups.values()] for i in range(repeats)]
    values = np.array([_friction_of(_least_squares(chosen)[0]) for chosen in sets])
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
        random, freedom = _difference(high, low, index)
        motor.append(interval(value, random, freedom, rig.scale_uncertainty))
        joint.append(interval(value * factor, random * factor, freedom, relative))
    return JointFrictionEstimate(motor[0], motor[1], joint[0], joint[1])


def _difference(loaded: RampFriction, unloaded: RampFriction, index: int) -> tuple[float, float]:
    """Return the random error of the difference of two estimates and its degrees of freedom."""
    variances = loaded.covariance[index, index], unloaded.covariance[index, index]
    total = float(sum(variances))
    shares = variances[0] ** 2 / loaded.freedom + variances[1] ** 2 / unloaded.freedom
    return math.sqrt(total), total**2 / shares if shares > 0.0 else math.inf
