"""`rx90 identify` on a single joint: what a user does wrong, a file that is checked, assumed bristles, interrupts."""

import os
import re
import shutil
import signal
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from foreign_arms import urdf_text, write
from hinge_arm import CURVE, RATE, Hinge
from processes import files_up_to

import rx90_emulator as rx
from rx90_common.base.errors import DONE, INTERRUPTED, REFUSED, VERDICT_NO, OutputError
from rx90_common.process.files import write_all
from rx90_emulator.cli.frame import run
from rx90_emulator.identification import identify as identify_bags
from rx90_emulator.identification import job as identify_job
from rx90_emulator.identification.options import RobotOptions, ValidationTolerances
from rx90_emulator.identification.output.report import check_page
from rx90_emulator.identification.output.summary import check_summary
from rx90_emulator.identification.records import BagSource
from rx90_emulator.identification.validation.prediction import TipDistance, Validation
from rx90_emulator.identification.validation.verdict import RunTorques

pytestmark = pytest.mark.slow

Change = Callable[[Hinge, Path], list[object]]


def options(*words: object) -> Change:
    return lambda hinge, _: ["sliding", hinge.bag, *words]


def sliding(rows: Any = slice(None), header: bool = True, **changed: Callable[[Hinge], Any]) -> Change:
    def make(hinge: Hinge, folder: Path) -> list[object]:
        fields = {name: getattr(hinge, name) for name in ("position", "velocity", "torque")}
        fields |= {name: change(hinge) for name, change in changed.items()}
        values = tuple(value[rows] for value in fields.values())
        return ["sliding", write(folder / "bag", "/joint_states", ["hinge"], RATE, values, header=header)]  # type: ignore[arg-type]

    return make


def filled(path: Path, text: str = "") -> Path:
    if text:
        path.write_text(text, encoding="utf-8")
    else:
        path.mkdir()
    return path


def mimicking(hinge: Hinge, folder: Path) -> list[object]:
    head, tail = urdf_text(["hinge", "jaw"], ["0 1 0", "0 1 0"], [2.0, 1.0]).rsplit("</joint>", 1)
    return ["sliding", hinge.bag, "--urdf", filled(folder / "m.urdf", f'{head}<mimic joint="hinge"/></joint>{tail}')]


REFUSED_CASES = {
    "slow": (lambda h, _: ["sliding", h.bag, "--presliding", h.bag], "100 samples per second; accepted: 500 or more"),
    "driven": (sliding(torque=lambda h: -h.torque), "hinge: the torque does not oppose the motion"),
    "motor_angles": (
        sliding(position=lambda h: 1e3 * h.position, velocity=lambda h: 1e3 * h.velocity),
        r"hinge moves through \d+ rad, in its URDF through 6 rad at most, which looks like deg or .*--gear",
    ),
    "unstamped": (sliding(header=False), "every stamp is 0.0* s; accepted: .*record_time: true"),
    "checked_by_itself": (
        lambda h, f: ["sliding", h.bag, "--validation", shutil.copytree(h.bag, f / "copy")],
        "copy: also used for the identification as .*run",
    ),
    "mimic": (mimicking, "'jaw' mimics hinge; accepted: .*--joints hinge"),
    "device": (options("--force", "--output", "/dev/full"), "/dev/full is no regular file; accepted"),
}


def everything(folder: Path) -> dict[Path, bytes]:
    return {path: path.read_bytes() for path in folder.rglob("*") if path.is_file()}


@pytest.mark.parametrize("case", REFUSED_CASES)
def test_a_mistake_is_one_line(hinge: Hinge, tmp_path: Path, capfd: pytest.CaptureFixture[str], case: str) -> None:
    """A user's mistake is one line with what is accepted and status 2, and leaves every file as it was."""
    change, message = REFUSED_CASES[case]
    good = ["--fallback", hinge.fallback, "--output", tmp_path / "f.yaml"]
    verb, bag, *more = change(hinge, tmp_path)  # type: ignore[no-untyped-call]
    words = [str(word) for word in (verb, bag, "--urdf", hinge.urdf, *good, *more)]
    before = everything(tmp_path)
    assert run("rx90 identify", words) == REFUSED
    lines = capfd.readouterr().err.replace("\r", "\n").splitlines()
    said = [line for line in lines if line.startswith("rx90 identify: ")]
    assert len(said) == 1, lines
    assert re.search(message, said[0]), said[0]
    assert everything(tmp_path) == before


def checked(hinge: Hinge, *words: object) -> int:
    return run("rx90 identify", [str(word) for word in (*words, "--urdf", hinge.urdf)])


def test_true_friction_is_confirmed_and_false_is_not(
    hinge: Hinge, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """The arm's friction is confirmed with 0, half as much again not, with 1; a hint tells of other bodies beside."""
    good, bad = hinge.friction(tmp_path / "good.yaml"), hinge.friction(tmp_path / "bad.yaml", 1.5)
    words, report = ["check", good, hinge.bag], tmp_path / "page.html"
    assert checked(hinge, *words, "--report", report) == DONE
    for more, hints in (("<!-- other -->", [str(tmp_path / "robot.urdf")]), ("", [])):
        (tmp_path / "robot.urdf").write_text(hinge.urdf.read_text(encoding="utf-8") + more, encoding="utf-8")
        assert checked(hinge, "check", bad, hinge.bag) == VERDICT_NO
        said = capsys.readouterr()
        assert re.findall(r"hint: (\S+) stands beside", said.out) == hints
    assert re.findall(r"validation \S+: (confirmed|NOT CONFIRMED)", said.out) == ["NOT CONFIRMED"]
    assert said.err.splitlines()[-1] == f"rx90 identify: the validation does not confirm {bad}"
    assert {file.name for file in tmp_path.iterdir()} == {"good.yaml", "bad.yaml", "page.html", "robot.urdf"}
    page = report.read_text(encoding="utf-8")
    for text in ("good.yaml", "<b>confirmed</b>", '<figure class="plot">'):
        assert text in page
    assert checked(hinge, *words, "--report", report) == REFUSED
    assert "page.html exists; accepted: another name, or --force" in capsys.readouterr().err.splitlines()[-1]


def test_the_difference_is_that_of_the_friction(hinge: Hinge, tmp_path: Path) -> None:
    """The RMS difference of friction that is half too large is half its RMS, and its share that of the torque's."""
    half = hinge.friction(tmp_path / "half.yaml", 1.5)
    (check,) = rx.check_friction(half, [hinge.bag], rx.RobotOptions(urdf=hinge.urdf))
    moves = np.abs(hinge.velocity[:, 0]) > 0.015
    expected = np.sqrt(np.mean((0.5 * CURVE(hinge.velocity[moves])) ** 2))
    assert check.torque.rms[0] == pytest.approx(expected, rel=0.05)
    assert check.torque.rms_share[0] == pytest.approx(expected / np.sqrt(np.mean(hinge.torque[moves] ** 2)), rel=0.05)
    assert not check.passed


@pytest.mark.parametrize(
    ("place", "number"),
    [
        ("read_record", signal.SIGTERM),
        ("identify_records", signal.SIGINT),
        ("identification_page", signal.SIGTERM),
        ("write_all", signal.SIGINT),
        ("write_all", signal.SIGTERM),
    ],
)
def test_an_interrupt_leaves_everything(
    hinge: Hinge,
    tmp_path: Path,
    place: str,
    number: signal.Signals,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    """Ctrl-C and SIGTERM while a bag is read, fitted, drawn or written end with one line and status 130."""
    signal.signal(signal.SIGTERM, signal.SIG_DFL)  # as in a process of its own
    output = filled(tmp_path / "friction.yaml", "mine")

    def interrupted(*_: Any, **__: Any) -> None:
        os.kill(os.getpid(), number)

    if place == "write_all":
        # After the first of the two files.
        whole = Path.write_bytes
        monkeypatch.setattr(Path, "write_bytes", lambda *a, **k: (whole(*a, **k), interrupted()))
    else:
        monkeypatch.setattr(identify_job if place == "identification_page" else identify_bags, place, interrupted)
    words = ["sliding", hinge.bag, "--fallback", hinge.fallback, "--output", output, "--force"]
    assert checked(hinge, *words) == INTERRUPTED
    assert capsys.readouterr().err.splitlines()[-1] == "rx90 identify: interrupted; nothing was written"
    assert everything(tmp_path) == {output: b"mine"}
    assert signal.getsignal(signal.SIGTERM) == signal.SIG_DFL


def test_a_full_disk_leaves_everything(tmp_path: Path) -> None:
    """Where the second of two files does not fit, the first keeps its old content, and the line names the second."""
    first = filled(tmp_path / "a.yaml", "mine")
    most = 10_000_000  # more than the tests' own log may need
    with files_up_to(most), pytest.raises(OutputError, match=r"b\.html: cannot be written \(File too large\)"):
        write_all({first: b"new", tmp_path / "b.html": bytes(most + 1)})
    assert everything(tmp_path) == {first: b"mine"}


def validation(error: float) -> Validation:
    """Return a validation in which joint_1 moves and is off by a share of its torque, and joint_2 stands still."""
    time = np.linspace(0.0, 1.0, 101)
    recorded = np.stack([3.0 + np.cos(time), np.full(101, 2.0)], axis=1)
    predicted = recorded * [1.0 + error, 5.0]
    moves = np.stack([time >= 0.0, time < 0.0], axis=1)
    source = BagSource(Path("bag"), "0" * 64, 1.0)
    torque = RunTorques(time, recorded, predicted, moves, ("joint_1", "joint_2"), source, np.zeros_like(moves))
    return Validation(torque, ValidationTolerances(), "bag")


@pytest.mark.parametrize(("error", "confirmed"), [(0.04, True), (0.06, False)])
def test_a_joint_at_rest_does_not_decide(error: float, confirmed: bool) -> None:
    """What a joint gives at rest is not compared; the verdict is on the joints that move, here 5 % of the torque."""
    check = validation(error)
    assert check.passed is confirmed
    assert check.torque.rms_share[0] == pytest.approx(error, rel=1e-12)
    torque = check.torque
    assert np.isnan([torque.rms[1], torque.rms_share[1], torque.worst[1], torque.worst_share[1]]).all()
    assert f"{100.0 * error:.2f}" in check_page([check], "friction.yaml")
    row = next(line for line in check_summary([check]).splitlines() if line.startswith("joint_2"))
    assert row.split() == ["joint_2", "-", "-", "-", "-"]


@pytest.mark.parametrize(
    ("spike", "distance", "said"),
    [
        (0.14, 9e-5, ""),
        (0.16, 9e-5, "largest torque difference 16.00% (joint_1, limit 15%)"),
        (0.14, 1.1e-4, "tip worst 110.00 µm (limit 100)"),
    ],
)
def test_one_moment_and_the_tip_decide(spike: float, distance: float, said: str) -> None:
    """A difference at one moment over the largest torque is limited, and the farthest that the tip was."""
    check = validation(0.0)
    recorded = check.torque.recorded
    predicted = recorded.copy()
    predicted[50, 0] += spike * np.abs(recorded[:, 0]).max()
    tip = np.array([0.0, distance, 2e-5])
    check = replace(check, torque=replace(check.torque, predicted=predicted), tip=TipDistance(np.arange(3.0), tip))
    assert [criterion.text for criterion in check.criteria if not criterion.passed] == ([said] if said else [])
    assert f"tip RMS {1e6 * np.sqrt(np.mean(tip**2)):.2f} µm" in check_summary([check])


def test_without_a_file_bristles_are_assumed(hinge: Hinge, tmp_path: Path) -> None:
    """Sweeps alone, no fallback: bristles break away after 0.25 mrad, marked so; rows at reversals judge them alone."""
    file = tmp_path / "friction.yaml"
    words = ["sliding", str(hinge.bag), "--urdf", str(hinge.urdf), "--output", str(file)]
    assert run("rx90 identify", words) == DONE
    element = rx.FrictionFile.read(file).elements["hinge"]
    mean = 0.5 * (element.tau_c.positive + element.tau_c.negative)
    assert element.c0 == pytest.approx(mean / 2.5e-4, rel=1e-5)
    assert "break away after 0.25 mrad" in file.read_text("utf-8")
    (check,) = rx.check_friction(file, [hinge.bag], RobotOptions(urdf=str(hinge.urdf)))
    assert check.assumed_bristles
    assert all("away from reversals" in criterion.quantity for criterion in check.criteria[:2])
