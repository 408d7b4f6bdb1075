"""The command rx90 check, with the CS7B's node and with a controller that is not this project's."""

from __future__ import annotations

import json
import sys
from pathlib import Path
from typing import Any

import pytest
from processes import Processes, command, wait_until

from rx90_common.base.errors import DONE, FAILED, INTERRUPTED, VERDICT_NO
from rx90_emulator.cli.frame import run
from rx90_emulator.conformance import battery, bench, case, metrics

CS7B = command("rx90_controller")
OWN = [sys.executable, str(Path(__file__).resolve().parents[2] / "support" / "user_servo.py")]
WEAK = """\
/**/rx90_controller:
  ros__parameters: {servo: {kp: [20, 20, 20, 20, 20, 20], kv: [60, 60, 60, 60, 60, 60]}}
"""


def checked(folder: Path, *words: object) -> tuple[int, dict[str, Any]]:
    """Check a controller in this process; return the exit code and what the check has written."""
    code = run("rx90 check", ["--output", str(folder), *map(str, words)])
    return code, dict(json.loads((folder / "result.json").read_text(encoding="utf-8")))


@pytest.fixture
def brief(monkeypatch: pytest.MonkeyPatch) -> None:
    """Shorten the time before the motion."""
    for module in (battery, bench, case, metrics):
        monkeypatch.setattr(module, "START", 0.2)


@pytest.mark.usefixtures("processes", "brief", "undrawn")
def test_the_cs7b_as_a_node_has_the_numbers_of_the_closed_loop(tmp_path: Path) -> None:
    """On a weaker arm each is that of the run without ROS to the bit."""
    code, found = checked(tmp_path / "out", "--case", "saturation", *CS7B)
    assert (code, found["passed"]) == (DONE, True)
    assert len(found["findings"]) == 42
    assert [row["value"] for row in found["findings"]] == [row["cs7b"] for row in found["findings"]]


@pytest.mark.usefixtures("processes", "brief")
def test_bad_gains_do_not_pass_and_it_is_said_what_decided(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """A parameter file with weak gains: exit code 1, and lines with case, quantity, joint, value and limit."""
    file = tmp_path / "weak.yaml"
    file.write_text(WEAK, encoding="utf-8")
    code, found = checked(tmp_path / "out", "--case", "step", *CS7B, "--ros-args", "--params-file", file)
    assert code == VERDICT_NO
    (beyond,) = [
        row for row in found["findings"] if (row["quantity"], row["joint"]) == ("tracking_error_rms", "joint_2")
    ]
    assert beyond["value"] > beyond["limit"]
    assert "<h2>step</h2>" in (tmp_path / "out" / "report.html").read_text(encoding="utf-8")
    said = [line for line in capsys.readouterr().err.splitlines() if "tracking_error_rms of joint_" in line]
    assert len(said) == 1
    assert said[0].startswith("rx90 check: step: ")
    assert " rad; accepted: up to " in said[0]


@pytest.mark.usefixtures("processes", "brief", "undrawn")
def test_another_controller_follows_set_points_at_motors_or_joints_in_the_same_bits_each_time(tmp_path: Path) -> None:
    """An rclpy node without trajectories follows set-points by their stamps: with torques of the motors at 4 kHz."""
    runs = {}
    for name, side in (("motor", "motor"), ("joint", "joint"), ("again", "joint")):
        words = [
            "--case",
            "step",
            "--set-points",
            "set_points",
            *(["--joint-commands", "1000"] if side == "joint" else []),
        ]
        code, found = checked(tmp_path / name, *words, *OWN, side)
        assert code in (DONE, VERDICT_NO)
        runs[name] = found["findings"]
        values = {(row["quantity"], row["joint"]): row["value"] for row in found["findings"]}
        assert values["torque_off", "joint_1"] == 0.0
        assert 0.0 < values["tracking_error_peak", "joint_1"] < 5e-3  # of a way of 0.035 rad: it followed
    assert runs["again"] == runs["joint"]


@pytest.mark.usefixtures("processes", "undrawn")
@pytest.mark.parametrize(
    ("words", "said"),
    [
        ((sys.executable, "-c", "print('no torque today'); raise SystemExit(4)"), "exit code 4: no torque today"),
        ((sys.executable, "-c", "import time; time.sleep(60)"), "within 2 s"),
    ],
)
def test_a_controller_that_ends_or_is_silent(
    words: tuple[str, ...], said: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """It could not be carried out: exit code 3, one line that says why, no report."""
    options = ["--output", str(tmp_path / "out"), "--case", "step", "--timeout", "2"]
    assert run("rx90 check", [*options, *words]) == FAILED
    assert said in capsys.readouterr().err.splitlines()[-1]
    assert not (tmp_path / "out" / "report.html").exists()


def test_an_interrupted_check_leaves_no_controller(processes: Processes, tmp_path: Path) -> None:
    """Ctrl-C ends the check with 130, and the controller with it."""
    options = ("--output", tmp_path / "out", "--case", "step")
    pid = tmp_path / "pid"
    program = f"import os, pathlib, time; pathlib.Path({str(pid)!r}).write_text(str(os.getpid())); time.sleep(60)"
    check = processes.start("rx90 check", *options, sys.executable, "-c", program)
    wait_until(lambda: pid.is_file() and bool(pid.read_text(encoding="utf-8")), "the controller")
    check.signal(2)  # type: ignore[arg-type]
    assert check.wait() == INTERRUPTED
    assert not Path(f"/proc/{pid.read_text(encoding='utf-8')}").exists()
