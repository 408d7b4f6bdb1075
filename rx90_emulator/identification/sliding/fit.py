"""Identify the sliding regime of all friction elements from sweeps at constant velocity (paper, section 4)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from rx90_common.base.arrays import Array
from rx90_common.base.errors import IdentificationError
from rx90_common.base.quoting import quoted
from rx90_emulator.identification.model.estimates import SLIDING, ElementEstimate
from rx90_emulator.identification.model.rigid_arm import RigidArm
from rx90_emulator.identification.model.zeros import ZeroCheck
from rx90_emulator.identification.records.record import JointRecord
from rx90_emulator.identification.sliding import stribeck
from rx90_emulator.identification.sliding.blocks import Blocks, find_blocks
from rx90_emulator.identification.sliding.identifiability import (
    element_estimate,
    natural_covariance,
    with_viscous_exponent,
    without_stribeck,
)
from rx90_emulator.identification.sliding.quality import FitQuality
from rx90_emulator.identification.sliding.rows import SlidingRows, sliding_rows
from rx90_emulator.identification.sliding.solver import SlidingSolution, fit_curves, predicted
from rx90_emulator.identification.sliding.usage import BagUse
from rx90_emulator.identification.sliding.zeros import Instants, check_zeros, known_joints

LEAST_SPEEDS = 5
"""Speeds in each direction: four determine the seven parameters of an element, one more leaves a degree of freedom.

A viscous exponent takes another speed.
"""
_SHAPED = np.array([2, 3, 5, 6])  # parameters of the fit that are identifiable by a Stribeck effect only
_WORTH_A_FIT = 2.0  # standard deviations by which a step from the linear fit moves an exponent
_LINE_POINTS = 100
_RESTS = "does not slide at constant velocity; accepted: sweeps in both directions"
_SAME_SPEED = 1.1  # ratio of speeds up to which they count as one


@dataclass(frozen=True, eq=False)
class CurvePoints:
    """Measured against fitted friction torque of one element, one point for each of p plateaus.

    Attributes:
        velocity: rad/s, shape (p,).
        torque: measured torque less the rigid arm's and the other elements', Nm, shape (p,).
        deviation: standard deviation of its noise, Nm, shape (p,).
        fitted: torque by the identified parameters, Nm, shape (p,).
        source: number of the record, shape (p,).
        time: in the series, s, shape (p,).
        line: the identified curve over the measured speeds, in either direction: velocity, torque, and the standard
            deviation of the torque that follows from that of the parameters, shape (3, k).
    """

    velocity: Array
    torque: Array
    deviation: Array
    fitted: Array
    source: NDArray[np.int64]
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
    for record in records:
        if record.names != arm.names:
            raise IdentificationError(
                f"{record.source}: joints {', '.join(record.names)}; accepted: {', '.join(arm.names)}"
            )
    for name in required:
        if name not in arm.element_names:
            raise IdentificationError(f"element {quoted(name)}; accepted: {', '.join(arm.element_names)}")
    blocks, usage = find_blocks(records, arm.element_matrix)
    blocks, lacking = _enough(blocks, arm)
    # Where none is left, what an element lacks that moves says more than that another one rests.
    every = sorted(lacking, key=lambda name: lacking[name] == _RESTS) if len(lacking) == len(arm.element_names) else ()
    for name in [*required, *every]:
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
            e,
            curve.velocity,
            curve.torque - curve.fitted,
            curve.deviation,
            curve.torque,
            (solution.misfit, solution.drift),
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
    linear = _without_flat(rows, linear)
    # Most data are linear, and a step from their solution says so for a fraction of a fit.
    free[:, stribeck.EXPONENT] = slides & _bendable(rows) & (linear.bend > _WORTH_A_FIT)
    solution = linear
    while free[:, stribeck.EXPONENT].any():
        solution = _without_flat(rows, fit_curves(rows, free))
        bent = with_viscous_exponent(solution)
        if (bent == free[:, stribeck.EXPONENT]).all():
            return solution
        free[:, stribeck.EXPONENT] = bent
    return linear


def _without_flat(rows: SlidingRows, solution: SlidingSolution) -> SlidingSolution:
    """Return the solution, fitted again without the Stribeck effects that do not show."""
    flat = without_stribeck(solution)
    if not flat.any():
        return solution
    free = solution.free.copy()
    free[np.ix_(flat, _SHAPED)] = False
    return fit_curves(rows, free)


def _bendable(rows: SlidingRows) -> NDArray[np.bool_]:
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
            lacking[name] = _RESTS
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
            count, least = count + 1, _SAME_SPEED * float(value)
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
    source = np.zeros(len(plateau), dtype=np.int64)
    source[number] = rows.source[mine]
    time = np.bincount(number, rows.time[mine], len(plateau)) / np.bincount(number, minlength=len(plateau))
    return CurvePoints(
        velocity=velocity,
        torque=np.bincount(number, gain[mine] * left, len(plateau)) / power,
        deviation=np.sqrt(np.bincount(number, (gain * solution.noise)[mine] ** 2, len(plateau))) / power,
        fitted=stribeck.torque(velocity, solution.parameters[element]),
        source=source,
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
