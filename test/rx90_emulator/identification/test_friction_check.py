"""A given friction file against bags: `rx90_identify --friction FILE --validation BAG ...` and `rx.check_friction`."""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
import pytest
from foreign_arms import Curve, Program, drive_torque, urdf_text, write

import rx90_emulator as rx
from rx90_common.base.errors import DONE, REFUSED, VERDICT_NO
from rx90_emulator.cli.frame import run

CURVE = Curve(6.0, 5.5, 7.8, 7.0, 0.05, 1.2, 2.5)
RATE = 100.0


@dataclass
class Hinge:
    """One joint's URDF, a run of it, and its friction with a factor as a file."""

    folder: Path
    urdf: Path
    bag: Path
    velocity: Any
    torque: Any

    def friction(self, name: str, factor: float = 1.0, element: str = "hinge") -> str:
        """Write the friction times a factor and return the file's name."""
        values = vars(CURVE.scaled(factor)) | {"c0": 1e5, "c1": 0.0}
        file = self.folder / name
        file.write_text(rx.FrictionFile({element: rx.FrictionElement(**values)}).text(), encoding="utf-8")
        return str(file)

    def check(self, *words: object) -> int:
        """Run the command."""
        return run("rx90_identify", [str(word) for word in ("--urdf", self.urdf, *words)])


@pytest.fixture(scope="module")
def hinge(tmp_path_factory: pytest.TempPathFactory) -> Hinge:
    """Return a joint that swings there and back at six speeds."""
    folder = tmp_path_factory.mktemp("hinge")
    urdf = folder / "arm.urdf"
    urdf.write_text(urdf_text(["hinge"], ["0 1 0"], [2.0]), encoding="utf-8")
    model = pin.buildModelFromXML(urdf.read_text(encoding="utf-8"))
    position, velocity = Program([[1.0]], [[0.2]], np.geomspace(0.05, 1.0, 6).tolist(), RATE).motion()
    torque = drive_torque(model, np.eye(1), [CURVE], (position, velocity), RATE)
    bag = write(folder / "run", "/joint_states", ["hinge"], RATE, (position, velocity, torque))
    return Hinge(folder, urdf, bag, velocity, torque)


def test_true_friction_is_confirmed_and_false_is_not(hinge: Hinge, capsys: pytest.CaptureFixture[str]) -> None:
    """The arm's own friction is confirmed with 0; half as much again is not, with 1, and no file is written."""
    before = sorted(hinge.folder.iterdir())
    good, bad = hinge.friction("good.yaml"), hinge.friction("bad.yaml", 1.5)
    assert hinge.check("--friction", good, "--validation", hinge.bag) == DONE
    assert hinge.check("--friction", bad, "--validation", hinge.bag) == VERDICT_NO
    said = capsys.readouterr()
    assert re.findall(r"validation \S+: (confirmed|NOT CONFIRMED)", said.out) == ["confirmed", "NOT CONFIRMED"]
    assert said.err.splitlines()[-1] == f"rx90_identify: the validation does not confirm {bad}"
    assert {file.name for file in hinge.folder.iterdir()} == {file.name for file in before} | {"good.yaml", "bad.yaml"}


def test_the_difference_is_that_of_the_friction(hinge: Hinge) -> None:
    """The RMS difference of friction that is half too large is half its RMS, and its share that of the torque's."""
    (check,) = rx.check_friction(hinge.friction("half.yaml", 1.5), [hinge.bag], rx.RobotOptions(urdf=hinge.urdf))
    moves = np.abs(hinge.velocity[:, 0]) > 0.04
    expected = np.sqrt(np.mean((0.5 * CURVE(hinge.velocity[moves])) ** 2))
    assert check.rms[0] == pytest.approx(expected, rel=0.05)
    assert check.rms_share[0] == pytest.approx(expected / np.sqrt(np.mean(hinge.torque[moves] ** 2)), rel=0.05)
    assert not check.passed


def test_the_report_is_written_where_it_is_asked_for(hinge: Hinge, capsys: pytest.CaptureFixture[str]) -> None:
    """`--report` names the page; one that exists stays without --force."""
    words = ["--friction", hinge.friction("f.yaml"), "--validation", hinge.bag, "--report", hinge.folder / "page.html"]
    assert hinge.check(*words) == DONE
    page = (hinge.folder / "page.html").read_text(encoding="utf-8")
    assert "f.yaml" in page
    assert "<b>confirmed</b>" in page
    assert '<figure class="plot">' in page
    assert hinge.check(*words) == REFUSED
    assert "page.html exists; accepted: another name, or --force" in capsys.readouterr().err.splitlines()[-1]


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["--friction", "good"], "no bag to hold the friction against; accepted: --validation BAG ..."),
        (["--friction", "good", "--validation", "bag", "bag"], "given twice for --validation"),
        (["--friction", "good", "--validation", "bag", "--output", "x.yaml"], "x.yaml with --friction; accepted"),
        (["--friction", "good", "--validation", "bag", "--sliding", "bag"], "run with --friction; accepted"),
        (["--friction", "good", "--validation", "bag", "--bristle-kinds"], "--bristle-kinds with --friction; accepted"),
        (["--friction", "other", "--validation", "bag"], "elements.hinge is missing; accepted"),
        (["--friction", "nowhere.yaml", "--validation", "bag"], "nowhere.yaml"),
        (["--validation", "bag"], "no --output; accepted: --output FILE"),
    ],
)
def test_what_cannot_be_checked_is_refused(
    hinge: Hinge, words: list[str], message: str, capsys: pytest.CaptureFixture[str]
) -> None:
    """Missing or repeated bags, other uses at the same time and another arm's friction are one line and 2."""
    files = {
        "good": hinge.friction("good.yaml"),
        "other": hinge.friction("other.yaml", element="elbow"),
        "bag": str(hinge.bag),
    }
    assert hinge.check(*(files.get(word, word) for word in words)) == REFUSED
    assert message in capsys.readouterr().err.splitlines()[-1]
