"""The least-squares solution of the sliding equations: start, robust fit, weights, covariance."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares

from rx90_identification import stribeck
from rx90_identification.sliding_rows import SlidingRows

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

_HUBER = 3.0  # deviations from which a residual counts linearly
_ROUNDS = 3  # of fit and weights
_DELTA_RANGE = (0.2, 5.0)
_GRID_DELTA = (0.6, 1.0, 1.6, 2.5)
_GRID_SPEEDS = 10


@dataclass(frozen=True, eq=False)
class Solution:
    """What the solver found.

    Attributes:
        parameters: of the elements, shape (n_el, 7), as rx90_identification.stribeck writes them.
        nuisance: shape (k,).
        covariance: of all parameters, the elements' first, shape (7 n_el + k, 7 n_el + k); 0 where fixed.
        at_bound: parameters that lie on a bound, shape (n_el, 7).
        rows: the equations with their final weights.
    """

    parameters: Array
    nuisance: Array
    covariance: Array
    at_bound: Mask
    rows: SlidingRows


def solve(rows: SlidingRows, free: Mask) -> Solution:
    """Fit all elements together.

    Args:
        rows: the equations.
        free: parameters of the elements to fit, shape (n_el, 7); the Stribeck rise is 0 where it is not free.
    """
    lower, upper = _bounds(rows)
    weighted = rows
    start = _start(_plateau_means(rows), free, lower, upper)
    nuisance = np.zeros(rows.nuisance.shape[1])
    for _ in range(_ROUNDS):
        start, nuisance, jacobian = _fit(weighted, free, start, nuisance, lower, upper)
        weighted = _weighted(rows, start, nuisance, jacobian.shape[1])
    start, nuisance, jacobian = _fit(weighted, free, start, nuisance, lower, upper)
    margin = 1e-3 * (upper - lower)
    at_bound = free & ((start <= lower + margin) & np.isfinite(lower) | (start >= upper - margin))
    return Solution(start, nuisance, _covariance(jacobian, free), at_bound, weighted)


def predicted(rows: SlidingRows, parameters: Array, nuisance: Array) -> Array:
    """Return the values that the parameters predict, shape (r,)."""
    total = rows.nuisance @ nuisance
    for e, values in enumerate(parameters):
        total = total + rows.gain[:, e] * stribeck.torque(rows.velocity[:, e], values)
    return np.asarray(total)


def _bounds(rows: SlidingRows) -> tuple[Array, Array]:
    elements = rows.gain.shape[1]
    lower = np.zeros((elements, stribeck.SIZE))
    upper = np.full((elements, stribeck.SIZE), np.inf)
    for e in range(elements):
        speed = np.abs(rows.velocity[rows.gain[:, e] != 0.0, e])
        slowest, fastest = (speed.min(), speed.max()) if len(speed) else (0.01, 1.0)
        lower[e, stribeck.SHAPE] = np.log(slowest / 3.0), np.log(_DELTA_RANGE[0])
        upper[e, stribeck.SHAPE] = np.log(2.0 * fastest), np.log(_DELTA_RANGE[1])
    return lower, upper


def _plateau_means(rows: SlidingRows) -> SlidingRows:
    """Return one equation for each plateau and group: enough to find the start."""
    cluster = rows.clusters()
    count = np.bincount(cluster)
    first = np.unique(cluster, return_index=True)[1]

    def mean(values: Array) -> Array:
        total = np.zeros((len(count), *values.shape[1:]))
        np.add.at(total, cluster, values)
        return total / np.sqrt(count).reshape(-1, *[1] * (values.ndim - 1))

    return replace(
        rows,
        value=mean(rows.value),
        gain=mean(rows.gain),
        nuisance=mean(rows.nuisance),
        velocity=mean(rows.velocity) / np.sqrt(count)[:, None],
        group=rows.group[first],
        plateau=rows.plateau[first],
        source=rows.source[first],
    )


def _start(rows: SlidingRows, free: Mask, lower: Array, upper: Array) -> Array:
    """Return the best point of a grid over omega_s and delta of each element; the rest is linear."""
    elements = rows.gain.shape[1]
    parameters = np.zeros((elements, stribeck.SIZE))
    shapes = np.log(np.column_stack([np.exp((lower + upper)[:, 5] / 2.0), np.ones(elements)]))
    # Every solution lies in the complement of the nuisance parameters, which have a prior of deviation 1.
    nuisance = np.vstack([rows.nuisance, np.eye(rows.nuisance.shape[1])])
    span = np.linalg.qr(nuisance)[0]

    def columns(e: int, shape: Array) -> Array:
        block = rows.gain[:, [e]] * stribeck.basis(rows.velocity[:, e], shape)
        return _project(span, block)

    value = _project(span, rows.value[:, None])
    blocks = [columns(e, shapes[e]) for e in range(elements)]
    shaped = [e for e in range(elements) if free[e, stribeck.SHAPE].all()]
    for _ in range(2):
        for e in shaped:
            others = np.hstack([blocks[k][:, free[k, stribeck.LINEAR]] for k in range(elements) if k != e])
            rest = np.linalg.qr(others)[0] if others.shape[1] else np.zeros((len(value), 0))
            target = _remove(rest, value)
            best = np.inf
            for speed in np.linspace(lower[e, 5], upper[e, 5], _GRID_SPEEDS + 2)[1:-1]:
                for delta in np.log(_GRID_DELTA):
                    shape = np.array([speed, delta])
                    block = columns(e, shape)
                    cost = _cost(_remove(rest, block), target)
                    if cost < best:
                        best, shapes[e], blocks[e] = cost, shape, block
    chosen = free[:, stribeck.LINEAR].ravel()
    linear = np.zeros(len(chosen))
    linear[chosen] = np.linalg.lstsq(np.hstack(blocks)[:, chosen], value[:, 0], rcond=1e-10)[0]
    parameters[:, stribeck.LINEAR] = linear.reshape(elements, -1)
    parameters[:, stribeck.SHAPE] = shapes
    return parameters


def _project(span: Array, block: Array) -> Array:
    """Return a block, continued by zeros for the prior, less its share in the span of the nuisance."""
    padded = np.vstack([block, np.zeros((len(span) - len(block), block.shape[1]))])
    return _remove(span, padded)


def _remove(span: Array, block: Array) -> Array:
    return np.asarray(block - span @ (span.T @ block))


def _cost(block: Array, target: Array) -> float:
    solution = np.linalg.lstsq(block, target, rcond=1e-9)[0]
    return float(np.sum((target - block @ solution) ** 2))


def _fit(
    rows: SlidingRows, free: Mask, parameters: Array, nuisance: Array, lower: Array, upper: Array
) -> tuple[Array, Array, Array]:
    """Fit from one start; return parameters, nuisance and the Jacobian at the solution, its loss included."""
    chosen = free.ravel()
    size = int(chosen.sum())
    prior = len(nuisance)
    fixed = np.where(free, parameters, np.where(np.arange(stribeck.SIZE) < stribeck.VISCOUS + 1, 0.0, parameters))

    def split(x: Array) -> tuple[Array, Array]:
        values = fixed.copy()
        values[free] = x[:size]
        return values, x[size:]

    def residual(x: Array) -> Array:
        values, weights = split(x)
        return np.concatenate([predicted(rows, values, weights) - rows.value, weights])

    jacobian = np.zeros((len(rows) + prior, size + prior))
    jacobian[: len(rows), size:] = rows.nuisance
    jacobian[len(rows) :, size:] = np.eye(prior)

    def derivative(x: Array) -> Array:
        values, _ = split(x)
        full = [rows.gain[:, [e]] * stribeck.jacobian(rows.velocity[:, e], p) for e, p in enumerate(values)]
        jacobian[: len(rows), :size] = np.hstack(full)[:, chosen]
        return jacobian.copy()

    low = np.concatenate([lower[free], np.full(prior, -np.inf)])
    high = np.concatenate([upper[free], np.full(prior, np.inf)])
    inside = np.concatenate([fixed[free], nuisance])
    span = np.where(np.isfinite(high - low), high - low, 1.0)
    inside = np.clip(inside, low + 1e-6 * span, high - 1e-6 * span)
    # scipy calls |r| <= 1 quadratic after the division by f_scale.
    result = least_squares(
        residual, inside, derivative, (low, high), x_scale="jac", loss="huber", f_scale=_HUBER, max_nfev=60,
        xtol=1e-10, ftol=1e-10, gtol=1e-10,
    )  # fmt: skip
    values, weights = split(result.x)
    return values, weights, np.asarray(result.jac)


def _weighted(rows: SlidingRows, parameters: Array, nuisance: Array, fitted: int) -> SlidingRows:
    """Scale each group to unit noise, and share what plateaus have in common.

    Besides noise from block to block, a plateau as a whole may be off (ripple, temperature, an arm that is not
    quite rigid). With variances s^2 of a block and t^2 of a plateau of m blocks, the equations less the share
    1 - s / sqrt(s^2 + m t^2) of their plateau's mean, over s, have unit noise (random effects).
    """
    residual = rows.value - predicted(rows, parameters, nuisance)
    cluster = rows.clusters()
    count = np.bincount(cluster)
    mean = np.bincount(cluster, residual) / count
    inner = residual - mean[cluster]
    group = rows.group[np.unique(cluster, return_index=True)[1]]
    keep = np.ones(len(count))
    factor = np.ones(len(rows))
    # The plateaus' means have lost the share that the fit explains.
    left = max(0.1, 1.0 - fitted / len(count))
    for g in np.unique(group):
        inside, mine = rows.group == g, group == g
        noise = _spread(inner[inside]) * np.sqrt(np.sum(count[mine]) / max(1.0, np.sum(count[mine] - 1)))
        factor[inside] = 1.0 / max(noise, 1e-12)
        excess = np.sum(count[mine] * mean[mine] ** 2) / left - np.sum(mine) * noise**2
        common = max(0.0, excess / np.sum(count[mine]))
        keep[mine] = noise / np.sqrt(noise**2 + count[mine] * common)
    return _less_means(rows, cluster, 1.0 - keep).scaled(factor)


def _less_means(rows: SlidingRows, cluster: NDArray[np.int64], share: Array) -> SlidingRows:
    """Take the given share of each cluster's mean off the equations.

    The friction torque is a function of the velocity, which hardly changes in a plateau, so its gain carries the
    whole change.
    """
    count = np.bincount(cluster)

    def less(values: Array) -> Array:
        total = np.zeros((len(count), *values.shape[1:]))
        np.add.at(total, cluster, values)
        weights = (share / count).reshape(-1, *[1] * (values.ndim - 1))
        return np.asarray(values - (weights * total)[cluster])

    return replace(rows, value=less(rows.value), gain=less(rows.gain), nuisance=less(rows.nuisance))


def _spread(values: Array) -> float:
    """Return the standard deviation about 0, blind to a few outliers."""
    robust = 1.4826 * float(np.median(np.abs(values)))
    good = np.abs(values) <= _HUBER * robust
    # Of a normal distribution cut at 3 deviations 0.9867 of the deviation is left.
    return float(np.sqrt(np.mean(values[good] ** 2))) / 0.9867 if robust > 0.0 and good.any() else robust


def _covariance(jacobian: Array, free: Mask) -> Array:
    """Return the covariance of all parameters at unit noise; infinite where the equations say nothing."""
    scale = np.linalg.norm(jacobian, axis=0)
    scale[scale == 0.0] = 1.0
    _, values, directions = np.linalg.svd(jacobian / scale, full_matrices=False)
    inverse = 1.0 / np.maximum(values, 1e-12 * values[0])
    root = directions.T * inverse
    small = (root @ root.T) / np.outer(scale, scale)
    size = free.size + jacobian.shape[1] - int(free.sum())
    chosen = np.concatenate([free.ravel(), np.ones(size - free.size, dtype=np.bool_)])
    covariance = np.zeros((size, size))
    covariance[np.ix_(chosen, chosen)] = small
    return covariance
