"""`rx90_identify --load-part`: friction that grows with the load, from runs with and without a known payload."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import yaml
from foreign_arms import write
from sine_motions import motion_of

from benchmarks.load_parts import MASS, Experiment, coefficients_of, payload_of, torque_of
from rx90_common.base.arrays import Array
from rx90_common.base.errors import DONE, REFUSED
from rx90_common.friction.friction_file import FrictionFile
from rx90_common.report import page
from rx90_emulator.cli.frame import run
from rx90_emulator.identification.excitation import filtering, identify, instruments
from rx90_emulator.loop.setup import Setup

RATE = 100.0
NAMES = [f"joint_{k}" for k in range(1, 7)]


@pytest.fixture(scope="module")
def runs(tx40: Setup, tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Array]:
    """Return a folder with bags of a TX40, the second and the fourth loaded, and the coefficients; joint 4 has none."""
    folder, coefficients = tmp_path_factory.mktemp("loads"), coefficients_of(0)
    coefficients[3] = 0.0
    rng = np.random.default_rng(1)
    body = payload_of(MASS["tx40"])
    for number in range(4):
        motion = motion_of(number, 15.0, RATE)
        torque = torque_of(tx40, motion, body if number % 2 else None, coefficients)
        torque += 0.005 * torque.std(axis=0) * rng.normal(size=torque.shape)
        write(folder / f"run_{number}", "/joint_states", NAMES, RATE, (motion[0], motion[1], torque))
    inertia = np.asarray(body.inertia)
    known = f"mass: {body.mass}, centre: {body.centre}, inertia: {inertia[np.triu_indices(3)].tolist()}"
    (folder / "payload.yaml").write_text(f"run_1: {{{known}}}\nrun_3: {{{known}}}\n", encoding="utf-8")
    return folder, coefficients


def test_two_payloads_tell_the_load_part(
    runs: tuple[Path, Array],
    tx40: Setup,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """The friction file's load blocks are the true ones within 5 %, where the load varies, and predict the other run.

    The element that has no part gets none, with the reason. Oracle: Pinocchio's torques with friction written out.
    """
    folder, true = runs
    monkeypatch.setattr(filtering, "_MAX_ROWS", 4000)
    monkeypatch.setattr(identify, "WITHOUT_BRISTLES", ())
    monkeypatch.setattr(instruments, "_MAX_ROUNDS", 0)
    for drawn in ("as_svg", "plot_json"):  # the plots are looked at in test_identify_excitation.py
        monkeypatch.setattr(page, drawn, lambda *_: "")
    urdf = folder / "tx40.urdf"
    urdf.write_text(tx40.robot.urdf, encoding="utf-8")
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


def test_no_load_part_is_found_where_there_is_none(tx40: Setup) -> None:
    """Of an arm whose friction does not depend on the load no element gets a part."""
    arm = Experiment(tx40, [motion_of(number, 20.0, 200.0) for number in (3, 4)], MASS["tx40"])
    assert arm.outcome(3, there=False).found.kept == ()


@pytest.mark.parametrize(
    ("words", "message"),
    [
        ("--load-part", "--load-part without --payload; accepted: with --payload FILE"),
        ("--load-part --payload same.yaml", "load parts: all runs carry the same payload"),
    ],
)
def test_load_parts_need_two_payloads(
    words: str,
    message: str,
    runs: tuple[Path, Array],
    tx40: Setup,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
) -> None:
    """Without a payload, or with one and the same in all runs, the command refuses in one line."""
    folder = runs[0]
    (tmp_path / "same.yaml").write_text(
        (folder / "payload.yaml").read_text(encoding="utf-8").splitlines()[0], encoding="utf-8"
    )
    given = words.replace("same.yaml", str(tmp_path / "same.yaml")).split()
    (tmp_path / "tx40.urdf").write_text(tx40.robot.urdf, encoding="utf-8")
    arm = [
        "--urdf",
        str(tmp_path / "tx40.urdf"),
        "--excitation",
        str(folder / "run_1"),
        "--output",
        str(tmp_path / "arm"),
    ]
    assert run("rx90_identify", [*arm, *given]) == REFUSED
    assert message in capsys.readouterr().err
