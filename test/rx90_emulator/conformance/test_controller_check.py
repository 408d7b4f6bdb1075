"""The command rx90 check, with the CS7B's node and with another controller, and what it measures."""

import json
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from processes import Processes, command, wait_until

import rx90_emulator as rx
from rx90_common.base.arrays import Array
from rx90_common.base.errors import DONE, FAILED, INTERRUPTED, VERDICT_NO
from rx90_emulator.cli.frame import run
from rx90_emulator.conformance import battery, bench, case, metrics
from rx90_emulator.conformance.battery import CASES, Nominal, run_cs7b
from rx90_emulator.conformance.case import Case, Record
from rx90_emulator.conformance.check import CaseResult, Finding

CS7B = command("rx90_controller")
OWN = [sys.executable, str(Path(__file__).resolve().parents[2] / "support" / "user_servo.py")]
WEAK = """\
/**/rx90_controller:
  ros__parameters: {servo: {kp: [20, 20, 20, 20, 20, 20], kv: [60, 60, 60, 60, 60, 60]}}
"""


def checked(folder: Path, *words: object) -> tuple[int, dict[str, Any]]:
    code = run("rx90 check", ["--output", str(folder), *map(str, words)])
    return code, dict(json.loads((folder / "result.json").read_text(encoding="utf-8")))


@pytest.fixture
def brief(monkeypatch: pytest.MonkeyPatch) -> None:
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
def test_another_controller_follows_set_points_at_motors_or_joints(tmp_path: Path) -> None:
    """An rclpy node without trajectories follows set-points by their stamps: with torques of the motors at 4 kHz."""
    for side, more in (("motor", []), ("joint", ["--joint-commands", "1000"])):
        words = ["--case", "step", "--set-points", "set_points", *more]
        code, found = checked(tmp_path / side, *words, *OWN, side)
        assert code in (DONE, VERDICT_NO)
        values = {(row["quantity"], row["joint"]): row["value"] for row in found["findings"]}
        assert values["torque_off", "joint_1"] == 0.0
        assert 0.0 < values["tracking_error_peak", "joint_1"] < 5e-3  # of a way of 0.035 rad: it followed


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


@pytest.fixture
def nominal(shipped: rx.Setup, tmp_path: Path) -> Nominal:
    return Nominal(shipped, tmp_path)


def record_of(case: Case, position: Array, torque: Array | float = 0.0) -> Record:
    record, drives = Record(case), case.setup.drives
    motors = np.broadcast_to(torque, position.shape) @ np.linalg.inv(drives.turning.turns) / drives.gear
    for tick, place in enumerate(position @ drives.turning.turns.T * drives.gear):
        record.note(tick, place, motors[tick])
    return record


def beyond(findings: list[Finding]) -> set[str]:
    return {row.quantity for row in findings if row.value > row.limit}


def exact(case: Case) -> Array:
    return np.repeat(case.set_points[:, 0], case.setup.rates.ratio, axis=0)[: case.ticks]


def test_overshoot_settling_and_what_is_left(nominal: Nominal) -> None:
    """A decaying oscillation at a step's end has overshoot, settling time and remaining error by its equation."""
    case = CASES["step"](nominal, "step")
    way = case.points.position[-1] - case.points.position[0]
    times = np.arange(case.ticks) * case.setup.rates.period
    since = np.maximum(times - case.end, 0.0)
    ringing = np.where(times > case.end, 0.2 * np.exp(-since / 0.05) * np.sin(2 * np.pi * 25.0 * since), 0.0)
    run = record_of(case, exact(case) + np.outer(ringing + 1e-3 * (since > 0.0), way))
    values = {(row.quantity, row.joint): row.value for row in CaseResult(run, run).findings}
    fine = np.arange(0.0, 0.5, 1e-5)
    wave = 0.2 * np.exp(-fine / 0.05) * np.sin(2 * np.pi * 25.0 * fine) + 1e-3
    last = fine[np.flatnonzero(np.abs(wave) > 0.02)[-1]]
    for j, name in enumerate(case.setup.robot.joint_names):
        assert values["overshoot", name] == pytest.approx(wave.max(), rel=0.01)
        assert values["settling_time", name] == pytest.approx(last, abs=1e-3)
        assert values["rest_error", name] == pytest.approx(1e-3 * abs(way[j]), rel=0.01)


def test_hunting_and_ripple_have_their_size(nominal: Nominal) -> None:
    """A triangular motion at rest has its size, and a fast sine of the torque its RMS."""
    case = CASES["rest"](nominal, "rest")
    times = np.arange(case.ticks) * case.setup.rates.period
    position = exact(case) + 2e-3 * np.abs((times / 0.4) % 1.0 - 0.5)[:, None]
    run = record_of(case, position, 3.0 * np.sin(2 * np.pi * 200.0 * times)[:, None])
    values = {(row.quantity, row.joint): row.value for row in CaseResult(run, run).findings}
    for name in case.setup.robot.joint_names:
        assert values["hunting", name] == pytest.approx(1e-3, rel=0.01)
        assert values["torque_ripple", name] == pytest.approx(3.0 / np.sqrt(2.0), rel=0.02)


def test_the_cs7b_passes_and_bad_gains_fail(nominal: Nominal) -> None:
    """The shipped gains keep all limits in all cases; gains four times as stiff ripple, weak ones hunt."""
    weak = {"controller.kp[*]": 20.0, "controller.kv[*]": 60.0, "controller.ki[*]": 3e4}
    for name, make in CASES.items():
        case = make(nominal, name)
        good = run_cs7b(case, nominal.setup)
        assert beyond(CaseResult(good, good).findings) == set(), name
        if name == "rest":
            slack, stiff = (run_cs7b(case, rx.with_parameters(nominal.setup, law))
                            for law in (weak, {"controller.kv[*]": 1600.0}))  # fmt: skip
            assert beyond(CaseResult(slack, good).findings) >= {"hunting", "rest_error", "tracking_error_rms"}
            assert "torque_ripple" in beyond(CaseResult(stiff, good).findings)


def test_other_arms_are_the_nominal_one_but_for_what_is_named(nominal: Nominal) -> None:
    """Payload and friction are those of the files times their factors; drives give less than the CS7B needs."""
    payload = CASES["payload_1.3"](nominal, "payload_1.3").setup
    friction = CASES["friction_0.7"](nominal, "friction_0.7").setup
    heavier = payload.robot.chain.mass[5] - nominal.setup.robot.chain.mass[5]
    assert heavier == pytest.approx(0.3 * 3.5)
    assert payload.friction.elements == nominal.setup.friction.elements
    for one, usual in zip(friction.friction.elements, nominal.setup.friction.elements, strict=True):
        assert (one.tau_c.positive, one.c2) == pytest.approx((0.7 * usual.tau_c.positive, 0.7 * usual.c2))
        assert (one.c0, one.omega_s) == (usual.c0, usual.omega_s)
    case = CASES["saturation"](nominal, "saturation")
    needed = np.abs(run_cs7b(CASES["step"](nominal, "step"), nominal.setup).sent).max(axis=0)
    assert case.setup.drives.peak_torque == pytest.approx(0.8 * needed)
