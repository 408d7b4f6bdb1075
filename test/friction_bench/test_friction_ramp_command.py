"""The command friction_ramp, from its arguments to the files it leaves."""

from __future__ import annotations

import io
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from schema_faults import schema_faults

from friction_bench.experiment import job as ramp_job
from friction_bench.experiment import session
from friction_bench.rig.client import RigClient
from friction_bench.rig.emulated import EmulatedRig, VirtualPort
from friction_bench.rig.rig_file import JointFriction, Rig
from rx90_common.bags.reading import read_joint_states
from rx90_common.base.share import config_path
from rx90_common.friction import load_friction
from rx90_emulator.cli.frame import run

JOINTS = tuple(f"joint_{i}" for i in range(1, 7))
QUICK = ["--repeats", "2", "--slopes", "0.03", "0.06"]


@pytest.fixture(scope="module")
def measured(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return the folder of one complete measurement, no-load and loaded."""
    out = tmp_path_factory.mktemp("friction") / "run"
    assert run("friction_ramp", [*QUICK, "--output", str(out)]) == 0
    return out


def test_report_page_is_complete(measured: Path, check_report: Callable[[Path], None]) -> None:
    """The page holds plots for both loads, the overlay and the comparison, and the source's bands."""
    page = (measured / "report.html").read_text()
    assert page.count('<figure class="plot">') == 4
    for text in ("no-load", "loaded", "multibody", "closed form", "± 10", "± 7", "± 2", "joint side"):
        assert text in page
    check_report(measured / "report.html")


def test_friction_file_is_one_that_the_simulation_reads(measured: Path) -> None:
    """rx90_sim loads the YAML: tau_c and c2 of the joint's element are identified, all else is stated as assumed."""
    found = load_friction(measured / "friction.yaml", JOINTS)
    shipped = load_friction(config_path("robots/rx90b/friction.yaml"), JOINTS)
    index = found.names.index("joint_6")
    assert found.elements[index].tau_c_positive == pytest.approx(0.9, rel=0.05)
    assert found.elements[index].c2 == pytest.approx(0.11, rel=0.05)
    assert found.elements[:index] == shipped.elements[:index]
    assert schema_faults("friction", measured / "friction.yaml") == []
    stated = yaml.safe_load((measured / "friction.yaml").read_text())
    parameters = stated["identification"]["parameters"]["joint_6"]
    assert stated["provenance"] == "assumed"
    identified = {name for name, entry in parameters.items() if entry["provenance"] == "identified"}
    assert identified == {"tau_c", "c2"}
    assert "torque noise releases the shaft" in parameters["tau_s"]["reason"]


def test_estimates_carry_their_intervals(measured: Path) -> None:
    """The YAML of estimates has value, uncertainty and interval for both loads and the joint."""
    estimates = yaml.safe_load((measured / "estimates.yaml").read_text())
    low, high = estimates["loaded"]["exact, by covariance"]["coulomb"]["interval_95"]
    assert low < 0.0698 < high
    assert estimates["joint"]["joint_side"]["coulomb"]["standard_uncertainty"] > 0.0


def test_bag_holds_every_reading(measured: Path) -> None:
    """The bag's stamps are the firmware's 20 ms ticks, and states and commands go together."""
    states = read_joint_states(measured / "bag", "friction_bench/joint_states")
    commands = read_joint_states(measured / "bag", "friction_bench/joint_commands")
    assert states.stamp_ns.tolist() == commands.stamp_ns.tolist()
    assert set((states.stamp_ns % 20_000_000).tolist()) == {0}
    assert commands.effort is not None
    assert commands.effort.max() <= 0.18


def test_recorded_ramps_evaluate_to_the_same(measured: Path, tmp_path: Path) -> None:
    """The CSV files that a measurement leaves give the same f_c as the measurement."""
    slopes = {}
    for file in sorted(measured.glob("ramp_*.csv")):
        label, _, slope = file.read_text().splitlines()[0][2:].rpartition(", slope ")
        slopes[file] = (label, float(slope.removesuffix(" Nm/s")))
    arguments = []
    for file, (label, slope) in slopes.items():
        option = "--loaded-file" if label.startswith("loaded") else "--no-load-file"
        arguments += [option, f"{slope!r}:{file}"]
    assert run("friction_ramp", [*arguments, "--output", str(tmp_path / "again")]) == 0
    again = yaml.safe_load((tmp_path / "again" / "estimates.yaml").read_text())
    before = yaml.safe_load((measured / "estimates.yaml").read_text())
    key = "exact, by covariance"
    assert again["loaded"][key]["coulomb"]["value"] == pytest.approx(before["loaded"][key]["coulomb"]["value"])


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--slopes", "99"], "slope 99 Nm/s; accepted"),
        (["--repeats", "0"], "--repeats is 0"),
        (["--end-torque", "0.5"], "--end-torque is 0.5"),
        (["--rig", "nothing.yaml"], "no file 'nothing.yaml'"),
        (["--repeats", "1001"], "--repeats is 1001; accepted: 1 to 1000"),
        (["--seed", "-1"], "--seed is -1; accepted: 0 to"),
        (["--baud", "0"], "--baud is 0; accepted: 1200 to 1000000"),
        (["--slopes", "nan"], "argument --slopes: 'nan'; accepted: a finite number"),
        (["--slopes", "0.1", "0.05", "0.1"], "--slopes has 0.1 twice; accepted: each slope once"),
        (["--slopes", "inf", "0.1"], "argument --slopes: 'inf'; accepted: a finite number"),
        (["--end-torque", "nan"], "argument --end-torque: 'nan'; accepted: a finite number"),
        (["--end-torque", "0.19"], "end torque 0.19 Nm; accepted by the firmware: 0.00078 to 0.18 Nm"),
        (["--text", "counts"], "--text is given without a file"),
        (["--port", "nonsense://x"], "nonsense://x: cannot be opened"),
        (["--output", "/proc/friction"], "/proc/friction: cannot be written ("),
        (["--output", "/dev/null"], "/dev/null exists; accepted: a new name"),
        (["--velocity", "mean"], "--velocity is mean; accepted: with --text velocity alone"),
        (["--end-torque", "0.02", "--load", "none"], "no break-away"),
        (["--no-load-file", "0.1:nothing.csv"], "nothing.csv: cannot be read"),
        (["--no-load-file", "nothing.csv"], "accepted: slope:file"),
        (["--no-load-file", "0.1"], "accepted: slope:file"),
        (["--no-load-file", "nan:ramp.csv"], "accepted: slope:file"),
        (["--element", "joint_9", *QUICK, "--load", "none"], "--element is 'joint_9'"),
    ],
)
def test_mistakes_get_one_line(
    arguments: list[str], message: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """A user's mistake is answered by one line and exit code 2."""
    assert run("friction_ramp", ["--output", str(tmp_path / "out"), *arguments]) == 2
    error = capsys.readouterr().err.strip().splitlines()[-1]
    assert message in error
    assert error.startswith("friction_ramp: ")


@pytest.mark.parametrize("port", ["/dev/nothing", "/etc/hostname"])
def test_a_rig_that_cannot_be_reached_is_a_failure(
    port: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """A port that is not there, or is no serial one, is one line and exit code 3."""
    assert run("friction_ramp", ["--output", str(tmp_path / "out"), "--port", port]) == 3
    assert f"friction_ramp: {port}: cannot be opened" in capsys.readouterr().err


def test_existing_folder_is_refused_before_the_rig_moves(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """Whatever a folder holds, for ramps and for files: exit code 2, no rig is opened, its files are as they were."""
    monkeypatch.setattr(session, "EmulatedRig", lambda *_: pytest.fail("the rig was opened"))
    (tmp_path / "report.html").write_text("mine")
    csv = tmp_path / "old.csv"
    csv.write_text("time,counts\n0,1\n")
    for arguments in ([], ["--no-load-file", f"0.1:{csv}"]):
        assert run("friction_ramp", [*arguments, "--output", str(tmp_path)]) == 2
        assert f"{tmp_path} exists; accepted: a new name" in capsys.readouterr().err
    assert (tmp_path / "report.html").read_text() == "mine"
    assert sorted(path.name for path in tmp_path.iterdir()) == ["old.csv", "report.html"]


def test_source_figure_from_its_kind_of_velocity(tmp_path: Path) -> None:
    """Velocities a t - b give the source's 0.1464 Nm as instantaneous, 0.1403 Nm (m tick / 2 less) as tick means."""
    time = 0.02 * np.arange(1, 150)
    path = tmp_path / "source.txt"
    np.savetxt(path, np.maximum(949.5407 * time - 227.8898, 0.0))
    for name, options, expected in (("a", [], 0.1403), ("b", ["--velocity", "instantaneous"], 0.1464)):
        out = tmp_path / name
        arguments = ["--text", "velocity", "--no-load-file", f"0.61:{path}", *options, "--output", str(out)]
        assert run("friction_ramp", arguments) == 0
        found = yaml.safe_load((out / "estimates.yaml").read_text())["no-load"]["source, m b / a"]["coulomb"]["value"]
        assert found == pytest.approx(expected, abs=5e-5)


def test_load_without_an_estimate_does_not_cost_the_other(
    rig: Rig, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """A joint too heavy for the motor ends the measurement after one ramp: exit code 1, no-load friction reported."""
    assert rig.plant is not None
    heavy = replace(rig, plant=replace(rig.plant, joint=JointFriction(4.0, 0.1)))
    monkeypatch.setattr(ramp_job, "load_rig", lambda _: heavy)
    out = tmp_path / "out"
    assert run("friction_ramp", [*QUICK, "--output", str(out)]) == 1
    text = capsys.readouterr().out
    assert "not used: loaded 0.03 Nm/s #1: no break-away up to 0.15" in text
    assert yaml.safe_load((out / "estimates.yaml").read_text())["no-load"]["exact, by covariance"]
    assert len(list(out.glob("ramp_*.csv"))) == 5
    assert "no break-away" in (out / "report.html").read_text()
    assert not (out / "friction.yaml").exists()


def test_interrupted_measurement_keeps_what_it_measured(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """Ctrl-C in the third ramp leaves two ramps as CSV and a bag of all readings, and exit code 130."""
    run_ramp = ramp_job.run_ramp
    done = 0

    def third_time(*arguments: Any) -> Any:
        nonlocal done
        done += 1
        if done == 3:
            raise KeyboardInterrupt
        return run_ramp(*arguments)

    monkeypatch.setattr(ramp_job, "run_ramp", third_time)
    assert run("friction_ramp", [*QUICK, "--load", "none", "--output", str(tmp_path / "out")]) == 130
    assert "switched off" in capsys.readouterr().err
    assert sorted(path.name for path in tmp_path.glob("out/*.csv")) == ["ramp_01.csv", "ramp_02.csv"]
    assert read_joint_states(tmp_path / "out" / "bag", "friction_bench/joint_states").stamp_ns.size > 100


def test_rig_at_a_port_asks_for_the_joint_only_where_both_loads_are_run(
    rig: Rig, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """With --load none nobody need be there; with both loads an empty input is a clear refusal."""
    emulated = EmulatedRig(rig, 1)
    monkeypatch.setattr(session, "SerialPort", lambda *_: VirtualPort(emulated))
    monkeypatch.setattr("sys.stdin", io.StringIO())
    assert run("friction_ramp", [*QUICK, "--port", "somewhere", "--load", "none", "--output", str(tmp_path / "a")]) == 0
    assert run("friction_ramp", [*QUICK, "--port", "somewhere", "--output", str(tmp_path / "b")]) == 3
    assert "nobody there to couple the joint" in capsys.readouterr().err


def test_latched_fault_is_named_and_cleared_by_option(
    rig: Rig, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """What a killed program left latched is refused by its name, and --clear runs all the same."""
    emulated = EmulatedRig(rig, 1)
    client = RigClient(VirtualPort(emulated), rig)
    client.connect()
    client.arm()
    emulated.advance(0.3)  # nobody pumps: as after kill -9
    monkeypatch.setattr(session, "EmulatedRig", lambda *_: emulated)
    assert run("friction_ramp", [*QUICK, "--load", "none", "--output", str(tmp_path / "a")]) == 3
    assert "the host was silent for more than 120 ms; find out why, then clear it" in capsys.readouterr().err
    assert run("friction_ramp", [*QUICK, "--load", "none", "--clear", "--output", str(tmp_path / "b")]) == 0
