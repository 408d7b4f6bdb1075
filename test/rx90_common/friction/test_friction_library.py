"""The library of identified friction: complete provenance, intervals, ranges, and agreement with others' values.

Others' values are the sources' own, where they publish some, and those of a script of plain least squares that shares
nothing with this project (docs/explanation/measured.md), each Coulomb torque in Nm and viscous friction in Nm s/rad.
"""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from rx90_common.base.share import config_path
from rx90_common.friction.friction_file import FrictionFile

MEASURED = Path(__file__).parents[3] / "docs" / "explanation" / "measured.md"
LIBRARY = sorted(config_path("friction/library").glob("*.yaml"))
UR = ("shoulder_pan", "shoulder_lift", "elbow", "wrist_1", "wrist_2", "wrist_3")
OTHERS = {
    "tx40_gautier": {
        "joint_1": (7.14, 8.05), "joint_2": (8.26, 5.53), "joint_3": (6.34, 1.97), "joint_4": (2.48, 1.11),
        "joint_5": (3.03, 1.24), "joint_6": (0.28, 0.034), "joint_5_6": (1.95, 0.616),
    },
    "panda_gaz": {
        f"panda_joint{k}": pair
        for k, pair in enumerate(
            ((0.29, 0.03), (0.20, 0.07), (0.25, 0.01), (0.50, 0.09), (0.26, 0.07), (0.160, 0.002), (0.246, 0.033)), 1
        )
    },
    "tiago_figaroh": {
        f"arm_{k}_joint": pair for k, pair in enumerate(((1.81, 30.5), (5.21, 12.8), (3.06, 4.4), (2.14, 3.99)), 1)
    },
    "ur10e_mamedov": {
        f"{name}_joint": pair
        for name, pair in zip(
            UR, ((12.55, 21.26), (13.27, 20.22), (4.99, 10.38), (2.00, 3.58), (2.69, 2.49), (2.30, 3.03)), strict=True
        )
    },
    "direct_drive_chavez": {"shoulder": (11.7, 3.05), "elbow": (1.83, 0.125)},
}  # fmt: skip
WITHIN = {("tx40_gautier", "joint_6"): 0.35} | {("panda_gaz", f"panda_joint{k}"): 0.25 for k in (1, 2, 3)}
"""Relative difference of torques, 0.15 of all others; these elements have hardly any friction beside other torques."""


@pytest.fixture(params=LIBRARY, ids=lambda path: path.stem)
def file(request: pytest.FixtureRequest) -> FrictionFile:
    """Return a file of the library."""
    return FrictionFile.read(request.param)


def stated(file: FrictionFile, *keys: str) -> dict[str, Any]:
    """Return a block of what is stated of the identification."""
    found: Any = file.identification
    for key in keys:
        found = found[key]
    assert isinstance(found, dict)
    return found


def test_a_file_says_where_its_data_are_and_how_to_come_to_it(file: FrictionFile) -> None:
    """Address, revision, licence and bags' digests are there; the commands are those of the page."""
    recording, page = stated(file, "recording"), MEASURED.read_text(encoding="utf-8")
    assert file.provenance == "identified"
    assert set(recording) == {
        "arm", "source", "url", "revision", "folder", "licence", "torques", "torque_error", "described_in", "commands",
    }  # fmt: skip
    assert re.fullmatch(r"https://github\.com/[\w-]+/[\w-]+", str(recording["url"]))
    assert re.fullmatch(r"[0-9a-f]{40}", str(recording["revision"]))
    assert f"git clone {recording['url']}\n" in page
    for line in str(recording["commands"]).splitlines():
        assert line in page
    name, _, anchor = str(recording["described_in"]).partition("#")
    assert MEASURED.as_posix().endswith(name)
    headings = [re.sub(r"[^\w -]", "", one).lower().replace(" ", "-") for one in re.findall(r"^## (.*)$", page, re.M)]
    assert anchor in headings
    for bag in stated(file, "bags").values():
        assert re.fullmatch(r"[0-9a-f]{64}", bag["sha256"])


def test_identified_values_stand_in_their_intervals(file: FrictionFile) -> None:
    """Each identified value is the middle of its interval of 1.96 deviations; every element has some, and a range."""
    assert set(stated(file, "speeds")) == set(file.elements) == set(stated(file, "parameters"))
    for name, element in file.elements.items():
        low, high = stated(file, "speeds")[name]
        assert 0.0 < low < high < 20.0
        known = {key: one for key, one in stated(file, "parameters", name).items() if one["provenance"] == "identified"}
        assert {"tau_c_positive", "tau_c_negative"} <= set(known)
        for key, one in known.items():
            value, (least, most) = getattr(element, key), one["interval"]
            assert value == one["value"]
            digits = 1e-5 * max(abs(least), abs(most))
            assert 0.5 * (least + most) == pytest.approx(value, abs=digits)
            assert 0.5 * (most - least) == pytest.approx(1.96 * one["deviation"], abs=digits + 2e-5 * one["deviation"])


def test_torques_are_near_those_of_others(file: FrictionFile) -> None:
    """From a fifth of the fastest speed of the data on the mean torque of both directions is that of others' fits."""
    assert file.path is not None
    others = OTHERS[file.path.stem]
    assert set(others) == set(file.elements)
    for name, (coulomb, viscous) in others.items():
        _, high = stated(file, "speeds")[name]
        speed, element = np.linspace(0.2 * high, high, 9), file.elements[name]
        torque = 0.5 * (element.steady_torque(speed) - element.steady_torque(-speed))
        difference = float(np.abs(torque / (coulomb + viscous * speed) - 1.0).max())
        assert difference < WITHIN.get((file.path.stem, name), 0.15), (name, difference)


def test_all_that_is_compared_is_there() -> None:
    """The library has the five sets, and no name that a published set has."""
    assert [path.stem for path in LIBRARY] == sorted(OTHERS)
    assert not {path.stem for path in LIBRARY} & {path.stem for path in config_path("friction").glob("*.yaml")}
