"""Models compared by their errors in data that they were not fitted to."""

from __future__ import annotations

import numpy as np
import pytest

from rx90_common.friction.held_out import HeldOutErrors

_BLOCKS = 40


def test_the_gain_has_the_deviation_of_repeated_experiments() -> None:
    """The standard error of the gain in RMS error is the scatter of gains over many sets of blocks of unequal size."""
    rng = np.random.default_rng(2)
    gains, deviations = [], []
    for _ in range(2000):
        rows = rng.integers(20, 40, _BLOCKS).astype(float)
        good = rng.chisquare(rows)
        held_out = HeldOutErrors({"good": good, "bad": good + 0.3 * rng.chisquare(rows)}, rows)
        gain, deviation = held_out.gain("good", "bad")
        gains.append(gain)
        deviations.append(deviation)
        assert gain == pytest.approx(held_out.rms("bad")[0] - held_out.rms("good")[0], abs=1e-12)
    assert np.mean(deviations) == pytest.approx(np.std(gains), rel=0.08)
