"""The blocks of a drives file about its motors: cogging, windings, current sensors; read, refused, off by default."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from refusals import refusal_by

from rx90_common.description.drives import load_drives
from rx90_common.description.robot_files import RobotFiles

Edit = Callable[..., Path]
COGGING = {"provenance": "assumed", "harmonic": [6.0, 36.0], "amplitude": [[0.05] * 6, [0.01] * 6]}
WINDING = {
    "resistance": [2.0] * 6,
    "thermal_resistance": [1.5] * 6,
    "heat_capacity": [400.0] * 6,
    "ambient": 25.0,
    "derating": 120.0,
    "limit": 140.0,
}
SENSOR = {"offset": [0.02] * 6, "noise": [0.01] * 6, "resolution": [0.005] * 6, "bandwidth": 800.0}


def test_the_blocks_are_read(shipped_files: RobotFiles, edited_yaml: Edit) -> None:
    """What a file says is what the drives have; phases are 0 and windings as warm as their surroundings by default."""
    cogging = load_drives(edited_yaml(shipped_files.drives, ("cogging",), COGGING)).cogging
    assert cogging.harmonic.tolist() == COGGING["harmonic"]
    assert cogging.amplitude.tolist() == COGGING["amplitude"]
    assert cogging.phase.tolist() == [[0.0] * 6] * 2
    winding = load_drives(edited_yaml(shipped_files.drives, ("winding",), WINDING)).winding
    for name, value in WINDING.items():
        assert np.array_equal(getattr(winding, name), np.array(value))
    assert winding.initial == 25.0
    assert winding.used
    sensor = load_drives(edited_yaml(shipped_files.drives, ("current_sensor",), SENSOR)).current_sensor
    for name, value in SENSOR.items():
        assert np.array_equal(getattr(sensor, name), np.array(value))
    assert sensor.used


def test_shipped_motors_are_ideal() -> None:
    """Without the blocks there is neither cogging nor heat nor an error of a sensor, as in all shipped robots."""
    for robot in ("rx90b", "tx40"):
        drives = load_drives(RobotFiles.named(robot).drives)
        assert not drives.cogging.harmonic.size
        assert not drives.winding.used
        assert not drives.current_sensor.used


@pytest.mark.parametrize(
    ("block", "content", "said"),
    [
        (
            "cogging",
            {**COGGING, "harmonic": [6.0, -1.0]},
            "cogging.harmonic[1] is -1.0; accepted: a number in (0, 1000]",
        ),
        ("cogging", {**COGGING, "harmonic": [6.0]}, "cogging: amplitude is"),
        ("cogging", {**COGGING, "amplitude": [[0.1] * 5]}, "cogging.amplitude[0] is"),
        ("winding", {**WINDING, "limit": 100.0}, "winding: derating is 120 °C; accepted: below limit = 100 °C"),
        ("winding", {**WINDING, "ambient": -300.0}, "winding.ambient is -300.0; accepted: a number in [-273.15, 1000]"),
        ("winding", {**WINDING, "resistance": [0.0] * 6}, "winding.resistance[0] is 0.0; accepted: 6 numbers"),
        ("current_sensor", {**SENSOR, "noise": [-0.1] * 6}, "current_sensor.noise[0] is -0.1; accepted: 6 numbers"),
        ("current_sensor", {**SENSOR, "bandwidth": 0.0}, "current_sensor.bandwidth is 0.0; accepted: a number > 0"),
    ],
)
def test_a_wrong_value_is_refused(
    shipped_files: RobotFiles, edited_yaml: Edit, block: str, content: Any, said: str
) -> None:
    """One line names file, block, key, value and what is accepted."""
    path = edited_yaml(shipped_files.drives, (block,), content)
    line = refusal_by(load_drives, path)
    assert f"{path}: {said}" in line
    assert "accepted" in line
