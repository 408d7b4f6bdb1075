"""The commands of rx90 rig on emulated rigs, the self-test among them, and the launch file."""

import io
import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from launch_stub import arguments as launch_arguments
from launch_stub import build, ending, parameters
from report_pages import leave_plots_out
from rig_bench import greeted, rig_file_with, spoil
from schema_faults import schema_faults
from shared_files import made_once

from friction_bench.experiment import job as ramp_job
from friction_bench.experiment import selftest, session
from friction_bench.experiment.selftest import self_test
from friction_bench.node import bench_node
from friction_bench.rig.client import RigClient
from friction_bench.rig.emulated import EmulatedRig, PtyRig
from friction_bench.rig.messages import Fault
from friction_bench.rig.rig_file import JointFriction, Rig, load_rig
from rx90_common.bags.reading import read_joint_states
from rx90_common.base.share import SHIPPED_RIG, SOURCE_RIG, config_path
from rx90_common.description.coupling import RX_WRIST
from rx90_common.friction import load_friction
from rx90_emulator.cli.frame import EXECUTABLES, run

JOINTS = tuple(f"joint_{i}" for i in range(1, 7))
QUICK_RAMPS = ["--repeats", "2", "--slopes", "0.03", "0.06"]


def estimates(out: Path) -> Any:
    return yaml.safe_load((out / "estimates.yaml").read_text())


@pytest.fixture(scope="module")
def ramps(tmp_path_factory: pytest.TempPathFactory) -> Path:
    def make(folder: Path) -> None:
        with pytest.MonkeyPatch.context() as patch:
            leave_plots_out(patch)
            assert run("rx90 rig ramp", [*QUICK_RAMPS, "--output", str(folder / "run")]) == 0

    return made_once(tmp_path_factory, "ramps", make) / "run"


def test_report_page_and_estimates_are_complete(ramps: Path) -> None:
    """Page: plots of loads, overlay, comparison, sensor, the source's bands. YAML: intervals of loads and joint."""
    page = (ramps / "report.html").read_text()
    assert page.count('<figure class="plot">') == 5
    for text in ("no-load", "loaded", "multibody", "closed form", "± 10", "± 7", "± 2", "joint side"):
        assert text in page
    low, high = estimates(ramps)["loaded"]["exact, by covariance"]["coulomb"]["interval_95"]
    assert low < 0.0698 < high
    assert estimates(ramps)["joint"]["joint_side"]["coulomb"]["standard_uncertainty"] > 0.0
    states = read_joint_states(ramps / "bag", "friction_bench/joint_states")
    commands = read_joint_states(ramps / "bag", "friction_bench/joint_commands")
    assert states.stamp_ns.tolist() == commands.stamp_ns.tolist()
    assert set((states.stamp_ns % 20_000_000).tolist()) == {0}
    assert commands.effort.max() <= 0.18


def test_friction_file_is_one_that_the_simulation_reads(ramps: Path) -> None:
    """rx90_sim loads the YAML: tau_c and c2 of the joint's element are identified, all else is stated as assumed."""
    found = load_friction(ramps / "friction.yaml", RX_WRIST.element_names(JOINTS))
    shipped = load_friction(config_path("robots/rx90b/friction.yaml"), RX_WRIST.element_names(JOINTS))
    index = found.names.index("joint_6")
    assert found.elements[index].tau_c.positive == pytest.approx(0.9, rel=0.05)
    assert found.elements[index].c2 == pytest.approx(0.11, rel=0.05)
    assert found.elements[:index] == shipped.elements[:index]
    assert schema_faults("friction", ramps / "friction.yaml") == []
    stated = yaml.safe_load((ramps / "friction.yaml").read_text())
    entries = stated["identification"]["parameters"]["joint_6"]
    assert stated["provenance"] == "assumed"
    assert {name for name, entry in entries.items() if entry["provenance"] == "identified"} == {"tau_c", "c2"}
    assert "torque noise releases the shaft" in entries["tau_s"]["reason"]


def test_recorded_ramps_evaluate_to_the_same_whatever_the_calibration(ramps: Path, tmp_path: Path) -> None:
    """The CSV files that a measurement leaves give its values; `scale_uncertainty` 0.05 adds (5 %)² to variances."""
    words, found = [], {}
    for file in sorted(ramps.glob("ramp_*.csv")):
        label, _, slope = file.read_text().splitlines()[0][2:].rpartition(", slope ")
        option = "--loaded-file" if label.startswith("loaded") else "--no-load-file"
        words += [option, f"{float(slope.removesuffix(' Nm/s'))!r}:{file}"]
    for scale in (0.0, 0.05):
        file = rig_file_with(tmp_path, SHIPPED_RIG, {"scale_uncertainty: 0.003": f"scale_uncertainty: {scale}"})
        out = tmp_path / f"out_{scale}"
        assert run("rx90 rig read", [*words, "--rig", str(file), "--output", str(out)]) == 0
        written = estimates(out)
        exact = {load: written[load]["exact, by covariance"] for load in ("no-load", "loaded")}
        found[scale] = [*exact["no-load"].values(), *exact["loaded"].values(), *written["joint"]["motor_side"].values()]
        measured = estimates(ramps)["loaded"]["exact, by covariance"]["coulomb"]["value"]
        assert exact["loaded"]["coulomb"]["value"] == pytest.approx(measured)
    assert len(found[0.0]) == 8
    for without, with_scale in zip(found[0.0], found[0.05], strict=True):
        assert with_scale["value"] == without["value"]
        variance = without["standard_uncertainty"] ** 2 + (0.05 * without["value"]) ** 2
        assert with_scale["standard_uncertainty"] ** 2 == pytest.approx(variance, rel=0.01)  # digits of the file
        low, high = with_scale["interval_95"]
        assert high - low >= 2 * 1.95 * variance**0.5


NO_RIGS = "/dev/nothing", "/etc/hostname"


@pytest.mark.parametrize(
    ("words", "message"),
    [
        *((f"rx90 rig ramp --port {port}", f"{port}: cannot be opened") for port in NO_RIGS),
        ("rx90 rig ramp --slopes 0.1 0.05 0.1", "--slopes has 0.1 twice; accepted: each slope once"),
        ("rx90 rig ramp --end-torque 0.02 --load none", "no break-away"),
        ("rx90 rig ramp --element joint_9 --load none", "--element is 'joint_9'"),
        ("rx90 rig emulator --link /dev/null", "/dev/null: cannot point to the emulated rig"),
    ],
)
def test_mistakes_get_one_line(words: str, message: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """A user's mistake is answered by one line and exit code 2 (3 where no rig is), and nothing is written."""
    output = ["--output", str(tmp_path / "out")] if words.startswith("rx90 rig ramp") else []
    assert run(words, output) == (3 if words.endswith(NO_RIGS) else 2)
    error = capsys.readouterr().err.strip().splitlines()[-1]
    assert message in error
    assert error.startswith("rx90 rig: ")
    assert not (tmp_path / "out").exists() or "no break-away" in message


def test_existing_folder_is_refused_before_the_rig_moves(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """Whatever a folder holds, for ramps and for files: exit code 2, no rig is opened, its files are as they were."""
    monkeypatch.setattr(session, "EmulatedRig", lambda *_: pytest.fail("the rig was opened"))
    csv = tmp_path / "old.csv"
    csv.write_text("time,counts\n0,1\n")
    for verb, words in (("ramp", []), ("read", ["--no-load-file", f"0.1:{csv}"])):
        assert run(f"rx90 rig {verb}", [*words, "--output", str(tmp_path)]) == 2
        assert f"{tmp_path} exists; accepted: a new name" in capsys.readouterr().err
    assert csv.read_text() == "time,counts\n0,1\n"
    assert list(tmp_path.iterdir()) == [csv]


def test_source_figure_from_its_kind_of_velocity(tmp_path: Path) -> None:
    """Velocities a t - b give the source's 0.1464 Nm as instantaneous, 0.1403 Nm (m tick / 2 less) as tick means."""
    time = 0.02 * np.arange(1, 150)
    path = tmp_path / "source.txt"
    np.savetxt(path, np.maximum(949.5407 * time - 227.8898, 0.0))
    for kind, expected in (("velocity", 0.1403), ("instantaneous-velocity", 0.1464)):
        out = tmp_path / kind
        words = ["--text", kind, "--no-load-file", f"0.61:{path}", "--output", str(out)]
        assert run("rx90 rig read", words) == 0
        assert estimates(out)["no-load"]["source, m b / a"]["coulomb"]["value"] == pytest.approx(expected, abs=5e-5)


SOURCE_RAMPS = {"no-load": (0.61, 949.5407, 227.8898), "loaded": (0.55, 981.3603, 412.1713)}
"""The source's own m, Nm/s, a and b of its velocities a t - b."""


@pytest.mark.parametrize(
    ("loads", "quantity", "estimate"),
    [
        (("no-load", "loaded"), "viscous", 0.55 / 981.3603 - 0.61 / 949.5407),
        (("loaded", "no-load"), "coulomb", 0.61 * 227.8898 / 949.5407 - 0.55 * 412.1713 / 981.3603),
    ],
)
def test_an_unphysical_estimate_is_a_verdict(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], loads: tuple[str, str], quantity: str, estimate: float
) -> None:
    """The source's data have a joint with f_v < 0: exit code 1, cause and remedy, and no file calls it identified."""
    words = ["--text", "instantaneous-velocity", "--output", str(tmp_path / "out")]
    for option, load in zip(("--no-load-file", "--loaded-file"), loads, strict=True):
        m, a, b = SOURCE_RAMPS[load]
        np.savetxt(tmp_path / load, np.maximum(a * 0.02 * np.arange(1, 150) - b, 0.0))
        words += [option, f"{m}:{tmp_path / load}"]
    assert run("rx90 rig read", words) == 1
    said = capsys.readouterr().err
    known = estimates(tmp_path / "out")
    assert known["joint"]["motor_side"][quantity]["value"] == pytest.approx(estimate, rel=1e-3)
    (reason,) = [text for text in known["not_physical"] if quantity in text.lower()]
    assert f"not physical: {reason}" in said
    assert re.search(r"accepted: > 0. no-load and loaded had one slope: .* run two slopes", reason)
    assert "Not physical:" in (tmp_path / "out" / "report.html").read_text()
    file = tmp_path / "out" / "friction.yaml"
    if quantity == "coulomb":
        assert not file.exists()
        return
    written = yaml.safe_load(file.read_text())["identification"]["parameters"]["joint_6"]
    assert (written["tau_c"]["provenance"], written["c2"]["provenance"]) == ("identified", "assumed")
    assert (written["c2"]["value"], written["c2"]["reason"]) == (0.0, reason)


def test_load_without_an_estimate_does_not_cost_the_other(
    rig: Rig, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """A joint too heavy for the motor ends the measurement after one ramp: exit code 1, no-load friction reported."""
    heavy = rig.replaced(emulation={"joint_friction": JointFriction(model="coulomb_viscous", coulomb=4.0, viscous=0.1)})
    monkeypatch.setattr(ramp_job, "load_rig", lambda _: heavy)
    out = tmp_path / "out"
    assert run("rx90 rig ramp", [*QUICK_RAMPS, "--output", str(out)]) == 1
    assert "not used: loaded 0.03 Nm/s #1: no break-away up to 0.15" in capsys.readouterr().out
    assert estimates(out)["no-load"]["exact, by covariance"]
    assert len(list(out.glob("ramp_*.csv"))) == 5
    assert "no break-away" in (out / "report.html").read_text()
    assert not (out / "friction.yaml").exists()


def test_interrupted_measurement_keeps_what_it_measured(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """Ctrl-C in the third ramp leaves two ramps as CSV and a bag of all readings, and exit code 130."""
    run_ramp, begun = ramp_job.run_ramp, []

    def third_time(*words: Any) -> Any:
        begun.append(words)
        if len(begun) == 3:
            raise KeyboardInterrupt
        return run_ramp(*words)

    monkeypatch.setattr(ramp_job, "run_ramp", third_time)
    assert run("rx90 rig ramp", [*QUICK_RAMPS, "--load", "none", "--output", str(tmp_path / "out")]) == 130
    assert "switched off" in capsys.readouterr().err
    assert sorted(path.name for path in tmp_path.glob("out/*.csv")) == ["ramp_01.csv", "ramp_02.csv"]
    assert read_joint_states(tmp_path / "out" / "bag", "friction_bench/joint_states").stamp_ns.size > 100


def test_rig_at_a_port_asks_for_the_joint_only_where_both_loads_are_run(
    rig: Rig, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """With --load none nobody need be there; with both loads an empty input is a clear refusal."""
    monkeypatch.setattr(session, "SerialPort", lambda *_: greeted(rig).port)
    monkeypatch.setattr("sys.stdin", io.StringIO())
    words = [*QUICK_RAMPS, "--port", "somewhere", "--output"]
    assert run("rx90 rig ramp", [*words, str(tmp_path / "a"), "--load", "none"]) == 0
    assert run("rx90 rig ramp", [*words, str(tmp_path / "b")]) == 3
    assert "nobody there to couple the joint" in capsys.readouterr().err


def test_latched_fault_is_named_and_cleared_by_option(
    rig: Rig, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """What a killed program left latched is refused by its name, and --clear runs all the same."""
    client = greeted(rig)
    client.arm()
    client.port.emulated.advance(0.3)  # nobody pumps: as after kill -9
    monkeypatch.setattr(session, "EmulatedRig", lambda *_: client.port.emulated)
    words = [*QUICK_RAMPS, "--load", "none", "--output"]
    assert run("rx90 rig ramp", [*words, str(tmp_path / "a")]) == 3
    assert "the host was silent for more than 120 ms; find out why, then clear it" in capsys.readouterr().err
    assert run("rx90 rig ramp", [*words, str(tmp_path / "b"), "--clear"]) == 0


def test_the_link_goes_with_the_rig_that_has_it(rig: Rig, tmp_path: Path) -> None:
    """A rig that ends takes its link away, but not one that another rig has taken over meanwhile."""
    link = tmp_path / "rig"
    first = PtyRig(EmulatedRig(rig, 1), link)
    second = PtyRig(EmulatedRig(rig, 2), link)
    first.close()
    assert str(link.readlink()) == second.path
    second.close()
    assert not link.is_symlink()


def test_launch_file_starts_the_node_with_parameters_that_it_has(monkeypatch: pytest.MonkeyPatch) -> None:
    """The executable exists, every default is the node's own, and its end is the launch's."""
    actions = build(monkeypatch, "friction_bench.launch.py")
    (node,) = (action for action in actions if action.kind == "Node")
    declared = dict(bench_node.BenchParameters.of({}))
    given = parameters(node)
    assert node.named["executable"] in EXECUTABLES
    assert given == {name: name for name in ("port", "rig", "seed")}
    assert launch_arguments(actions) == {"namespace": ""} | {name: str(declared[name]) for name in given}
    assert ending(node, 0).kind == "Shutdown"


def failed(client: RigClient) -> dict[str, str]:
    found = {check.name: check.found for check in self_test(client) if not check.good}
    assert not client.port.emulated.board.stage_on
    assert client.last.report.fault == Fault.NONE
    return found


@pytest.mark.parametrize("file", [SHIPPED_RIG, SOURCE_RIG])
def test_a_good_rig_passes_at_rest(file: str) -> None:
    """All checks hold, twice in a row and after a latched fault, and the shaft does not turn."""
    client = greeted(load_rig(config_path(file)))
    client.arm()
    client.port.emulated.advance(0.3)  # nobody pumps: the watchdog's fault is latched
    assert failed(client) == {}
    assert failed(client) == {}
    assert client.port.emulated.plant.angle == 0.0


def test_a_fault_of_the_board_is_found(client: RigClient, emulated: EmulatedRig) -> None:
    """An encoder's line that counts along and a current sense with an offset fail the checks that show them."""
    advance, reading = emulated.plant.advance, emulated.plant.current_reading
    emulated.plant.advance = lambda *step: advance(*step) + 1
    emulated.plant.current_reading = lambda: reading() + 0.01
    assert failed(client).keys() == {"encoder counts of a shaft at rest", "ADC code, disarmed"}


def test_a_line_that_loses_reports_is_found(client: RigClient, emulated: EmulatedRig) -> None:
    """Reports that are damaged on the line are counted."""
    spoil(emulated.board, 100, lambda data: data.replace(b"\0", b"\1"))
    assert failed(client).keys() == {"lost reports", "damaged frames"}


WATCHDOG, STOP = "ticks to torque off, without a host", "stage and DAC code after STOP"
ARM = "    if (state != DISARMED)\n        return RESULT_STATE;\n    travel_start"
MUTANTS = {
    "no watchdog": ("trip(FAULT_WATCHDOG);", ";", WATCHDOG, "more than 21"),
    "slow watchdog": (">= WATCHDOG_TICKS", ">= WATCHDOG_TICKS + 5u", WATCHDOG, "12"),
    "high torque": ("if (code > TORQUE_LIMIT_CODE)", "if (0)", "torque", "TORQUE code 230 was obeyed"),
    "high ramp": ("end > TORQUE_LIMIT_CODE", "0", "torque", "RAMP code 230 was obeyed"),
    "torque left on": ("    hal_stage(0);\n    drive(0);", "    hal_stage(0);", STOP, "off, 1"),
    "no arming": (ARM, "    return RESULT_STATE;\n    travel_start", "torque", "ARM: not possible"),
}
"""By text of core/rig.c, what stands in its place, the check that fails, and what is found."""


@pytest.mark.parametrize("name", MUTANTS)
def test_a_fault_of_the_firmware_is_found(name: str, make_mutant: Callable[..., Any], rig: Rig) -> None:
    """A firmware without one of its rules fails the check that shows it."""
    old, new, check, found = MUTANTS[name]
    client = greeted(rig, board=make_mutant("native", "core/rig.c", old, new))
    faults = {each.name: each.found for each in self_test(client) if not each.good}
    assert found in faults[check]


def test_other_figures_than_the_rig_file_s_end_the_test(client: RigClient, rig: Rig) -> None:
    """A firmware for another encoder fails the first check with both numbers; nothing is switched on after that."""
    client.rig = rig.replaced(counts_per_revolution=500)
    client.port.emulated.board.switched_on()
    (check,) = self_test(client)
    assert not check.good
    assert "counts_per_revolution is 500, the rig's firmware has 504" in check.found
    assert not client.port.emulated.board.switched_on()


def test_the_command_prints_a_table(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    """0 and a line for each check on a good rig, 1 on one that fails."""
    assert run("rx90 rig", ["selftest"]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert len(lines) == 14
    assert all(line.endswith(": ok") for line in lines[1:])
    monkeypatch.setattr(selftest, "HIGHEST_IDLE_ADC", -1.0)
    assert run("rx90 rig", ["selftest"]) == 1
    assert sum(line.endswith(": WRONG") for line in capsys.readouterr().out.splitlines()) == 1
