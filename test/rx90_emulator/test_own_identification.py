"""What an identification of one's own is built on: regressor, covariance of base parameters, torques by given files."""

from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest
from foreign_arms import urdf_text

import rx90_emulator as rx

NAMES = ["shoulder", "elbow"]


@pytest.fixture(scope="module")
def urdf(tmp_path_factory: pytest.TempPathFactory) -> Path:
    file = tmp_path_factory.mktemp("arm") / "arm.urdf"
    file.write_text(urdf_text(NAMES, ["0 1 0", "0 1 0"], [5.0, 3.0]), encoding="utf-8")
    return file


def swing() -> tuple[np.ndarray, ...]:
    time = np.arange(0.0, 4.0, 0.002)
    angle = np.array([1.1, 1.7]) * time[:, None]
    return time, np.sin(angle), np.array([1.1, 1.7]) * np.cos(angle), -(np.array([1.1, 1.7]) ** 2) * np.sin(angle)


def pinocchio_torque(urdf: Path, motion: tuple[np.ndarray, ...]) -> np.ndarray:
    model = pin.buildModelFromXML(urdf.read_text(encoding="utf-8"))
    data = model.createData()
    return np.array([pin.rnea(model, data, *row) for row in zip(*motion, strict=True)])


def test_the_regressor_times_the_described_values_is_the_torque(urdf: Path) -> None:
    """Columns times base parameters of the description are Pinocchio's torque, and every column tells something new."""
    _, *motion = swing()
    found = rx.regressor(rx.RigidArm.from_urdf(urdf), *motion)
    torque = pinocchio_torque(urdf, tuple(motion))
    np.testing.assert_allclose(found.values @ found.described, torque, atol=1e-4 * np.abs(torque).max())
    assert found.values.shape == (len(torque), 2, len(found.base.names))
    assert np.linalg.matrix_rank(found.values.reshape(-1, len(found.base.names))) == len(found.base.names)


def test_torques_are_those_of_arm_and_friction(urdf: Path) -> None:
    """Where both joints slide: Pinocchio's torque, tau_c and c2 v of the file, and what its `joints` state."""
    values = {"omega_s": 0.1, "delta": 1.0, "c0": 1e6, "c1": 0.0}
    element = rx.FrictionElement(tau_c=3.0, tau_s=3.0, c2=2.0, **values)
    time, *motion = swing()
    beside = {"elbow": {"offset": 1.5, "rotor_inertia": 0.2}}
    file, robot = rx.FrictionFile(elements=dict.fromkeys(NAMES, element), joints=beside), rx.RobotOptions(urdf=urdf)
    found = rx.predict_torque(file, time, *motion, robot=robot)
    slides = (np.abs(motion[1]) > 0.1) & (time > 0.1)[:, None]
    expected = pinocchio_torque(urdf, tuple(motion)) + 3.0 * np.sign(motion[1]) + 2.0 * motion[1]
    expected[:, 1] += 1.5 + 0.2 * motion[2][:, 1]
    np.testing.assert_allclose(found[slides], expected[slides], atol=0.01)
    differences = rx.predict_torque(file, time, motion[0], robot=robot)
    np.testing.assert_allclose(differences[10:-10][slides[10:-10]], expected[10:-10][slides[10:-10]], atol=0.05)


def test_what_does_not_fit_is_refused(urdf: Path) -> None:
    """Arrays of another shape and times that do not increase are one line each."""
    time, position, *_ = swing()
    wide = np.zeros((2000, 3))
    for times, positions, message in ((time, wide, r"\(2000, 3\); accepted"), (0.0 * time, position, "three or more")):
        with pytest.raises(rx.Rx90Error, match=message):
            rx.predict_torque("robots/tx40/friction.yaml", times, positions, robot=rx.RobotOptions(urdf=urdf))
    with pytest.raises(rx.Rx90Error, match=r"position has shape \(2000, 3\); accepted: \(m, 2\)"):
        rx.regressor(rx.RigidArm.from_urdf(urdf), wide, wide, wide)
