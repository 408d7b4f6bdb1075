"""The non-linear least-squares fit of all elements' curves: several starts, bounds, reweighting, covariance."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.optimize import least_squares, lsq_linear

from rx90_common.base.arrays import Array, Mask
from rx90_common.friction.element import ALPHA_BOUNDS
from rx90_emulator.identification.sliding import stribeck
from rx90_emulator.identification.sliding.equations import (
    NormalForm,
    PlateauTorques,
    SlidingRows,
    Weights,
    speed_design_effect,
)
from rx90_emulator.identification.sliding.quality import Drift, Misfit, Residuals, drifts_of, misfits_of

_REWEIGHTINGS = 4  # of iteratively reweighted least squares
_DELTA_RANGE = (0.2, 5.0)
_STARTS = ((0.3, 1.0), (0.1, 1.0), (0.03, 1.0), (0.1, 2.0), (0.3, 2.0))
"""Starts: omega_s as the squared share of the range of ln omega_s from its lower bound, and delta."""
_ALPHA_START = 0.8
_BOUND_MARGIN = 1e-3  # Nm, or of a logarithm
_TIE_WEIGHT = 10.0  # weight of an exact equation over that of the data


@dataclass(frozen=True, eq=False)
class SlidingSolution:
    """The curves of all elements that fit the equations best.

    Attributes:
        rows: the equations.
        free: parameters that were fitted, shape (n_el, 8).
        parameters: of the elements, shape (n_el, 8), in the order of `stribeck`.
        nuisance: errors of the arm's weights along the directions of `rows`, shape (k,).
        nuisance_covariance: shape (k, k).
        covariance: of the elements' parameters, shape (8 n_el, 8 n_el); 0 where fixed.
        at_bound: free parameters that lie on a bound, shape (n_el, 8).
        noise: standard deviation of each row over the one that it was scaled by, shape (r,).
        common: intraclass correlation: share of the variance of a plateau's mean that its blocks share, shape (r,).
        exponent_score: by how many standard deviations a Gauss-Newton step moves each element's exponent from 1,
            shape (n_el,); 0 where it is free already.
        design_effect: Kish's factor on the variance because plateaus at one speed err together, shape (r,).
        misfits: whether each element's curve fits, and how much wider that makes the variances.
        drifts: of each element's friction over the series.
    """

    rows: SlidingRows
    free: Mask
    parameters: Array
    nuisance: Array
    nuisance_covariance: Array
    covariance: Array
    at_bound: Mask
    noise: Array
    common: Array
    exponent_score: Array
    design_effect: Array
    misfits: list[Misfit]
    drifts: list[Drift]


def fit_curves(rows: SlidingRows, free: Mask) -> SlidingSolution:
    """Fit all elements together, in turn with the weights of the equations.

    Args:
        rows: the equations.
        free: parameters of the elements to fit, shape (n_el, 8); where they are not free, the Stribeck rise is 0 and
            the viscous exponent 1.
    """
    torques = PlateauTorques.of(rows)
    design = torques.design
    fit = _CurveFit(torques, free, len(rows.directions) // 10)
    weights = Weights.equal(rows)
    form = NormalForm.of(rows, design, weights)
    parameters = fit.from_many_starts(form)
    for _ in range(_REWEIGHTINGS):
        friction = fit.torques(parameters)
        residual = rows.value - design @ friction - rows.nuisance @ form.nuisance(friction)
        slope = weights.means(design @ fit.slope(parameters))
        leverage = _leverage(slope, weights.means(rows.nuisance))
        weights = Weights.of(rows, residual, leverage)
        form = NormalForm.of(rows, design, weights)
        parameters = fit.run(form, parameters)
    covariance = fit.covariance(form, parameters)
    at_bound = free & (np.minimum(parameters - fit.lower, fit.upper - parameters) < _BOUND_MARGIN)
    friction = fit.torques(parameters)
    nuisance = form.nuisance(friction)
    residual = rows.value - design @ friction - rows.nuisance @ nuisance
    residuals = Residuals.of(rows, weights, residual, design @ fit.slope(parameters))
    common = 1.0 - (1.0 - weights.share[weights.cluster]) ** 2
    chosen = np.flatnonzero(free)
    nuisance_covariance = form.nuisance_covariance(fit.slope(parameters), covariance[np.ix_(chosen, chosen)])
    return SlidingSolution(
        rows=rows,
        free=free,
        parameters=parameters,
        nuisance=nuisance,
        nuisance_covariance=nuisance_covariance,
        covariance=covariance,
        at_bound=at_bound,
        noise=1.0 / weights.factor,
        common=common,
        exponent_score=fit.exponent_score(form, parameters),
        design_effect=speed_design_effect(rows, weights, residual),
        misfits=misfits_of(residuals, free, covariance[np.ix_(chosen, chosen)]),
        drifts=drifts_of(residuals, free),
    )


def predicted(solution: SlidingSolution) -> Array:
    """Return the left sides of the equations that a solution predicts, shape (r,)."""
    rows = solution.rows
    total = rows.nuisance @ solution.nuisance
    for e, values in enumerate(solution.parameters):
        total = total + rows.gain[:, e] * stribeck.torque(rows.velocity[:, e], values)
    return np.asarray(total)


def _leverage(slope: Array, nuisance: Array) -> Array:
    """Return the diagonal of the hat matrix of all parameters, nuisance with its prior, shape (c,)."""
    count = nuisance.shape[1]
    prior = np.hstack([np.zeros((count, slope.shape[1])), np.eye(count)])
    matrix = np.vstack([np.hstack([slope, nuisance]), prior])
    size = np.linalg.norm(matrix, axis=0)
    left, values, _ = np.linalg.svd(matrix / np.where(size > 0.0, size, 1.0), full_matrices=False)
    return np.asarray(np.sum(left[: len(slope), values > 1e-10 * values[0]] ** 2, axis=1))


class _CurveFit:
    """The non-linear least-squares fit of all elements' curves to the friction torques of the plateaus."""

    def __init__(self, torques: PlateauTorques, free: Mask, joints: int) -> None:
        self._velocity = torques.velocity
        self._columns = [np.flatnonzero(torques.element == e) for e in range(len(free))]
        self._free = free
        self._joints = joints
        self.lower, self.upper = self._bounds()

    def torques(self, parameters: Array) -> Array:
        """Return the friction torques, Nm, shape (c,)."""
        result = np.zeros(len(self._velocity))
        for columns, values in zip(self._columns, parameters, strict=True):
            result[columns] = stribeck.torque(self._velocity[columns], values)
        return result

    def exponent_score(self, form: NormalForm, parameters: Array) -> Array:
        """Return how far, in standard deviations, a Gauss-Newton step moves each exponent from 1, shape (n_el,)."""
        exponent = np.zeros_like(self._free)
        exponent[:, stribeck.EXPONENT] = self._free[:, stribeck.VISCOUS] & ~self._free[:, stribeck.EXPONENT]
        added = form.root @ self.slope(parameters, exponent)
        basis = np.linalg.qr(self._jacobian(form, parameters))[0]
        # What the other parameters do not explain (Frisch, Waugh and Lovell).
        added -= basis @ (basis.T @ added)
        residual = form.target - form.root @ self.torques(parameters)
        normal = np.linalg.pinv(added.T @ added, hermitian=True)
        step, deviation = normal @ (added.T @ residual), np.sqrt(np.maximum(np.diag(normal), 0.0))
        result = np.zeros(len(self._free))
        inside = exponent[:, stribeck.EXPONENT]
        result[inside] = np.abs(step) / np.where(deviation > 0.0, deviation, np.inf)
        return result

    def slope(self, parameters: Array, chosen: Mask | None = None) -> Array:
        """Return the derivatives of the friction torques by the free, or the chosen, parameters, shape (c, p)."""
        parts = []
        for columns, values, free in zip(
            self._columns, parameters, self._free if chosen is None else chosen, strict=True
        ):
            part = np.zeros((len(self._velocity), int(free.sum())))
            part[columns] = stribeck.torque_jacobian(self._velocity[columns], values)[:, free]
            parts.append(part)
        return np.hstack(parts)

    def from_many_starts(self, form: NormalForm) -> Array:
        """Return the best of the solutions from several starts."""
        found = [self._run(form, self._start(form, *start)) for start in _STARTS]
        return min(found, key=lambda pair: pair[1])[0]

    def run(self, form: NormalForm, parameters: Array) -> Array:
        """Return the solution from one start."""
        return self._run(form, parameters)[0]

    def covariance(self, form: NormalForm, parameters: Array) -> Array:
        """Return the covariance, shape (8 n_el, 8 n_el); huge for what is not identifiable, 0 for what is fixed."""
        jacobian = np.vstack([self._jacobian(form, parameters), self._ties(form)])
        scale = np.linalg.norm(jacobian, axis=0)
        scale[scale == 0.0] = 1.0
        _, values, directions = np.linalg.svd(jacobian / scale, full_matrices=False)
        root = directions.T / np.maximum(values, 1e-10 * values[0])
        covariance = np.zeros((self._free.size, self._free.size))
        chosen = np.flatnonzero(self._free)
        covariance[np.ix_(chosen, chosen)] = (root @ root.T) / np.outer(scale, scale)
        return covariance

    def _run(self, form: NormalForm, start: Array) -> tuple[Array, float]:
        ties = self._ties(form)
        fixed = start.copy()
        fixed[:, stribeck.LINEAR][~self._free[:, stribeck.LINEAR]] = 0.0

        def filled(x: Array) -> Array:
            values = fixed.copy()
            values[self._free] = x
            return values

        def residual(x: Array) -> Array:
            return np.concatenate([form.root @ self.torques(filled(x)) - form.target, ties @ x])

        def jacobian(x: Array) -> Array:
            return np.vstack([self._jacobian(form, filled(x)), ties])

        low, high = self.lower[self._free], self.upper[self._free]
        inside = np.clip(start[self._free], low + 1e-9, high - 1e-9)
        result = least_squares(residual, inside, jacobian, (low, high), x_scale="jac", max_nfev=200)
        return filled(result.x), float(result.cost)

    def _start(self, form: NormalForm, place: float, delta: float) -> Array:
        """Return the start with one guess of omega_s and delta for all elements, and the best linear parameters."""
        start = np.zeros(self._free.shape)
        start[:, 5] = self.lower[:, 5] + place**0.5 * (self.upper[:, 5] - self.lower[:, 5])
        start[:, 6] = np.log(delta)
        start[self._free[:, stribeck.EXPONENT], stribeck.EXPONENT] = np.log(_ALPHA_START)
        linear = self._free[:, stribeck.LINEAR]
        mask = self._free & (np.arange(stribeck.SIZE) < stribeck.LINEAR.stop)
        matrix = self._jacobian(form, start)[:, mask[self._free]]
        values = np.zeros(linear.shape)
        values[linear] = lsq_linear(matrix, form.target, (0.0, np.inf)).x
        start[:, stribeck.LINEAR] = values
        return start

    def _jacobian(self, form: NormalForm, parameters: Array) -> Array:
        """Return the derivatives of root @ f by the free parameters."""
        return np.asarray(form.root @ self.slope(parameters))

    def _bounds(self) -> tuple[Array, Array]:
        lower = np.full(self._free.shape, -np.inf)
        upper = np.full(self._free.shape, np.inf)
        lower[:, stribeck.LINEAR] = 0.0
        for e, columns in enumerate(self._columns):
            speed = np.abs(self._velocity[columns]) if len(columns) else np.array([0.01, 1.0])
            lower[e, stribeck.SHAPE] = np.log(speed.min() / 3.0), np.log(_DELTA_RANGE[0])
            upper[e, stribeck.SHAPE] = np.log(2.0 * speed.max()), np.log(_DELTA_RANGE[1])
        lower[:, stribeck.EXPONENT], upper[:, stribeck.EXPONENT] = np.log(ALPHA_BOUNDS)
        return lower, upper

    def _ties(self, form: NormalForm) -> Array:
        """Return equations tau_c+ = tau_c- for the elements beyond the joints, shape (n_el - n or less, p).

        The difference of the two is a constant torque. Constants k of the elements act on the joints as E^T k, whatever
        sticks or slides, so n_el - n of them are not identifiable by any motion.
        """
        column = np.cumsum(self._free.ravel()).reshape(self._free.shape) - 1
        coupled = [e for e in range(self._joints, len(self._free)) if self._free[e, 0]]
        ties = np.zeros((len(coupled), int(self._free.sum())))
        for row, e in zip(ties, coupled, strict=True):
            scale = _TIE_WEIGHT * float(np.linalg.norm(form.root[:, self._columns[e]]))
            row[column[e, 0]], row[column[e, 1]] = scale, -scale
        return ties
