"""Models compared by their errors in data that they were not fitted to."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import stats

from rx90_common.friction.held_out import HeldOutErrors, leave_out

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


@pytest.mark.parametrize(
    ("factor", "p", "share"), [(1.0, 0.01, 0.1), (1.05, 0.05, 0.1), (1.3, 1e-3, 0.1), (4.0, 0.01, 5.0)]
)
def test_a_model_is_refuted_by_scipys_paired_test_and_by_a_share(factor: float, p: float, share: float) -> None:
    """A model is refuted exactly where SciPy's one-sided paired t-test is below p and its errors exceed the share."""
    held_out = errors(factor)
    less, more = (held_out.squares[name] for name in ("good", "bad"))
    test = stats.ttest_rel(held_out.scores["bad"], held_out.scores["good"], alternative="greater")
    expected = "good" if test.pvalue < p and more.mean() > (1.0 + share) * less.mean() else None
    assert held_out.refutes("bad", ("good", "bad"), p, share) == expected
    assert held_out.refutes("good", ("good",), p, share) is None


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


def test_each_block_is_predicted_by_a_fit_that_has_not_seen_it() -> None:
    """Leaving out gives the fits without each block, and errors that do not change with the block's own noise in it."""
    data = np.random.default_rng(3).normal(1.0, 0.1, 8)
    fits, squares = leave_out(
        range(8), lambda k: np.delete(data, k).mean(), lambda mean, k: (data[k : k + 1] - mean) ** 2
    )
    assert fits == pytest.approx([(data.sum() - one) / 7.0 for one in data], rel=1e-12)
    assert squares == pytest.approx(((data - data.mean()) * 8.0 / 7.0) ** 2, rel=1e-9)
