"""Compiled sums over samples: a symmetric filter of which every n-th sample is kept, and linear interpolation."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from rx90_common.base.arrays import Array
from rx90_common.kernels.compiled import kernel
from rx90_common.kernels.lanes import fma, load, store


@kernel
def filter_columns(columns: Array, taps: Array, down: int, result: Array) -> None:
    """Filter samples of several columns.

    Args:
        columns: at the full rate, shape (c, m).
        taps: by which samples are multiplied, shape (t,).
        down: samples from one result to the next.
        result: takes the sums, of which the first begins at sample 0, shape (k, c).
    """
    whole = len(taps) - len(taps) % 16
    parts = np.empty(8)
    for number in range(len(columns)):
        for row in range(len(result)):
            samples = columns[number, row * down :]
            parts[:] = 0.0
            even = load(parts, 8)
            odd = load(parts, 8)
            for tap in range(0, whole, 16):
                even = fma(load(taps[tap:], 8), load(samples[tap:], 8), even)
                odd = fma(load(taps[tap + 8 :], 8), load(samples[tap + 8 :], 8), odd)
            store(parts, even + odd)
            total = 0.0
            for part in parts:
                total += part
            for tap in range(whole, len(taps)):
                total += taps[tap] * samples[tap]
            result[row, number] = total


@kernel
def between(values: Array, before: NDArray[np.intp], share: Array, result: Array) -> None:
    """Interpolate linearly.

    Args:
        values: shape (s, c).
        before: number of the value before each result, shape (m,).
        share: of the value after it, shape (m,).
        result: takes what lies between, shape (m, c).
    """
    for row in range(len(result)):
        first, part = before[row], share[row]
        for column in range(values.shape[1]):
            result[row, column] = values[first, column] * (1.0 - part) + values[first + 1, column] * part
