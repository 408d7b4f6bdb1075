"""Pseudo-inertia matrices: the mass distribution of a body as one symmetric matrix of order 4.

    P = [[S, h], [h^T, m]],   S = integral of r r^T = tr(I) / 2 - I,   h = m c,   I the inertia about the origin.

A body of positive density exists for m, h and I if and only if P is positive definite (Wensing, Kim and Slotine 2018).
In another frame the same body has T P T^T, with T the homogeneous transform of its old frame to the new one.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from rx90_common.base.arrays import Array

_ROWS, _COLUMNS = np.array([0, 0, 1, 0, 1, 2]), np.array([0, 1, 1, 2, 2, 2])
"""Of Ixx, Ixy, Iyy, Ixz, Iyz, Izz, in Pinocchio's order."""


def pseudo_inertia(parameters: ArrayLike) -> Array:
    """Return P, shape (..., 4, 4).

    Args:
        parameters: m, mx, my, mz, Ixx, Ixy, Iyy, Ixz, Iyz, Izz about the origin of the frame, shape (..., 10).
    """
    values = np.asarray(parameters, dtype=np.float64)
    inertia = np.zeros((*values.shape[:-1], 3, 3))
    inertia[..., _ROWS, _COLUMNS] = inertia[..., _COLUMNS, _ROWS] = values[..., 4:]
    pseudo = np.zeros((*values.shape[:-1], 4, 4))
    pseudo[..., :3, :3] = _other(inertia, 0.5)
    pseudo[..., :3, 3] = pseudo[..., 3, :3] = values[..., 1:4]
    pseudo[..., 3, 3] = values[..., 0]
    return pseudo


def inertial_parameters(pseudo: Array) -> Array:
    """Return the parameters, shape (..., 10), of pseudo-inertias, shape (..., 4, 4); the inverse of `pseudo_inertia`.

    It is linear: differences of pseudo-inertias give differences of parameters.
    """
    inertia = _other(pseudo[..., :3, :3], 1.0)
    parts = [pseudo[..., 3, 3][..., None], pseudo[..., :3, 3], inertia[..., _ROWS, _COLUMNS]]
    return np.concatenate(parts, axis=-1)


def _other(matrix: Array, share: float) -> Array:
    """Return share tr(M) - M: S of an inertia for a share of 1/2, the inertia of S for 1."""
    trace = np.trace(matrix, axis1=-2, axis2=-1)
    return np.asarray(share * trace[..., None, None] * np.eye(3) - matrix)


def about_center(mass: float, center: ArrayLike, inertia: ArrayLike) -> Array:
    """Return P, shape (4, 4).

    Args:
        mass: kg.
        center: of mass, m, shape (3,).
        inertia: about the centre of mass, in the axes of the frame, kg m^2, shape (3, 3).
    """
    place = np.append(np.asarray(center, dtype=np.float64), 1.0)
    pseudo = mass * np.outer(place, place)
    pseudo[:3, :3] += _other(np.asarray(inertia, dtype=np.float64), 0.5)
    return pseudo


def central(pseudo: Array) -> tuple[float, Array, Array]:
    """Return mass, centre of mass (3,) and inertia about it (3, 3) of a positive definite P, shape (4, 4)."""
    mass = float(pseudo[3, 3])
    center = pseudo[:3, 3] / mass
    spread = pseudo[:3, :3] - mass * np.outer(center, center)
    return mass, center, _other(0.5 * (spread + spread.T), 1.0)


def is_body(pseudo: Array) -> bool:
    """Tell whether a body of positive density has this P, shape (4, 4), finite and positive definite."""
    if not np.isfinite(pseudo).all() or not (np.diag(pseudo) > 0.0).all():
        return False
    scale = np.sqrt(np.diag(pseudo))
    return bool(np.linalg.eigvalsh(pseudo / np.outer(scale, scale))[0] > _LEAST)


_LEAST = 1e-12
"""Of the eigenvalues of P scaled to ones on its diagonal: less is rounding."""
