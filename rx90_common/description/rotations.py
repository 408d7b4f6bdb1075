"""Vectors and rotation matrices in a fixed order of operations, over any leading axes.

NumPy adds and multiplies arrays element by element, rounded as IEEE 754 says, and so gives the same bits on every
machine. Its sums, matrix products and elementary functions do not: they come from libraries that choose the order of
operations and the instructions by processor and version. Set-points and the plant's constants are therefore computed
with these functions.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from rx90_common.base.arrays import Array
from rx90_common.kernels.compiled import kernel
from rx90_common.kernels.elementary import angles_of, sines_cosines


def dot(a: Array, b: Array) -> Array:
    """Return the scalar products (...) of vectors (..., 3)."""
    return a[..., 0] * b[..., 0] + a[..., 1] * b[..., 1] + a[..., 2] * b[..., 2]


def length(vector: Array) -> Array:
    """Return the lengths (...) of vectors (..., 3)."""
    return np.sqrt(dot(vector, vector))


def angle_between(a: Array, b: Array) -> Array:
    """Return the angles (...), rad, between vectors (..., 3)."""
    return np.arctan2(length(np.cross(a, b)), dot(a, b))


def transposed(rotation: Array) -> Array:
    """Return the inverse of rotations (..., 3, 3)."""
    return np.swapaxes(rotation, -1, -2)


def rotated(rotation: Array, vector: Array) -> Array:
    """Return vectors (..., 3) turned by rotations, or multiplied by any matrices, (..., 3, 3)."""
    x, y, z = (rotation[..., :, k] * vector[..., k, None] for k in range(3))
    return x + y + z


def product(a: Array, b: Array) -> Array:
    """Return the matrix products (..., 3, 3) of a and b."""
    x, y, z = (a[..., :, k, None] * b[..., None, k, :] for k in range(3))
    return x + y + z


def outer(a: Array, b: Array) -> Array:
    """Return the matrices a b^T, (..., 3, 3)."""
    return a[..., :, None] * b[..., None, :]


def symmetric(entries: ArrayLike) -> Array:
    """Return the matrices (..., 3, 3) with the entries xx, yy, zz, xy, xz, yz (..., 6)."""
    return np.asarray(entries)[..., [[0, 3, 4], [3, 1, 5], [4, 5, 2]]]


def cross_matrix(vector: Array) -> Array:
    """Return the matrix (3, 3) whose product with another vector is the cross product of `vector` (3,) with it."""
    x, y, z = vector
    return np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])


def axis_rotation(axis: Array, angle: ArrayLike) -> Array:
    """Return the rotation (..., 3, 3) by `angle` (...) rad about the unit vector `axis` (3,) (Rodrigues)."""
    return np.ascontiguousarray(axis_rotation_by_component(axis, angle))


def axis_rotation_by_component(axis: Array, angle: ArrayLike) -> Array:
    """Return what `axis_rotation` does, in another order in memory: for each of the nine components all angles.

    `product` and `rotated` keep that order: NumPy's loops then run over the angles, not over three numbers at a time.
    """
    cross = cross_matrix(axis)
    sine, cosine = sines_cosines(angle)
    unit = np.eye(3).reshape(3, 3, *(1,) * sine.ndim)
    once = cross.reshape(3, 3, *(1,) * sine.ndim)
    twice = product(cross, cross).reshape(3, 3, *(1,) * sine.ndim)
    rotation: Array = unit + sine * once + (1.0 - cosine) * twice
    return np.moveaxis(rotation, (0, 1), (-2, -1))


def rpy_quaternion(rpy: ArrayLike) -> Array:
    """Return the quaternion (4,), scalar last, of roll, pitch and yaw about fixed axes, (3,) rad."""
    (sr, sp, sy), (cr, cp, cy) = sines_cosines(0.5 * np.asarray(rpy, dtype=np.float64))
    return np.array(
        [
            sr * cp * cy - cr * sp * sy,
            cr * sp * cy + sr * cp * sy,
            cr * cp * sy - sr * sp * cy,
            cr * cp * cy + sr * sp * sy,
        ]
    )


def rpy_rotation(rpy: ArrayLike) -> Array:
    """Return the rotation (3, 3) by roll, pitch and yaw about fixed axes, (3,) rad."""
    x, y, z = np.eye(3)
    roll, pitch, yaw = np.asarray(rpy, dtype=np.float64)
    return product(product(axis_rotation(z, yaw), axis_rotation(y, pitch)), axis_rotation(x, roll))


def turn_between(first_rpy: ArrayLike, last_rpy: ArrayLike) -> Array:
    """Return the rotation vector (3,), rad, in base axes that leads from one orientation to another by the shorter way.

    It is exactly zero between equal orientations.
    """
    *a, v = rpy_quaternion(first_rpy)
    *b, w = rpy_quaternion(last_rpy)
    first = np.array(a)
    last = np.array(b)
    # The quaternion of last · first⁻¹.
    vector = v * last - w * first - np.cross(last, first)
    scalar = w * v + dot(last, first)
    return _rotation_vector(vector if scalar >= 0.0 else -vector, abs(scalar))


def rotation_vector(rotation: Array) -> Array:
    """Return the rotation vector (3,), rad, of a rotation (3, 3) by less than half a turn."""
    skew = 0.5 * np.array(
        [
            rotation[2, 1] - rotation[1, 2],
            rotation[0, 2] - rotation[2, 0],
            rotation[1, 0] - rotation[0, 1],
        ]
    )
    sine = length(skew)
    trace = rotation[0, 0] + rotation[1, 1] + rotation[2, 2]
    angle = angles_of(sine, 0.5 * (trace - 1.0))
    return skew * (angle / sine if sine > 0.0 else 1.0)


def _rotation_vector(vector: Array, scalar: float) -> Array:
    sine = length(vector)
    return vector * (2.0 * angles_of(sine, scalar) / sine if sine > 0.0 else 2.0)


def solved(matrix: Array, right: Array) -> Array:
    """Return the solutions (..., 6) for matrices (..., 6, 6) and right sides (..., 6); not finite if there is none."""
    matrices = np.array(np.broadcast_to(matrix, (*right.shape, 6)), dtype=np.float64).reshape(
        -1, 6, 6
    )
    solution = np.array(right, dtype=np.float64).reshape(-1, 6)
    _eliminate(matrices, solution)
    return solution.reshape(right.shape)


@kernel
def _eliminate(matrices: Array, rights: Array) -> None:
    """Solve in place by Gauss's elimination with the largest pivot of each column."""
    for n in range(matrices.shape[0]):
        a = matrices[n]
        x = rights[n]
        for k in range(6):
            pivot = k
            for i in range(k + 1, 6):
                if abs(a[i, k]) > abs(a[pivot, k]):
                    pivot = i
            for j in range(6):
                a[k, j], a[pivot, j] = a[pivot, j], a[k, j]
            x[k], x[pivot] = x[pivot], x[k]
            for i in range(k + 1, 6):
                factor = a[i, k] / a[k, k]
                for j in range(k + 1, 6):
                    a[i, j] -= factor * a[k, j]
                x[i] -= factor * x[k]
        for k in range(5, -1, -1):
            for j in range(k + 1, 6):
                x[k] -= a[k, j] * x[j]
            x[k] /= a[k, k]
