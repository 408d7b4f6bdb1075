"""The command friction_presliding on emulated rigs of known law, through the real protocol; few seeds.

The experiments tell these joints apart with a power near 1 (`python -m benchmarks.friction_presliding` counts errors
over many rigs), so one rig of each law is enough to see that they do: LuGre and elasto-plastic, which the drift is for.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import yaml
from scipy.integrate import solve_ivp

from friction_bench.presliding import job
from friction_bench.presliding.motions import Profile, Trace, follow, pulled
from friction_bench.presliding.sliding import evaluate_pull, sampled_growth
from friction_bench.rig.client import RigClient, Sample
from friction_bench.rig.emulated import EmulatedRig, VirtualPort
from friction_bench.rig.messages import RigLostError
from friction_bench.rig.rig_file import load_rig
from rx90_common.base.share import PRESLIDING_RIG, config_path
from rx90_common.friction.element import FrictionElement
from rx90_emulator.cli.frame import run

QUICK = ["--kinds", "loops", "sweep", "drift", "--blocks", "6", "--cycles", "300"]
BRISTLES = {
    "LuGre": "",
    "elasto-plastic": ", bristles: {kind: elasto_plastic, break_away: 0.5}",
}


def rig_file(folder: Path, law: str) -> Path:
    """Return the shipped rig file with a joint of this law."""
    text = config_path(PRESLIDING_RIG).read_text()
    end = "omega_d: 0.05}"
    assert text.count(end) == 1
    path = folder / "rig.yaml"
    path.write_text(text.replace(end, f"omega_d: 0.05{BRISTLES[law]}}}"))
    return path


@pytest.fixture(scope="module", params=list(BRISTLES))
def measured(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> tuple[str, Path]:
    """Return law and folder of a measurement."""
    folder = tmp_path_factory.mktemp("presliding")
    words = ["--rig", str(rig_file(folder, request.param)), "--seed", "2", "--output", str(folder / "run"), *QUICK]
    assert run("friction_presliding", words) == (0 if request.param == "LuGre" else 1)
    return request.param, folder / "run"


def test_the_law_of_the_joint_is_found(measured: tuple[str, Path]) -> None:
    """Loops and drift keep the law that the joint has and tell LuGre from elasto-plastic; rigid laws are refuted.

    Six blocks, a pass of the kinds of loops, leave Maxwell slip beside elasto-plastic: "cannot tell", exit code 1.
    """
    law, out = measured
    found = yaml.safe_load((out / "estimates.yaml").read_text())
    assert found["law"]["left"] == ([law] if law == "LuGre" else [law, "Maxwell slip"])
    assert {"Coulomb and viscous", "Stribeck"} <= set(found["law"]["refuted"])
    assert found["drift"]["verdict"].startswith("LuGre" if law == "LuGre" else "no drift")
    assert found["sliding"] == pytest.approx(
        {"tau_c": 2.0, "tau_s": 2.5, "omega_s": 0.1, "c2": 1.0, "inertia": 0.4}, rel=0.12
    )
    assert found["not_used"] == []


def test_break_away_falls_with_the_rate_as_scipy_has_it(measured: tuple[str, Path]) -> None:
    """The largest friction before sliding falls with the torque's rate, for LuGre to what the equations give."""
    law, out = measured
    rows = yaml.safe_load((out / "estimates.yaml").read_text())["break_away"]
    rates, torques = (np.array([row[name] for row in rows]) for name in ("rate_nm_s", "torque_nm"))
    assert torques[0] > torques[-1] + 0.05
    if law == "LuGre":
        expected = [_largest_friction(rate) for rate in rates[[1, 3]]]
        assert torques[[1, 3]] == pytest.approx(expected, abs=0.05)


def _largest_friction(rate: float) -> float:
    """Return the largest friction before a LuGre joint slides under a torque that rises from 1.5 Nm, Nm."""

    def motion(time: float, state: list[float]) -> list[float]:
        _, v, z = state
        steady = 2.0 + 0.5 * math.exp(-abs(v) / 0.1)
        z_dot = v - abs(v) * 4e3 / steady * z
        return [v, (1.5 + rate * time - 4e3 * z - 50.0 * math.exp(-((v / 0.05) ** 2)) * z_dot - v) / 0.4, z_dot]

    def slid(_time: float, state: list[float]) -> float:
        return state[0] - 8e-3

    slid.terminal = True  # type: ignore[attr-defined]
    start = [0.0, rate / 4e3, 1.5 / 4e3]
    solved = solve_ivp(motion, (0.0, 60.0), start, "LSODA", events=slid, rtol=1e-7, atol=1e-10, max_step=0.05)
    _, v, z = solved.y
    steady = 2.0 + 0.5 * np.exp(-np.abs(v) / 0.1)
    z_dot = v - np.abs(v) * 4e3 / steady * z
    return float((4e3 * z + 50.0 * np.exp(-((v / 0.05) ** 2)) * z_dot + v).max())


def test_the_folder_holds_every_reading_and_a_page(
    measured: tuple[str, Path], check_report: Callable[[Path], None]
) -> None:
    """Each experiment is a CSV file, the bag holds all readings, and the page shows loops, drift, rates and sliding."""
    law, out = measured
    names = sorted(path.name for path in out.glob("*.csv"))
    assert len(names) == 15 + 6 + 2
    assert (out / "bag").is_dir()
    page = (out / "report.html").read_text()
    assert page.count('<figure class="plot">') == 4
    assert "counts, up to break-away" in page
    if law == "LuGre":  # pages differ in numbers alone
        check_report(out / "report.html")


def test_steady_sliding_is_unstable_where_the_sampled_spring_says_so(tmp_path: Path) -> None:
    """A slow pull sticks and slips, a fast one slides; the eigenvalues of the sampled spring and joint tell which."""
    rig = load_rig(rig_file(tmp_path, "LuGre"))
    emulated = EmulatedRig(rig, 1)
    emulated.plant.load(True)
    client = RigClient(VirtualPort(emulated), rig)
    client.connect()
    assert rig.plant is not None
    joint, inertia = rig.plant.joint, rig.plant.load_inertia + rig.plant.joint_inertia
    assert isinstance(joint, FrictionElement)
    for speed, stiffness, slips in ((0.06, 8.0, True), (0.3, 8.0, False)):
        growth = sampled_growth(joint, inertia, speed, stiffness, rig.tick)
        assert (growth > 1.0) is slips
        spring = stiffness * rig.joint_step / (rig.torque(1) * rig.joint_scale)
        ticks = round(8.0 / rig.tick)
        profile = pulled(spring, speed * rig.tick / rig.joint_step, ticks, 229, 85.0)
        assert evaluate_pull(follow(client, profile, "pull"), speed, stiffness).sticks_and_slips is slips


@pytest.mark.parametrize(
    ("words", "text"),
    [
        (["--rig", "rig/gm8224_lugre.yaml"], "counts_down is false"),
        (["--cycles", "5"], "--cycles is 5; accepted: 100 to 100000"),
        (["--blocks", "2"], "--blocks is 2; accepted: 6 to 100"),
    ],
)
def test_what_cannot_be_measured_is_refused(
    words: list[str], text: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """A rig that cannot see a reversal, and numbers out of range, are refused in one line, and nothing is written."""
    assert run("friction_presliding", [*words, "--output", str(tmp_path / "run")]) == 2
    lines = capsys.readouterr().err.splitlines()
    assert len(lines) == 1
    assert text in lines[0]
    assert not (tmp_path / "run").exists()


@pytest.mark.parametrize(
    ("ends", "code", "line"),
    [
        (KeyboardInterrupt(), 130, "friction_presliding: interrupted; the rig is switched off"),
        (RigLostError("/dev/rig: lost while reading"), 3, "friction_presliding: /dev/rig: lost while reading"),
    ],
)
def test_a_measurement_that_ends_early_keeps_all_readings(
    ends: BaseException,
    code: int,
    line: str,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    """After Ctrl-C or a lost line the rig is off; what was measured is kept and evaluated, the drift so far, too."""
    clients: list[RigClient] = []

    def follow_some(client: RigClient, profile: Profile, label: str, keep: Callable[[Sample], None]) -> Trace:
        clients.append(client)

        def some(sample: Sample) -> None:
            keep(sample)
            drift.append(sample)
            if len(drift) == 900:
                raise ends

        drift: list[Sample] = []
        return follow(client, profile, label, some if label == "drift" else keep)

    monkeypatch.setattr(job, "follow", follow_some)
    monkeypatch.setattr("friction_bench.presliding.job.RATES", (6.0,))
    words = ["--kinds", "drift", "--cycles", "300", "--output", str(tmp_path / "run")]
    assert run("friction_presliding", words) == code
    assert capsys.readouterr().err.splitlines()[-1] == line
    out = tmp_path / "run"
    names = sorted(path.name.split("_", 1)[1] for path in out.glob("*.csv"))
    assert names == ["drift_unfinished.csv", "ramp.csv", "ramp.csv", "ramp.csv"]
    assert len((out / "004_drift_unfinished.csv").read_text().splitlines()) == 2 + 900
    assert (out / "bag").is_dir()
    assert (out / "report.html").is_file()
    assert yaml.safe_load((out / "estimates.yaml").read_text())["drift"]["verdict"] == "LuGre"
    port = clients[0].port
    assert isinstance(port, VirtualPort)
    port.emulated.advance(0.04)  # for the stop to arrive; the watchdog waits for 120 ms
    assert not port.emulated.board.stage_on


@pytest.mark.parametrize(
    ("torques", "rate", "reason", "shown"),
    [
        ("tau_c: 20.0, tau_s: 25.0", 6.0, "no break-away up to 5.4 Nm", "it has not broken away"),
        ("tau_c: 0.02, tau_s: 0.02", 0.1, "leaves no codes for small cycles", "it bends by"),
    ],
)
def test_a_joint_beyond_the_rigs_codes_gets_a_report_that_says_so(
    torques: str, rate: float, reason: str, shown: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Where the motor cannot break the joint away, or a code does, page and estimates say so; the exit code is 1."""
    monkeypatch.setattr("friction_bench.presliding.job.RATES", (rate,))
    file, out = rig_file(tmp_path, "LuGre"), tmp_path / "run"
    text = file.read_text()
    assert text.count("tau_c: 2.0, tau_s: 2.5") == 1
    file.write_text(text.replace("tau_c: 2.0, tau_s: 2.5", torques))
    assert run("friction_presliding", ["--rig", str(file), "--kinds", "drift", "--output", str(out)]) == 1
    found = yaml.safe_load((out / "estimates.yaml").read_text())
    assert reason in found["not_used"][0]
    assert ("presliding_counts" in found["resolution"]) is (shown == "it bends by")
    page = (out / "report.html").read_text()
    assert reason in page
    assert shown in page
