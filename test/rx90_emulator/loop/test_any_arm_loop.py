"""Closed loops of arms with another number of joints, or another coupling, than the RX family's."""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from any_arm import joint_names, write_arm
from full_friction import PARTS
from numpy.typing import NDArray

from rx90_common.base.errors import ConfigError
from rx90_common.description.coupling import ArmSize, Coupling
from rx90_common.description.drives import LINK, MOTOR, Cogging, CurrentSensor, Elasticity, Windings
from rx90_common.friction import FrictionSet
from rx90_controller.law.model import ModelFiles
from rx90_controller.law.parameters import FeedForward
from rx90_controller.trajectory import TrajectoryPoints
from rx90_emulator.cli.frame import run
from rx90_emulator.loop.closed_loop import simulate
from rx90_emulator.loop.setup import Setup, load_setup

Array = NDArray[np.float64]


def everything(setup: Setup, side: str) -> Setup:
    """Return the setup with all that is off in the shipped files, and encoders so fine that no count is in doubt."""
    stiffness = np.array([1.5e6, 1.5e6, 5e5, 1e5, 6e4, 3e4])
    drives = dataclasses.replace(
        setup.drives,
        encoder_counts=np.full(6, 2.0**30),
        elasticity=Elasticity(stiffness, 2e-4 * stiffness, np.full(6, 1e-4), side),
        cogging=Cogging(np.array([6.0]), np.full((1, 6), 0.02), np.zeros((1, 6))),
        winding=Windings(np.full(6, 2.0), np.full(6, 20.0), np.full(6, 3.0), 25.0, 100.0, derating=100.0, limit=140.0),
        current_sensor=CurrentSensor(np.full(6, 0.01), np.full(6, 0.01), np.zeros(6)),
    )
    elements = tuple(dataclasses.replace(element, **PARTS) for element in setup.friction.elements)
    switches = FeedForward(inverse_dynamics=True, friction_model=True)
    files = setup.files
    assert files is not None
    model = ModelFiles(files.urdf, files.tool, files.drives, files.friction)
    controller = dataclasses.replace(setup.controller, feed_forward=switches, model=model)
    friction = FrictionSet(setup.friction.names, elements)
    return dataclasses.replace(setup, drives=drives, friction=friction, controller=controller)


@pytest.mark.parametrize("side", [MOTOR, LINK])
def test_matrices_give_what_the_wrists_fixed_order_gives(
    shipped: Setup, side: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The shipped arm with everything on is the same, to rounding, by the code for any coupling and by its own."""
    setup = everything(shipped, side)
    rest, pose = np.zeros((2, 6)), np.array([0.0, 0.5, 0.8, 0.0, 0.5, 0.0])
    points = TrajectoryPoints(np.array([0.0, 0.3]), np.stack([pose, pose + 0.05]), rest, rest)
    fixed = simulate(setup, points, duration=0.35)
    monkeypatch.setattr(Coupling, "size", property(lambda _: ArmSize(6, 7, wrist=False)))
    by_matrices = simulate(dataclasses.replace(setup, drives=dataclasses.replace(setup.drives)), points, duration=0.35)
    assert by_matrices.slow.joint_states.tobytes() != fixed.slow.joint_states.tobytes(), "the same code ran twice"
    for name, got, want in zip(fixed.slow._fields, by_matrices.slow, fixed.slow, strict=True):
        scale = np.abs(want).max(axis=0, initial=0.0)
        assert (np.abs(got - want) <= 1e-7 * scale + 1e-10).all(), name


def test_a_folder_of_seven_joints_runs_by_command(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """rx90_config checks the folder, rx90_run follows a trajectory, and the recorded bag compares as measured."""
    folder = write_arm(tmp_path / "arm", 7)
    assert run("rx90_config", ["check", str(folder)]) == 0
    names = ", ".join(joint_names(7))
    points = [(0.0, 0.0), (0.8, 0.4), (1.6, -0.2), (2.4, 0.0)]
    rows = "".join(
        f"- {{positions: {[q] * 7}, velocities: {[0.0] * 7}, time_from_start: {{sec: {int(t)}, "
        f"nanosec: {round(1e9 * (t % 1.0))}}}}}\n"
        for t, q in points
    )
    (tmp_path / "motion.yaml").write_text(f"joint_names: [{names}]\npoints:\n{rows}")
    arguments = ["--robot", str(folder), "--trajectory", str(tmp_path / "motion.yaml")]
    assert run("rx90_run", [*arguments, "--output", str(tmp_path / "bag")]) == 0
    assert run("rx90_compare_measured", [str(tmp_path / "bag"), "--robot", str(folder), "--topic", "joint_states"]) == 0
    assert "arm_7" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"drives.yaml": ("counts_per_revolution: 65536", "counts_per_revolution: 8")}, "[16, 1073741824]"),
        ({"drives.yaml": ("torque_constant: [0.3, 0.3, 0.3]", "torque_constant: [0.3, 0.3]")}, "3 numbers, as many as"),
        ({"controller.yaml": ("kp: [50.0, 50.0, 50.0]", "kp: [50.0, 50.0]")}, "kp is [50.0, 50.0]"),
    ],
    ids=["value", "count", "law"],
)
def test_lists_of_another_length_are_refused(tmp_path: Path, change: dict[str, tuple[str, str]], said: str) -> None:
    """A list with another number of values than joints is one line with file, key and what is accepted."""
    folder = write_arm(tmp_path / "arm", 3)
    for name, (old, new) in change.items():
        text = (folder / name).read_text()
        assert old in text, text
        (folder / name).write_text(text.replace(old, new))
    with pytest.raises(ConfigError) as refused:
        load_setup(robot=folder)
    assert said in str(refused.value)
    assert "\n" not in str(refused.value)


@pytest.mark.parametrize(
    ("turns", "said"),
    [
        ([[1, 0], [1, 0]], "1 in column 1 for a motor that turns with one joint"),
        ([[2, 0], [0, 1]], "1 in column 0"),
        ([[1, 1], [1, 1]], "an invertible matrix"),
        ([[1, 1, 0], [0, 1, 1]], "square, of 1 to 7 rows"),
        ((np.eye(7) + np.eye(7, k=-1)).tolist(), "up to 1, for 8 friction elements in all"),
    ],
)
def test_couplings_that_no_arm_has_are_refused(turns: Any, said: str) -> None:
    """Each refusal names the row or the matrix, and what is accepted."""
    with pytest.raises(ConfigError) as refused:
        Coupling(np.array(turns, np.float64))
    assert said in str(refused.value)
