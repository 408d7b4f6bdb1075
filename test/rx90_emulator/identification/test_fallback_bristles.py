"""Friction files with other bristles than LuGre's as `--fallback`: they go with its c0."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import yaml
from foreign_arms import write_fallback
from hinge_arm import Hinge
from schema_faults import schema_faults

from rx90_common.base.errors import DONE
from rx90_common.friction.friction_file import FrictionFile
from rx90_common.friction.parts.bristles import ElastoPlastic, MaxwellSlip
from rx90_emulator.cli.frame import run
from rx90_emulator.identification import identify as identification
from rx90_emulator.identification.estimates import SLIDING, ElementEstimate, ParameterEstimate
from rx90_emulator.identification.identify import check_friction, identify_records
from rx90_emulator.identification.options import RobotOptions
from rx90_emulator.identification.robot import RecordedRobot

SLIPPING = {"kind": "maxwell_slip", "stiffness": [0.61234567, 0.38765433], "share": [0.25, 0.75], "attraction": 5000.0}
ELASTIC = {"kind": "elasto_plastic", "break_away": 0.4512345678}
PARTS = (
    MaxwellSlip(stiffness=(0.61234567, 0.38765433), share=(0.25, 0.75), attraction=5000.0),
    ElastoPlastic(break_away=0.4512345678),
)


def fallback(path: Path, bristles: dict[str, Any]) -> Path:
    """Write a fallback for the joint with such a block."""
    content = yaml.safe_load(write_fallback(path, ["hinge"]).read_text(encoding="utf-8"))
    content["elements"]["hinge"]["bristles"] = bristles
    path.write_text(yaml.safe_dump(content), encoding="utf-8")
    return path


def test_a_joint_without_micro_oscillations_takes_c0_and_bristles(
    hinge: Hinge, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Sweeps alone leave c0 and block of the fallback, to the last digit, marked as assumed, on page and terminal."""
    given, file = fallback(tmp_path / "given.yaml", SLIPPING), tmp_path / "friction.yaml"
    words = ["--sliding", str(hinge.bag), "--urdf", str(hinge.urdf), "--fallback", str(given), "--output", str(file)]
    assert run("rx90_identify", words) == DONE
    content = yaml.safe_load(file.read_text(encoding="utf-8"))
    element = content["elements"]["hinge"]
    assert (element["bristles"], element["c0"]) == (SLIPPING, 12345.0)
    assert element["note"] == f"bristles: as its c0 those of {given}, assumed"
    numbers = content["identification"]["parameters"]["hinge"]
    expected = {"stiffness[0]": 0.61234567, "stiffness[1]": 0.38765433, "share[0]": 0.25, "share[1]": 0.75}
    for name, value in {**expected, "attraction": 5000.0}.items():
        one = numbers[f"bristles.{name}"]
        assert (one["value"], one["provenance"], one["taken_from"]) == (value, "assumed", str(given)), name
    assert schema_faults("friction", file) == []
    assert FrictionFile.read(file).elements["hinge"].bristles == PARTS[0]
    assert f"bristles of hinge: as c0 those of {given}, assumed" in capsys.readouterr().out
    assert "With c0 the bristles of hinge are those of that file" in file.with_suffix(".html").read_text("utf-8")


def test_without_a_file_bristles_are_assumed(hinge: Hinge, tmp_path: Path) -> None:
    """Sweeps alone, no fallback: bristles break away after 0.25 mrad, marked so; rows at reversals judge them alone."""
    file = tmp_path / "friction.yaml"
    words = ["--sliding", str(hinge.bag), "--urdf", str(hinge.urdf), "--output", str(file)]
    assert run("rx90_identify", words) == DONE
    element = FrictionFile.read(file).elements["hinge"]
    mean = 0.5 * (element.tau_c.positive + element.tau_c.negative)
    assert element.c0 == pytest.approx(mean / 2.5e-4, rel=1e-5)
    assert "break away after 0.25 mrad" in file.read_text("utf-8")
    (check,) = check_friction(file, [hinge.bag], RobotOptions(urdf=str(hinge.urdf)))
    assert check.assumed_bristles
    assert all("away from reversals" in criterion.quantity for criterion in check.criteria[:2])


@pytest.mark.parametrize("known", [False, True], ids=["c0 open", "c0 known"])
def test_bristles_go_with_c0(hinge: Hinge, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, known: bool) -> None:
    """The fallback's block comes with its c0; a c0 of LuGre's fit stays LuGre's."""
    options = RobotOptions(urdf=str(hinge.urdf), fallback=str(fallback(tmp_path / "given.yaml", SLIPPING)))
    robot = RecordedRobot.load(options)
    c0 = ParameterEstimate(2e4, 1e2) if known else ParameterEstimate.unknown("too small")
    cycles = ElementEstimate("hinge", {"c0": c0, "c1": c0}, np.eye(2), ())
    slides = ElementEstimate("hinge", dict.fromkeys(SLIDING, ParameterEstimate(1.0, 0.1)), np.eye(7), ())
    monkeypatch.setattr(
        identification, "identify_sliding", lambda *_, **__: SimpleNamespace(estimates=[slides], alarms=())
    )
    monkeypatch.setattr(identification, "identify_presliding", lambda *_: SimpleNamespace(estimates=[cycles]))
    (one,) = identify_records([], [None], robot).elements  # type: ignore[list-item]
    assert one.element.bristles == (None if known else PARTS[0])
    assert one.given_bristles is not known
    assert one.element.c0 == (2e4 if known else 12345.0)
    if known:
        alone = RecordedRobot.load(replace(options, fallback="none"))
        (own,) = identify_records([], [None], alone).elements  # type: ignore[list-item]
        assert own.element.replaced(omega_d=one.element.omega_d) == one.element
        assert own.element.passivity_limit(1e3) == np.inf
