"""Lists and distributions of values."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from scipy import stats

from rx90_common.base.errors import ConfigError
from rx90_emulator.sweep.plan import Distribution, LogUniform, Normal, Uniform, Values

SHARES = (2.0**-54, 1e-6, 0.25, 0.5, 0.9, 1.0 - 2.0**-53)


@pytest.mark.parametrize(
    ("distribution", "oracle"),
    [
        (Uniform(-1.0, 3.0), stats.uniform(-1.0, 4.0)),
        (LogUniform(1e-3, 10.0), stats.loguniform(1e-3, 10.0)),
        (Normal(1.0, 0.2), stats.norm(1.0, 0.2)),
        (Normal(1.0, 0.2, low=0.7), stats.truncnorm(-1.5, np.inf, 1.0, 0.2)),
        (Normal(1.0, 0.2, low=0.9, high=1.6), stats.truncnorm(-0.5, 3.0, 1.0, 0.2)),
    ],
)
def test_quantiles(distribution: Distribution, oracle: Any) -> None:
    """The quantiles are SciPy's, finite and within the bounds even at the ends of the generator's range."""
    for share in SHARES:
        value = distribution.quantile(share)
        assert math.isfinite(value)
        assert value == pytest.approx(oracle.ppf(share), rel=1e-7, abs=1e-12)
        if not isinstance(distribution, Normal):
            assert distribution.low <= value <= distribution.high


def test_spaced_values() -> None:
    """Evenly and geometrically spaced values keep both ends."""
    assert Values.linspace(0.0, 1.0, 5).values == (0.0, 0.25, 0.5, 0.75, 1.0)
    assert Values.geomspace(0.25, 4.0, 5).values == pytest.approx((0.25, 0.5, 1.0, 2.0, 4.0))


@pytest.mark.parametrize(
    ("build", "said"),
    [
        (lambda: Values(()), "empty"),
        (lambda: Values((1.0, 2.0, 1.0)), "1.0 stands twice"),
        (lambda: Values((math.nan,)), "finite"),
        (lambda: Values.linspace(0.0, 1.0, -3), "count of values is -3"),
        (lambda: Values.linspace(0.0, 1.0, 2.5), "count of values is 2.5"),
        (lambda: Values.geomspace(0.0, 1.0, 3), "both > 0"),
        (lambda: Uniform(2.0, 2.0), "bounds are 2 and 2"),
        (lambda: Uniform(-math.inf, 2.0), "finite"),
        (lambda: LogUniform(0.0, 2.0), "lower bound > 0"),
        (lambda: Normal(1.0, 0.0), "deviation is 0"),
        (lambda: Normal(1.0, 0.1, low=2.0), "leave"),
    ],
)
def test_spaces_without_sense_are_refused(build: Any, said: str) -> None:
    """A list or distribution without sense is refused with the value and what is accepted."""
    with pytest.raises(ConfigError, match=said) as error:
        build()
    assert "accepted" in str(error.value)
