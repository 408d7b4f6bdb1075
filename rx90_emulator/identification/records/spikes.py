"""Samples that stand out alone: a wild value of a sensor, not a motion."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import median_filter

_NEIGHBOURS = 5  # samples whose median a sample is compared with
_OUTLIER = 4.0  # times what 99 % of the samples keep from it
_SPIKE = 0.02  # and this part of the signal's range
_ALONE = 0.25  # share of its distance that its neighbours keep


def spikes(values: NDArray[np.float64]) -> NDArray[np.bool_]:
    """Return the rows of samples, shape (m, k), in which a column stands out from its neighbours, and these do not.

    The start of a motion stands out, too, but not for a single sample.
    """
    distance = np.abs(values - median_filter(values, size=(_NEIGHBOURS, 1), mode="nearest"))
    usual = np.percentile(distance, 99.0, axis=0)
    low, high = np.percentile(values, (1.0, 99.0), axis=0)
    far = distance > _OUTLIER * usual + _SPIKE * (high - low) + 1e-9
    beside = np.pad(distance, ((1, 1), (0, 0)))
    return np.asarray((far & (_ALONE * distance > beside[:-2]) & (_ALONE * distance > beside[2:])).any(axis=1))
