"""Excitation runs of an arm of which only the URDF is known: limits by Pinocchio, files by SciPy, refusals."""

from __future__ import annotations

import io
from contextlib import redirect_stdout
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest
import yaml
from grip_arm import JOINTS, write_urdf
from numpy.typing import NDArray
from scipy.interpolate import BPoly

from rx90_common.base.errors import DONE, REFUSED
from rx90_emulator.cli.frame import run

pytestmark = pytest.mark.slow

Array = NDArray[np.float64]
ARM = ["--joints", *JOINTS]
SHORT = ["--quick", "--period", "6"]
SHARE = 0.8


def _plan(*words: str) -> int:
    return run("rx90 experiment excitation any", words)


@pytest.fixture(scope="module")
def urdf(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return the description of an arm of seven joints with a gripper."""
    return write_urdf(tmp_path_factory.mktemp("arm"), continuous=True)


@pytest.fixture(scope="module")
def motions(urdf: Path) -> Path:
    """Return the folder of a short plan's files."""
    folder = urdf.parent / "motions"
    with redirect_stdout(io.StringIO()) as said:
        assert _plan("--urdf", str(urdf), *ARM, *SHORT, "--output", str(folder), "--rate", "250") == DONE
    (folder / "said.txt").write_text(said.getvalue(), encoding="utf-8")
    return folder


def _held(urdf: Path) -> pin.Model:
    """Return Pinocchio's model of the seven joints, the others held at 0."""
    model = pin.buildModelFromUrdf(str(urdf))
    others = [k for k, name in enumerate(model.names) if k and name not in JOINTS]
    return pin.buildReducedModel(model, others, pin.neutral(model))


def _knots(file: Path) -> tuple[list[str], Array, Array]:
    """Return names, times and knots, shape (n, 3, joints), of a trajectory file, by PyYAML."""
    content = yaml.safe_load(file.read_text(encoding="utf-8"))
    points = content["points"]
    times = [one["time_from_start"]["sec"] + 1e-9 * one["time_from_start"]["nanosec"] for one in points]
    knots = [[one[key] for key in ("positions", "velocities", "accelerations")] for one in points]
    return content["joint_names"], np.array(times), np.array(knots)


@pytest.mark.parametrize("name", ["excitation_1", "validation"])
def test_a_motion_keeps_the_limits_of_the_urdf(urdf: Path, motions: Path, name: str) -> None:
    """Ranges, 80 % of speeds, these in 0.5 s as accelerations, and efforts by Pinocchio's inverse dynamics are kept."""
    names, times, knots = _knots(motions / f"{name}.yaml")
    assert tuple(names) == JOINTS
    model = _held(urdf)
    limits = [model.joints[k].idx_q for k in range(1, 8)]
    low, high = (np.append(one[limits[:6]], end) for one, end in (
        (model.lowerPositionLimit, -np.pi), (model.upperPositionLimit, np.pi)))  # fmt: skip
    at = np.arange(0.0, times[-1], 5e-3)
    curve = BPoly.from_derivatives(times, list(knots))
    q, v, a = (curve(at, nu=order) for order in range(3))
    assert np.all((low <= q) & (q <= high))
    speed = model.velocityLimit[:7]
    shares = [np.abs(v / speed), np.abs(a / (speed / 0.5))]
    data = model.createData()
    torque = [
        pin.rnea(model, data, np.concatenate([row[:6], [np.cos(row[6]), np.sin(row[6])]]), *rest)
        for row, *rest in zip(q, v, a, strict=True)
    ]
    shares.append(np.abs(np.array(torque) / model.effortLimit[:7]))
    assert np.max(shares) <= SHARE * 1.001
    assert np.max(shares) > (0.7 if name == "excitation_1" else 0.4)  # the validation is not optimised
    home = 0.5 * (low + high)
    np.testing.assert_allclose(
        knots[[0, -1]], np.stack([home, np.zeros(7), np.zeros(7)])[None].repeat(2, 0), atol=1e-12
    )


def test_the_table_of_set_points_is_the_trajectory(motions: Path) -> None:
    """Each row of the CSV is SciPy's quintic through the knots of the YAML, at 250 Hz, in named columns."""
    file = motions / "excitation_1.csv"
    head = file.read_text().splitlines()[0].split(",")
    rows = np.loadtxt(file, delimiter=",", skiprows=1)
    names, times, knots = _knots(motions / "excitation_1.yaml")
    quantities = ("position [rad]", "velocity [rad/s]", "acceleration [rad/s^2]")
    assert head == ["time [s]", *(f"{name} {what}" for what in quantities for name in names)]
    curve = BPoly.from_derivatives(times, list(knots))
    np.testing.assert_allclose(rows[:, 0], np.arange(len(rows)) / 250.0, atol=1e-9)
    assert times[-1] - rows[-1, 0] < 1.0 / 250.0
    inside = rows[:, 0] < times[-1]
    for order in range(3):
        there = curve(rows[inside, 0], nu=order)
        np.testing.assert_allclose(rows[inside, 1 + 7 * order : 8 + 7 * order], there, rtol=1e-6, atol=1e-7)


@pytest.mark.parametrize(
    ("words", "change", "said"),
    [
        ([], (), "accepted: revolute and continuous joints with a drive of their own, --joints"),
        ([*ARM, "--home", *["0"] * 7], (), "home: arm_4 is 0 rad; accepted: [-3.1, -0.07]"),
        ([*ARM, "--keep-above", "1.5"], (), "even of a small one tip to --keep-above 1.5 is too near; accepted: walls"),
        (ARM, ('effort="90"', 'effort="0"'), "joint 'arm_1' limit effort is 0.0; accepted: a number > 0 Nm"),
    ],
)
def test_what_does_not_fit_the_arm_is_refused(
    urdf: Path, tmp_path: Path, words: list[str], change: tuple[str, ...], said: str, capsys: pytest.CaptureFixture[str]
) -> None:
    """Options, and limits that plan nothing, are one line with the value and what is accepted, and exit code 2."""
    file = tmp_path / "arm.urdf"
    file.write_text(urdf.read_text(encoding="utf-8").replace(*change) if change else urdf.read_text(encoding="utf-8"))
    assert _plan("--urdf", str(file), *SHORT, *words) == REFUSED
    error = capsys.readouterr().err.strip().splitlines()
    assert len(error) == 1
    assert said in error[0]
