"""How often the test for a drift within a series claims one that is not there."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.signal import lfilter
from scipy.stats import binom

from rx90_emulator.identification.sliding.quality import FALSE_ALARMS, Residuals, drifts_of

SERIES = 500


def residuals(seed: int, elements: int, count: int, keep: float) -> Residuals:
    """Return what a fit of one level for each element leaves of noise, `keep` of which each plateau hands on."""
    rng = np.random.default_rng(seed)
    plateaus, owner = elements * count, np.repeat(np.arange(elements), count)
    noise = lfilter([1.0], [1.0, -keep], rng.normal(size=(elements, count + 50)), axis=1)[:, 50:]
    gain = np.eye(elements)[owner]
    left = (noise - noise.mean(axis=1, keepdims=True)).ravel()
    time = np.tile(np.arange(float(count)), elements)
    return Residuals(left, gain, gain, np.arange(plateaus), gain, gain * left[:, None], time)


@pytest.mark.parametrize(("elements", "count", "keep"), [(7, 100, 0.0), (1, 40, 0.6)])
def test_drift_is_claimed_as_rarely_as_it_says(elements: int, count: int, keep: float) -> None:
    """Of all elements together, and with errors that a plateau hands on to the next, no more than by the level."""
    free = np.ones((elements, 1), dtype=np.bool_)
    found = [
        any(drift.significant for drift in drifts_of(residuals(seed, elements, count, keep), free))
        for seed in range(SERIES)
    ]
    assert sum(found) <= binom.ppf(0.95, SERIES, FALSE_ALARMS)
