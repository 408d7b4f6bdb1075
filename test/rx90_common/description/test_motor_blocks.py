"""The blocks of a drives file about its motors: cogging, windings, current sensors; read, refused, off by default."""

from __future__ import annotations

import math
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from refusals import refusal_by

from rx90_common.base.errors import ConfigError
from rx90_common.description.cogging import Cogging
from rx90_common.description.current_sensor import CurrentSensor
from rx90_common.description.drives import load_drives
from rx90_common.description.robot_files import RobotFiles
from rx90_common.description.winding import Windings

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
    """What a file says is what the drives have.

    What it leaves out: phases are 0, windings as warm as their surroundings and of copper (IEC 60028) at 20 degrees.
    """
    cogging = load_drives(edited_yaml(shipped_files.drives, ("cogging",), COGGING)).cogging
    assert cogging.harmonic.tolist() == COGGING["harmonic"]
    assert cogging.amplitude.tolist() == COGGING["amplitude"]
    assert cogging.phase.tolist() == [[0.0] * 6] * 2
    winding = load_drives(edited_yaml(shipped_files.drives, ("winding",), WINDING)).winding
    for name, value in WINDING.items():
        assert np.array_equal(getattr(winding, name), np.array(value))
    assert (winding.initial, winding.reference, winding.coefficient) == (25.0, 20.0, 0.00393)
    assert winding.used
    sensor = load_drives(edited_yaml(shipped_files.drives, ("current_sensor",), SENSOR)).current_sensor
    for name, value in SENSOR.items():
        assert np.array_equal(getattr(sensor, name), np.array(value))
    assert sensor.used
    phase = np.random.default_rng(1).uniform(-3.0, 3.0, (2, 6)).tolist()
    cogging = load_drives(edited_yaml(shipped_files.drives, ("cogging",), {**COGGING, "phase": phase})).cogging
    assert cogging.phase.tolist() == phase
    rest = {"initial": 40.0, "reference": 30.0, "coefficient": 0.004}
    winding = load_drives(edited_yaml(shipped_files.drives, ("winding",), {**WINDING, **rest})).winding
    assert {name: getattr(winding, name) for name in rest} == rest


@pytest.mark.parametrize("name", ["offset", "noise", "resolution"])
def test_each_error_of_a_sensor_counts_alone(name: str) -> None:
    """A sensor with one of its errors, at one motor, is not taken for an ideal one."""
    assert CurrentSensor(**{name: 0.01 * np.eye(6)[5]}).used
    assert not CurrentSensor(**{name: np.zeros(6)}).used


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
        (
            "cogging",
            {**COGGING, "harmonic": [6.0, 1001.0]},
            "cogging.harmonic[1] is 1001.0; accepted: a number in (0, ",
        ),
        ("cogging", {**COGGING, "harmonic": [6.0, 0.0]}, "cogging.harmonic[1] is 0.0; accepted: a number in (0, 1000]"),
        ("cogging", {**COGGING, "harmonic": []}, "cogging.harmonic is []; accepted: a list of numbers"),
        ("cogging", {**COGGING, "harmonic": [6.0]}, "cogging: amplitude is"),
        (
            "cogging",
            {"harmonic": [6.0] * 9, "amplitude": [[0.1] * 6] * 9},
            "cogging: harmonic has 9 numbers; accepted: ",
        ),
        ("cogging", {**COGGING, "phase": [[0.0] * 6]}, "cogging: phase is"),
        ("cogging", {**COGGING, "amplitude": [[0.1] * 5]}, "cogging.amplitude[0] is"),
        ("winding", {**WINDING, "limit": 100.0}, "winding: derating is 120 °C; accepted: below limit = 100 °C"),
        ("winding", {**WINDING, "ambient": -300.0}, "winding.ambient is -300.0; accepted: a number in [-273.15, 1000]"),
        ("winding", {**WINDING, "resistance": [0.0] * 6}, "winding.resistance[0] is 0.0; accepted: 6 numbers"),
        ("winding", {**WINDING, "thermal_resistance": [0.0] * 6}, "winding.thermal_resistance[0] is 0.0; accepted: 6"),
        ("winding", {**WINDING, "heat_capacity": [0.0] * 6}, "winding.heat_capacity[0] is 0.0; accepted: 6 numbers"),
        (
            "winding",
            {**WINDING, "ambient": 130.0},
            "winding: derating is 120 °C; accepted: at least 130 °C, as it begin",
        ),
        (
            "winding",
            {**WINDING, "initial": 130.0},
            "winding: derating is 120 °C; accepted: at least 130 °C, as it begin",
        ),
        (
            "winding",
            {**WINDING, "ambient": 130.0, "initial": 20.0},
            "winding: derating is 120 °C; accepted: at least 130",
        ),
        ("winding", {**WINDING, "coefficient": 0.393}, "winding.coefficient is 0.393; accepted: a number in [0, 0.1]"),
        ("winding", {**WINDING, "limit": 1001.0}, "winding.limit is 1001.0; accepted: a number in [-273.15, 1000]"),
        ("current_sensor", {**SENSOR, "noise": [-0.1] * 6}, "current_sensor.noise[0] is -0.1; accepted: 6 numbers"),
        (
            "current_sensor",
            {**SENSOR, "resolution": [-0.1] * 6},
            "current_sensor.resolution[0] is -0.1; accepted: 6 num",
        ),
        (
            "current_sensor",
            {**SENSOR, "bandwidth": math.inf},
            "current_sensor.bandwidth is inf; accepted: a finite num",
        ),
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


@pytest.mark.parametrize(
    ("make", "said"),
    [
        (
            lambda: Cogging(np.zeros(1), np.ones((1, 6)), np.zeros((1, 6))),
            r"cogging: harmonic\[0\] is 0.0; accepted: a number in \(0, 1000\]",
        ),
        (
            lambda: Cogging(np.ones(9), np.ones((9, 6)), np.zeros((9, 6))),
            "cogging: harmonic has 9 numbers; accepted: up",
        ),
        (
            lambda: Cogging(np.ones(1), np.full((1, 6), math.nan), np.zeros((1, 6))),
            "cogging: amplitude.* is .*; accepted",
        ),
        (
            lambda: CurrentSensor(bandwidth=math.inf),
            "current_sensor: bandwidth is inf; accepted: a finite number > 0",
        ),
        (
            lambda: CurrentSensor(offset=np.full(6, math.nan)),
            r"current_sensor: offset.* is .*; accepted: 6 numbers, each a finite number",
        ),
        (
            lambda: CurrentSensor(noise=np.zeros(5)),
            "current_sensor: noise is .*; accepted: 6 numbers, each a number >= 0",
        ),
        (
            lambda: Windings(resistance=np.full(6, -1.0)),
            r"winding: resistance\[0\] is -1.0; accepted: 6 numbers",
        ),
    ],
)
def test_a_wrong_value_is_refused_in_python(make: Callable[[], object], said: str) -> None:
    """The classes refuse what the file refuses; eight waves are as many as are taken."""
    with pytest.raises(ConfigError, match=said):
        make()
    assert Cogging(np.ones(8), np.ones((8, 6)), np.zeros((8, 6))).used
