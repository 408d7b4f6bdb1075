"""Identify the sliding regime of all friction elements from sweeps at constant velocity (paper, section 4)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.stats import t as student

from rx90_common.base.arrays import Array
from rx90_common.base.errors import IdentificationError
from rx90_emulator.identification.arm import RigidArm
from rx90_emulator.identification.estimates import (
    NOT_IN_MODEL,
    SLIDING,
    VISCOUS_EXPONENT,
    ElementEstimate,
    ParameterEstimate,
)
from rx90_emulator.identification.options import SLIDING_PARTS, model_parts
from rx90_emulator.identification.records import BagSource, JointRecord
from rx90_emulator.identification.sanity import Recorded, mistake_alarms
from rx90_emulator.identification.sliding.plateaus import BagUse, Blocks, find_blocks
from rx90_emulator.identification.sliding.quality import MISFIT_SD, CurvePoints, FitQuality
from rx90_emulator.identification.sliding.solver import (
    EXPONENT,
    FITTED,
    LINEAR,
    OMEGA_S,
    RISE,
    SHAPE,
    SIZE,
    CurveFit,
    natural,
    natural_jacobian,
    sliding_rows,
    torque,
    torque_jacobian,
)

MIN_SPEEDS = 5
"""Least number of speeds in each direction: four determine the seven parameters of an element, and one more leaves a
degree of freedom.

A viscous exponent needs one more speed.
"""
_SAME_SPEED_RATIO = 1.1  # ratio of speeds up to which they count as one
_SIGNIFICANT_SD = 3.0  # standard deviations of the Stribeck rise from 0, and of an exponent from 1
_MIN_EXPONENT_SHIFT = 0.02  # least relevant distance of a viscous exponent from 1
_MIN_EXPONENT_SCORE = 2.0  # standard deviations by which a step from the linear fit moves an exponent
_MAX_RELATIVE_SD = 0.3  # relative standard deviation up to which a parameter is identifiable
_MAX_CORRELATION = 0.98  # correlation above which two parameters cannot be separated
_SYSTEMATIC_SD = 1e-3
"""Relative standard deviation beyond repeatability: the mean of a sampled torque whose ripple is nearly synchronous
with the sampling has an error of this size even far from a beat (measured on the engine, whose parameters are
known)."""
_STRIBECK = ("tau_s_positive", "tau_s_negative", "omega_s", "delta")
_LINE_POINTS = 100
_DOES_NOT_SLIDE = "does not slide at constant velocity; accepted: sweeps in both directions"


@dataclass(frozen=True, eq=False)
class SlidingFit:
    """The sliding regime of all elements.

    Attributes:
        estimates: for each element of the arm, in its order; the parameters are those in SLIDING, and the viscous
            exponent where it is not 1.
        curves: for each element; empty where the element could not be identified.
        inertial: estimated error of the arm's inertial parameters, to be added to them, shape (10 n,):
            rigid torque = arm.torque(...) + arm.regressor(...) @ inertial.
        inertial_covariance: its covariance, the prior's along directions that sweeps do not observe, shape
            (10 n, 10 n).
        plateaus: number of stretches of constant velocity that were used.
        usage: what was used of each record, and why the rest was not.
        quality: goodness of fit of each element; None where it could not be identified.
        doubt: which sign or zero looks wrong, in words; empty if none does.
    """

    estimates: tuple[ElementEstimate, ...]
    curves: tuple[CurvePoints, ...]
    inertial: Array
    inertial_covariance: Array
    plateaus: int
    usage: tuple[BagUse, ...] = ()
    quality: tuple[FitQuality | None, ...] = ()
    doubt: str = ""


def identify_sliding(
    records: Sequence[JointRecord], arm: RigidArm, zero: Array | None = None, model: Sequence[str] | None = None
) -> SlidingFit:
    """Fit tau_c+-, tau_s+-, omega_s, delta, c2 and, where the data prefer one, alpha of every element that slides.

    Errors of the arm's inertial parameters, such as an unknown payload, are nuisance parameters of the same fit, so
    that they do not bias the friction. Parameters that are not identifiable are marked as such in the estimates.

    Args:
        records: sweeps of the arm's joints at constant velocity, both directions, several speeds.
        arm: rigid-body model.
        zero: zeros of the encoders that were subtracted from the records, rad, shape (n,); by default 0.
        model: names of the parts in SLIDING_PARTS that all elements have; by default the significant ones.
    """
    names = arm.element_names
    where = ", ".join(str(record.source) for record in records)
    blocks, usage = find_blocks(records, arm.element_matrix)
    blocks, lacking = _enough(blocks, arm)
    if len(lacking) == len(names):
        # The reason of an element that moves is more informative than that of one at rest.
        name = min(lacking, key=lambda name: lacking[name] == _DOES_NOT_SLIDE)
        raise IdentificationError(f"{where}: {name} {lacking[name]}")
    motion = np.stack([blocks.position, blocks.velocity, blocks.acceleration])
    used = ~(~blocks.sliding @ (arm.element_matrix != 0.0)) & arm.identified
    doubt = "; ".join(mistake_alarms(arm, Recorded(motion, blocks.torque, used, blocks.plateau), zero=zero))
    rows = sliding_rows(blocks, arm)
    free = np.zeros((len(names), SIZE), dtype=np.bool_)
    free[[name not in lacking for name in names], :EXPONENT] = True
    fit = CurveFit(rows, free)
    drives = (fit.at_bound & free)[:, LINEAR].all(axis=1)  # all torques lie at their bound, 0
    for e in np.flatnonzero(drives).tolist():
        # Such torques may be the weight of an arm in another pose.
        error = (
            f"{where}: {names[e]}: the torque does not oppose the motion; accepted: efforts of the sign with which "
            "the drive moves the joint (check the signs of gears and torque constants)"
        )
        raise IdentificationError("; ".join(filter(None, (error, doubt))))
    requested = None if model is None else model_parts(model, SLIDING_PARTS)
    fit = _with_shown_parameters(fit) if requested is None else _with_parts(fit, requested)
    sources = tuple(record.bag for record in records)
    estimates = []
    curves = []
    quality = []
    for e, name in enumerate(names):
        if name in lacking:
            estimates.append(ElementEstimate.unknown(name, SLIDING, lacking[name], sources))
        else:
            given = requested is None or "stribeck-rise" in requested
            estimates.append(_estimate(fit, names, e, usage, sources, rising=given))
        curves.append(_curve(fit, e))
        quality.append(
            FitQuality.of(curves[e], float(fit.agreement[e]), fit.widening[e], fit.drifts[e])
            if len(curves[e].velocity)
            else None
        )
    # The covariance of the inertial errors is that of the prior where nothing is observed.
    scale = arm.inertial_scale()
    directions = rows.directions
    scaled = directions / scale[:, None]
    covariance = directions @ fit.nuisance_covariance @ directions.T
    covariance += scale[:, None] * (np.eye(len(scale)) - scaled @ scaled.T) * scale
    inertial = directions @ fit.nuisance
    count = len(np.unique(rows.plateau))
    return SlidingFit(tuple(estimates), tuple(curves), inertial, covariance, count, usage, tuple(quality), doubt)


def _enough(blocks: Blocks, arm: RigidArm) -> tuple[Blocks, dict[str, str]]:
    """Mark elements with sweeps at too few speeds as not sliding; return the blocks, and the reasons by element."""
    velocity = blocks.velocity @ arm.element_matrix.T
    sliding = blocks.sliding.copy()
    lacking = {}
    for e, name in enumerate(arm.element_names):
        up, down = _speeds(velocity[sliding[:, e], e])
        if up == down == 0:
            lacking[name] = _DOES_NOT_SLIDE
        elif min(up, down) == 0:
            only = "positive" if up else "negative"
            lacking[name] = f"slides at {only} velocities only; accepted: sweeps in both directions"
        elif min(up, down) < MIN_SPEEDS:
            lacking[name] = (
                f"slides at {up} speeds in positive and {down} in negative direction; accepted: {MIN_SPEEDS} or "
                "more in each"
            )
        if name in lacking:
            sliding[:, e] = False
    return replace(blocks, sliding=sliding), lacking


def _speeds(velocity: Array) -> tuple[int, int]:
    """Return how many distinct speeds there are in positive and in negative direction."""
    counts = [0, 0]
    for side, sign in enumerate((1.0, -1.0)):
        least = 0.0
        for value in np.sort(np.abs(velocity[sign * velocity > 0.0])).tolist():
            if value > least:
                counts[side] = counts[side] + 1
                least = _SAME_SPEED_RATIO * value
    return counts[0], counts[1]


def _with_parts(fit: CurveFit, parts: Sequence[str]) -> CurveFit:
    """Return the fit with the same parts for all elements; an element with too few speeds has no exponent."""
    free = fit.free.copy()
    if "stribeck-rise" not in parts:
        free[:, RISE] = free[:, SHAPE] = False
    if "viscous-exponent" in parts:
        free[:, EXPONENT] = fit.free.any(axis=1) & (np.array(_least_speeds(fit)) > MIN_SPEEDS)
    return CurveFit(fit.rows, free)


def _least_speeds(fit: CurveFit) -> list[int]:
    """Return the number of speeds of each element in the direction with fewer of them."""
    pairs = zip(fit.rows.velocity.T, fit.rows.gain.T, strict=True)
    return [min(_speeds(velocity[gain != 0.0])) for velocity, gain in pairs]


def _with_shown_parameters(fit: CurveFit) -> CurveFit:
    """Return the fit with the significant parameters: Stribeck effects, and exponents that differ from 1."""
    rows = fit.rows
    free = fit.free.copy()
    linear = _drop_insignificant_stribeck(fit)
    # Most data are linear in velocity, which a step from the linear solution shows at a fraction of a fit's cost.
    free[:, EXPONENT] = (np.array(_least_speeds(fit)) > MIN_SPEEDS) & (linear.exponent_score > _MIN_EXPONENT_SCORE)
    while free[:, EXPONENT].any():
        fit = _drop_insignificant_stribeck(CurveFit(rows, free.copy()))
        has_exponent = np.array([_has_exponent(fit, e) for e in range(len(free))])
        if (has_exponent == free[:, EXPONENT]).all():
            return fit
        free[:, EXPONENT] = has_exponent
    return linear


def _drop_insignificant_stribeck(fit: CurveFit) -> CurveFit:
    """Return the fit, repeated without insignificant Stribeck effects: no rise, or omega_s at its bound."""
    free = fit.free.copy()
    for e in np.flatnonzero(free[:, SHAPE].all(axis=1)).tolist():
        deviation = np.sqrt(np.diag(fit.block(e)))[RISE]
        # At a bound the deviation has no meaning; a rise of 0 is at one.
        insignificant = (fit.parameters[e, RISE] < _SIGNIFICANT_SD * deviation).all()
        if insignificant or fit.at_bound[e, OMEGA_S]:
            free[e, RISE] = free[e, SHAPE] = False
    return fit if (free == fit.free).all() else CurveFit(fit.rows, free)


def _has_exponent(fit: CurveFit, element: int) -> bool:
    """Return whether the viscous exponent of an element differs from 1 significantly, and is not at a bound.

    The deviations are those of the result: a misfit common to plateaus or speeds does not count as evidence.
    """
    if not fit.free[element, EXPONENT] or fit.at_bound[element, EXPONENT]:
        return False
    deviation_from_one = abs(float(np.exp(fit.parameters[element, EXPONENT])) - 1.0)
    deviation = float(np.sqrt(_natural_covariance(fit, element)[-1, -1]))
    return deviation_from_one > max(_MIN_EXPONENT_SHIFT, _SIGNIFICANT_SD * deviation)


def _natural_covariance(fit: CurveFit, element: int) -> Array:
    """Return the covariance of an element's parameters in the form of `natural`, shape (8, 8).

    It is that of the fit, times the squared t factor and the design effect of plateaus at one speed or, if larger, the
    factor of a misfit, plus errors beyond repeatability.
    """
    own_rows = fit.rows.gain[:, element] != 0.0
    design = float(fit.design_effect[own_rows].mean())
    wider = np.sqrt(np.maximum(design, fit.widening[element]))
    # The degrees of freedom are Satterthwaite's: with the intraclass correlation of a plateau's blocks each plateau is
    # one observation, with the rest of the variance each block is one. The factor is that of the 97.5 % quantiles.
    common = float(fit.common[own_rows].mean())
    fitted = int(fit.free[element].sum())
    plateaus = max(1, len(np.unique(fit.rows.plateau[own_rows])) - fitted)
    freedom = 1.0 / (common**2 / plateaus + (1.0 - common) ** 2 / max(1, int(own_rows.sum()) - fitted))
    factor = float(student.ppf(0.975, freedom) / student.ppf(0.975, np.inf))
    transform = natural_jacobian(fit.parameters[element])
    covariance = transform @ (wider[:, None] * fit.block(element) * wider) @ transform.T * factor**2
    # Independent for each parameter, so that no correlation changes its sign.
    unseen = _SYSTEMATIC_SD * np.array(list(natural(fit.parameters[element]).values()))
    if not fit.free[element, EXPONENT]:
        unseen[-1] = 0.0
    return np.asarray(covariance + np.diag(unseen**2))


def _estimate(
    fit: CurveFit,
    names: Sequence[str],
    element: int,
    usage: Sequence[BagUse],
    sources: tuple[BagSource, ...],
    *,
    rising: bool,
) -> ElementEstimate:
    chosen = (*SLIDING, VISCOUS_EXPONENT) if fit.free[element, EXPONENT] else SLIDING
    covariance = _natural_covariance(fit, element)[: len(chosen), : len(chosen)]
    values = natural(fit.parameters[element])
    estimates = {}
    for name, deviation in zip(chosen, np.sqrt(np.diag(covariance)).tolist(), strict=True):
        estimate = ParameterEstimate(values[name], deviation)
        missing = name in _STRIBECK and not rising
        reason = NOT_IN_MODEL if missing else _reason(fit, names, element, name, estimate, usage)
        estimates[name] = ParameterEstimate.unknown(reason) if reason else estimate
    return ElementEstimate.of(names[element], estimates, covariance, sources)


def _reason(
    fit: CurveFit, names: Sequence[str], element: int, name: str, estimate: ParameterEstimate, usage: Sequence[BagUse]
) -> str:
    """Return why a parameter is not identifiable; empty if it is."""
    if name in _STRIBECK and not fit.free[element, SHAPE].any():
        speed = np.abs(fit.rows.velocity[fit.rows.gain[:, element] != 0.0, element])
        unused = np.concatenate([use.unused[:, element] for use in usage])
        slower = unused[(unused > 0.0) & (unused < speed.min())]
        more = f"; what it does at {slower.min():.3g} rad/s was recorded, but could not be used" if len(slower) else ""
        return f"no Stribeck effect shows at speeds from {speed.min():.3g} to {speed.max():.3g} rad/s{more}"
    if estimate.deviation > _MAX_RELATIVE_SD * abs(estimate.value):
        size = f"standard deviation {estimate.deviation:.3g} at a value of {estimate.value:.3g}"
        size += ", as the curve does not fit" * bool(fit.agreement[element] > MISFIT_SD)
        # The parameter, of any element, that this one is fully correlated with.
        own = element * SIZE + FITTED.index(name)
        deviation = np.sqrt(np.diag(fit.covariance))
        with np.errstate(divide="ignore", invalid="ignore"):
            correlation = np.abs(fit.covariance[own] / (deviation * deviation[own]))
        correlation[~fit.free.ravel()] = correlation[own] = 0.0
        other = int(np.nanargmax(correlation))
        if correlation[other] > _MAX_CORRELATION:
            return f"not separable from {FITTED[other % SIZE]} of {names[other // SIZE]}: {size}"
        return size
    if name in ("omega_s", "delta") and fit.at_bound[element, FITTED.index(name)]:
        return f"at the bound of its range, {estimate.value:.3g}"
    return ""


def _curve(fit: CurveFit, element: int) -> CurvePoints:
    """Subtract everything but one element from the equations, and average over each plateau."""
    rows = fit.rows
    parameters = fit.parameters[element]
    own_rows = np.flatnonzero(rows.gain[:, element])
    gain = rows.gain[own_rows, element]
    along = rows.velocity[own_rows, element]
    own_torque = fit.residual[own_rows] + gain * torque(along, parameters)
    number = np.unique(rows.plateau[own_rows], return_inverse=True)[1]
    power = np.bincount(number, gain**2)
    weighted = np.bincount(number, gain**2 * along)
    pull = np.bincount(number, gain * own_torque)
    noise = np.bincount(number, (gain * fit.noise[own_rows]) ** 2)
    time = np.bincount(number, rows.time[own_rows])
    velocity = weighted / power
    line = np.zeros((3, 0))
    if len(own_rows):  # velocity, torque and standard deviation of the identified curve
        sides = [(sign, sign * velocity[sign * velocity > 0.0]) for sign in (-1.0, 1.0)]
        grids = [sign * np.geomspace(speed.min(), speed.max(), _LINE_POINTS) for sign, speed in sides if len(speed)]
        grid = np.sort(np.concatenate(grids))
        slope = np.linalg.solve(natural_jacobian(parameters).T, torque_jacobian(grid, parameters).T).T
        deviation = np.sqrt(np.einsum("ki,ij,kj->k", slope, _natural_covariance(fit, element), slope))
        line = np.stack([grid, torque(grid, parameters), deviation])
    seconds = time / np.bincount(number)
    return CurvePoints(velocity, pull / power, np.sqrt(noise) / power, torque(velocity, parameters), seconds, line)
