"""From runs with and without a payload to a robot folder whose torques are right: six joints with a coupled wrist."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest
import yaml
from foreign_arms import write

import rx90_emulator as rx
from rx90_common.base.arrays import Array
from rx90_common.base.errors import DONE
from rx90_common.description.rigid_torque import rigid_torque
from rx90_common.report import page
from rx90_emulator.cli.frame import run
from rx90_emulator.identification.excitation import filtering, identify, instruments
from rx90_emulator.loop.setup import Setup

RATE = 80.0
FACTOR = np.array([1.06, 0.94, 1.1, 0.9, 1.2, 0.5])  # true over recorded torque; the last one is hardly a gain
BODY = pin.Inertia(4.0, np.array([0.05, -0.03, 0.12]), np.diag([0.03, 0.02, 0.025]))
PAYLOAD = "loaded: {mass: 4.0, centre: [0.05, -0.03, 0.12], inertia: [0.03, 0, 0, 0.02, 0, 0.025]}"


def motion_of(seed: int) -> tuple[Array, Array, Array]:
    """Return 15 s of five sines in each joint, to 1.5 rad and some rad/s."""
    rng = np.random.default_rng(seed)
    rate, phase = 2.0 * np.pi * np.arange(1, 6) / 15.0 * 2.0, rng.uniform(0.0, 2.0 * np.pi, (6, 5))
    size = rng.uniform(0.5, 1.0, (6, 5)) / np.sqrt(np.arange(1, 6))
    size *= 1.5 / size.sum(axis=1, keepdims=True)
    angle = np.arange(0.0, 15.0, 1.0 / RATE)[:, None, None] * rate + phase
    return (
        (size * np.sin(angle)).sum(axis=2),
        (size * rate * np.cos(angle)).sum(axis=2),
        (-size * rate**2 * np.sin(angle)).sum(axis=2),
    )


def torque_of(setup: Setup, motion: tuple[Array, Array, Array], body: pin.Inertia | None = None) -> Array:
    """Return joint torques, Nm: Pinocchio's with rotors, springs and a body, Coulomb and viscous friction."""
    model, drives = setup.robot.model.copy(), setup.drives
    if body is not None:
        model.inertias[6] = model.inertias[6] + body
    elements = np.vstack([np.eye(6), [0.0, 0.0, 0.0, 0.0, 1.0, 1.0]])
    inputs = motion[1] @ elements.T
    laws = setup.friction.elements
    friction = np.sign(inputs) * [law.tau_c_positive for law in laws] + inputs * [law.c2 for law in laws]
    return np.asarray(rigid_torque(model, drives.rotor_matrix, drives.spring_torque, *motion) + friction @ elements)


def test_a_payload_makes_a_robot_with_true_torques(
    tx40: Setup, tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Torque constants in the folder are the old ones times the gains, and its robot has the torques of a third run.

    A gain of 0.5, which nothing explains, is written with a warning in summary, report and files.
    """
    monkeypatch.setattr(filtering, "_MAX_ROWS", 2000)
    monkeypatch.setattr(identify, "WITHOUT_BRISTLES", ())
    monkeypatch.setattr(instruments, "_MAX_ROUNDS", 0)
    for drawn in ("as_svg", "plot_json"):  # the plots are looked at in test_identify_excitation.py
        monkeypatch.setattr(page, drawn, lambda *_: "")
    turns = tx40.drives.gear[:, None] * np.eye(6)
    turns[5, 4] = tx40.drives.gear[5]
    names = [f"motor_{k}" for k in range(1, 7)]
    for seed, (name, body) in enumerate({"bare": None, "loaded": BODY, "third": None}.items()):
        motion = motion_of(seed)
        motors = np.linalg.solve(turns.T, torque_of(tx40, motion, body).T).T / FACTOR
        motors += 0.01 * motors.std(axis=0) * np.random.default_rng(seed).normal(size=motors.shape)
        write(tmp_path / name, "/motor_states", names, RATE, (motion[0] @ turns.T, motion[1] @ turns.T, motors))
    (tmp_path / "payload.yaml").write_text(PAYLOAD, encoding="utf-8")
    monkeypatch.chdir(tmp_path)
    words = "--robot tx40 --excitation bare loaded --validation third --payload payload.yaml --output arm"
    assert run("rx90_identify", words.split()) == DONE

    found = rx.load_setup(robot="arm")
    assert found.drives.torque_constant == pytest.approx(tx40.drives.torque_constant * FACTOR, rel=0.03)
    third = motion_of(2)
    error = torque_of(found, third) - torque_of(tx40, third)
    assert np.all(error.std(axis=0) < 0.03 * torque_of(tx40, third).std(axis=0))

    warning = "hardly a drive gain: joint_6 0.5"
    assert f"warning: {warning}" in capsys.readouterr().out
    texts = {name: (tmp_path / "arm" / name).read_text(encoding="utf-8") for name in ("report.html", "drives.yaml")}
    assert warning in texts["report.html"]
    assert "joint_6 hardly to be believed" in yaml.safe_load(texts["drives.yaml"])["motor"]["source"]["torque_constant"]
    remarks = yaml.safe_load((tmp_path / "arm" / "parameters.yaml").read_text(encoding="utf-8"))["remarks"]
    assert any(text.startswith(warning) for text in remarks)
