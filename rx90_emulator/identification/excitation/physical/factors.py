"""The way to the minimum from afar: nonlinear least squares in log-Cholesky factors (Rucker and Wensing 2022).

With Q = L L^T and the logarithms of L's diagonal as unknowns every Q is positive definite, and the divergence from 1 is
a sum of squares: tr Q - log det Q - order = sum_i (l_ii^2 - 2 log l_ii - 1) + sum_(i>j) l_ij^2. Where the prior is
wrong by orders of magnitude, these steps go on where Newton's, kept short by the boundary, come to a halt; the map to Q
is one to one, so the minimum is the same.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from scipy.optimize import least_squares

from rx90_common.base.arrays import Array

_ROWS, _COLUMNS = np.tril_indices(4)
_DIAGONAL = _ROWS == _COLUMNS
_MOST_EVALUATIONS = 2000
_SMALL = 1e-6


class Target(NamedTuple):
    """What is to be minimised: |jacobian x - target|^2 / 2 + weight D(x).

    Attributes:
        jacobian: shape (p, N).
        target: shape (p,).
        weight: of the divergence from 1.
        basis: an orthonormal basis of the symmetric matrices of order 4, shape (10, 4, 4).
        blocks: how many blocks of order 4 the unknowns begin with, ten coordinates each.
        scalars: how many positive numbers follow them; the rest is free.
    """

    jacobian: Array
    target: Array
    weight: float
    basis: Array
    blocks: int
    scalars: int


def nearer(x: Array, problem: Target) -> Array:
    """Return unknowns nearer to the minimum, shape (N,), from others inside the cone."""
    first, bound = 10 * problem.blocks, 10 * problem.blocks + problem.scalars
    start = x.copy()
    for b in range(problem.blocks):
        factor = np.linalg.cholesky(np.einsum("kij,k->ij", problem.basis, x[10 * b : 10 * b + 10]))
        entries = factor[_ROWS, _COLUMNS]
        entries[_DIAGONAL] = np.log(entries[_DIAGONAL])
        start[10 * b : 10 * b + 10] = entries
    start[first:bound] = 0.5 * np.log(x[first:bound])
    logarithm = np.concatenate([np.tile(_DIAGONAL, problem.blocks), np.ones(problem.scalars, dtype=bool)])
    root = np.sqrt(problem.weight)

    def residual(u: Array) -> Array:
        return np.concatenate([problem.jacobian @ _unknowns(u, problem) - problem.target, root * _barrier(u[:bound])])

    def _barrier(u: Array) -> Array:
        return np.where(logarithm, _excess(u), np.sqrt(2.0) * u)

    def jacobian(u: Array) -> Array:
        slope = np.where(logarithm, _excess_slope(u[:bound]), np.sqrt(2.0))
        below = np.zeros((bound, len(u)))
        below[:, :bound] = root * np.diag(slope)
        return np.vstack([problem.jacobian @ _slopes(u, problem), below])

    found = least_squares(residual, start, jacobian, method="lm", x_scale="jac", max_nfev=_MOST_EVALUATIONS)
    return _unknowns(found.x, problem)


def _excess(u: Array) -> Array:
    """Return r with r^2 / 2 = e^(2u) - 2u - 1 and the sign of u."""
    return np.asarray(np.sign(u) * np.sqrt(np.maximum(2.0 * (np.expm1(2.0 * u) - 2.0 * u), 0.0)))


def _excess_slope(u: Array) -> Array:
    """Return dr/du of `_excess`."""
    small = np.abs(u) < _SMALL
    return np.where(small, 2.0, 2.0 * np.expm1(2.0 * u) / np.where(small, 1.0, _excess(u)))


def _factor(u: Array) -> Array:
    entries = np.where(_DIAGONAL, np.exp(np.where(_DIAGONAL, u, 0.0)), u)
    factor = np.zeros((4, 4))
    factor[_ROWS, _COLUMNS] = entries
    return factor


def _unknowns(u: Array, problem: Target) -> Array:
    """Return x of logarithms and entries of factors."""
    x = u.copy()
    for b in range(problem.blocks):
        factor = _factor(u[10 * b : 10 * b + 10])
        x[10 * b : 10 * b + 10] = np.einsum("kij,ij->k", problem.basis, factor @ factor.T)
    first = 10 * problem.blocks
    x[first : first + problem.scalars] = np.exp(2.0 * u[first : first + problem.scalars])
    return x


def _slopes(u: Array, problem: Target) -> Array:
    """Return dx/du, shape (N, N)."""
    slopes = np.eye(len(u))
    for b in range(problem.blocks):
        factor = _factor(u[10 * b : 10 * b + 10])
        change = np.zeros((10, 4, 4))
        change[range(10), _ROWS, _COLUMNS] = np.where(_DIAGONAL, factor[_ROWS, _COLUMNS], 1.0)
        half = change @ factor.T
        both = half + half.transpose(0, 2, 1)
        slopes[10 * b : 10 * b + 10, 10 * b : 10 * b + 10] = np.einsum("lij,kij->lk", problem.basis, both)
    first = 10 * problem.blocks
    places = range(first, first + problem.scalars)
    slopes[places, places] = 2.0 * np.exp(2.0 * u[first : first + problem.scalars])
    return slopes
