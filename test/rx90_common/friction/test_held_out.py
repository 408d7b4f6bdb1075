"""Models compared by their errors in data that they were not fitted to."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import stats

from rx90_common.friction.held_out import HeldOutErrors

_BLOCKS = 40


def errors(factor: float) -> HeldOutErrors[str]:
    """Return the errors of a model and of one whose squared errors are `factor` times as large, but for chance."""
    rng = np.random.default_rng(1)
    good = rng.chisquare(3, _BLOCKS) + 1.0
    return HeldOutErrors({"good": good, "bad": factor * good * np.exp(rng.normal(0.0, 0.3, _BLOCKS))})


@pytest.mark.parametrize("factor", [1.0, 1.5, 4.0])
def test_the_distance_is_that_of_a_paired_t_test(factor: float) -> None:
    """Standard errors between two models are SciPy's paired t statistic, but for Bessel's correction."""
    held_out = errors(factor)
    paired = stats.ttest_rel(held_out.scores["bad"], held_out.scores["good"]).statistic
    assert held_out.behind("bad", "good") == pytest.approx(paired * np.sqrt(_BLOCKS / (_BLOCKS - 1)), rel=1e-12)
    assert held_out.behind("good", "good") == 0.0


def test_the_best_model_has_the_least_errors() -> None:
    """Of all models, or of some, the best is that with the least mean logarithm of its errors."""
    held_out = errors(4.0)
    assert held_out.best() == "good"
    assert held_out.best(["bad"]) == "bad"
