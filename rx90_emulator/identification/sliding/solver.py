"""The non-linear least-squares fit of all elements' curves: several starts, bounds, reweighting, covariance.

With dz/dt = 0, equations 17 to 19 leave sign(v) [tau_c + d exp(-(|v| / omega_s)^delta) + c2 |v|^alpha] with the
Stribeck rise d = tau_s - tau_c. Written in d and in the logarithms of omega_s, delta and alpha, the bounds
tau_s >= tau_c > 0 and omega_s, delta > 0 are plain, and five of the eight parameters are linear.
"""

from __future__ import annotations

from functools import cached_property

import numpy as np
from scipy.optimize import least_squares, lsq_linear
from scipy.sparse import csr_array

from rx90_common.base.arrays import Array, Mask
from rx90_common.friction.curves import LINEAR_SPEED, stribeck_decay_slopes, viscous_torque
from rx90_common.friction.element import ALPHA_BOUNDS
from rx90_emulator.identification.estimates import SLIDING, VISCOUS_EXPONENT
from rx90_emulator.identification.sliding.equations import NormalForm, SlidingRows, Weights, speed_design_effect
from rx90_emulator.identification.sliding.quality import Drift, Misfit, Residuals, drifts_of, misfits_of

FITTED = ("tau_c_positive", "tau_c_negative", "tau_s_positive", "tau_s_negative", "c2", "omega_s", "delta", "alpha")
"""The parameters of an element in the fit, tau_c+, tau_c-, d+, d-, c2, ln omega_s, ln delta, ln alpha, by the names
that they determine."""
SIZE = len(FITTED)
LINEAR = slice(0, 5)
RISE = slice(2, 4)
VISCOUS, OMEGA_S = 4, 5
SHAPE = slice(5, 7)
EXPONENT = 7

_REWEIGHTINGS = 4  # of iteratively reweighted least squares
_DELTA_RANGE = (0.2, 5.0)
_STARTS = ((0.3, 1.0), (0.1, 1.0), (0.03, 1.0), (0.1, 2.0), (0.3, 2.0))
"""Starts: omega_s as the squared share of the range of ln omega_s from its lower bound, and delta."""
_ALPHA_START = 0.8
_BOUND_MARGIN = 1e-3  # Nm, or of a logarithm
_TIE_WEIGHT = 10.0  # weight of an exact equation over that of the data


def torque(velocity: Array, parameters: Array) -> Array:
    """Return the friction torque of an element, Nm, shape (m,), by velocities in rad/s and parameters of the fit."""
    return np.asarray(torque_jacobian(velocity, parameters)[:, LINEAR] @ parameters[LINEAR])


def torque_jacobian(velocity: Array, parameters: Array) -> Array:
    """Return the derivatives of the torque by all parameters, shape (m, 8)."""
    omega_s, delta, alpha = np.exp(parameters[SHAPE.start :]).tolist()
    decay, by_omega_s, by_delta = stribeck_decay_slopes(velocity, omega_s, delta)
    forward, backward = 1.0 * (velocity > 0.0), -1.0 * (velocity < 0.0)
    rise = forward * parameters[2] + backward * parameters[3]
    viscous = viscous_torque(velocity, 1.0, alpha)
    by_alpha = alpha * parameters[VISCOUS] * viscous * np.log(np.maximum(np.abs(velocity), LINEAR_SPEED))
    return np.column_stack(
        [forward, backward, decay * forward, decay * backward, viscous, rise * by_omega_s, rise * by_delta, by_alpha]
    )


def natural(parameters: Array) -> dict[str, float]:
    """Return the parameters by the names in SLIDING, and the viscous exponent by its own."""
    coulomb_up, coulomb_down, rise_up, rise_down, viscous = (float(value) for value in parameters[LINEAR])
    omega_s, delta, alpha = (float(value) for value in np.exp(parameters[SHAPE.start :]))
    values = (coulomb_up, coulomb_down, coulomb_up + rise_up, coulomb_down + rise_down, omega_s, delta, viscous)
    return dict(zip(SLIDING, values, strict=True)) | {VISCOUS_EXPONENT: alpha}


def natural_jacobian(parameters: Array) -> Array:
    """Return the derivatives of what `natural` returns by the parameters of the fit, shape (8, 8)."""
    matrix = np.zeros((SIZE, SIZE))
    matrix[0, 0] = matrix[1, 1] = matrix[2, 0] = matrix[2, 2] = matrix[3, 1] = matrix[3, 3] = 1.0
    matrix[4, 5], matrix[5, 6] = np.exp(parameters[SHAPE])
    matrix[6, VISCOUS] = 1.0
    matrix[7, EXPONENT] = np.exp(parameters[EXPONENT])
    return matrix


class CurveFit:
    """The curves of all elements that fit the equations best, all fitted together.

    Args:
        rows: the equations.
        free: parameters of the elements to fit, shape (n_el, 8); where they are not free, the Stribeck rise is 0 and
            the viscous exponent 1.

    Attributes:
        rows: the equations.
        free: as the argument.
        parameters: of the elements, shape (n_el, 8), in the order of FITTED.
        nuisance: errors of the arm's weights along the directions of `rows`, shape (k,).
        nuisance_covariance: shape (k, k).
        covariance: of the elements' parameters, shape (8 n_el, 8 n_el); 0 where fixed.
        at_bound: free parameters that lie on a bound, shape (n_el, 8).
        residual: of the equations, shape (r,).
        weights: of the equations.
        design_effect: Kish's factor on the variance because plateaus at one speed err together, shape (r,).
    """

    def __init__(self, rows: SlidingRows, free: Mask) -> None:
        self.rows, self.free = rows, free
        # A friction torque for each plateau and element that slides in it.
        at, element = np.nonzero(rows.gain)
        keys, number = np.unique(rows.plateau[at] * len(free) + element, return_inverse=True)
        self._velocity = np.bincount(number, rows.velocity[at, element]) / np.bincount(number)
        self._columns = [np.flatnonzero(keys % len(free) == e) for e in range(len(free))]
        design = csr_array((rows.gain[at, element], (at, number)), shape=(len(rows), len(keys)))
        self._lower, self._upper = self._bounds()
        self.weights = Weights.equal(rows)
        self._form = NormalForm.of(rows, design, self.weights)
        self.parameters = min((self._solved(self._start(*start)) for start in _STARTS), key=lambda pair: pair[1])[0]
        for _ in range(_REWEIGHTINGS):
            slope = self.weights.means(design @ self._slope(self.parameters))
            leverage = _leverage(slope, self.weights.means(rows.nuisance))
            self.weights = self.weights.updated(rows, self._left(design), leverage)
            self._form = NormalForm.of(rows, design, self.weights)
            self.parameters = self._solved(self.parameters)[0]
        inside = np.minimum(self.parameters - self._lower, self._upper - self.parameters)
        self.at_bound = free & (inside < _BOUND_MARGIN)
        self.residual = self._left(design)
        self.nuisance = self._form.nuisance(self._torques(self.parameters))
        slope = self._slope(self.parameters)
        own = self._own_covariance()
        follows, spread = self._form.back[:, 1:] @ slope, self._form.spread
        self.nuisance_covariance = spread @ spread.T + follows @ own @ follows.T
        self.covariance = np.zeros((free.size, free.size))
        self.covariance[np.ix_(*2 * [np.flatnonzero(free)])] = own
        self.design_effect = speed_design_effect(rows, self.weights, self.residual)
        residuals = Residuals.of(rows, self.weights, self.residual, design @ slope)
        self.misfits: list[Misfit] = misfits_of(residuals, free, own)
        self.drifts: list[Drift] = drifts_of(residuals, free)

    @cached_property
    def exponent_score(self) -> Array:
        """Return how far, in standard deviations, a Gauss-Newton step moves each exponent from 1, shape (n_el,).

        It is 0 where the exponent is free already.
        """
        exponent = np.zeros_like(self.free)
        exponent[:, EXPONENT] = self.free[:, VISCOUS] & ~self.free[:, EXPONENT]
        root, parameters = self._form.root, self.parameters
        added = root @ self._slope(parameters, exponent)
        basis = np.linalg.qr(root @ self._slope(parameters))[0]
        # What the other parameters do not explain (Frisch, Waugh and Lovell).
        added -= basis @ (basis.T @ added)
        residual = self._form.target - root @ self._torques(parameters)
        normal = np.linalg.pinv(added.T @ added, hermitian=True)
        step, deviation = normal @ (added.T @ residual), np.sqrt(np.maximum(np.diag(normal), 0.0))
        result = np.zeros(len(self.free))
        result[exponent[:, EXPONENT]] = np.abs(step) / np.where(deviation > 0.0, deviation, np.inf)
        return result

    def block(self, element: int) -> Array:
        """Return the covariance of the fitted parameters of an element, shape (8, 8)."""
        rows = slice(element * SIZE, (element + 1) * SIZE)
        return np.asarray(self.covariance[rows, rows])

    def _torques(self, parameters: Array) -> Array:
        result = np.zeros(len(self._velocity))
        for columns, values in zip(self._columns, parameters, strict=True):
            result[columns] = torque(self._velocity[columns], values)
        return result

    def _slope(self, parameters: Array, chosen: Mask | None = None) -> Array:
        """Return the derivatives of the friction torques by the free, or the chosen, parameters, shape (c, p)."""
        parts = []
        chosen = self.free if chosen is None else chosen
        for columns, values, mine in zip(self._columns, parameters, chosen, strict=True):
            part = np.zeros((len(self._velocity), int(mine.sum())))
            part[columns] = torque_jacobian(self._velocity[columns], values)[:, mine]
            parts.append(part)
        return np.hstack(parts)

    def _left(self, design: csr_array) -> Array:
        friction = self._torques(self.parameters)
        return np.asarray(self.rows.value - design @ friction - self.rows.nuisance @ self._form.nuisance(friction))

    def _own_covariance(self) -> Array:
        """Return the covariance of the free parameters; huge for what is not identifiable."""
        jacobian = np.vstack([self._form.root @ self._slope(self.parameters), self._ties()])
        scale = np.linalg.norm(jacobian, axis=0)
        scale[scale == 0.0] = 1.0
        _, values, directions = np.linalg.svd(jacobian / scale, full_matrices=False)
        root = directions.T / np.maximum(values, 1e-10 * values[0])
        return np.asarray((root @ root.T) / np.outer(scale, scale))

    def _solved(self, start: Array) -> tuple[Array, float]:
        """Return the solution from a start, and its cost."""
        ties, root, target = self._ties(), self._form.root, self._form.target
        fixed = start.copy()
        fixed[:, LINEAR][~self.free[:, LINEAR]] = 0.0

        def filled(x: Array) -> Array:
            values = fixed.copy()
            values[self.free] = x
            return values

        def residual(x: Array) -> Array:
            return np.concatenate([root @ self._torques(filled(x)) - target, ties @ x])

        def jacobian(x: Array) -> Array:
            return np.vstack([root @ self._slope(filled(x)), ties])

        low, high = self._lower[self.free], self._upper[self.free]
        inside = np.clip(start[self.free], low + 1e-9, high - 1e-9)
        result = least_squares(residual, inside, jacobian, (low, high), x_scale="jac", max_nfev=200)
        return filled(result.x), float(result.cost)

    def _start(self, place: float, delta: float) -> Array:
        """Return the start with one guess of omega_s and delta for all elements, and the best linear parameters."""
        start = np.zeros(self.free.shape)
        low, high = self._lower[:, OMEGA_S], self._upper[:, OMEGA_S]
        start[:, OMEGA_S] = low + place**0.5 * (high - low)
        start[:, OMEGA_S + 1] = np.log(delta)
        start[self.free[:, EXPONENT], EXPONENT] = np.log(_ALPHA_START)
        linear = self.free & (np.arange(SIZE) < LINEAR.stop)
        matrix = self._form.root @ self._slope(start, linear)
        start[linear] = lsq_linear(matrix, self._form.target, (0.0, np.inf)).x
        return start

    def _bounds(self) -> tuple[Array, Array]:
        lower, upper = np.full(self.free.shape, -np.inf), np.full(self.free.shape, np.inf)
        lower[:, LINEAR] = 0.0
        for e, columns in enumerate(self._columns):
            speed = np.abs(self._velocity[columns]) if len(columns) else np.array([0.01, 1.0])
            lower[e, SHAPE] = np.log(speed.min() / 3.0), np.log(_DELTA_RANGE[0])
            upper[e, SHAPE] = np.log(2.0 * speed.max()), np.log(_DELTA_RANGE[1])
        lower[:, EXPONENT], upper[:, EXPONENT] = np.log(ALPHA_BOUNDS)
        return lower, upper

    def _ties(self) -> Array:
        """Return equations tau_c+ = tau_c- for the elements beyond the joints, shape (n_el - n or less, p).

        The difference of the two is a constant torque. Constants k of the elements act on the joints as E^T k, whatever
        sticks or slides, so n_el - n of them are not identifiable by any motion.
        """
        column = np.cumsum(self.free.ravel()).reshape(self.free.shape) - 1
        joints = len(self.rows.directions) // 10
        coupled = [e for e in range(joints, len(self.free)) if self.free[e, 0]]
        ties = np.zeros((len(coupled), int(self.free.sum())))
        for row, e in zip(ties, coupled, strict=True):
            scale = _TIE_WEIGHT * float(np.linalg.norm(self._form.root[:, self._columns[e]]))
            row[column[e, 0]], row[column[e, 1]] = scale, -scale
        return ties


def _leverage(slope: Array, nuisance: Array) -> Array:
    """Return the diagonal of the hat matrix of all parameters, nuisance with its prior, shape (c,)."""
    count = nuisance.shape[1]
    prior = np.hstack([np.zeros((count, slope.shape[1])), np.eye(count)])
    matrix = np.vstack([np.hstack([slope, nuisance]), prior])
    size = np.linalg.norm(matrix, axis=0)
    left, values, _ = np.linalg.svd(matrix / np.where(size > 0.0, size, 1.0), full_matrices=False)
    return np.asarray(np.sum(left[: len(slope), values > 1e-10 * values[0]] ** 2, axis=1))
