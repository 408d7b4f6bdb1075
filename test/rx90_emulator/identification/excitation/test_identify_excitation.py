"""`rx90 identify excitation BAG ...`: values, verdicts, files, and what is refused."""

import io
import re
from collections.abc import Callable
from contextlib import redirect_stderr, redirect_stdout
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
import pytest
import yaml
from foreign_arms import Curve, drive_torque, urdf_text, write
from terminal import Terminal
from two_joints import CURVES, NAMES, NOISE, RATE, Bench, fourier

import rx90_emulator as rx
from rx90_common.base.errors import REFUSED, VERDICT_NO
from rx90_emulator.identification.output.report import check_page
from rx90_emulator.identification.output.summary import validation_verdict
from rx90_emulator.identification.result import ExcitationIdentification
from rx90_emulator.identification.robot import RecordedRobot

pytestmark = pytest.mark.slow

STILL = Curve(0.0, 0.0, 0.0, 0.0, 0.1, 1.0, 0.0)


@pytest.fixture(scope="module")
def bench(tmp_path_factory: pytest.TempPathFactory) -> Bench:
    bench = Bench.make(tmp_path_factory.mktemp("arm"))
    bench.bag("run", 1)
    bench.bag("unseen", 2)
    bench.bag("stiff", 3, 1.8)
    bench.bag("later", 1, seconds=30.0, first=1600)
    bench.bag("short", 5, seconds=0.5)
    position, velocity = fourier(4, 20.0)
    half = position * [1.0, 0.0], velocity * [1.0, 0.0]
    bench.write("half", half, bench.torque(half))
    motion = fourier(6, 20.0)
    dead = bench.torque(motion) * [1.0, 0.0] + bench.noise(motion, 7)
    for name, torque in (
        ("one", bench.torque(motion) * [1.0, -1.0]),
        ("dead", dead),
        ("zero", dead * [1.0, 0.0]),
    ):
        bench.write(name, motion, torque)
    return bench


@dataclass
class Outcome:
    code: int
    folder: Path
    said: str
    error: str
    result: ExcitationIdentification


@pytest.fixture(scope="module")
def outcome(bench: Bench) -> Outcome:
    folder, kept, identify = bench.folder / "identified", [], rx.identify_excitation

    def kept_result(*arguments: Any, **options: Any) -> ExcitationIdentification:
        kept.append(identify(*arguments, **options))
        return kept[0]

    bags = ["excitation", bench.folder / "run", "--validation", bench.folder / "unseen", bench.folder / "stiff"]
    out, err = io.StringIO(), Terminal()
    with pytest.MonkeyPatch.context() as patch, redirect_stdout(out), redirect_stderr(err):
        patch.setattr(rx, "identify_excitation", kept_result)
        code = bench.identify(*bags, "--output", folder)
    return Outcome(code, folder, out.getvalue(), err.getvalue(), kept[0])


def test_values_are_those_of_the_arm(bench: Bench, outcome: Outcome) -> None:
    """Coulomb, viscous and gravity parameters lie within four deviations of the truth; friction is told to 5 %."""
    found = yaml.safe_load((outcome.folder / "parameters.yaml").read_text(encoding="utf-8"))
    for name, curve in zip(NAMES, CURVES, strict=True):
        for parameter in ("tau_c_positive", "tau_c_negative", "c2"):
            truth, entry = getattr(curve, parameter), found["friction"][name][parameter]
            assert abs(entry["value"] - truth) < 4.0 * entry["deviation"]
            assert abs(entry["value"] / truth - 1.0) < 0.05
    gravity = next(entry for entry in found["base_parameters"].values() if entry["group"].startswith("mz_2"))
    inertia = bench.model.inertias[2]
    assert abs(gravity["value"] - inertia.mass * inertia.lever[2]) < 4.0 * gravity["deviation"]
    assert gravity["unit"] == "kg m"
    names = found["correlation"]["names"]
    assert np.shape(found["correlation"]["matrix"]) == (len(names), len(names))
    assert [bag["use"] for bag in found["bags"]] == ["excitation", "validation", "validation"]
    assert "consistent inertias" in outcome.error


def test_verdict_is_that_of_the_unseen_runs(outcome: Outcome) -> None:
    """The arm's own run is confirmed at its noise, one with 1.8 times the friction is not, and the code says so."""
    assert outcome.code == VERDICT_NO
    assert outcome.error.splitlines()[-1] == "rx90 identify: the validation does not confirm the result"
    verdicts = re.findall(r"validation \S+/(\w+): (confirmed|NOT CONFIRMED)", outcome.said)
    assert verdicts == [("unseen", "confirmed"), ("stiff", "NOT CONFIRMED")]
    good, bad = outcome.result.validations
    assert good.fitted.total_share < 0.02
    assert bad.fitted.total_share > 0.1
    assert good.fitted.total_share < 1.05 * good.simplest.total_share
    shares = [torques.total_share for check in (good, bad) for torques in (check.fitted, check.simplest, check.torque)]
    assert all(f"{share:.1%}" in outcome.said for share in shares)
    assert f" are assumed: torque RMS of all joints {bad.fitted.total_share:.2%} (limit 10%)" in outcome.said
    # A verdict that the files alone decide says so.
    alone = replace(good, torque=bad.torque)
    assert not alone.passed
    page = check_page([alone], "friction.yaml")
    assert re.search(r'class="fact bad"><b>[\d.]+%</b>\s+torque RMS of all joints by the files', page)
    said = validation_verdict(alone)
    assert "NOT CONFIRMED: torque RMS of all joints by the files, away from reversals" in said
    assert f"at reversals, where the assumed c0 and c1 act, {bad.torque.at_reversals.total_share:.2%}" in said
    together = bad.torque.at_reversals.compared | bad.torque.away_from_reversals.compared
    assert np.array_equal(together, bad.torque.compared)
    written = yaml.safe_load((outcome.folder / "parameters.yaml").read_text(encoding="utf-8"))["bodies"]
    distance = f"{written['distance']:.2g} standard deviations from the base parameters"
    assert f"bodies in the files: {distance}" in outcome.said


def test_a_check_of_the_written_files_gives_the_same_numbers(bench: Bench, outcome: Outcome) -> None:
    """Of the unseen runs `check_friction` finds the RMS errors that the identification found, and the same verdicts."""
    robot, file = rx.RobotOptions(urdf=outcome.folder / "robot.urdf"), outcome.folder / "friction.yaml"
    runs = [bench.folder / "unseen", bench.folder / "stiff"]
    checks = rx.check_friction(file, runs, robot)
    for check, first in zip(checks, outcome.result.validations, strict=True):
        np.testing.assert_allclose(check.torque.rms_share, first.torque.rms_share, rtol=1e-3)
        assert check.torque.total_share == pytest.approx(first.torque.total_share, rel=1e-3)
        assert [one.limit for one in check.criteria[:2]] == [one.limit for one in first.criteria[:2]]
        assert not check.notes


def test_folder_holds_the_arm(bench: Bench, outcome: Outcome, check_report: Callable[[Path], None]) -> None:
    """The written URDF and friction give the torque of an unseen motion to 5 % of its RMS; the page shows all parts."""
    model = pin.buildModelFromXML((outcome.folder / "robot.urdf").read_text(encoding="utf-8"))
    elements = rx.FrictionFile.read(outcome.folder / "friction.yaml").elements
    position, velocity = fourier(9, 10.0)
    bare = drive_torque(model, np.eye(2), [STILL, STILL], (position, velocity), RATE)
    rotors = outcome.result.consistency.rotors * np.gradient(velocity, 1.0 / RATE, axis=0)
    friction = np.column_stack([elements[name].steady_torque(velocity[:, k]) for k, name in enumerate(NAMES)])
    truth = bench.torque((position, velocity))
    difference = bare + rotors + friction - truth
    assert (np.std(difference, axis=0) < 0.05 * np.std(truth, axis=0)).all()
    page = (outcome.folder / "report.html").read_text(encoding="utf-8")
    assert page.count('<figure class="plot') >= 3
    assert len(page) < 3e6
    for part in ("Physically consistent", "Filters"):
        assert part in page
    assert "nan" not in re.sub(r"<(svg|script).*?</\1>", "", page, flags=re.DOTALL).lower().split()
    check_report(outcome.folder / "report.html")


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["run", "--validation", "unseen", "later"], r"later: 2\d% of its motion also used .* as \S+run; accepted"),
        (["run", "--output", "identified"], "identified/report.html exists; accepted: another name, or --force"),
        (["run", "--bandwidth=60"], "bandwidths of 60 and 20 Hz at 100 samples per second; accepted: up to 45 and"),
        (["short"], "samples without a gap; accepted"),
    ],
)
def test_what_cannot_be_identified_is_refused(
    bench: Bench, outcome: Outcome, words: list[str], message: str, capsys: pytest.CaptureFixture[str]
) -> None:
    """Repeated bags, other uses, places that take no folder, models that cannot be and runs that tell nothing."""
    assert outcome.folder.is_dir()
    before = sorted(bench.folder.rglob("*"))
    given = [word if word.startswith(("--", "0")) else str(bench.folder / word) for word in words]
    output = [] if "--output" in words else ["--output", str(bench.folder / "new")]
    assert bench.identify("excitation", *given, *output) == REFUSED
    lines = [line for line in capsys.readouterr().err.replace("\r", "\n").splitlines() if line and "| " not in line]
    said = [line for line in lines if not line.startswith(("usage: ", "  "))]
    assert len(said) == 1, said
    assert re.search(message, said[0]), said[0]
    assert sorted(bench.folder.rglob("*")) == before


def test_a_joint_that_is_not_identified_follows_the_bag(tmp_path: Path) -> None:
    """Beside a wrist that swings, whose torque is not used, shoulder and elbow are predicted to their noise."""
    names, urdf = [*NAMES, "wrist"], tmp_path / "arm.urdf"
    urdf.write_text(urdf_text(names, ["0 1 0"] * 3, [5.0, 3.0, 2.5]), encoding="utf-8")
    model = pin.buildModelFromXML(urdf.read_text(encoding="utf-8"))
    for name, seed in (("run", 1), ("unseen", 2)):
        motion = tuple(
            np.column_stack([a, 1.5 * b[:, 0]]) for a, b in zip(fourier(seed, 20), fourier(9 + seed, 20), strict=True)
        )
        torque = drive_torque(model, np.eye(3), [*CURVES, STILL], motion, RATE)
        torque += NOISE * np.random.default_rng(seed).normal(size=torque.shape)
        torque[:, 2] = 7.0  # tells nothing
        write(tmp_path / name, "/joint_states", names, RATE, (*motion, torque))
        bare = [values[:, :2] for values in (*motion, torque)]
        write(tmp_path / f"{name}_bare", "/joint_states", NAMES, RATE, bare)
    robot = rx.RobotOptions(urdf=urdf, joints=NAMES)
    result = rx.identify_excitation([tmp_path / "run"], robot, [tmp_path / "unseen"])
    (check,) = result.validations
    assert check.fitted.names == tuple(NAMES)
    assert (check.fitted.rms < 0.5 * NOISE).all()  # the low-pass leaves a part of it
    assert "not identified, along their recorded motion: wrist" in rx.identification_summary(result)
    for one, curve in zip(result.elements, CURVES, strict=True):
        estimate = one.estimates["tau_c_positive"]
        assert abs(estimate.value - curve.tau_c_positive) < 4.0 * estimate.deviation
    rx.write_identification(result, tmp_path / "identified")
    written = replace(robot, urdf=tmp_path / "identified" / "robot.urdf")
    (again,) = rx.check_friction(tmp_path / "identified" / "friction.yaml", [tmp_path / "unseen"], written)
    np.testing.assert_allclose(again.torque.rms_share, check.torque.rms_share, atol=5e-4)
    motors = RecordedRobot.load(replace(robot, gear=[1.0, 1.0]), [tmp_path / "run"], massless=True, follow=True)
    assert (motors.held, motors.followed) == (("wrist",), ())
    held = rx.identify_excitation([tmp_path / "run_bare"], robot, [tmp_path / "unseen_bare"])
    assert (held.validations[0].fitted.rms_share > 5.0 * check.fitted.rms_share).all()


def test_currents_without_constants_stay_currents(bench: Bench, outcome: Outcome, tmp_path: Path) -> None:
    """Efforts in A give A, A s/rad and A s^2 in summary, report and files, half the numbers of 2 Nm/A, and no Nm."""
    position, velocity = fourier(1, 20.0)
    torque = bench.torque((position, velocity)) + NOISE * np.random.default_rng(1).normal(size=position.shape)
    time = np.arange(len(position)) / RATE
    columns = np.column_stack([time, position, velocity, torque / 2.0])
    np.savetxt(tmp_path / "run.csv", columns, delimiter=",", header="t,q1,q2,v1,v2,i1,i2", comments="")
    fields = (("position", "q", "rad"), ("velocity", "v", "rad/s"), ("effort", "i", "A"))
    content = {name: {"columns": [f"{letter}1", f"{letter}2"], "unit": unit} for name, letter, unit in fields}
    text = yaml.safe_dump({"time": {"column": "t", "unit": "s"}, "names": NAMES, **content})
    (tmp_path / "run.yaml").write_text(text, encoding="utf-8")
    result = rx.identify_excitation([tmp_path / "run.csv"], rx.RobotOptions(urdf=bench.urdf))
    for one, other in zip(result.elements, outcome.result.elements, strict=True):
        for name in ("tau_c_positive", "c2"):
            assert one.estimates[name].value == pytest.approx(0.5 * other.estimates[name].value, rel=0.01)
    said = rx.identification_summary(result)
    assert "warning: efforts in A and no torque constants" in said
    rx.write_identification(result, tmp_path / "identified")
    texts = {path.name: path.read_text(encoding="utf-8") for path in (tmp_path / "identified").iterdir()}
    page = re.sub(r"<(script|style|footer).*?</\1>", "", texts["report.html"], flags=re.DOTALL)
    for shown in (said, page, texts["friction.yaml"], texts["parameters.yaml"]):
        assert not re.search(r"\bNm\b", shown)
    assert "A (s/rad)" in page
    assert "unit: A s^2" in texts["parameters.yaml"]
    robot = rx.RobotOptions(urdf=tmp_path / "identified" / "robot.urdf")
    (check,) = rx.check_friction(tmp_path / "identified" / "friction.yaml", [tmp_path / "run.csv"], robot)
    assert check.torque.source.unit == "A"
    with pytest.raises(rx.Rx90Error, match="its torques are in A; accepted: bags with efforts in A"):
        rx.check_friction(tmp_path / "identified" / "friction.yaml", [bench.folder / "run"], robot)


OTHER = "{tau_c: 0.7, tau_s: 0.9, omega_s: 0.02, delta: 1.0, c0: 900.0, c1: 2.0, c2: 0.3, omega_d: 0.5}"


@pytest.mark.parametrize("fallback", [True, False])
def test_a_joint_at_rest_is_assumed_and_the_others_are_written(
    bench: Bench, tmp_path: Path, fallback: bool, capsys: pytest.CaptureFixture[str]
) -> None:
    """The joint that rests has the fallback's friction, else the others' least Coulomb torque, marked."""
    words: list[object] = ["--model", "coulomb-viscous"]
    if fallback:
        (tmp_path / "other.yaml").write_text(
            f"provenance: assumed\nelements:\n  shoulder: {OTHER}\n  elbow: {OTHER}\n", encoding="utf-8"
        )
        words += ["--fallback", tmp_path / "other.yaml"]
    assert bench.identify("excitation", bench.folder / "half", "--output", tmp_path / "out", *words) == 0
    said = capsys.readouterr().out
    assert re.search(r"not identified: tau_c, .* of elbow: at rest in all runs", said)
    file = yaml.safe_load((tmp_path / "out" / "friction.yaml").read_text(encoding="utf-8"))
    whose = f"that of {tmp_path / 'other.yaml'}" if fallback else "the least of the others"
    note = file["elements"]["elbow"]["note"]
    assert note.startswith("the friction of elbow is not identified (at rest in all runs); assumed is a Coulomb torque")
    assert note.endswith(whose)
    mark = file["identification"]["parameters"]["elbow"]["tau_c_positive"]
    assert (mark["identifiable"], mark["reason"], mark["provenance"]) == (False, "at rest in all runs", "assumed")
    elements = rx.FrictionFile.read(tmp_path / "out" / "friction.yaml").elements
    assert elements["shoulder"].tau_c.positive == pytest.approx(CURVES[0].tau_c_positive, rel=0.05)
    elbow = elements["elbow"]
    expected = (0.7, 0.9, 0.3, 900.0) if fallback else (elements["shoulder"].tau_c.positive,) * 2 + (0.0, elbow.c0)
    assert (elbow.tau_c.positive, elbow.tau_s.positive, elbow.c2, elbow.c0) == expected


def test_an_alarm_without_a_validation_is_said_as_one(
    bench: Bench, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """An effort has the wrong sign and no run is held against the result: exit code 1, and the alarm is the reason."""
    words = ["excitation", bench.folder / "one", "--output", tmp_path / "out", "--model", "coulomb-viscous"]
    assert bench.identify(*words) == VERDICT_NO
    said = capsys.readouterr()
    assert "alarm: wrong sign of the effort of elbow" in said.out
    assert said.err.splitlines()[-1] == "rx90 identify: an alarm stands against the result"


@pytest.mark.parametrize("bag", ["dead", "zero"])
def test_an_effort_that_tells_nothing_carries_a_warning(
    bench: Bench, tmp_path: Path, bag: str, capsys: pytest.CaptureFixture[str]
) -> None:
    """Terminal, friction file, parameters and report say that the torque of a joint is noise, or 0; of others not."""
    words = ["excitation", bench.folder / bag, "--output", tmp_path / "out", "--model", "coulomb-viscous"]
    assert bench.identify(*words) == 0
    warned = r"(\d+)% of what varies in the torque of (\w+) is not explained"
    texts = {name: (tmp_path / "out" / name).read_text(encoding="utf-8") for name in ("report.html", "parameters.yaml")}
    for text in (capsys.readouterr().out, *texts.values()):
        found = re.findall(warned, " ".join(text.split()))
        assert {joint for _, joint in found} == {"elbow"}
        assert all(85 <= int(share) <= 100 for share, _ in found)
    elements = yaml.safe_load((tmp_path / "out" / "friction.yaml").read_text(encoding="utf-8"))["elements"]
    assert re.search(warned, elements["elbow"]["note"])
    assert "note" not in elements["shoulder"]
