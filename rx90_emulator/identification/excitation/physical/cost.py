"""What consistency costs: how the other parameters follow the base parameters, and the torque that it adds."""

from __future__ import annotations

import numpy as np

from rx90_common.base.arrays import Array


def whole_shift(covariance: Array, base: Array, shift: Array) -> Array:
    """Return how all q parameters of a fit change if its base parameters are moved.

    Friction was estimated together with the base parameters. Where these move, the others take the values that fit best
    then: their conditional mean.

    Args:
        covariance: of all parameters, shape (q, q).
        base: which of them are the base parameters, shape (p,).
        shift: of the base parameters, shape (p,).

    Returns:
        Shape (q,); the base parameters have their `shift`.
    """
    deviation = np.sqrt(np.diag(covariance))
    correlation = covariance / np.outer(deviation, deviation)
    gain = np.linalg.lstsq(correlation[np.ix_(base, base)], shift / deviation[base], rcond=None)[0]
    moved = deviation * (correlation[:, base] @ gain)
    moved[base] = shift
    return np.asarray(moved)


def torque_cost(rows: Array, joint: Array, shift: Array, count: int) -> Array:
    """Return the RMS of the torque that a shift of the parameters adds at each joint, Nm, shape (count,).

    Args:
        rows: derivative of the torque by the parameters, along the runs, shape (r, q).
        joint: of each row, shape (r,).
        shift: of the parameters, shape (q,).
        count: number of joints; those without a row get 0.
    """
    square = np.square(rows @ shift)
    rows_of = np.bincount(joint, minlength=count)
    return np.asarray(np.sqrt(np.bincount(joint, square, count) / np.maximum(rows_of, 1)))
