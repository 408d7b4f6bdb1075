"""The elementary functions for numbers and arrays of Python, for computations before compiled code runs."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import ArrayLike, NDArray

from rx90_common.kernels.compiled import kernel
from rx90_common.kernels.elementary import arctangent, exponential, exponential_less_one, power, sine_cosine

_Array = NDArray[np.float64]


def sines_cosines(angle: ArrayLike) -> tuple[_Array, _Array]:
    """Return sine and cosine of angles, rad, of any shape."""
    angles = np.array(angle, dtype=np.float64)
    sine, cosine = np.empty(angles.size), np.empty(angles.size)
    _sines_cosines(angles.ravel(), sine, cosine)
    return sine.reshape(angles.shape), cosine.reshape(angles.shape)


def angles_of(y: ArrayLike, x: ArrayLike) -> _Array:
    """Return the angles of points, rad, from -pi to pi; the shapes are broadcast."""
    return _of_pairs(_angles, y, x)


def powers(base: ArrayLike, exponent: ArrayLike) -> _Array:
    """Return base^exponent for bases >= 0 and exponents > 0; the shapes are broadcast."""
    return _of_pairs(_powers, base, exponent)


def _of_pairs(compute: Callable[[_Array, _Array, _Array], None], *given: ArrayLike) -> _Array:
    pairs = np.stack(np.broadcast_arrays(*(np.asarray(one, dtype=np.float64) for one in given)))
    result = np.empty(pairs[0].size)
    compute(pairs[0].ravel(), pairs[1].ravel(), result)
    return result.reshape(pairs[0].shape)


@kernel
def exponential_of(x: float) -> float:
    """Return exp(x) for x up to 708; below -708 it is 0."""
    return exponential(x)


@kernel
def exponential_less_one_of(x: float) -> float:
    """Return exp(x) - 1 for x up to 708, without cancellation next to 0."""
    return exponential_less_one(x)


@kernel
def _sines_cosines(angle: _Array, sine: _Array, cosine: _Array) -> None:
    for i in range(angle.size):
        sine[i], cosine[i] = sine_cosine(angle[i])


@kernel
def _powers(base: _Array, exponent: _Array, result: _Array) -> None:
    for i in range(base.size):
        result[i] = power(base[i], exponent[i])


@kernel
def _angles(y: _Array, x: _Array, angle: _Array) -> None:
    for i in range(y.size):
        angle[i] = arctangent(y[i], x[i])
