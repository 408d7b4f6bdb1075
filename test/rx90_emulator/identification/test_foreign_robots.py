"""Bags of other robots through the command: single joint, three joints on motors, coupled wrist."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
import pytest
import yaml
from foreign_arms import Curve, Program, drive_torque, micro_oscillation, write, write_fallback, write_urdf

from rx90_common.base.errors import DONE
from rx90_common.friction.friction_file import FrictionFile
from rx90_emulator.cli.frame import run

pytestmark = pytest.mark.slow

CURVE = Curve(6.0, 5.5, 7.8, 7.0, 0.05, 1.2, 2.5)
SPEEDS = np.geomspace(0.006, 1.2, 9).tolist()
POSES = ([0.2, 0.5, 0.1], [-0.9, -0.7, 1.2])
GEAR, CONSTANT = np.array([100.0, -80.0, 50.0]), np.array([0.12, 0.1, 0.05])
ZERO = np.array([np.pi / 2, -0.4, 0.1])
ENCODER = 2.0 * np.pi / 2**20
C0, C1 = 2e4, 25.0


def identified(arguments: Sequence[object], output: Path, capsys: pytest.CaptureFixture[str]) -> dict[str, Any]:
    code = run("rx90 identify", [*map(str, arguments), "--output", str(output)])
    assert code == DONE, capsys.readouterr().err
    file = FrictionFile.read(output)
    parameters: dict[str, Any] = file.identification["parameters"]
    for element, values in parameters.items():
        for name, entry in values.items():
            assert file.elements[element].parameters[name] == entry["value"], (element, name)
    return parameters


def signal_map(folder: Path, **keys: object) -> list[object]:
    file = folder / "signals.yaml"
    file.write_text(yaml.safe_dump(keys), encoding="utf-8")
    return ["--signals", file]


def assert_found(found: dict[str, Any], curve: Curve) -> None:
    for name, truth in vars(curve).items():
        entry = found[name]
        assert entry["provenance"] == "identified", name
        assert abs(entry["value"] / truth - 1.0) < 0.02, (name, entry)
        assert abs(entry["value"] - truth) < 3.5 * entry["deviation"], (name, entry)


def measured(torque: np.ndarray[Any, Any], seed: int) -> np.ndarray[Any, Any]:
    rng = np.random.default_rng(seed)
    return np.asarray(torque + 3e-3 * torque.std(axis=0) * rng.normal(size=torque.shape))


def test_a_single_joint_in_bags_of_ros_1(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """A turning joint without limits and without velocities, in ROS 1 bags, gives all nine parameters."""
    urdf = write_urdf(tmp_path, ["hinge"], ["0 0 1"], [4.0], "continuous")
    model = pin.buildModelFromXML(urdf.read_text(encoding="utf-8"))
    motion = Program([[1.0]], [[0.3]], SPEEDS, 250.0).motion()
    torque = measured(drive_torque(model, np.eye(1), [CURVE], motion, 250.0), 1)
    position = np.round(motion[0] / ENCODER) * ENCODER
    write(tmp_path / "sweeps.bag", "/hinge/state", ["hinge"], 250.0, (position, None, torque), "ros1")
    inertia = float(pin.crba(model, model.createData(), pin.neutral(model))[0, 0])
    x, _, u = (column[:, None] for column in micro_oscillation(inertia, CURVE, C0, C1, 1000.0))
    rows = np.round(x / ENCODER) * ENCODER, None, measured(u, 1)
    write(tmp_path / "micro.bag", "/hinge/state", ["hinge"], 1000.0, rows, "ros1")
    bags = ["sliding", tmp_path / "sweeps.bag", "--presliding", tmp_path / "micro.bag"]
    # Each torque is that of its stamp, not the mean of the period before it.
    robot = ["--urdf", urdf, "--topic", "hinge/state", *signal_map(tmp_path, torque_delay=0.0005)]
    found = identified([*bags, *robot], tmp_path / "f.yaml", capsys)["hinge"]
    assert_found(found, CURVE)
    assert abs(found["c0"]["value"] / C0 - 1.0) < 0.02
    assert abs(found["c1"]["value"] / C1 - 1.0) < 0.05


def test_currents_of_motors_among_other_joints(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Motor angles from other zeros and currents at 100 Hz, among others, give friction that another bag confirms."""
    names = ["shoulder", "elbow", "twist"]
    urdf = write_urdf(tmp_path, names, ["0 1 0", "0 1 0", "1 0 0"], [5.0, 3.0, 1.0])
    model = pin.buildModelFromXML(urdf.read_text(encoding="utf-8"))
    curves = [CURVE.scaled(3.0), CURVE.scaled(1.5), CURVE.scaled(0.5)]
    run = Program([[1.0, 0.7, -0.5]], [[-0.4, 0.1, 0.6]], [0.15, 0.6], 100.0)
    for bag, program in (("sweeps", Program(np.eye(3).tolist(), POSES, SPEEDS, 100.0)), ("run", run)):
        motion = program.motion()
        current = measured(drive_torque(model, np.eye(3), curves, motion, 100.0), 3) / GEAR / CONSTANT
        q, v, i = (np.column_stack([np.full(len(values), 7.0), values[:, [2, 0, 1]]])
                   for values in ((motion[0] + ZERO) * GEAR, motion[1] * GEAR, current))  # fmt: skip
        write(tmp_path / bag, "/arm/motors", ["gripper", "m3", "m1", "m2"], 100.0, (q, v, i), "sqlite3")
    robot = ["--urdf", urdf, "--topic", "arm/motors", "--joints", *names]
    robot += signal_map(tmp_path, names=["m1", "m2", "m3"])
    motors = ["--gear", *GEAR, "--torque-constant", *CONSTANT, "--fallback", write_fallback(tmp_path / "g.yaml", names)]
    bags = ["sliding", tmp_path / "sweeps", "--validation", tmp_path / "run", "--zero", *ZERO]
    found = identified([*bags, *robot, *motors], tmp_path / "f.yaml", capsys)
    for name, curve in zip(names, curves, strict=True):
        assert_found(found[name], curve)
        assert found[name]["c0"] | {"date": ""} == {
            "provenance": "assumed", "value": 12345.0, "identifiable": False, "bags": [], "date": "",
            "reason": "no bag with micro-oscillations was given", "taken_from": str(tmp_path / "g.yaml"),
        }  # fmt: skip
    assert 'class="assumed">assumed' in (tmp_path / "f.html").read_text(encoding="utf-8")


@pytest.mark.parametrize("side", ["motors", "joints"])
def test_a_coupled_wrist(tmp_path: Path, capsys: pytest.CaptureFixture[str], side: str) -> None:
    """Three elements on two joints come apart, from the motors' side and from the joints', stamped by the recorder."""
    names = ["tilt", "roll"]
    urdf = write_urdf(tmp_path, names, ["0 1 0", "1 0 0"], [3.0, 1.0])
    model = pin.buildModelFromXML(urdf.read_text(encoding="utf-8"))
    coupling = np.array([[1.0, 0.0], [-1.0, 1.0]])
    matrix = np.vstack([np.eye(2), [-1.0, 1.0]])
    directions = [[1.0, 0.0], [0.0, 1.0], [1.0, 1.0], [0.5, -0.5]]
    motion = Program(directions, [pose[1:] for pose in POSES], SPEEDS, 100.0).motion()
    curves = [CURVE, CURVE.scaled(0.5), Curve(2.0, 2.0, 2.6, 2.7, 0.08, 1.0, 0.6)]
    torque = measured(drive_torque(model, matrix, curves, motion, 100.0), 4)
    fields, options = (*motion, torque), signal_map(tmp_path, coupling=[1, 0, -1, 1], record_time=side == "joints")
    if side == "motors":
        turns = GEAR[:2, None] * coupling
        fields = motion[0] @ turns.T, motion[1] @ turns.T, np.linalg.solve(turns.T, torque.T).T / CONSTANT[:2]
        options += ["--gear", *GEAR[:2], "--torque-constant", *CONSTANT[:2]]
    elements = [*names, "-tilt+roll"]
    write(tmp_path / "bag", "/wrist", names, 100.0, fields, header=side == "motors")
    options += ["--fallback", write_fallback(tmp_path / "g.yaml", elements), "--urdf", urdf, "--topic", "wrist"]
    found = identified(["sliding", tmp_path / "bag", *options], tmp_path / "f.yaml", capsys)
    for name, curve in zip(elements, curves, strict=True):
        assert_found(found[name], curve)
