"""Runs with and without a known payload: drive gains, load parts, robots with true torques, a prior, and refusals."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
import pytest
import yaml
from excitation_arms import all_columns, plain_arm, rigid_arm, runs_of, truth
from foreign_arms import drive_torque, urdf_text, write
from sine_motions import motion_of
from two_joints import CURVES, NAMES, RATE, Bench

import rx90_emulator as rx
from benchmarks.excitation_runs import NOISE
from benchmarks.load_parts import MASS, Experiment, coefficients_of, payload_of, torque_of
from rx90_common.base.arrays import Array
from rx90_common.base.errors import DONE, REFUSED, ConfigError, IdentificationError
from rx90_common.friction.friction_file import FrictionFile
from rx90_emulator.cli.frame import run
from rx90_emulator.identification.arm import RigidArm
from rx90_emulator.identification.excitation import filtering, identify, known_payload
from rx90_emulator.identification.excitation.checks import coulomb_viscous
from rx90_emulator.identification.excitation.choice import Scored
from rx90_emulator.identification.excitation.filtering import Bandwidths, filter_record
from rx90_emulator.identification.excitation.fit import solve
from rx90_emulator.identification.excitation.friction import identify_friction_parts
from rx90_emulator.identification.excitation.identify import identify_excitation
from rx90_emulator.identification.excitation.known_payload import (
    LoadParts,
    beyond_chance,
    drive_gains,
    load_columns,
    transmitted_torques,
    trimmed,
)
from rx90_emulator.identification.excitation.problem import ExcitationProblem, Payload, payloads_of, read_payloads
from rx90_emulator.identification.excitation.result import base_parameters
from rx90_emulator.identification.output.robot_files import torque_constants
from rx90_emulator.identification.records import JointRecord
from rx90_emulator.loop.setup import Setup

FACTOR = np.array([1.12, 0.93])  # true over recorded torque
BODY = "{mass: 4.0, centre: [0.02, -0.03, 0.3], inertia: [0.03, 0.001, 0.0, 0.03, 0.0, 0.02]}"


@pytest.fixture(scope="module")
def scales(tmp_path_factory: pytest.TempPathFactory) -> Bench:
    """Return two joints whose recorded torques are off by known factors, and two bags, one with a body of 4 kg."""
    bench = Bench.make(tmp_path_factory.mktemp("scales"))
    (bench.folder / "payload.yaml").write_text(f"loaded: {BODY}\n", encoding="utf-8")
    inertia = np.array([[0.03, 1e-3, 0.0], [1e-3, 0.03, 0.0], [0.0, 0.0, 0.02]])
    body = pin.Inertia(4.0, np.array([0.02, -0.03, 0.3]), inertia)
    time, rate = np.arange(0.0, 14.0, 1.0 / RATE)[:, None], 2.0 * np.pi * 0.1 * np.arange(1.0, 6.0)
    for seed, (name, carried) in enumerate({"bare": None, "loaded": body}.items()):
        rng = np.random.default_rng(seed)
        angle = time[:, :, None] * rate + rng.uniform(0.0, 2.0 * np.pi, (2, 5))
        motion = (0.8 * np.sin(angle) / rate).sum(axis=2), 0.8 * np.cos(angle).sum(axis=2)
        torque = bench.torque(motion, body=carried) / FACTOR
        bench.write(name, motion, torque + 0.1 * rng.normal(size=torque.shape))
    return bench


def given(scales: Bench, *words: object) -> int:
    """Run the command on the arm's bags `bare` and `loaded`."""
    return scales.identify("--excitation", scales.folder / "bare", scales.folder / "loaded", *words)


@pytest.mark.usefixtures("quick")
def test_gains_are_told_by_a_known_payload(
    scales: Bench, tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Gains off by 12 and 7 % come out within three deviations; friction and weight are then in true torques.

    A torque constant is multiplied by its gain; values that scale with a gain are no better known than it.
    """
    results = []

    def kept(*arguments: object, **options: object) -> rx.ExcitationIdentification:
        results.append(identify_excitation(*arguments, **options))  # type: ignore[arg-type]
        return results[0]

    monkeypatch.setattr("rx90_emulator.identification.job.identify_excitation", kept)
    folder = tmp_path / "arm"
    assert given(scales, "--payload", scales.folder / "payload.yaml", "--output", folder) == 0
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
    (result,) = results
    assert torque_constants(result) is None
    motors = replace(result.options, gear=[100.0, 50.0], torque_constant=[0.2, 0.1])
    constants = torque_constants(replace(result, options=motors))
    assert constants is not None
    assert constants.value == pytest.approx([0.2, 0.1] * FACTOR, rel=0.02)
    assert constants.provenance == "identified"
    assert result.gains is not None
    half = replace(result.gains, covariance=np.diag([result.gains.covariance[0, 0], np.inf]))
    assert "elbow keeps the given gain, whose scale may not fit" in rx.excitation_summary(replace(result, gains=half))
    assert "given gain" not in rx.excitation_summary(result)


@pytest.mark.parametrize(
    ("text", "words", "message"),
    [
        (f"lost: {BODY}", (), "payload of 'lost': no such run; accepted: each of bare, loaded once"),
        (f"loaded: {BODY}\nbare: {BODY}", (), "drive gains: all runs carry the same payload"),
        (f"loaded: {BODY}\nbare: {BODY}", ("--load-part",), "load parts: all runs carry the same payload"),
        ("", ("--load-part",), "--load-part without --payload; accepted: with --payload FILE"),
        (f"loaded: {BODY}".replace("0.02]", "0.2]"), (), "payload's principal moments"),
        (f"loaded: {BODY}".replace("0.3]", "-0.3]"), (), "drive gain of elbow: -"),
    ],
)
def test_payloads_that_cannot_be_are_refused(
    scales: Bench, text: str, words: tuple[str, ...], message: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Names of no run, bodies that cannot be, and payloads that tell nothing are refused in one line."""
    (tmp_path / "payload.yaml").write_text(text, encoding="utf-8")
    file = ["--payload", tmp_path / "payload.yaml"] if text else []
    assert given(scales, *file, *words, "--output", tmp_path / "arm") == REFUSED
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


@pytest.mark.parametrize(
    ("given", "said"),
    [
        ((0.0, (0, 0, 0), np.eye(3)), "payload of 0.0 kg; accepted: a mass above 0"),
        ((1.0, (0, 0), np.eye(3)), "accepted: 3 numbers"),
        ((1.0, (0, 0, 0), np.eye(3) + 0.1 * np.tri(3)), "accepted: a symmetric 3 x 3 matrix"),
        ((1.0, (0, 0, 0), np.diag([1.0, 1.0, 3.0])), "none above the sum of the others"),
    ],
)
def test_a_payload_that_no_body_is_is_refused(given: tuple[Any, ...], said: str) -> None:
    """Mass, centre and inertia are checked where they are given."""
    with pytest.raises(IdentificationError, match=said):
        Payload(*given)


@pytest.mark.parametrize("words", [["--payload", "1"], ["--prior", "0.5"], ["--bristles"]], ids=" ".join)
def test_options_of_excitation_runs_are_refused_without(
    scales: Bench, words: list[str], capsys: pytest.CaptureFixture[str]
) -> None:
    """What counts for excitation runs alone is refused with others, not ignored."""
    assert run("rx90_identify", ["--sliding", str(scales.folder / "bare"), "--output", "f.yaml", *words]) == REFUSED
    assert f"{' '.join(words)} without excitation runs" in capsys.readouterr().err.splitlines()[-1]


@pytest.mark.usefixtures("quick")
def test_a_prior_stands_in_for_what_runs_do_not_tell(tmp_path: Path) -> None:
    """Where one joint hardly moves a narrow prior holds its weight at the description's; else it would be named."""
    text = urdf_text(NAMES, ["0 0 1", "0 1 0"], [5.0, 3.0])
    (tmp_path / "arm.urdf").write_text(text, encoding="utf-8")
    time = np.arange(0.0, 12.0, 1.0 / RATE)[:, None]
    rate, size = 2.0 * np.pi * np.array([0.3, 0.2]), np.array([1.0, 0.1])
    motion = size * np.sin(rate * time), size * rate * np.cos(rate * time)
    torque = drive_torque(pin.buildModelFromXML(text), np.eye(2), CURVES, motion, RATE)
    noise = 5.0 * np.random.default_rng(1).normal(size=torque.shape)
    bag = write(tmp_path / "bag", "/joint_states", NAMES, RATE, (*motion, torque + noise))
    held = rx.identify_excitation([bag], rx.RobotOptions(urdf=tmp_path / "arm.urdf"), prior=0.05)
    described = held.problem.base.combination @ held.problem.columns.values()
    k = held.problem.names.index("mx_2")
    estimate = held.base[k].estimate
    assert abs(estimate.value - described[k]) < 3.0 * estimate.deviation < 0.2
    assert "mx_2" not in held.undetermined
    free = identify_friction_parts(held.problem, ())
    alone = replace(held, base=base_parameters(held.problem, free, held.consistency, held.instruments))
    assert "mx_2" in alone.undetermined
    assert f"not determined by these runs: {', '.join(alone.undetermined)};" in rx.excitation_summary(alone)


def test_a_known_payload_tells_the_drive_gains(tmp_path: Path) -> None:
    """With recorded torques too small or large by a tenth, runs with and without a payload give the true factors.

    The coupled motor's acts on both joints. With them all parameters are the true ones. Torques in a unit 400 times as
    large have 400 times the gains, told just as well, which hardly are a drive's. The same payload in all is refused.
    """
    arm = plain_arm(3, 3, coupled=True)
    payload = Payload(6.0, (0.1, -0.05, 0.15), 0.02 * np.eye(3))
    factor = np.array([1.1, 0.92, 1.05])
    scale = np.linalg.inv(arm.coupling) @ np.diag(1.0 / factor) @ arm.coupling
    rigid, carried = rigid_arm(arm, tmp_path), [None, payload]
    runs = runs_of(arm, 200.0, NOISE, Bandwidths(40.0, 15.0), (1, 2))
    true = ExcitationProblem.of(rigid, runs, carried)
    last = true.columns.torque(runs[1].position, runs[1].velocity, runs[1].acceleration)[:, :, 20:30]
    torques = runs[0].torque, runs[1].torque + last @ payload.parameters()
    recorded = [replace(run, torque=torque @ scale) for run, torque in zip(runs, torques, strict=True)]
    problem = ExcitationProblem.of(rigid, recorded, carried)
    friction = coulomb_viscous(problem)
    gains = drive_gains(problem, friction)
    assert np.all(np.abs(gains.factor - factor) < 3.0 * gains.deviation)
    assert gains.deviation.max() < 0.01
    assert len(gains.implausible) == 0
    again = gains.after(np.array([2.0, 0.5, 1.0]))  # as if these had been multiplied in before
    assert again.factor == pytest.approx(gains.factor * [2.0, 0.5, 1.0])
    assert again.deviation == pytest.approx(gains.deviation * [2.0, 0.5, 1.0])
    other = [replace(run, torque=run.torque / 400.0) for run in recorded]
    scaled = drive_gains(ExcitationProblem.of(rigid, other, carried), friction)
    assert scaled.factor == pytest.approx(400.0 * gains.factor, rel=1e-3)
    assert scaled.deviation.max() > 0.1
    assert scaled.implausible.tolist() == scaled.identified.tolist() == [0, 1, 2]
    corrected = gains.applied(problem)
    columns = all_columns(corrected)
    fit = solve(corrected, columns)
    assert np.mean(np.abs(fit.value - truth(true, arm)) < 2.5 * fit.deviation) > 0.9
    # The gains' own deviations are in those of what scales with them, as where each gain is off by one of them.
    sure = solve(replace(corrected, uncertain=corrected.uncertain[:, :0]), columns)
    scaled_by = [solve(replace(gains, factor=gains.factor + gains.deviation * unit).applied(problem), columns).value
                 for unit in np.eye(3)]  # fmt: skip
    variance = sure.deviation**2 + np.sum((np.array(scaled_by) - fit.value) ** 2, axis=0)
    assert fit.deviation == pytest.approx(np.sqrt(variance), rel=0.25)
    assert np.max(fit.deviation / sure.deviation) > 1.3
    with pytest.raises(IdentificationError, match="the same payload"):
        drive_gains(replace(problem, payloads=(payload, payload)), friction)


def test_a_motor_whose_gain_is_lost_in_noise_keeps_it(tmp_path: Path) -> None:
    """With 40 Nm of noise on the last joint the payload tells the first one's gain alone; the other stays 1."""
    arm = plain_arm(8, 2, coupled=False)
    body = Payload(8.0, (0.1, 0.0, 0.05), 0.02 * np.eye(3))
    rigid, rng = rigid_arm(arm, tmp_path), np.random.default_rng(0)
    runs = runs_of(arm, 100.0, NOISE, Bandwidths(25.0, 10.0), (1, 2), periods=1)
    columns = ExcitationProblem.of(rigid, runs).columns
    load = columns.torque(runs[1].position, runs[1].velocity, runs[1].acceleration)[:, :, 10:20] @ body.parameters()
    recorded = [
        replace(run, torque=(run.torque + more) / 1.1 + rng.normal(size=run.torque.shape) * [0.0, 40.0])
        for run, more in zip(runs, (0.0, load), strict=True)
    ]
    problem = ExcitationProblem.of(rigid, recorded, [None, body])
    gains = drive_gains(problem, coulomb_viscous(problem))
    assert gains.identified.tolist() == [0]
    assert gains.factor == pytest.approx([1.1, 1.0], abs=3.0 * gains.deviation[0])
    assert gains.factor[1] == 1.0
    assert gains.deviation[1] == np.inf


MOTORS = np.array([1.06, 0.94, 1.1, 0.9, 1.2, 0.5])  # true over recorded torque; the last one is hardly a gain
PAYLOAD = "loaded: {mass: 4.0, centre: [0.05, -0.03, 0.12], inertia: [0.03, 0, 0, 0.02, 0, 0.025]}"


@pytest.mark.usefixtures("quick")
def test_a_payload_makes_a_robot_with_true_torques(
    tx40: Setup, tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Torque constants in the folder are the old ones times the gains, and its robot has the torques of a third run.

    A gain of 0.5, which nothing explains, is written with a warning in summary, report and files.
    """
    monkeypatch.setattr(filtering, "_MAX_ROWS", 2000)
    monkeypatch.setattr(identify, "WITHOUT_BRISTLES", ())
    turns = tx40.drives.gear[:, None] * np.eye(6)
    turns[5, 4] = tx40.drives.gear[5]
    names = [f"motor_{k}" for k in range(1, 7)]
    body = Payload(4.0, (0.05, -0.03, 0.12), np.diag([0.03, 0.02, 0.025]))
    none, motions = np.zeros((7, 2)), [motion_of(seed, 15.0, RATE) for seed in range(3)]
    for seed, (name, carried) in enumerate({"bare": None, "loaded": body, "third": None}.items()):
        position, velocity, _ = motions[seed]
        motors = np.linalg.solve(turns.T, torque_of(tx40, motions[seed], carried, none).T).T / MOTORS
        motors += 0.01 * motors.std(axis=0) * np.random.default_rng(seed).normal(size=motors.shape)
        write(tmp_path / name, "/motor_states", names, RATE, (position @ turns.T, velocity @ turns.T, motors))
    (tmp_path / "payload.yaml").write_text(PAYLOAD, encoding="utf-8")
    monkeypatch.chdir(tmp_path)
    words = "--robot tx40 --excitation bare loaded --validation third --payload payload.yaml --output arm"
    assert run("rx90_identify", words.split()) == DONE

    found = rx.load_setup(robot="arm")
    assert found.drives.torque_constant == pytest.approx(tx40.drives.torque_constant * MOTORS, rel=0.03)
    true = torque_of(tx40, motions[2], None, none)
    error = torque_of(found, motions[2], None, none) - true
    assert np.all(error.std(axis=0) < 0.03 * true.std(axis=0))
    said = re.search(r"warning: (hardly a drive gain: joint_6 ([\d.]+))", capsys.readouterr().out)
    assert said is not None
    assert float(said[2]) == pytest.approx(0.5, rel=0.03)
    warning = said[1]
    texts = {name: (tmp_path / "arm" / name).read_text(encoding="utf-8")
             for name in ("report.html", "drives.yaml", "parameters.yaml")}  # fmt: skip
    assert warning in texts["report.html"]
    assert "joint_6 hardly to be believed" in yaml.safe_load(texts["drives.yaml"])["motor"]["source"]["torque_constant"]
    assert any(text.startswith(warning) for text in yaml.safe_load(texts["parameters.yaml"])["remarks"])


@pytest.fixture(scope="module")
def runs(tx40: Setup, tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Array]:
    """Return a folder with bags of a TX40, the second and the fourth loaded, and the coefficients; joint 4 has none."""
    folder, coefficients = tmp_path_factory.mktemp("loads"), coefficients_of(0)
    coefficients[3] = 0.0
    rng, body = np.random.default_rng(1), payload_of(MASS["tx40"])
    for number in range(4):
        motion = motion_of(number, 15.0, RATE)
        torque = torque_of(tx40, motion, body if number % 2 else None, coefficients)
        torque += 0.005 * torque.std(axis=0) * rng.normal(size=torque.shape)
        names = [f"joint_{k}" for k in range(1, 7)]
        write(folder / f"run_{number}", "/joint_states", names, RATE, (motion[0], motion[1], torque))
    moments = np.asarray(body.inertia)[np.triu_indices(3)].tolist()
    known = f"mass: {body.mass}, centre: {body.centre}, inertia: {moments}"
    (folder / "payload.yaml").write_text(f"run_1: {{{known}}}\nrun_3: {{{known}}}\n", encoding="utf-8")
    (folder / "tx40.urdf").write_text(tx40.robot.urdf, encoding="utf-8")
    return folder, coefficients


@pytest.mark.usefixtures("quick")
def test_two_payloads_tell_the_load_part(
    runs: tuple[Path, Array], tx40: Setup, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """The friction file's load blocks are the true ones within 5 %, where the load varies, and predict the other run.

    The element that has no part gets none, with the reason. Oracle: Pinocchio's torques with friction written out.
    """
    folder, true = runs
    monkeypatch.setattr(filtering, "_MAX_ROWS", 4000)
    monkeypatch.setattr(identify, "WITHOUT_BRISTLES", ())
    monkeypatch.chdir(folder)
    rotors = " ".join(f"{value!r}" for value in tx40.drives.rotor_inertia.tolist())
    words = f"--urdf tx40.urdf --coupling 1 0 0 0 0 0 0 1 0 0 0 0 0 0 1 0 0 0 0 0 0 1 0 0 0 0 0 0 1 0 0 0 0 0 1 1 \
        --rotor-inertia {rotors} --excitation run_0 run_1 run_2 --validation run_3 --payload payload.yaml --load-part \
        --output arm"
    assert run("rx90_identify", words.split()) == DONE
    told = capsys.readouterr().out
    elements = list(FrictionFile.read(folder / "arm" / "friction.yaml").elements.values())
    found = yaml.safe_load((folder / "arm" / "parameters.yaml").read_text(encoding="utf-8"))
    known = list(found["friction"].values())
    for e, element in enumerate(elements):
        if element.load is not None:
            deviations = [known[e][f"load.{name}"]["deviation"] for name in ("driving", "driven")]
            assert np.all(np.abs([element.load.driving, element.load.driven] - true[e]) < 4.0 * np.array(deviations))
    for e in (1, 2, 4):  # the others transmit less than their Coulomb torques
        part = elements[e].load
        assert part is not None
        assert [part.driving, part.driven] == pytest.approx(list(true[e]), rel=0.05)
    assert elements[3].load is None
    assert "RMS of the load" in known[3]["load.driving"]["reason"]
    assert next(iter(found["validation"].values()))["relative"] < 0.01
    assert "load.driving" in told
    assert "load parts of joint_" in told


@pytest.mark.parametrize(
    ("skipped", "result"), [("beyond_chance", {}), ("trimmed", None)], ids=["by_prediction", "by_chance"]
)
def test_no_load_part_is_found_where_there_is_none(
    tx40: Setup, monkeypatch: pytest.MonkeyPatch, skipped: str, result: dict[int, str] | None
) -> None:
    """Of an arm whose friction does not depend on the load no element gets a part, by either test alone."""
    monkeypatch.setattr(known_payload, skipped, lambda kept, *_: (tuple(kept), {}, "") if result is None else result)
    arm = Experiment(tx40, [motion_of(number, 20.0, 200.0) for number in (3, 4)], MASS["tx40"])
    assert arm.outcome(3, there=False).found.kept == ()


LOW_RATE = 50.0
COEFFICIENTS = coefficients_of(2)


def problem_of(setup: Setup, coefficients: Array, lead: float = 0.0) -> ExcitationProblem:
    """Return the equations of a bare and a loaded run, whose torques acted `lead` seconds before their stamps."""
    runs, carried = [], (None, payload_of(6.0))
    for number, body in enumerate(carried):
        motion, late = (motion_of(number, 8.0, LOW_RATE, after) for after in (0.0, -lead))
        torque, time = torque_of(setup, late, body, coefficients), np.arange(len(motion[0])) / LOW_RATE
        name = f"run_{number}"
        one = JointRecord(setup.robot.joint_names, time, motion[0], motion[1], torque, Path(name), name)
        runs += filter_record(one, Bandwidths(12.0, 4.0), torque_lead=lead)
    return ExcitationProblem.of(RigidArm.from_setup(setup), runs, carried)


@pytest.fixture(scope="module")
def problem() -> ExcitationProblem:
    """Return the equations of the RX90B, with a spring, rotors and a coupled wrist, and load parts."""
    return problem_of(rx.load_setup(), COEFFICIENTS)


def base_of(problem: ExcitationProblem, **more: float) -> Array:
    """Return the described base parameters, standard parameters being larger by some; by name."""
    values = problem.columns.values().copy()
    for name, value in more.items():
        values[problem.columns.names.index(name)] += value
    return np.asarray(problem.base.combination @ values)


@pytest.mark.parametrize("lead", [0.0, 0.45 / LOW_RATE])
def test_columns_give_the_torque_of_the_load_parts(lead: float) -> None:
    """Also of torques that were recorded between the samples, whose reversals are where these are.

    What the runs tell of rotors and offsets is not transmitted: it may be any.

    Oracle: recorded torques of an arm with load parts less those of one without, through the same filter.
    """
    parted = problem_of(rx.load_setup(), COEFFICIENTS, lead)
    expected = parted.torque - problem_of(rx.load_setup(), np.zeros((7, 2)), lead).torque
    rotors, offsets = ([name for name in parted.columns.names if name.startswith(kind)] for kind in ("Ia", "offset"))
    base = base_of(parted, **dict.fromkeys([*rotors[2:], *offsets], 0.4))
    error = load_columns(parted, transmitted_torques(parted, base)) @ COEFFICIENTS.ravel() - expected
    for joint in range(6):
        rows = parted.joint == joint
        assert np.std(error[rows]) < 0.02 * np.std(expected[rows])


def test_what_is_taken_off_is_uncertain_as_the_coefficients_are(problem: ExcitationProblem) -> None:
    """The rows lose the parts' torque; what is unknown of that has the covariance of the coefficients, carried over."""
    base, spread = base_of(problem), np.random.default_rng(3).normal(size=(4, 4)) * 1e-3
    value = np.zeros((7, 2))
    value[[1, 4]] = COEFFICIENTS[[1, 4]]
    parts = LoadParts(value, (1, 4), spread @ spread.T, base, np.ones(7), ("",) * 7)
    columns = load_columns(problem, transmitted_torques(problem, base))
    without = parts.applied(problem)
    assert problem.torque - without.torque == pytest.approx(columns @ value.ravel(), abs=1e-9)
    some = np.arange(0, len(problem), 97)
    uncertain, own = without.uncertain[some], columns[some][:, [2, 3, 8, 9]]
    assert uncertain @ uncertain.T == pytest.approx(own @ (spread @ spread.T) @ own.T, abs=1e-12)


@pytest.mark.parametrize(
    ("value", "deviation", "reason"),
    [
        ([0.05, 0.08], (0.01, 0.01), None),
        (
            [0.05, 0.001],
            (0.01, 0.06),
            "the runs do not determine it: driving 5 +- 1 % and driven 0.1 +- 6 % of the load",
        ),
        ([0.08, -0.031], (0.01, 0.01), "no load part has these coefficients: driving 8 +- 1 % and driven -3.1 +- 1 %"),
        ([0.96, 0.08], (0.01, 0.01), "no load part has these coefficients: driving 96 +- 1 %"),
        ([0.08, -0.029], (0.01, 0.01), None),
        # chi^2 of 2 degrees of freedom: 1 % of elements without a part are beyond 9.21.
        ([0.03, 0.0], (0.01, 0.01), "no more than chance: driving 3 +- 1 %"),
        ([0.031, 0.0], (0.01, 0.01), None),
    ],
)
def test_a_load_part_is_told_possible_and_beyond_chance(
    value: list[float], deviation: tuple[float, float], reason: str | None
) -> None:
    """Both deviations below 0.05, no share that falls by three deviations or exceeds 0.95, and chi^2 beyond chance."""
    found = beyond_chance([3], np.array(value), np.diag(deviation) ** 2)
    assert list(found) == ([] if reason is None else [3])
    assert reason is None or found[3].startswith(reason)


def test_chance_is_shared_among_the_elements() -> None:
    """Of seven elements each has a seventh of the 1 %: what is beyond chance for one alone is not for seven."""
    assert not beyond_chance([0], np.array([0.033, 0.0]), np.eye(2) * 1e-4)
    assert len(beyond_chance(range(7), np.array([0.033, 0.0] * 7), np.eye(14) * 1e-4)) == 7


def test_the_least_useful_part_goes_first() -> None:
    """Of two elements of which either predicts as well without its part, one keeps it, if both together need one."""
    errors = {(2, 4): 1.0, (4,): 0.998, (2,): 0.999, (): 1.5}  # weighted RMS, by the elements that have a part
    fit: Any = None

    def scored(kept: Sequence[int]) -> Scored:
        return Scored(fit, np.zeros(20), {"blocks": (np.full(20, errors[tuple(kept)] ** 2), 0.0)}, np.ones(20))

    kept, reasons, gain = trimmed((2, 4), scored)
    assert kept == (4,)
    assert list(reasons) == [2]
    assert reasons[2].startswith("with a load part, by blocks the error rises by 0.20 %")
    assert gain.startswith("by blocks the error falls by 33.47 %")
