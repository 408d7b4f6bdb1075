"""Identify the sliding regime of all friction elements from sweeps at constant velocity (paper, section 4)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.stats import t as student

from rx90_common.base.arrays import Array, Mask
from rx90_common.base.errors import IdentificationError
from rx90_common.base.quoting import quoted
from rx90_emulator.identification.model.estimates import SLIDING, VISCOUS_EXPONENT, ElementEstimate, ParameterEstimate
from rx90_emulator.identification.model.rigid_arm import RigidArm
from rx90_emulator.identification.model.zeros import ZeroCheck
from rx90_emulator.identification.records.record import BagSource, JointRecord, check_joints
from rx90_emulator.identification.sliding import stribeck
from rx90_emulator.identification.sliding.blocks import BagUse, Blocks, find_blocks, unused_speeds
from rx90_emulator.identification.sliding.equations import SlidingRows, sliding_rows
from rx90_emulator.identification.sliding.quality import FitQuality
from rx90_emulator.identification.sliding.solver import SlidingSolution, fit_curves, predicted
from rx90_emulator.identification.sliding.zeros import Instants, check_zeros, known_joints

_SIGNIFICANT_SD = 3.0  # standard deviations of the Stribeck rise from 0
_MAX_RELATIVE_SD = 0.3  # relative standard deviation up to which a parameter is identifiable
_MAX_CORRELATION = 0.98  # correlation from which two parameters cannot be separated
_SYSTEMATIC_SD = 1e-3
"""Relative standard deviation that repetition does not show: the mean of a sampled torque, rippling in step with the
sampling, is off by so much even far from a beat (measured on the engine, whose parameters are known)."""
_FITTED = ("tau_c_positive", "tau_c_negative", "tau_s_positive", "tau_s_negative", "c2", "omega_s", "delta", "alpha")
"""The parameters of the fit by the names that they determine."""
_STRIBECK = ("tau_s_positive", "tau_s_negative", "omega_s", "delta")
_OMEGA_S = 5  # place in the fit
_MIN_EXPONENT_SHIFT = 0.02  # distance of a viscous exponent from 1 that counts


def without_stribeck(solution: SlidingSolution) -> Mask:
    """Return which elements show no Stribeck effect, shape (n_el,): no significant rise, or omega_s at its bound."""
    flat = np.zeros(len(solution.free), dtype=np.bool_)
    for e in np.flatnonzero(solution.free[:, stribeck.SHAPE].all(axis=1)).tolist():
        rise = solution.parameters[e, stribeck.RISE]
        deviation = np.sqrt(np.diag(_block(solution, e)))[stribeck.RISE]
        # At a bound the deviation means nothing; a rise of 0 is on it.
        flat[e] = bool((rise < _SIGNIFICANT_SD * deviation).all()) or bool(solution.at_bound[e, _OMEGA_S])
    return flat


def with_viscous_exponent(solution: SlidingSolution) -> Mask:
    """Return which elements show a viscous exponent other than 1, shape (n_el,): significantly so, and not at a bound.

    The deviations are those of the result: a misfit that plateaus or speeds share does not count as evidence.
    """
    bent = np.zeros(len(solution.free), dtype=np.bool_)
    for e in np.flatnonzero(solution.free[:, stribeck.EXPONENT]).tolist():
        away = abs(float(np.exp(solution.parameters[e, stribeck.EXPONENT])) - 1.0)
        deviation = float(np.sqrt(natural_covariance(solution, e)[-1, -1]))
        at_bound = bool(solution.at_bound[e, stribeck.EXPONENT])
        bent[e] = away > max(_MIN_EXPONENT_SHIFT, _SIGNIFICANT_SD * deviation) and not at_bound
    return bent


def element_estimate(
    solution: SlidingSolution,
    names: Sequence[str],
    element: int,
    sources: tuple[BagSource, ...],
    usage: Sequence[BagUse],
) -> ElementEstimate:
    """Return the estimates of one element that was fitted.

    Args:
        solution: of the fit.
        names: of all elements.
        element: index of this one.
        sources: the bags.
        usage: what was used of each.
    """
    values = stribeck.natural(solution.parameters[element])
    covariance = natural_covariance(solution, element)
    estimates = {}
    names_here = (*SLIDING, VISCOUS_EXPONENT) if solution.free[element, stribeck.EXPONENT] else SLIDING
    covariance = covariance[: len(names_here), : len(names_here)]
    for name, deviation in zip(names_here, np.sqrt(np.diag(covariance)).tolist(), strict=True):
        estimate = ParameterEstimate(values[name], deviation)
        reason = _reason(solution, names, element, name, estimate, usage)
        estimates[name] = ParameterEstimate.unknown(reason) if reason else estimate
    return ElementEstimate.of(names[element], estimates, covariance, sources)


def natural_covariance(solution: SlidingSolution, element: int) -> Array:
    """Return the covariance of an element's parameters as `stribeck.natural` has them, shape (8, 8).

    It is that of the fit, times the squared t factor and the design effect of plateaus at one speed or, where it is
    larger, the factor of a misfit, plus what repetition does not show.
    """
    transform = stribeck.natural_jacobian(solution.parameters[element])
    design = float(solution.design_effect[solution.rows.gain[:, element] != 0.0].mean())
    wider = np.sqrt(np.maximum(design, solution.misfits[element].widening))
    block = wider[:, None] * _block(solution, element) * wider
    covariance = transform @ block @ transform.T * _t_factor(solution, element) ** 2
    values = stribeck.natural(solution.parameters[element])
    # Independent for each parameter, so that no correlation changes its sign.
    unseen = _SYSTEMATIC_SD * np.array(list(values.values()))
    if not solution.free[element, stribeck.EXPONENT]:
        unseen[-1] = 0.0
    return np.asarray(covariance + np.diag(unseen**2))


def _block(solution: SlidingSolution, element: int) -> Array:
    rows = slice(element * stribeck.SIZE, (element + 1) * stribeck.SIZE)
    return solution.covariance[rows, rows]


def _t_factor(solution: SlidingSolution, element: int) -> float:
    """Return the ratio of Student's 97.5 % quantile to the normal one.

    The degrees of freedom are Satterthwaite's: with the intraclass correlation of a plateau's blocks each plateau is
    one observation, with the rest of the variance each block is one.
    """
    mine = solution.rows.gain[:, element] != 0.0
    common = float(solution.common[mine].mean())
    fitted = int(solution.free[element].sum())
    plateaus = max(1, len(np.unique(solution.rows.plateau[mine])) - fitted)
    blocks = max(1, int(mine.sum()) - fitted)
    freedom = 1.0 / (common**2 / plateaus + (1.0 - common) ** 2 / blocks)
    return float(student.ppf(0.975, freedom) / student.ppf(0.975, np.inf))


def _reason(
    solution: SlidingSolution,
    names: Sequence[str],
    element: int,
    name: str,
    estimate: ParameterEstimate,
    usage: Sequence[BagUse],
) -> str:
    """Return why a parameter is not identifiable; empty if it is."""
    if name in _STRIBECK and not solution.free[element, stribeck.SHAPE].any():
        speed = np.abs(solution.rows.velocity[solution.rows.gain[:, element] != 0.0, element])
        lacking = unused_speeds(usage, element, float(speed.min()))
        slower = f"; what it does at {lacking[0]:.3g} rad/s was recorded, but could not be used" if len(lacking) else ""
        return f"no Stribeck effect shows at speeds from {speed.min():.3g} to {speed.max():.3g} rad/s{slower}"
    if estimate.deviation > _MAX_RELATIVE_SD * abs(estimate.value):
        partner = _partner(solution, names, element, name)
        size = f"standard deviation {estimate.deviation:.3g} at a value of {estimate.value:.3g}"
        size += ", as the curve does not fit" * solution.misfits[element].significant
        return f"not separable from {partner}: {size}" if partner else size
    if name in ("omega_s", "delta") and solution.at_bound[element, _FITTED.index(name)]:
        return f"at the bound of its range, {estimate.value:.3g}"
    return ""


def _partner(solution: SlidingSolution, names: Sequence[str], element: int, name: str) -> str:
    """Return the parameter, with its element, that this one is fully correlated with, or nothing."""
    own = element * stribeck.SIZE + _FITTED.index(name)
    deviation = np.sqrt(np.diag(solution.covariance))
    with np.errstate(divide="ignore", invalid="ignore"):
        correlation = np.abs(solution.covariance[own] / (deviation * deviation[own]))
    correlation[~solution.free.ravel()] = 0.0
    correlation[own] = 0.0
    other = int(np.nanargmax(correlation))
    if not correlation[other] > _MAX_CORRELATION:
        return ""
    return f"{_FITTED[other % stribeck.SIZE]} of {names[other // stribeck.SIZE]}"


LEAST_SPEEDS = 5
"""Speeds in each direction: four determine the seven parameters of an element, one more leaves a degree of freedom.

A viscous exponent takes another speed.
"""
_STRIBECK_COLUMNS = np.array([2, 3, 5, 6])  # parameters of the fit that are identifiable by a Stribeck effect only
_MIN_EXPONENT_SCORE = 2.0  # standard deviations by which a step from the linear fit moves an exponent
_LINE_POINTS = 100
_DOES_NOT_SLIDE = "does not slide at constant velocity; accepted: sweeps in both directions"
_SAME_SPEED_RATIO = 1.1  # ratio of speeds up to which they count as one


@dataclass(frozen=True, eq=False)
class CurvePoints:
    """Measured against fitted friction torque of one element, one point for each of p plateaus.

    Attributes:
        velocity: rad/s, shape (p,).
        torque: measured torque less the rigid arm's and the other elements', Nm, shape (p,).
        deviation: standard deviation of its noise, Nm, shape (p,).
        fitted: torque by the identified parameters, Nm, shape (p,).
        time: in the series, s, shape (p,).
        line: the identified curve over the measured speeds, in either direction: velocity, torque, and the standard
            deviation of the torque that follows from that of the parameters, shape (3, k).
    """

    velocity: Array
    torque: Array
    deviation: Array
    fitted: Array
    time: Array
    line: Array


@dataclass(frozen=True, eq=False)
class SlidingFit:
    """The sliding regime of all elements.

    Attributes:
        estimates: for each element of the arm, in its order; the parameters are those in SLIDING, and the viscous
            exponent where it is not 1.
        curves: for each element; empty where the element could not be identified.
        inertial: estimated error of the arm's inertial parameters, to be added to them, shape (10 n,):
            rigid torque = arm.torque(...) + arm.regressor(...) @ inertial.
        inertial_covariance: of it, that of the prior along directions that sweeps do not observe, shape (10 n, 10 n).
        plateaus: how many stretches of constant velocity were used.
        usage: what was used of each record, and why the rest was not.
        quality: goodness of fit of each element; None where it could not be identified.
        zeros: what the torques say of the encoders' zeros.
    """

    estimates: tuple[ElementEstimate, ...]
    curves: tuple[CurvePoints, ...]
    inertial: Array
    inertial_covariance: Array
    plateaus: int
    usage: tuple[BagUse, ...] = ()
    quality: tuple[FitQuality | None, ...] = ()
    zeros: ZeroCheck | None = None


def identify_sliding(
    records: Sequence[JointRecord], arm: RigidArm, required: Sequence[str] = (), zero: Array | None = None
) -> SlidingFit:
    """Fit tau_c+-, tau_s+-, omega_s, delta, c2 and, where they prefer one, alpha of every element that slides.

    Errors of the arm's inertial parameters, such as an unknown payload, are nuisance parameters of the same fit, so
    that they do not bias the friction. Parameters that are not identifiable are marked as such in the estimates.

    Args:
        records: sweeps at constant velocity, both directions, several speeds.
        arm: rigid-body model of the same joints.
        required: elements that must have sweeps at enough speeds; others may lack them.
        zero: of the encoders, that the records are without, rad, shape (n,); by default 0.

    Raises:
        IdentificationError: for other joints than the arm's; for no sweep; for too few speeds or a single direction of
            a required element, or of all elements; and for torques that do not oppose the motion.
    """
    check_joints(records, arm.names)
    for name in required:
        if name not in arm.element_names:
            raise IdentificationError(f"element {quoted(name)}; accepted: {', '.join(arm.element_names)}")
    blocks, usage = find_blocks(records, arm.element_matrix)
    blocks, lacking = _enough(blocks, arm)
    # Where none is left, what an element lacks that moves says more than that another one rests.
    none_slides = len(lacking) == len(arm.element_names)
    unusable = sorted(lacking, key=lambda name: lacking[name] == _DOES_NOT_SLIDE) if none_slides else ()
    for name in [*required, *unusable]:
        if name in lacking:
            where = ", ".join(str(record.source) for record in records)
            raise IdentificationError(f"{where}: {name} {lacking[name]}")
    zeros = check_zeros(_instants(blocks, arm), arm, zero)
    rows = sliding_rows(blocks, arm)
    slides = np.array([name not in lacking for name in arm.element_names])
    try:
        solution = _solution(records, arm, rows, slides)
    except IdentificationError as error:
        # Torques that do not oppose the motion may be the weight of an arm that stands elsewhere.
        raise IdentificationError("; ".join(filter(None, (str(error), zeros.text)))) from error
    sources = tuple(record.bag for record in records)
    estimates = tuple(
        ElementEstimate.unknown(name, SLIDING, lacking[name], sources)
        if name in lacking
        else element_estimate(solution, arm.element_names, e, sources, usage)
        for e, name in enumerate(arm.element_names)
    )
    curves = tuple(_curve(solution, e) for e in range(len(arm.element_names)))
    quality = tuple(
        FitQuality.of(
            curve.velocity,
            curve.torque - curve.fitted,
            curve.deviation,
            curve.torque,
            solution.misfits[e],
            solution.drifts[e],
        )
        if len(curve.velocity)
        else None
        for e, curve in enumerate(curves)
    )
    inertial = rows.directions @ solution.nuisance, _inertial_covariance(solution, arm)
    return SlidingFit(estimates, curves, *inertial, len(np.unique(rows.plateau)), usage, quality, zeros)


def _instants(blocks: Blocks, arm: RigidArm) -> Instants:
    known = known_joints(blocks.sliding, arm.element_matrix)
    return Instants(blocks.position, blocks.velocity, blocks.acceleration, blocks.torque, known, blocks.plateau)


def _solution(
    records: Sequence[JointRecord], arm: RigidArm, rows: SlidingRows, slides: NDArray[np.bool_]
) -> SlidingSolution:
    """Return the fit with the parameters that the data show: Stribeck effects, and exponents that differ from 1."""
    free = np.tile(slides, (stribeck.SIZE, 1)).T
    free[:, stribeck.EXPONENT] = False
    linear = fit_curves(rows, free)
    _check_signs(records, arm, linear)
    linear = _drop_insignificant_stribeck(rows, linear)
    # Most data are linear, and a step from their solution says so for a fraction of a fit.
    free[:, stribeck.EXPONENT] = (
        slides & _enough_speeds_for_exponent(rows) & (linear.exponent_score > _MIN_EXPONENT_SCORE)
    )
    solution = linear
    while free[:, stribeck.EXPONENT].any():
        solution = _drop_insignificant_stribeck(rows, fit_curves(rows, free))
        bent = with_viscous_exponent(solution)
        if (bent == free[:, stribeck.EXPONENT]).all():
            return solution
        free[:, stribeck.EXPONENT] = bent
    return linear


def _drop_insignificant_stribeck(rows: SlidingRows, solution: SlidingSolution) -> SlidingSolution:
    """Return the solution, fitted again without the Stribeck effects that do not show."""
    flat = without_stribeck(solution)
    if not flat.any():
        return solution
    free = solution.free.copy()
    free[np.ix_(flat, _STRIBECK_COLUMNS)] = False
    return fit_curves(rows, free)


def _enough_speeds_for_exponent(rows: SlidingRows) -> NDArray[np.bool_]:
    """Return which elements have a speed more than without a viscous exponent, in each direction, shape (n_el,)."""
    counts = []
    for velocity, gain in zip(rows.velocity.T, rows.gain.T, strict=True):
        signed = velocity[gain != 0.0]
        counts.append(min(_speeds(np.unique(np.abs(signed[sign * signed > 0.0]))) for sign in (1, -1)))
    return np.array(counts) > LEAST_SPEEDS


def _inertial_covariance(solution: SlidingSolution, arm: RigidArm) -> Array:
    """Return the covariance of the errors of the inertial parameters; that of the prior where nothing is observed."""
    scale, rows = arm.inertial_scale(), solution.rows
    seen = rows.directions / scale[:, None]
    unseen = np.eye(len(scale)) - seen @ seen.T
    return np.asarray(
        rows.directions @ solution.nuisance_covariance @ rows.directions.T + scale[:, None] * unseen * scale
    )


def _enough(blocks: Blocks, arm: RigidArm) -> tuple[Blocks, dict[str, str]]:
    """Mark elements with sweeps at too few speeds as not sliding, and return the blocks, and reasons by element."""
    velocity = blocks.velocity @ arm.element_matrix.T
    sliding = blocks.sliding.copy()
    lacking = {}
    for e, name in enumerate(arm.element_names):
        signed = velocity[sliding[:, e], e]
        counts = {sign: _speeds(np.abs(signed[np.sign(signed) == sign])) for sign in (1, -1)}
        if max(counts.values()) == 0:
            lacking[name] = _DOES_NOT_SLIDE
        elif min(counts.values()) == 0:
            only = "positive" if counts[1] else "negative"
            lacking[name] = f"slides at {only} velocities only; accepted: sweeps in both directions"
        elif min(counts.values()) < LEAST_SPEEDS:
            lacking[name] = (
                f"slides at {counts[1]} speeds in positive and {counts[-1]} in negative direction; "
                f"accepted: {LEAST_SPEEDS} or more in each"
            )
        if name in lacking:
            sliding[:, e] = False
    return replace(blocks, sliding=sliding), lacking


def _check_signs(records: Sequence[JointRecord], arm: RigidArm, solution: SlidingSolution) -> None:
    """Refuse torques that do not oppose the motion: all torques of an element lie at their bound, 0."""
    none = (solution.at_bound[:, stribeck.LINEAR] & solution.free[:, stribeck.LINEAR]).all(axis=1)
    for e in np.flatnonzero(none).tolist():
        where = ", ".join(str(record.source) for record in records)
        raise IdentificationError(
            f"{where}: {arm.element_names[e]}: the torque does not oppose the motion; accepted: efforts of the sign "
            "with which the drive moves the joint (check the signs of gears and torque constants)"
        )


def _speeds(speed: Array) -> int:
    """Return how many distinct speeds there are."""
    count, least = 0, 0.0
    for value in np.sort(speed):
        if value > least:
            count, least = count + 1, _SAME_SPEED_RATIO * float(value)
    return count


def _curve(solution: SlidingSolution, element: int) -> CurvePoints:
    """Subtract everything but one element from the equations, and average over each plateau."""
    rows = solution.rows
    gain = rows.gain[:, element]
    mine = np.flatnonzero(gain)
    own = stribeck.torque(rows.velocity[mine, element], solution.parameters[element])
    left = (rows.value - predicted(solution))[mine] + gain[mine] * own
    plateau, number = np.unique(rows.plateau[mine], return_inverse=True)
    power = np.bincount(number, gain[mine] ** 2, len(plateau))
    velocity = np.bincount(number, gain[mine] ** 2 * rows.velocity[mine, element], len(plateau)) / power
    time = np.bincount(number, rows.time[mine], len(plateau)) / np.bincount(number, minlength=len(plateau))
    return CurvePoints(
        velocity=velocity,
        torque=np.bincount(number, gain[mine] * left, len(plateau)) / power,
        deviation=np.sqrt(np.bincount(number, (gain * solution.noise)[mine] ** 2, len(plateau))) / power,
        fitted=stribeck.torque(velocity, solution.parameters[element]),
        time=time,
        line=_line(solution, element, velocity),
    )


def _line(solution: SlidingSolution, element: int, measured: Array) -> Array:
    """Return velocity, torque and standard deviation of the identified curve, shape (3, k)."""
    if len(measured) == 0:
        return np.zeros((3, 0))
    parts = [sign * measured[sign * measured > 0.0] for sign in (-1.0, 1.0)]
    grids = [np.geomspace(speed.min(), speed.max(), _LINE_POINTS) for speed in parts if len(speed)]
    velocity = np.sort(np.concatenate([sign * grid for sign, grid in zip((-1.0, 1.0), grids, strict=True)]))
    parameters = solution.parameters[element]
    covariance = natural_covariance(solution, element)
    slope = np.linalg.solve(
        stribeck.natural_jacobian(parameters).T, stribeck.torque_jacobian(velocity, parameters).T
    ).T  # by the parameters of `stribeck.natural`
    deviation = np.sqrt(np.einsum("ki,ij,kj->k", slope, covariance, slope))
    return np.stack([velocity, stribeck.torque(velocity, parameters), deviation])
