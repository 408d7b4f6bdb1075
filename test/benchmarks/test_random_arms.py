"""The random arms that the identification from excitation runs is measured with, and logs that are poor."""

import numpy as np
import pytest

from benchmarks.poor_logs import CONDITIONS, experiment


@pytest.mark.parametrize("condition", CONDITIONS)
def test_a_poor_log_gives_intervals_that_hold_and_no_wrong_verdict(condition: str) -> None:
    """Of one arm nothing is refused but a negated torque, an unseen run is confirmed, and intervals hold."""
    outcome = experiment((2, condition))
    assert not outcome.wrong
    assert (condition == "negated torque") == (not outcome.held)
    if outcome.held:
        assert np.mean(outcome.held) >= (0.75 if condition == "dead joint" else 0.85)
