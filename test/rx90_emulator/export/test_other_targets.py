"""Files for other simulators, read back by parsers that are not this project's, or by what their documentation says."""

from __future__ import annotations

import dataclasses
import json
import math
import re
import sys
import xml.etree.ElementTree as ET
from collections.abc import Callable
from pathlib import Path
from types import ModuleType, SimpleNamespace
from typing import Any

import numpy as np
import pinocchio as pin
import pytest
from pxr import Gf, Usd, UsdGeom, UsdPhysics

import rx90_emulator as rx
from benchmarks.any_arm import write_arm
from rx90_common.base.arrays import Array
from rx90_common.base.errors import ConfigError
from rx90_common.friction.parts.load import LoadPart
from rx90_emulator.loop.setup import Setup

SPEEDS = np.geomspace(1e-3, 4.0, 50)


def one_file(setup: Setup, target: str, suffix: str = "") -> str:
    """Return the text of the file that a target gets, or of that with a suffix."""
    (text,) = [text for name, text in rx.export_robot(setup, target).files.items() if name.endswith(suffix)]
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


@pytest.mark.parametrize("name", ["tx40", "panda"])
def test_usd_core_reads_joints_and_friction(name: str) -> None:
    """The frames of a joint on both of its bodies coincide, and what is per degree comes back to SI units."""
    setup = rx.load_setup(robot=name)
    export = rx.export_robot(setup, "usd")
    (text,) = export.files.values()
    stage = Usd.Stage.CreateInMemory()
    stage.GetRootLayer().ImportFromString(text)
    cache, seen = UsdGeom.XformCache(), 0
    for prim in stage.Traverse():
        if not prim.IsA(UsdPhysics.RevoluteJoint):
            continue
        joint, fit = UsdPhysics.RevoluteJoint(prim), export.fits[seen]
        ends = []
        for body, pos, rot in (
            (joint.GetBody0Rel(), joint.GetLocalPos0Attr(), joint.GetLocalRot0Attr()),
            (joint.GetBody1Rel(), joint.GetLocalPos1Attr(), joint.GetLocalRot1Attr()),
        ):
            world = cache.GetLocalToWorldTransform(stage.GetPrimAtPath(body.GetTargets()[0]))
            local = Gf.Matrix4d().SetRotate(Gf.Quatd(rot.Get())) * Gf.Matrix4d().SetTranslate(Gf.Vec3d(pos.Get()))
            ends.append(np.array(local * world))
        assert ends[0] == pytest.approx(ends[1], abs=1e-6)
        assert ends[0][2, :3] == pytest.approx(setup.robot.chain.axis[seen], abs=1e-6)
        physx = {key: prim.GetAttribute(f"physxJointAxis:angular:{key}").Get() for key in (
            "staticFrictionEffort", "dynamicFrictionEffort", "viscousFrictionCoefficient")}  # fmt: skip
        viscous = physx["viscousFrictionCoefficient"] * 180.0 / math.pi
        assert [physx["staticFrictionEffort"], physx["dynamicFrictionEffort"], viscous] == pytest.approx(
            [fit.law.tau_s, fit.law.tau_c, fit.law.viscous[0]], rel=1e-6
        )
        assert prim.GetAttribute("newton:damping").Get() * 180.0 / math.pi == pytest.approx(
            fit.law.viscous[0], rel=1e-6
        )
        assert joint.GetUpperLimitAttr().Get() == pytest.approx(math.degrees(setup.robot.upper[seen]))
        seen += 1
    assert seen == len(export.fits)


def test_bam_s_formula_gives_the_elements_curve(shipped: Setup) -> None:
    """BAM's `Model.compute_frictions` of model m2, from its source: exact for one sign and exponent 1."""
    for name, text in rx.export_robot(shipped, "bam").files.items():
        p = json.loads(text)
        stribeck = np.exp(-(np.abs(SPEEDS / p["dtheta_stribeck"]) ** p["alpha"]))
        friction = p["friction_base"] + stribeck * p["friction_stribeck"] + p["friction_viscous"] * SPEEDS
        element = shipped.friction[name.removesuffix(".json")]
        assert friction == pytest.approx(element.steady_torque(SPEEDS), rel=1e-12)


def test_the_module_for_isaac_lab_runs(shipped: Setup, monkeypatch: pytest.MonkeyPatch) -> None:
    """With Isaac Lab's class replaced, it gives break-away, sliding and viscous friction for each joint by its name."""
    package, actuators = ModuleType("isaaclab"), ModuleType("isaaclab.actuators")
    actuators.ImplicitActuatorCfg = SimpleNamespace  # type: ignore[attr-defined]
    monkeypatch.setitem(sys.modules, "isaaclab", package)
    monkeypatch.setitem(sys.modules, "isaaclab.actuators", actuators)
    export, found = rx.export_robot(shipped, "isaaclab"), {}
    exec(one_file(shipped, "isaaclab"), found)
    config = found["RX90B_ACTUATORS"]
    for fit in export.fits:
        got = [values[fit.name] for values in (config.friction, config.dynamic_friction, config.viscous_friction)]
        assert got == [fit.law.tau_s, fit.law.tau_c, fit.law.viscous[0]]
    assert config.armature["joint_5"] == pytest.approx(shipped.drives.rotor_matrix[4, 4])


def test_the_module_for_drake_is_the_law(shipped: Setup, monkeypatch: pytest.MonkeyPatch) -> None:
    """With Drake's class replaced, torques of signs, exponents and the coupled element are those of the elements."""
    first = dataclasses.replace(shipped.friction.elements[0], tau_c_negative=20.0, alpha=0.7, delta=1.4)
    friction = dataclasses.replace(shipped.friction, elements=(first, *shipped.friction.elements[1:]))
    setup = dataclasses.replace(shipped, friction=friction)

    class System:
        """What the module needs of a LeafSystem."""

        def __init__(self) -> None:
            self.bristles = np.zeros(7)

        def DeclareVectorInputPort(self, *_: Any) -> Any:  # noqa: N802
            return SimpleNamespace(Eval=lambda state: state)

        def DeclareDiscreteState(self, _: int) -> None:  # noqa: N802
            return None

        def DeclarePeriodicDiscreteUpdateEvent(self, *_: Any) -> None:  # noqa: N802
            return None

        def DeclareVectorOutputPort(self, *_: Any) -> None:  # noqa: N802
            return None

    for name in ("pydrake", "pydrake.systems", "pydrake.systems.framework"):
        monkeypatch.setitem(sys.modules, name, ModuleType(name))
    sys.modules["pydrake.systems.framework"].LeafSystem = System  # type: ignore[attr-defined]
    found: dict[str, Any] = {}
    exec(one_file(setup, "drake", ".py"), found)
    system = found["LuGreFriction"](6, 0.01)

    class Context(np.ndarray[Any, Any]):
        """A state of the plant that also holds the bristles."""

        def get_discrete_state(self, _: None) -> Any:
            return SimpleNamespace(value=lambda: system.bristles)

    def torque(velocity: Array) -> Array:
        context = np.concatenate([np.zeros(6), velocity]).view(Context)
        for _ in range(500):
            system._advance(context, SimpleNamespace(set_value=lambda _, z: setattr(system, "bristles", np.array(z))))
        found: list[Array] = []
        system._torque(context, SimpleNamespace(SetFromVector=found.append))
        return np.asarray(found[0])

    for velocity in (np.array([0.5, -0.3, 0.2, 0.1, 0.4, -0.1]), np.array([-0.5, 0.3, -0.02, 0.0, -0.4, 0.1])):
        each = [
            float(e.steady_torque(v)) for e, v in zip(friction.elements, [*velocity, velocity[4:].sum()], strict=True)
        ]
        expected = np.array(each[:6]) + np.array([0.0, 0.0, 0.0, 0.0, each[6], each[6]])
        assert torque(velocity) == pytest.approx(-expected, rel=1e-9)
        system.bristles = np.zeros(7)


def test_modelica_s_table_interpolates_to_the_curve(shipped: Setup) -> None:
    """Read as text, and interpolated linearly as BearingFriction does, it is the curve from break-away on."""
    text = one_file(shipped, "modelica")
    for name, element in zip(shipped.friction.names, shipped.friction.elements, strict=True):
        (rows,) = re.findall(rf"{name}_tau_pos\[:, 2\] = \[(.*?)\];", text, re.DOTALL)
        table = np.array([[float(x) for x in row.split(",")] for row in rows.split(";")])
        assert table[0].tolist() == [0.0, element.tau_s_positive]
        assert np.interp(SPEEDS[1:-1], *table.T) == pytest.approx(element.steady_torque(SPEEDS[1:-1]), rel=1e-4)


def test_bam_s_load_is_that_of_steady_sliding(shipped: Setup) -> None:
    """BAM's `compute_frictions` of model m5, from its source, solved for sliding under a load: ours."""
    load, element = LoadPart(0.12, 0.12, 0.05, 0.05), shipped.friction.elements[0]
    loaded = dataclasses.replace(element, load=load)
    friction = dataclasses.replace(shipped.friction, elements=(loaded, *shipped.friction.elements[1:]))
    p = json.loads(rx.export_robot(dataclasses.replace(shipped, friction=friction), "bam").files["joint_1.json"])
    assert p["model"] == "m5"
    stribeck = np.exp(-(np.abs(SPEEDS / p["dtheta_stribeck"]) ** p["alpha"]))
    for torque in (-40.0, 0.0, 40.0):
        found = np.zeros_like(SPEEDS)
        for _ in range(50):  # the motor's torque holds load and friction
            motor, external = torque + found, -torque
            sliding = np.abs(external * p["load_friction_external"] - motor * p["load_friction_motor"])
            rest = np.abs(external * p["load_friction_external_stribeck"] - motor * p["load_friction_motor_stribeck"])
            found = p["friction_base"] + sliding + stribeck * (p["friction_stribeck"] + rest)
            found += p["friction_viscous"] * SPEEDS
        decay = np.exp(-((SPEEDS / element.omega_s) ** element.delta))
        ours = element.steady_torque(SPEEDS) + (load.driving + load.stribeck_driving * decay) * abs(torque)
        assert found == pytest.approx(ours, rel=1e-12)


def test_names_that_other_languages_refuse(tmp_path: Path) -> None:
    """Elements that differ by a sign alone, and a joint that is called like a link, come out as different things."""
    coupling = [[1, 0, 0], [0, 0.5, -1], [0, 0.5, 1]]
    folder = write_arm(tmp_path / "arm", 3, coupling)
    for name in ("robot.urdf", "friction.yaml"):
        file = folder / name
        file.write_text(file.read_text().replace("arm_1", "base").replace("any_arm", "my/arm-3"))
    setup = rx.load_setup(robot=folder)
    export = rx.export_robot(setup, "usd")
    assert [*export.files] == ["my_arm-3.usda"]
    stage = Usd.Stage.CreateInMemory()
    stage.GetRootLayer().ImportFromString(*export.files.values())
    joints = [one.GetDisplayName() for one in stage.Traverse() if one.IsA(UsdPhysics.RevoluteJoint)]
    assert joints == ["base", "arm_2", "arm_3"]
    tables = re.findall(r"constant Real (\S+_tau_pos'?)\[", one_file(setup, "modelica"))
    assert tables[3:] == ["'0.5*arm_2-arm_3_tau_pos'", "'0.5*arm_2+arm_3_tau_pos'"]
    rx.write_export(rx.export_robot(setup, "bam"), tmp_path / "bam")
    assert len(list((tmp_path / "bam").glob("*.json"))) == 5
    for name in ("robot.urdf", "friction.yaml"):
        file = folder / name
        file.write_text(file.read_text().replace("arm_2", "a/b").replace("arm_3", "a_b"))
    with pytest.raises(ConfigError, match=r"a_b: its file would be a_b.json, another element's, too"):
        rx.export_robot(rx.load_setup(robot=folder), "bam")
