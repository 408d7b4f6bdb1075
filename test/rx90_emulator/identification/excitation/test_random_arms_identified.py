"""The whole way from runs of random arms to parameters, held against what is true of the arms."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from benchmarks.excitation_coverage import Case, Outcome, experiment
from benchmarks.excitation_runs import MISFIT
from benchmarks.random_arms import random_arm

QUANTILE = 3.3
"""Deviations that one of a thousand values exceeds."""


@pytest.fixture(scope="module")
def outcome() -> Outcome:
    """Return what came of an arm with coupled wrist, ripple and friction that grows with load, motions played twice."""
    arm = random_arm(1, 2, coupled=True, stribeck=False)
    return experiment(replace(Case.of(arm, MISFIT, 100.0, periods=2, seed=1), motions=12))


def test_intervals_hold_the_truth(outcome: Outcome) -> None:
    """Nine of ten 95 % intervals of base parameters and friction hold the best-fitting values, and none is far off."""
    scores = np.abs([score for kind in ("base", "Coulomb", "viscous", "exponent") for score in outcome.scores[kind]])
    assert len(scores) > 15
    assert np.mean(scores < 1.96) >= 0.9
    assert scores.max() < QUANTILE
    assert np.sqrt(np.mean(scores**2)) > 0.4  # intervals are not far too wide


def test_exponents_are_found(outcome: Outcome) -> None:
    """Exponents of the viscous friction are within 0.05 of the true ones."""
    assert len(outcome.errors["exponent"]) == 3
    assert np.abs(outcome.errors["exponent"]).max() < 0.05


def test_an_unseen_run_is_predicted(outcome: Outcome) -> None:
    """The torque of a run that was not used is off by no more than 1.2 times what the best model leaves."""
    assert max(outcome.floor) < 1.2
    assert max(outcome.noise) < 2.0
