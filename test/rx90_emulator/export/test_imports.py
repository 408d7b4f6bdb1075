"""What comes from other simulators, exactly."""

from __future__ import annotations

import dataclasses
import json
import re
import xml.etree.ElementTree as ET
from pathlib import Path

import mujoco
import numpy as np
import pinocchio as pin
import pytest

import rx90_emulator as rx
from benchmarks.any_arm import write_arm
from rx90_common.base.errors import DONE, ConfigError
from rx90_common.base.share import config_path
from rx90_common.description.drives import load_drives
from rx90_common.description.robot import load_robot
from rx90_common.friction.parts.load import LoadPart
from rx90_emulator.cli.frame import run
from rx90_emulator.loop.setup import Setup

# Frames that are turned, joints drawn away from 0 and beside their bodies' origins, principal axes of their own.
ARM = """<mujoco><compiler angle="radian" autolimits="true"/><worldbody><body name="foot" quat="1 0 0 1">
<inertial mass="4" pos="0 0 0" diaginertia="0.1 0.1 0.1"/>{}</body></worldbody><actuator>{}</actuator></mujoco>"""
LINK = """<body name="link{k}" pos="0.1 0.05 0.3" quat="1 {x} 0.3 0"><inertial mass="{m}" pos="0.02 0.1 0.05"
quat="1 0.2 {x} 0" diaginertia="0.03 0.02 0.04"/><joint name="joint_{k}" axis="0 {x} 1" range="-2 2" ref="{x}"
pos="0.01 0 0.02" armature="0.2"/>{{}}</body>"""


def arm_text() -> str:
    """Return an MJCF of six hinges with LuGre friction behind a gear on each."""
    bodies = "{}"
    for k in range(1, 7):
        bodies = bodies.format(LINK.format(k=k, x=0.1 * k, m=6.0 / k))
    dcmotor = '<dcmotor joint="joint_{}" gear="2" input="none" motorconst="0" resistance="1" damping="3" '
    dcmotor += 'lugre="1e3 1 2 3 .5"/>'
    return ARM.format(bodies.format(""), "".join(map(dcmotor.format, range(1, 7))))


def test_an_mjcf_arm_has_the_same_dynamics(tmp_path: Path) -> None:
    """The URDF's mass matrix and gravity, by Pinocchio, are MuJoCo's at random poses."""
    file = tmp_path / "arm.xml"
    file.write_text(arm_text(), encoding="utf-8")
    assert run("rx90_import", [str(file), "--output", str(tmp_path / "robot")]) == DONE
    ours = load_robot(tmp_path / "robot" / "robot.urdf").model
    model = mujoco.MjModel.from_xml_path(str(file))
    model.dof_armature[:] = 0.0
    data = mujoco.MjData(model)
    rng = np.random.default_rng(1)
    for _ in range(10):
        q, mass = rng.uniform(-2.0, 2.0, 6), np.empty((6, 6))
        data.qpos[:] = q
        mujoco.mj_forward(model, data)
        mujoco.mj_fullM(model, data, mass)
        assert np.triu(pin.crba(ours, ours.createData(), q)) == pytest.approx(np.triu(mass), abs=1e-9)
        gravity = pin.computeGeneralizedGravity(ours, ours.createData(), q)
        assert gravity == pytest.approx(data.qfrc_bias, abs=1e-9)
    friction = rx.FrictionFile.read(tmp_path / "robot" / "friction.yaml")
    assert load_drives(tmp_path / "robot" / "drives.yaml").rotor_inertia.tolist() == [0.2] * 6
    one = friction.elements["joint_3"]
    assert (one.tau_c_positive, one.tau_s_negative, one.omega_s) == (4.0, 6.0, 0.25)
    assert (one.c0, one.c1, one.c2, one.delta) == (4e3, 4.0, 12.0, 2.0)


def test_friction_behind_a_gear_is_mujoco_s(tmp_path: Path) -> None:
    """An imported element has the steady torque that MuJoCo has at constant speed, gear included."""
    file = tmp_path / "arm.xml"
    file.write_text(arm_text(), encoding="utf-8")
    element = rx.import_mjcf_friction(file).elements["joint_1"]
    model = mujoco.MjModel.from_xml_path(str(file))
    model.opt.timestep = 5.0  # in which a bristle comes to rest
    data = mujoco.MjData(model)
    for speed in (0.02, 0.3, 2.0):
        for _ in range(3):
            data.qpos[:], data.qvel[:] = 0.0, [speed, 0, 0, 0, 0, 0]
            mujoco.mj_step(model, data)
        data.qpos[:], data.qvel[:] = 0.0, [speed, 0, 0, 0, 0, 0]
        mujoco.mj_forward(model, data)
        torque = -(data.qfrc_actuator[0] + data.qfrc_passive[0])
        assert torque == pytest.approx(float(element.steady_torque(speed)), rel=1e-6)


def test_bam_s_file_of_the_erob80(tmp_path: Path) -> None:
    """Rhoban/bam, params/erob80_50/m2.json: the element is that of the shipped file, whose values come from it, too."""
    file = tmp_path / "m2.json"
    file.write_text(json.dumps({
        "kt": 4.5436619148111745, "R": 2.521141651470365, "armature": 0.3345162630438232,
        "friction_base": 4.086230363954603, "friction_stribeck": 1.6504871346024715e-08,
        "dtheta_stribeck": 0.9617768749469398, "alpha": 1.438935728332229, "friction_viscous": 1.3131993446070485,
        "model": "m2", "actuator": "erob80_50"}), encoding="utf-8")  # fmt: skip
    assert run("rx90_import", [str(file), "--output", str(tmp_path / "friction.yaml")]) == DONE
    ours = rx.FrictionFile.read(config_path("friction") / "erob80_50.yaml").elements["m2"]
    found = rx.FrictionFile.read(tmp_path / "friction.yaml").elements["m2"]
    speeds = np.linspace(-3.0, 3.0, 40)
    assert found.steady_torque(speeds) == pytest.approx(ours.steady_torque(speeds), rel=1e-5)
    whole = file.read_text(encoding="utf-8")
    for text, said in (
        ('{"model": "m6"}', "model is 'm6'; accepted: m1, m2, or m5"),
        ('{"model": []}', "model is .*accepted: m1, m2, or m5"),
        ("[" * 100_000, "no JSON"),
        (re.sub('"friction_base": [0-9.]+', '"friction_base": 1' + 400 * "0", whole), "friction_base is inf"),
    ):
        file.write_text(text, encoding="utf-8")
        with pytest.raises(ConfigError, match=said):
            rx.import_bam([file])


COUPLING = [*np.eye(7)[:6].tolist(), [0, 0, 0, 0, 1, -1, 1]]


def dynamics(setup: Setup, q: np.ndarray) -> list[np.ndarray]:
    """Return mass matrix, gravity and Coriolis torques at velocities of -q, and the tool centre point."""
    robot, model = setup.robot, setup.robot.model
    data = model.createData()
    pin.framesForwardKinematics(model, data, q)
    tcp = data.oMf[model.getFrameId(robot.tcp_frame)]
    return [np.triu(pin.crba(model, data, q)), pin.nonLinearEffects(model, data, q, -q), tcp.translation, tcp.rotation]


def test_an_arm_out_to_mujoco_and_back_runs(tmp_path: Path) -> None:
    """Seven joints, a motor that turns with three: coupling, rotors, spring, links and friction come back exactly.

    It runs; what MJCF does not say is marked as assumed.
    """
    setup = rx.load_setup(robot=write_arm(tmp_path / "arm", 7, COUPLING))
    rx.write_export(rx.export_robot(setup, "mujoco"), tmp_path / "out")
    words = [str(tmp_path / "out" / "any_arm.xml"), "--output", str(tmp_path / "back")]
    assert run("rx90_import", words) == DONE
    back = rx.load_setup(robot=tmp_path / "back")
    assert back.friction.names == setup.friction.names
    assert back.drives.turning.turns.tolist() == COUPLING
    for name, fit in zip(back.friction.names, rx.export_robot(setup, "mujoco").fits, strict=True):
        law, one = fit.law, back.friction[name]
        got = (one.tau_c_positive, one.tau_s_negative, one.omega_s, one.c0, one.c1, one.c2)
        assert got == (law.tau_c, law.tau_s, law.omega_s, law.c0, law.c1, law.viscous[0])
    assert back.drives.rotor_inertia.tolist() == setup.drives.rotor_inertia.tolist()
    assert back.drives.spring_torque == pytest.approx(setup.drives.spring_torque, rel=1e-12)
    assert (back.robot.lower.tolist(), back.robot.upper.tolist()) == (
        setup.robot.lower.tolist(),
        setup.robot.upper.tolist(),
    )
    q = np.linspace(-0.8, 1.1, 7)
    for ours, theirs in zip(dynamics(back, q), dynamics(setup, q), strict=True):
        assert ours == pytest.approx(theirs, rel=1e-12, abs=1e-12)
    for name in ("drives.yaml", "controller.yaml"):
        assert "provenance: assumed" in (tmp_path / "back" / name).read_text(encoding="utf-8")
    points = rx.TrajectoryPoints(
        np.array([0.0, 1.0]), np.array([0.0 * q, 0.2 + 0.0 * q]), np.zeros((2, 7)), np.zeros((2, 7))
    )
    assert np.abs(rx.simulate(back, points).slow.joint_states[-1, 0] - 0.2).max() < 2e-3


# As in public collections: classes, shapes whose files are elsewhere, a joint and a body without names, position
# servos, a gripper of coupled slides, a link called like our base, a site for the flange.
PUBLIC = """<mujoco><compiler angle="radian" meshdir="assets" autolimits="true"/>
<default><default class="arm"><joint axis="0 0 1" armature="0.1" damping="2" range="-2 2"/>
<position kp="900" forcerange="-40 40"/>
<default class="finger"><joint type="slide" axis="0 1 0" range="0 0.04"/></default>
<geom type="mesh" group="2"/></default></default>
<asset><texture name="grid" type="2d" file="grid.png"/><material name="grey" texture="grid"/><mesh file="base.stl"/>
<mesh name="upper" file="upper.obj"/><hfield name="ground" file="ground.png" size="1 1 1 1"/></asset>
<worldbody><geom type="plane" size="1 1 1" material="grey"/><geom type="hfield" hfield="ground"/>
<body name="base_link" childclass="arm">
<inertial mass="2" pos="0 0 0" diaginertia="0.1 0.1 0.1"/><geom mesh="base"/>
<body name="upper" pos="0 0 0.3"><inertial mass="3" pos="0 0.1 0.1" fullinertia="0.04 0.03 0.02 0.001 0.002 0.003"/>
<joint name="shoulder"/><geom mesh="upper" material="grey"/>
<body pos="0.2 0 0.1" quat="1 -1 0 0"><inertial mass="1" pos="0 0 0.1" diaginertia="0.01 0.01 0.005"/><joint/>
<body name="flange" pos="0 0 0.2"><site name="attachment_site" pos="0 0 0.05" quat="1 0 0 1"/>
<body name="left"><inertial mass="0.1" pos="0 0.02 0" diaginertia="1e-5 1e-5 1e-5"/>
<joint name="l" class="finger"/></body>
<body name="right"><inertial mass="0.1" pos="0 0 0" diaginertia="1e-5 1e-5 1e-5"/>
<joint name="r" class="finger"/></body>
</body></body></body></body></worldbody>
<tendon><fixed name="split"><joint joint="l" coef="0.5"/><joint joint="r" coef="0.5"/></fixed></tendon>
<equality><joint joint1="l" joint2="r"/></equality>
<actuator><position class="arm" joint="shoulder"/><general tendon="split" gainprm="1"/></actuator>
<sensor><jointpos joint="shoulder"/></sensor></mujoco>"""


def test_an_arm_as_public_collections_have_them(tmp_path: Path) -> None:
    """It is taken without its shapes, its fingers where they start; dynamics are MuJoCo's with these held."""
    file = tmp_path / "public--arm.xml"
    file.write_text(PUBLIC, encoding="utf-8")
    assert run("rx90_import", [str(file), "--output", str(tmp_path / "robot")]) == DONE
    robot = load_robot(tmp_path / "robot" / "robot.urdf")
    assert robot.joint_names == ("shoulder", "joint_2")
    assert robot.max_effort.tolist() == [40.0, 1000.0]
    assert robot.tcp_frame == "tool0"
    shapeless = re.sub(r"<geom[^>]*>|<asset>.*</asset>", "", PUBLIC, flags=re.DOTALL)
    model = mujoco.MjModel.from_xml_string(shapeless)
    model.dof_armature[:] = 0.0
    data, mass, q = mujoco.MjData(model), np.empty((4, 4)), np.array([0.4, -0.7])
    data.qpos[:2] = q
    mujoco.mj_forward(model, data)
    mujoco.mj_fullM(model, data, mass)
    ours, place = robot.model.createData(), data.site("attachment_site")
    assert np.triu(pin.crba(robot.model, ours, q)) == pytest.approx(np.triu(mass[:2, :2]), abs=1e-12)
    assert pin.computeGeneralizedGravity(robot.model, ours, q) == pytest.approx(data.qfrc_bias[:2], abs=1e-12)
    pin.framesForwardKinematics(robot.model, ours, q)
    flange = ours.oMf[robot.model.getFrameId("tool0")]
    assert flange.translation == pytest.approx(place.xpos, abs=1e-12)
    assert flange.rotation.ravel() == pytest.approx(place.xmat, abs=1e-12)
    friction = rx.FrictionFile.read(tmp_path / "robot" / "friction.yaml").elements
    assert [(name, one.c2) for name, one in friction.items()] == [("shoulder", 2.0), ("joint_2", 2.0)]


def test_inertias_of_shapes_are_kept(tmp_path: Path) -> None:
    """A body without an inertia of its own has that of its geoms."""
    file = tmp_path / "arm.xml"
    file.write_text(
        '<mujoco><worldbody><body name="link"><joint name="j" axis="1 0 0"/><geom type="box" size=".1 .2 .3" mass="5"/>'
        "</body></worldbody></mujoco>", encoding="utf-8")  # fmt: skip
    link = ET.fromstring(rx.import_arm(file)["robot.urdf"]).find("link[@name='link']/inertial")
    assert link is not None
    assert float(link.find("mass").get("value")) == 5.0  # type: ignore[union-attr, arg-type]
    assert float(link.find("inertia").get("ixx")) == pytest.approx(5.0 / 3.0 * (0.2**2 + 0.3**2))  # type: ignore[union-attr, arg-type]


@pytest.mark.parametrize(("old", "new", "reason"), [
    ('armature="0.2"', 'armature="0.2" stiffness="3"', "the springs of"),
    ('armature="0.2"', 'armature="0.2" damping="3 1"', "polynomial"),
    ('armature="0.2"', 'armature="0.2" frictionloss="3"', "lugre and frictionloss of joint_1"),
    ('armature="0.2"', 'armature="0.2" frictionloss="nan"', "frictionloss of joint_1 is nan; accepted"),
    ('armature="0.2"', 'armature="1e200"', r"armatures up to 1e\+200 kg m\^2; accepted: those of an arm"),
    ("<worldbody>", '<option gravity="0 0 -1.6"/><worldbody>', "gravity"),
])  # fmt: skip
def test_what_no_robot_folder_holds_is_refused(tmp_path: Path, old: str, new: str, reason: str) -> None:
    """One line with the file and the reason, instead of an arm that moves in another way."""
    file = tmp_path / "arm.xml"
    file.write_text(arm_text().replace(old, new), encoding="utf-8")
    with pytest.raises(ConfigError, match=reason):
        rx.import_arm(file)


def test_bam_s_load_out_and_back(shipped: Setup, tmp_path: Path) -> None:
    """Model m5 without motor terms comes back as the load part that was written; with them it is refused."""
    load = LoadPart(0.12, 0.12, 0.05, 0.05)
    element = dataclasses.replace(shipped.friction.elements[0], load=load)
    friction = dataclasses.replace(shipped.friction, elements=(element, *shipped.friction.elements[1:]))
    rx.write_export(rx.export_robot(dataclasses.replace(shipped, friction=friction), "bam"), tmp_path / "out")
    file = tmp_path / "out" / "joint_1.json"
    back = rx.import_bam([file]).elements["joint_1"]
    assert back.load == load
    assert (back.tau_c_positive, back.tau_s_positive) == pytest.approx((element.tau_c_positive, element.tau_s_positive))
    content = json.loads(file.read_text(encoding="utf-8")) | {"load_friction_motor": 0.1}
    file.write_text(json.dumps(content), encoding="utf-8")
    with pytest.raises(ConfigError, match=r"load_friction_motor is 0\.1; accepted: 0"):
        rx.import_bam([file])
