"""Joints that stand still in a bag for the validation."""

from __future__ import annotations

import numpy as np
import pytest

from rx90_emulator.identification.options import ValidationTolerances
from rx90_emulator.identification.output.report import check_page
from rx90_emulator.identification.output.summary import check_summary
from rx90_emulator.identification.validation.prediction import Validation
from rx90_emulator.identification.validation.verdict import TorquePrediction


def validation(error: float) -> Validation:
    """Return a validation in which joint_1 moves and is off by a share of its torque, and joint_2 stands still."""
    time = np.linspace(0.0, 1.0, 101)
    recorded = np.stack([3.0 + np.cos(time), np.full(101, 2.0)], axis=1)
    predicted = recorded * [1.0 + error, 5.0]
    moves = np.stack([time >= 0.0, time < 0.0], axis=1)
    torque = TorquePrediction(time, recorded, predicted, moves)
    nothing = np.zeros(0)
    return Validation(("joint_1", "joint_2"), torque, nothing, nothing, ValidationTolerances(), "bag")


@pytest.mark.parametrize(("error", "confirmed"), [(0.04, True), (0.06, False)])
def test_a_joint_at_rest_does_not_decide(error: float, confirmed: bool) -> None:
    """What a joint gives at rest is not compared; the verdict is on the joints that move, here 5 % of the torque."""
    check = validation(error)
    assert check.passed is confirmed
    assert check.rms_share[0] == pytest.approx(error, rel=1e-12)
    assert np.isnan([check.rms[1], check.rms_share[1], check.worst[1], check.worst_share[1]]).all()
    assert f"{100.0 * error:.2f}" in check_page([check], "friction.yaml")
    row = next(line for line in check_summary([check]).splitlines() if line.startswith("joint_2"))
    assert row.split() == ["joint_2", "-", "-", "-", "-"]
