"""Bristles that no recording tells: assumed by a stated rule, or of a fallback, which must be LuGre's."""

from __future__ import annotations

from pathlib import Path

import pytest
import yaml
from foreign_arms import write_fallback
from hinge_arm import Hinge

from rx90_common.base.errors import DONE, REFUSED
from rx90_common.friction.friction_file import FrictionFile
from rx90_emulator.cli.frame import run
from rx90_emulator.identification.identify import check_friction
from rx90_emulator.identification.options import RobotOptions


def test_without_a_file_bristles_are_assumed(hinge: Hinge, tmp_path: Path) -> None:
    """Sweeps alone, no fallback: bristles break away after 0.25 mrad, marked so; rows at reversals judge them alone."""
    file = tmp_path / "friction.yaml"
    words = ["sliding", str(hinge.bag), "--urdf", str(hinge.urdf), "--output", str(file)]
    assert run("rx90 identify", words) == DONE
    element = FrictionFile.read(file).elements["hinge"]
    mean = 0.5 * (element.tau_c.positive + element.tau_c.negative)
    assert element.c0 == pytest.approx(mean / 2.5e-4, rel=1e-5)
    assert "break away after 0.25 mrad" in file.read_text("utf-8")
    (check,) = check_friction(file, [hinge.bag], RobotOptions(urdf=str(hinge.urdf)))
    assert check.assumed_bristles
    assert all("away from reversals" in criterion.quantity for criterion in check.criteria[:2])


def test_other_bristles_than_lugres_are_refused(
    hinge: Hinge, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """A fallback with an elasto-plastic bristle is one line: the fit knows none."""
    given = write_fallback(tmp_path / "given.yaml", ["hinge"])
    content = yaml.safe_load(given.read_text(encoding="utf-8"))
    content["elements"]["hinge"]["bristles"] = {"kind": "elasto_plastic", "break_away": 0.45}
    given.write_text(yaml.safe_dump(content), encoding="utf-8")
    words = ["sliding", str(hinge.bag), "--urdf", str(hinge.urdf), "--fallback", str(given)]
    assert run("rx90 identify", [*words, "--output", str(tmp_path / "f.yaml")]) == REFUSED
    assert "hinge.bristles: an identification with it as --fallback cannot hold" in capsys.readouterr().err
