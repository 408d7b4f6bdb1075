"""Where torques are compared: block means of the simulation's steps, in the band of micro-oscillations."""

from __future__ import annotations

from functools import lru_cache

import numpy as np
from scipy.fft import rfft, rfftfreq
from scipy.signal.windows import tukey

from rx90_common.base.arrays import Array, Mask

BLOCK = 8
"""Steps of the simulation in one block mean."""
_LOWEST, _HIGHEST = 2.0, 50.0  # Hz: slower is creep and weight, faster is noise
_TAPER = 0.2  # share of a motion under the window's cosine flanks, against leakage


def block_means(values: Array) -> Array:
    """Return means of BLOCK rows; white noise stays white, and micro-oscillations are slower.

    Args:
        values: shape (m, ...).

    Returns:
        Shape (m // BLOCK, ...).
    """
    length = len(values) // BLOCK * BLOCK
    return np.asarray(values[:length].reshape(-1, BLOCK, *values.shape[1:]).mean(axis=1))


def fast_length(longest: int) -> int:
    """Return the largest length up to `longest` >= 1 whose real Fourier transform is fast: 2^i 3^j 5^k.

    scipy.fft.prev_fast_len(longest, real=True) is the same, from SciPy 1.14 on.
    """
    odd: list[int] = [3**j * 5**k for j in range(longest.bit_length()) for k in range(longest.bit_length())]
    return max(n << (longest // n).bit_length() - 1 for n in odd if n <= longest)


@lru_cache(maxsize=16)
def _window(length: int, step: float) -> tuple[Array, Array, Mask]:
    """Return the window over block means, the frequencies of its transform, Hz, and which are in the band."""
    frequency = rfftfreq(length, BLOCK * step)
    return tukey(length, _TAPER), frequency, (frequency >= _LOWEST) & (frequency <= _HIGHEST)


def band_spectrum(torque: Array, step: float) -> tuple[Array, Array]:
    """Return Fourier coefficients in the band of micro-oscillations (Tukey window), and their frequencies.

    Args:
        torque: block means, shape (b, k).
        step: of the simulation, s.

    Returns:
        Real parts above imaginary parts, shape (r, k), scaled so that white noise keeps the standard deviation that
        it has in a single step; frequencies, Hz, shape (r,).
    """
    length = fast_length(len(torque))
    window, frequency, band = _window(length, step)
    parts = rfft((torque - torque.mean(axis=0))[:length] * window[:, None], axis=0)[band]
    parts = parts * np.sqrt(2.0 * BLOCK / (window @ window))
    return np.concatenate([parts.real, parts.imag]), np.tile(frequency[band], 2)
