"""`rx90_identify --excitation` with known payloads, a prior, and recorded set-points: what is written, and refusals."""

from __future__ import annotations

import re
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest
import yaml
from excitation_arms import plain_arm, rigid_arm, runs_of, truth
from foreign_arms import Curve, drive_torque, urdf_text, write

import rx90_emulator as rx
from benchmarks.excitation_runs import Disturbances
from rx90_common.base.errors import REFUSED, ConfigError, IdentificationError
from rx90_common.report import page
from rx90_emulator.cli.frame import run
from rx90_emulator.identification.excitation import instruments
from rx90_emulator.identification.excitation.filtering import Bandwidths
from rx90_emulator.identification.excitation.friction import identify_friction_parts
from rx90_emulator.identification.excitation.identify import identify_excitation
from rx90_emulator.identification.excitation.instruments import check_closed_loop
from rx90_emulator.identification.excitation.payload import payloads_of, read_payloads
from rx90_emulator.identification.excitation.problem import ExcitationProblem
from rx90_emulator.identification.excitation.result import base_parameters
from rx90_emulator.identification.output.robot_files import torque_constants

RATE = 100.0
NAMES = ["shoulder", "elbow"]
CURVES = [Curve(8.0, 8.0, 8.0, 8.0, 0.1, 1.0, 5.0), Curve(3.0, 3.0, 3.0, 3.0, 0.1, 1.0, 2.0)]
FACTOR = np.array([1.12, 0.93])  # true over recorded torque
BODY = "{mass: 4.0, centre: [0.02, -0.03, 0.3], inertia: [0.03, 0.001, 0.0, 0.03, 0.0, 0.02]}"


@dataclass
class Scales:
    """Two joints whose recorded torques are off by known factors, and their bags with and without a payload."""

    folder: Path

    def identify(self, *words: object) -> int:
        """Run the command on the arm's bags `bare` and `loaded`."""
        bags = [str(self.folder / name) for name in ("bare", "loaded")]
        given = ["--urdf", self.folder / "arm.urdf", "--excitation", *bags, *words]
        return run("rx90_identify", [str(word) for word in given])


@pytest.fixture(scope="module")
def scales(tmp_path_factory: pytest.TempPathFactory) -> Scales:
    """Return the arm and two bags of the same motion, the second with a body of 4 kg."""
    folder = tmp_path_factory.mktemp("scales")
    text = urdf_text(NAMES, ["0 1 0", "0 1 0"], [5.0, 3.0])
    (folder / "arm.urdf").write_text(text, encoding="utf-8")
    (folder / "payload.yaml").write_text(f"loaded: {BODY}\n", encoding="utf-8")
    body = pin.Inertia(
        4.0, np.array([0.02, -0.03, 0.3]), np.array([[0.03, 1e-3, 0.0], [1e-3, 0.03, 0.0], [0.0, 0.0, 0.02]])
    )
    time = np.arange(0.0, 14.0, 1.0 / RATE)[:, None]
    for seed, name in enumerate(("bare", "loaded")):
        model, rng = pin.buildModelFromXML(text), np.random.default_rng(seed)
        if name == "loaded":
            model.inertias[2] = model.inertias[2] + body
        rate, phase = 2.0 * np.pi * 0.1 * np.arange(1.0, 6.0), rng.uniform(0.0, 2.0 * np.pi, (2, 5))
        angle = time[:, :, None] * rate + phase
        motion = (0.8 * np.sin(angle) / rate).sum(axis=2), 0.8 * np.cos(angle).sum(axis=2)
        recorded = drive_torque(model, np.eye(2), CURVES, motion, RATE) / FACTOR
        noise = 0.1 * rng.normal(size=recorded.shape)
        write(folder / name, "/joint_states", NAMES, RATE, (*motion, recorded + noise))
    return Scales(folder)


def test_gains_are_told_by_a_known_payload(
    scales: Scales, tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Gains off by 12 and 7 % come out within three deviations; friction and weight are then in true torques.

    A torque constant is multiplied by its gain; values that scale with a gain are no better known than it.
    """
    results = []

    def kept(*arguments: object, **options: object) -> rx.ExcitationIdentification:
        results.append(identify_excitation(*arguments, **options))  # type: ignore[arg-type]
        return results[0]

    monkeypatch.setattr(instruments, "_MAX_ROUNDS", 0)
    monkeypatch.setattr("rx90_emulator.identification.job.identify_excitation", kept)
    folder = tmp_path / "arm"
    for drawn in ("as_svg", "plot_json"):  # the plots are looked at in test_identify_excitation.py
        monkeypatch.setattr(page, drawn, lambda *_: "")
    assert scales.identify("--payload", scales.folder / "payload.yaml", "--output", folder) == 0
    found = yaml.safe_load((folder / "parameters.yaml").read_text(encoding="utf-8"))
    for name, factor, curve in zip(NAMES, FACTOR, CURVES, strict=True):
        gain = found["drive_gains"][name]
        assert gain["deviation"] < 0.02
        assert abs(gain["true_over_recorded"] - factor) < 3.0 * gain["deviation"]
        coulomb = found["friction"][name]["tau_c_positive"]
        assert abs(coulomb["value"] - curve.tau_c_positive) < 3.0 * coulomb["deviation"]
        assert coulomb["deviation"] / coulomb["value"] > 0.5 * gain["deviation"] / factor
    weight = next(entry for entry in found["base_parameters"].values() if entry["group"].startswith("mz_2"))
    assert abs(weight["value"] - 3.0 * 0.2) < 4.0 * weight["deviation"]
    assert "drive gains, true over recorded torque: shoulder 1.1" in capsys.readouterr().out
    assert "Drive gains" in (folder / "report.html").read_text(encoding="utf-8")
    assert torque_constants(results[0]) is None
    motors = replace(results[0].options, gear=[100.0, 50.0], torque_constant=[0.2, 0.1])
    constants = torque_constants(replace(results[0], options=motors))
    assert constants is not None
    assert constants.value == pytest.approx([0.2, 0.1] * FACTOR, rel=0.02)
    assert constants.provenance == "identified"
    gains = results[0].gains
    assert gains is not None
    half = replace(gains, covariance=np.diag([gains.covariance[0, 0], np.inf]))
    assert "elbow keeps the given gain, whose scale may not fit" in rx.excitation_summary(
        replace(results[0], gains=half)
    )
    assert "given gain" not in rx.excitation_summary(results[0])


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (f"lost: {BODY}", "payload of 'lost': no such run; accepted: each of bare, loaded once"),
        (f"loaded: {BODY}\nbare: {BODY}", "all runs carry the same payload"),
        ("loaded: {mass: 4.0, centre: [0, 0, 0]}", "loaded.inertia is missing; accepted: 6 numbers"),
        (f"loaded: {BODY}".replace("mass", "weight"), "loaded.mass is missing"),
        (f"loaded: {BODY}".replace("4.0", "-4.0"), "loaded.mass is -4.0; accepted: a number > 0"),
        (f"loaded: {BODY}".replace("0.02]", "0.2]"), "payload's principal moments"),
        (f"loaded: {BODY}".replace("0.3]", "-0.3]"), "drive gain of elbow: -"),
    ],
)
def test_payloads_that_cannot_be_are_refused(
    scales: Scales, text: str, message: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Names of no run, bodies that cannot be, and payloads that tell nothing are refused in one line."""
    (tmp_path / "payload.yaml").write_text(text, encoding="utf-8")
    assert scales.identify("--payload", tmp_path / "payload.yaml", "--output", tmp_path / "arm") == REFUSED
    assert re.search(re.escape(message), capsys.readouterr().err.replace("\r", "\n").splitlines()[-1])
    assert not (tmp_path / "arm").exists()


def test_a_payload_is_read_as_the_body_that_it_says(tmp_path: Path) -> None:
    """Six unequal moments stand where Pinocchio has them, by name or path; twice the same bag is refused."""
    file, bags = tmp_path / "payload.yaml", [tmp_path / "bare", tmp_path / "loaded"]
    body = "{mass: 2.0, centre: [0.1, 0.2, 0.3], inertia: [0.05, 0.001, 0.002, 0.06, 0.003, 0.07]}"
    file.write_text(f"{bags[1]}: {body}\n", encoding="utf-8")
    inertia = np.array([[0.05, 0.001, 0.002], [0.001, 0.06, 0.003], [0.002, 0.003, 0.07]])
    expected = pin.Inertia(2.0, np.array([0.1, 0.2, 0.3]), inertia).toDynamicParameters()
    carried = payloads_of(bags, read_payloads(file))
    assert carried[bags[0]] is None
    found = carried[bags[1]]
    assert found is not None
    assert found.parameters() == pytest.approx(expected)
    with pytest.raises(IdentificationError, match="or it is named twice; accepted"):
        payloads_of(bags, {"loaded": found, str(bags[1]): found})
    file.write_text(f"loaded: {body[:-1]}, colour: 1}}\n", encoding="utf-8")
    with pytest.raises(ConfigError, match="colour"):
        read_payloads(file)


@pytest.mark.parametrize("words", [["--payload", "1"], ["--prior", "0.5"], ["--bristles"]], ids=" ".join)
def test_options_of_excitation_runs_are_refused_without(
    scales: Scales, words: list[str], capsys: pytest.CaptureFixture[str]
) -> None:
    """What counts for excitation runs alone is refused with others, not ignored."""
    assert run("rx90_identify", ["--sliding", str(scales.folder / "bare"), "--output", "f.yaml", *words]) == REFUSED
    assert f"{' '.join(words)} without excitation runs" in capsys.readouterr().err.splitlines()[-1]


def test_a_prior_stands_in_for_what_runs_do_not_tell(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Where one joint hardly moves a narrow prior holds its weight at the description's; else it would be named."""
    text = urdf_text(NAMES, ["0 0 1", "0 1 0"], [5.0, 3.0])
    (tmp_path / "arm.urdf").write_text(text, encoding="utf-8")
    time = np.arange(0.0, 12.0, 1.0 / RATE)[:, None]
    rate, size = 2.0 * np.pi * np.array([0.3, 0.2]), np.array([1.0, 0.1])
    motion = size * np.sin(rate * time), size * rate * np.cos(rate * time)
    torque = drive_torque(pin.buildModelFromXML(text), np.eye(2), CURVES, motion, RATE)
    noise = 5.0 * np.random.default_rng(1).normal(size=torque.shape)
    bag = write(tmp_path / "bag", "/joint_states", NAMES, RATE, (*motion, torque + noise))
    monkeypatch.setattr(instruments, "_MAX_ROUNDS", 0)
    held = rx.identify_excitation([bag], rx.RobotOptions(urdf=tmp_path / "arm.urdf"), prior=0.05)
    described = held.problem.base.combination @ held.problem.columns.values()
    k = held.problem.names.index("mx_2")
    estimate = held.base[k].estimate
    assert abs(estimate.value - described[k]) < 3.0 * estimate.deviation < 0.2
    assert "mx_2" not in held.undetermined
    alone = replace(
        held,
        base=base_parameters(
            held.problem, identify_friction_parts(held.problem, ()), held.consistency, held.instruments
        ),
    )
    assert "mx_2" in alone.undetermined
    assert f"not determined by these runs: {', '.join(alone.undetermined)};" in rx.excitation_summary(alone)


def test_instrumental_values_are_written_where_set_points_tell(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Under a loop's noise all values become instrumental and hold the truth; without set-points they stay."""
    arm = plain_arm(1, 2, coupled=True)
    runs = runs_of(arm, 125.0, Disturbances(feedback=1e-3), Bandwidths(37.0, 18.0), (100,), 1)
    problem = ExcitationProblem.of(rigid_arm(arm, tmp_path), runs)
    fitted = identify_friction_parts(problem, ())
    monkeypatch.setattr(instruments, "_MAX_ROUNDS", 2)
    comparison, taken = check_closed_loop(problem, fitted)
    assert comparison.remark.endswith("all values written are by instrumental variables")
    expected = dict(zip(problem.names, truth(problem, arm), strict=False))
    held = [
        abs(taken.fit.value[k] - expected[name]) < 2.5 * taken.fit.deviation[k] for k, name in enumerate(problem.names)
    ]
    assert np.mean(held) > 0.85
    for element, law in zip(taken.elements, arm.friction, strict=True):
        for name, value in (("tau_c_positive", law.coulomb), ("c2", law.c2)):
            assert abs(element.parameters[name].value - value) < 4.0 * element.parameters[name].deviation
    assert taken.predicted == pytest.approx(problem.torque - taken.fit.residual)
    blind = ExcitationProblem.of(rigid_arm(arm, tmp_path), [replace(one, reference=None) for one in runs])
    monkeypatch.setattr(instruments, "_MAX_ROUNDS", 0)
    comparison, same = check_closed_loop(blind, fitted)
    assert same is fitted
    assert comparison.remark.endswith("all values written are by least squares")
