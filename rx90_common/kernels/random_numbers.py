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
# The shifts and factors of SplitMix64's output function.
_SHIFTS = (np.uint64(30), np.uint64(27), np.uint64(31))
_FACTORS = (np.uint64(0xBF58476D1CE4E5B9), np.uint64(0x94D049BB133111EB))
# A word holds four uniform numbers of 16 bits; mean and standard deviation of their sum.
_BITS, _LOW_BITS = np.uint64(16), np.uint64(0xFFFF)
_MEAN = 2.0 * (2**16 - 1)
_DEVIATION = math.sqrt(4.0 * (2.0**32 - 1.0) / 12.0)


@inlined
def mixed(word: Any) -> Any:
    """Return the output of SplitMix64 for its counter, a np.uint64."""
    word = (word ^ (word >> _SHIFTS[0])) * _FACTORS[0]
    word = (word ^ (word >> _SHIFTS[1])) * _FACTORS[1]
    return word ^ (word >> _SHIFTS[2])


@inlined
def nearly_normal(word: Any) -> float:
    """Return a random number of mean 0 and variance 1, within 3.5, from a word: the sum of its four uniform ones."""
    total = 0.0
    for _ in range(4):
        total += float(word & _LOW_BITS)
        word >>= _BITS
    return (total - _MEAN) / _DEVIATION
