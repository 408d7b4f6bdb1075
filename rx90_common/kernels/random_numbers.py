"""Random numbers in compiled code, with the same bits on every machine: SplitMix64 (Steele, Lea and Flood 2014).

Steele, Lea and Flood, Fast splittable pseudorandom number generators. A sequence is a counter that grows by GOLDEN.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from rx90_common.kernels.compiled import inlined

GOLDEN = np.uint64(0x9E3779B97F4A7C15)
"""What a counter grows by from one word to the next."""
_FIRST, _SECOND = np.uint64(0xBF58476D1CE4E5B9), np.uint64(0x94D049BB133111EB)
_THIRTY, _27, _31 = np.uint64(30), np.uint64(27), np.uint64(31)
_SIXTEEN, _LOW = np.uint64(16), np.uint64(0xFFFF)
_MIDDLE = 2.0 * (2**16 - 1)
"""Mean of the sum of four numbers of 16 bits."""
_DEVIATION = math.sqrt(4.0 * (2.0**32 - 1.0) / 12.0)
"""Standard deviation of it."""


@inlined
def mixed(word: Any) -> Any:
    """Return the output of SplitMix64 for its counter, a np.uint64."""
    word = (word ^ (word >> _THIRTY)) * _FIRST
    word = (word ^ (word >> _27)) * _SECOND
    return word ^ (word >> _31)


@inlined
def of_four(word: Any) -> float:
    """Return a random number of mean 0 and variance 1, within 3.5, from a word: the sum of four uniform ones."""
    total = 0.0
    for _ in range(4):
        total += float(word & _LOW)
        word >>= _SIXTEEN
    return (total - _MIDDLE) / _DEVIATION
