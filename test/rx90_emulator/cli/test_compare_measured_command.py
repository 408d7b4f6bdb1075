"""`rx90_compare_measured`: verdict, report and refusals."""

from __future__ import annotations

import shutil
from collections.abc import Callable
from pathlib import Path

import pytest
from foreign_arms import urdf_text

import rx90_emulator as rx
from rx90_common.base.errors import DONE, REFUSED, VERDICT_NO
from rx90_common.description.robot_files import RobotFiles
from rx90_emulator.cli.frame import run
from rx90_emulator.loop.setup import Setup

WAY_OUT = "rx90_identify --friction FILE --validation BAG --urdf URDF"


@pytest.fixture(scope="module")
def bag(tmp_path_factory: pytest.TempPathFactory, shipped: Setup, task: rx.LineTask) -> Path:
    """Return the bag of a short line."""
    folder = tmp_path_factory.mktemp("line") / "run"
    rx.write_bag(rx.run_line(shipped, task, record_fast=True), folder)
    return folder


def test_the_verdict_is_the_exit_code(
    bag: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], check_report: Callable[[Path], None]
) -> None:
    """0 for the robot that ran, 1 for tolerances that it cannot keep; a page says so and is not replaced unasked."""
    page = tmp_path / "page.html"
    assert run("rx90_compare_measured", [str(bag), "--report", str(page)]) == DONE
    said = capsys.readouterr().out
    assert ": agrees: torque RMS of all joints 0." in said
    assert [line.split()[0] for line in said.splitlines() if line.startswith("joint_")] == [
        f"joint_{k}" for k in range(1, 7)
    ]
    text = page.read_text(encoding="utf-8")
    assert "<b>agrees</b>" in text
    assert text.count('<figure class="plot">') == 2
    assert run("rx90_compare_measured", [str(bag), "--report", str(page)]) == REFUSED
    assert "exists; accepted: another name, or --force" in capsys.readouterr().err
    assert run("rx90_compare_measured", [str(bag), "--position-tolerance", "1e-12"]) == VERDICT_NO
    assert "DOES NOT AGREE" in capsys.readouterr().out
    check_report(page)


def test_other_arms_are_told_where_to_go(
    bag: Path, shipped_files: RobotFiles, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """A folder without drives, other numbers or names of joints, and a bag of others are one line with the way out."""
    four, other = tmp_path / "four.urdf", tmp_path / "other.urdf"
    four.write_text(urdf_text("abcd", ["0 0 1"] * 4, [1.0] * 4), encoding="utf-8")
    other.write_text(urdf_text("abcdef", ["0 0 1"] * 6, [1.0] * 6), encoding="utf-8")
    folder = tmp_path / "arm"
    folder.mkdir()
    shutil.copy(other, folder / "robot.urdf")
    shutil.copy(shipped_files.friction, folder)
    series = rx.read_joint_states(bag, "joint_states", [f"joint_{k}" for k in range(1, 7)])
    foreign = rx.JointSeries("/joint_states", tuple("abcdef"), series.stamp_ns, series.position, None, series.effort)
    rx.write_joint_states(tmp_path / "foreign", [foreign])
    for words, found in (
        ([bag, "--robot", folder], "no drives.yaml"),
        ([bag, "--urdf", four], "4 movable joints"),
        ([bag, "--urdf", other], "no friction element a, b, c, d, e, f"),
        ([tmp_path / "foreign"], "joint_states is of a, b, c, d, e, f; accepted: joint_1,"),
    ):
        assert run("rx90_compare_measured", [str(word) for word in words]) == REFUSED
        (line,) = [line for line in capsys.readouterr().err.splitlines() if line.startswith("rx90_compare_measured")]
        assert found in line
        assert WAY_OUT in line
