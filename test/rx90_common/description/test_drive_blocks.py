"""The blocks of a drives file: cogging, windings, current sensors, elasticity; read, refused, off by default."""

import math
import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from refusals import refusal_by

from rx90_common.base.errors import ConfigError
from rx90_common.description.drives import IDEAL_SENSOR, LINK, MOTOR, Cogging, Elasticity, load_drives
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
STIFFNESS = [1e5, math.inf, 5e4, 1e4, 6e3, 2e3]
ELASTICITY = {
    "provenance": "assumed",
    "stiffness": STIFFNESS,
    "damping": [20.0, 0.0, 5.0, 1.0, 0.6, 0.2],
    "backlash": [0.0, 0.0, 0.0, 1e-4, 2e-4, 3e-4],
    "friction": LINK,
}
SENSOR = {"offset": [0.02] * 6, "noise": [0.01] * 6, "resolution": [0.005] * 6, "bandwidth": 800.0}


def test_the_blocks_are_read(shipped_files: RobotFiles, edited_yaml: Edit) -> None:
    """What a file says is what the drives have, and what it leaves out what the declaration says."""

    def with_block(name: str, content: Any) -> Any:
        return getattr(load_drives(edited_yaml(shipped_files.drives, (name,), content)), name)

    cogging = with_block("cogging", COGGING)
    assert np.array_equal(cogging.amplitude, COGGING["amplitude"])
    assert np.array_equal(cogging.phase, [[0.0] * 6] * 2)
    winding = with_block("winding", WINDING)
    assert (winding.initial, winding.reference, winding.coefficient) == (25.0, 20.0, 0.00393)
    assert winding.used
    assert with_block("current_sensor", SENSOR).used
    whole, short = with_block("elasticity", ELASTICITY), with_block("elasticity", {"stiffness": STIFFNESS})
    assert (whole.friction, short.friction) == (LINK, MOTOR)
    assert whole.elastic.tolist() == [True, False, True, True, True, True]
    assert not any([*short.damping, *short.backlash])


@pytest.mark.parametrize("name", ["offset", "noise", "resolution"])
def test_each_error_of_a_sensor_counts_alone(name: str) -> None:
    """A sensor with one of its errors, at one motor, is not taken for an ideal one."""
    assert IDEAL_SENSOR.replaced(**{name: 0.01 * np.eye(6)[5]}).used
    assert not IDEAL_SENSOR.replaced(**{name: np.zeros(6)}).used


def test_shipped_drives_are_ideal() -> None:
    """Without the blocks drives are rigid, without cogging, heat and errors of sensors, as in all shipped robots."""
    for robot in ("rx90b", "tx40"):
        drives = load_drives(RobotFiles.named(robot).drives)
        assert not drives.cogging.used
        assert not drives.winding.used
        assert not drives.current_sensor.used
        assert not drives.elasticity.elastic.any()


@pytest.mark.parametrize(
    ("block", "content", "said"),
    [
        ("cogging", {**COGGING, "harmonic": [6.0]}, "cogging.amplitude is"),
        ("winding", {**WINDING, "limit": 100.0}, "winding.derating is 120.0; accepted: below limit = 100 °C"),
        ("winding", {**WINDING, "ambient": 130.0}, "winding.derating is 120.0; accepted: at least 130 °C"),
    ],
)
def test_values_that_do_not_fit_each_other_are_refused(
    shipped_files: RobotFiles, edited_yaml: Edit, block: str, content: Any, said: str
) -> None:
    """One line names file, block, key, value and what is accepted; eight waves are as many as are taken."""
    path = edited_yaml(shipped_files.drives, (block,), content)
    line = refusal_by(load_drives, path)
    assert f"{path}: {said}" in line
    assert Cogging(harmonic=[1.0] * 8, amplitude=[[1.0] * 6] * 8).used


@pytest.mark.parametrize("key", ["damping", "backlash"])
def test_a_rigid_drive_has_neither_damping_nor_play(shipped_files: RobotFiles, edited_yaml: Edit, key: str) -> None:
    """Damping or play beside an infinite stiffness is refused, not ignored: from a file and from Python."""
    values = [0.0, 1e-4, 0.0, 0.0, 0.0, 0.0]
    path = edited_yaml(shipped_files.drives, ("elasticity",), {**ELASTICITY, key: values})
    said = "is 0.0001; accepted: 0 for a rigid drive, as stiffness[1] is infinite"
    assert f"{path}: elasticity.{key}[1] {said}" in refusal_by(load_drives, path)
    with pytest.raises(ConfigError, match=re.escape(f"{key}[1] {said}")):
        Elasticity(stiffness=STIFFNESS).replaced(**{key: np.array(values)})
