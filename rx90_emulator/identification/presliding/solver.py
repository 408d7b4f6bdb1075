"""Fit c0 and c1 of a group of joints by deflecting simulated bristles along measured micro-oscillations."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.optimize import least_squares

from rx90_common.base.arrays import Array
from rx90_common.friction import FrictionElement
from rx90_common.friction.parameters import LINEAR_SPEED
from rx90_emulator.identification.presliding.band import band_spectrum, block_means
from rx90_emulator.identification.presliding.micro_motion import MicroMotion
from rx90_emulator.identification.presliding.residual import GroupResidual
from rx90_emulator.identification.presliding.uncertainty import group_covariance

_PASSES = 3  # of the fit, each with the noise that the one before shows
_EVALUATIONS = 30  # of the residuals in one pass, at most


@dataclass(frozen=True, eq=False)
class GroupSolution:
    """What the fit of a group of k joints with e elements found.

    Attributes:
        values: c0, Nm/rad, and c1, Nm s/rad, of the elements, shape (e, 2).
        covariance: of ln c0 and ln c1, element by element, shape (2 e, 2 e).
        inertia: errors of the group's rows of the mass matrix, in parts of sqrt(M_jj M_ii), shape (k, n).
        inertia_score: the same over the standard deviations that they would have if the prior held, shape (k, n).
        torque: block means of the friction torque at the joints, Nm, of each micro-motion, shape (b, k).
        loads: amplitude of each bristle's torque over its Coulomb torque, of each micro-motion, shape (motions, e).
        misfit: RMS of each joint's torque residuals beyond noise over that of its friction torque, shape (k,).
    """

    values: Array
    covariance: Array
    inertia: Array
    inertia_score: Array
    torque: tuple[Array, ...]
    loads: Array
    misfit: Array


def fit_group(
    motions: Sequence[MicroMotion],
    inputs: Array,
    sliding: Sequence[FrictionElement],
    sliding_covariance: Array | None = None,
    plant_period: float | None = None,
) -> GroupSolution:
    """Fit the elements of a group of joints to all its micro-motions (Levenberg-Marquardt).

    Args:
        motions: of the group, one or more.
        inputs: joint velocities to input velocities of the group's elements, shape (e, k).
        sliding: the elements with their sliding regime; c0 and c1 are not used.
        sliding_covariance: of that regime, element by element in the order of SLIDING, shape (7 e, 7 e); None if it
            is known.
        plant_period: as in `identify_presliding`.
    """
    residual = GroupResidual.of(motions, inputs, sliding)
    parameters = residual.parameters
    guess = first_guess(motions, inputs, sliding)
    x = np.concatenate([np.log(guess).ravel(), np.zeros(parameters.size - parameters.bristles)])
    for _ in range(_PASSES):
        x = _minimise(residual, x, 1e-3)
        residual = residual.with_measured_noise(x)
        if plant_period is not None:
            residual = residual.with_predicted_speeds(x, [motion.velocity for motion in motions], plant_period)
    x = _minimise(residual, x, 1e-6)
    covariance, scores = group_covariance(residual, x, sliding_covariance)
    return GroupSolution(
        values=parameters.values(x),
        covariance=covariance[: parameters.bristles, : parameters.bristles],
        inertia=parameters.inertia_errors(x),
        inertia_score=scores,
        torque=tuple(residual.friction.torque(x, index) for index in range(len(motions))),
        loads=residual.friction.loads(x),
        misfit=residual.misfit(x),
    )


def _minimise(residual: GroupResidual, start: Array, tolerance: float) -> Array:
    result = least_squares(
        residual,
        start,
        residual.jacobian,
        method="lm",
        max_nfev=_EVALUATIONS,
        xtol=tolerance,
        ftol=tolerance**1.5,
    )
    return np.asarray(result.x)


def first_guess(motions: Sequence[MicroMotion], inputs: Array, sliding: Sequence[FrictionElement]) -> Array:
    """Return c0 and c1 by linear regression of the torque on deflection and velocity, shape (e, 2).

    A bristle's stiffness falls with its deflection, so this c0 is low; it is where the fit begins.

    Args:
        motions: of the group.
        inputs: joint velocities to input velocities of the elements, shape (e, k).
        sliding: the elements.
    """
    elements, k = inputs.shape
    matrix, torque = [], []
    for motion in motions:
        deflection = np.cumsum(motion.velocity, axis=0) * motion.step @ inputs.T
        speed = motion.velocity @ inputs.T
        rest = band_spectrum(block_means(motion.drive - motion.acceleration @ motion.mass.T), motion.step)[0]
        columns = band_spectrum(block_means(np.hstack([deflection, speed])), motion.step)[0]
        for i in range(k):
            matrix.append(columns * np.tile(inputs[:, i], 2))
            torque.append(rest[:, i])
    solution = np.linalg.lstsq(np.vstack(matrix), np.concatenate(torque), rcond=1e-6)[0]
    viscous = np.array([e.c2 * LINEAR_SPEED ** (e.alpha - 1.0) for e in sliding])
    weakest = np.array([e.tau_c_positive for e in sliding]) / 2e-3
    c0 = np.maximum(1.2 * solution[:elements], weakest)
    return np.column_stack([c0, np.maximum(solution[elements:] - viscous, 2e-4 * c0)])
