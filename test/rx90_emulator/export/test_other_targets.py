"""Files for other simulators, read back by parsers that are not this project's, or by what their documentation says."""

from __future__ import annotations

import re
import sys
import xml.etree.ElementTree as ET
from collections.abc import Callable
from pathlib import Path
from types import ModuleType, SimpleNamespace

import numpy as np
import pinocchio as pin
import pytest
import yaml

import rx90_emulator as rx
from benchmarks.any_arm import write_arm
from rx90_emulator.export.targets import TARGETS
from rx90_emulator.loop.setup import Setup


def one_file(setup: Setup, target: str) -> str:
    """Return the text of the file that a target gets."""
    (text,) = rx.export_robot(setup, target).files.values()
    return text


@pytest.fixture(scope="module", params=["rx90b", "panda"])
def robot(request: pytest.FixtureRequest) -> Setup:
    """Return arms of six joints, two of which share an element, and of seven."""
    return rx.load_setup(robot=request.param)


def test_pinocchio_reads_friction_from_the_urdf(robot: Setup) -> None:
    """Its damping and friction are those of the fit, its arm that of the setup."""
    export = rx.export_robot(robot, "urdf")
    model = pin.buildModelFromXML(one_file(robot, "urdf"))
    assert model.damping == pytest.approx([fit.law.viscous[0] for fit in export.fits], rel=1e-12)
    assert model.friction == pytest.approx([fit.law.tau_c for fit in export.fits], rel=1e-12)
    ours = robot.robot.model
    q = np.linspace(-0.8, 1.1, ours.nq)
    assert pin.crba(model, model.createData(), q) == pytest.approx(pin.crba(ours, ours.createData(), q))


def placed_frame(model: ET.Element, placed: Callable[[str], pin.SE3], name: str) -> pin.SE3:
    """Return where a frame is that is attached to a link or to another frame."""
    frame = next((one for one in model.findall("frame") if one.get("name") == name), None)
    if frame is None:
        return placed(name)
    x = np.array([float(word) for word in frame.findtext("pose", "").split()])
    return placed_frame(model, placed, frame.get("attached_to", "")) * pin.SE3(pin.rpy.rpyToMatrix(x[3:]), x[:3])


def test_sdf_has_the_same_chain(robot: Setup) -> None:
    """Poses composed as SDF says, relative to what they name, put links and axes where Pinocchio has them."""
    model = ET.fromstring(one_file(robot, "sdf"))[0]
    poses = {one.get("name", ""): one.find("pose") for one in model if one.get("name")}

    def placed(name: str) -> pin.SE3:
        pose = poses[name]
        if pose is None:
            return pin.SE3.Identity()
        x = np.array([float(word) for word in (pose.text or "0 0 0 0 0 0").split()])
        above = placed(pose.get("relative_to", ""))
        return above * pin.SE3(pin.rpy.rpyToMatrix(x[3:]), x[:3])

    ours = robot.robot.model
    data = ours.createData()
    pin.framesForwardKinematics(ours, data, np.zeros(ours.nq))
    for k, name in enumerate(robot.robot.joint_names):
        joint = next(one for one in model.findall("joint") if one.get("name") == name)
        assert placed(joint.findtext("child", "")).translation == pytest.approx(data.oMi[k + 1].translation)
        axis = placed(name).rotation @ [float(word) for word in joint.findtext("axis/xyz", "").split()]
        assert axis == pytest.approx(robot.robot.chain.axis[k])
    tcp = robot.robot.tcp_frame
    there = data.oMf[ours.getFrameId(tcp)].homogeneous
    assert placed_frame(model, placed, tcp).homogeneous == pytest.approx(there, abs=1e-12)
    mass = sum(float(one.text or 0) for one in model.iter("mass"))
    assert mass == pytest.approx(pin.computeTotalMass(ours) + ours.inertias[0].mass)


@pytest.fixture
def isaac(monkeypatch: pytest.MonkeyPatch) -> None:
    """Replace Isaac Lab's class."""
    package, actuators = ModuleType("isaaclab"), ModuleType("isaaclab.actuators")
    actuators.ImplicitActuatorCfg = SimpleNamespace  # type: ignore[attr-defined]
    monkeypatch.setitem(sys.modules, "isaaclab", package)
    monkeypatch.setitem(sys.modules, "isaaclab.actuators", actuators)


@pytest.mark.usefixtures("isaac")
def test_the_module_for_isaac_lab_runs(shipped: Setup) -> None:
    """It gives break-away, sliding and viscous friction for each joint by its name."""
    export, found = rx.export_robot(shipped, "isaaclab"), {}
    exec(one_file(shipped, "isaaclab"), found)
    config = found["RX90B_ACTUATORS"]
    for fit in export.fits:
        got = [values[fit.name] for values in (config.friction, config.dynamic_friction, config.viscous_friction)]
        assert got == [fit.law.tau_s, fit.law.tau_c, fit.law.viscous[0]]
    assert config.armature["joint_5"] == pytest.approx(shipped.drives.rotor_matrix[4, 4])


HOSTILE = """x\"\"\"; raise SystemExit('hostile') # \\ & ' {{ 7 * 7 }} ]]> --> <i/>\U0001f980"""


@pytest.mark.usefixtures("isaac")
@pytest.mark.parametrize("target", TARGETS)
def test_names_are_quoted_for_the_language_that_they_go_into(target: str, tmp_path: Path) -> None:
    """No name of a robot, a link or a joint is code in any file, and each is read back as it was."""
    folder = write_arm(tmp_path / "arm", 2)
    file = folder / "robot.urdf"
    root = ET.fromstring(file.read_text(encoding="utf-8"))
    names = {root.get("name", ""): HOSTILE, "arm_1": f"joint {HOSTILE}"}
    for element in root.iter():
        element.set("name", names.get(element.get("name", ""), element.get("name", "")))
    file.write_text(ET.tostring(root, encoding="unicode"), encoding="utf-8")
    friction = yaml.safe_load((folder / "friction.yaml").read_text(encoding="utf-8"))
    friction["elements"] = {names.get(name, name): values for name, values in friction["elements"].items()}
    (folder / "friction.yaml").write_text(yaml.safe_dump(friction), encoding="utf-8")
    export = rx.export_robot(rx.load_setup(robot=folder), target)
    ((name, text),) = export.files.items()
    assert "/" not in name
    if target == "isaaclab":
        module: dict[str, object] = {}
        exec(text, module)
        assert HOSTILE in str(module["__doc__"])
        (config,) = (value for key, value in module.items() if key.endswith("ACTUATORS"))
        first, _ = config.friction  # type: ignore[attr-defined]
        assert re.fullmatch(first, names["arm_1"])
    else:
        read = ET.fromstring(text)
        assert {names["arm_1"]} <= {element.get("name", "") for element in read.iter()}
