"""An arm as MJCF: bodies, rotors, coupling, springs and motors, with the friction of a target of MuJoCo."""

from __future__ import annotations

import xml.etree.ElementTree as ET
from collections.abc import Sequence
from typing import Any

import mujoco
import numpy as np

from rx90_common.base.arrays import Array
from rx90_common.base.rates import Rates
from rx90_emulator.export.fit import FrictionFit
from rx90_emulator.export.targets import Target
from rx90_emulator.loop.setup import Arm, Setup

SOLIMP = "0.999 0.999 0.001 0.5 2"
"""Of MuJoCo's friction constraint: with its default, 0.9 0.95, joints creep a hundred times as fast."""
SOLREF_STEPS = 2.0
"""Time constant of that constraint in steps, the shortest that MuJoCo takes as it is."""

_NO_MOTOR = "1e-9"  # Nm/A, of what is no motor: MuJoCo 3 refuses 0, and this brakes by 1e-18 Nm s/rad
_SPRING_ARM, _SPRING_ANCHOR = 0.1, 0.3  # m; any two lengths give the same torque
_CREEP_TIME = 0.5  # s


def arm_spec(arm: Arm) -> Any:
    """Return the arm without motors and friction: an MjSpec with armatures, tendons and springs.

    Where a motor or an element turns with two joints there is a fixed tendon, which has the element's name.
    """
    robot, drives = arm.robot, arm.drives
    spec = mujoco.MjSpec.from_string(robot.urdf)
    spec.option.timestep = _period(arm)
    for geometry in list(spec.geoms):  # for display only; inertias are the URDF's
        spec.delete(geometry)
    joints = {name: spec.joint(name) for name in robot.joint_names}
    for joint in joints.values():
        joint.actfrclimited = mujoco.mjtLimited.mjLIMITED_FALSE
    tendons = {}
    for name, row in _transmissions(arm, arm.drives.turning.element_matrix):
        if name not in joints:
            tendons[name] = spec.add_tendon(name=name)
            for joint in np.flatnonzero(row):
                tendons[name].wrap_joint(robot.joint_names[joint], row[joint])
    for (name, _), rotor in zip(_transmissions(arm, arm.drives.turning.turns), drives.rotor_inertia, strict=True):
        (joints | tendons)[name].armature = rotor
    for joint, torque in zip(joints.values(), drives.spring_torque, strict=True):
        if torque > 0.0:
            _add_spring(spec, joint, torque)
    _add_tcp(spec, arm)
    return spec


def _period(arm: Arm) -> float:
    return (arm.rates if isinstance(arm, Setup) else Rates()).period


def _add_tcp(spec: Any, arm: Arm) -> None:
    """Add the tool centre point as a site of the last link."""
    chain, model = arm.robot.chain, spec.compile()
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    last = spec.joint(arm.robot.joint_names[-1]).parent
    at, turn = data.body(last.name).xpos, data.body(last.name).xmat.reshape(3, 3)
    quaternion = np.empty(4)
    mujoco.mju_mat2Quat(quaternion, (turn.T @ chain.tcp_rotation).ravel())
    last.add_site(name="tcp", pos=turn.T @ (chain.origin.sum(axis=0) + chain.tcp_position - at), quat=quaternion)


def _transmissions(arm: Arm, turns: Array) -> list[tuple[str, Array]]:
    """Return the joint, or the tendon, for each row of turns, shape (n, joints), and the row."""
    names, elements = arm.robot.joint_names, arm.friction.names
    rows = {tuple(row): name for name, row in zip(elements, arm.drives.turning.element_matrix.tolist(), strict=True)}
    return [(names[int(np.argmax(row))] if np.count_nonzero(row) == 1 else rows[tuple(row)], row) for row in turns]


def _add_spring(spec: Any, joint: Any, torque: float) -> None:
    """Add -torque sin(q): a spring of no free length between a point of the link and one above the joint."""
    link = joint.parent
    side = np.cross(joint.axis, np.eye(3)[np.argmin(np.abs(joint.axis))])
    side /= np.linalg.norm(side)
    turned = np.empty(3)
    mujoco.mju_rotVecQuat(turned, side, link.quat)
    centre = np.empty(3)
    mujoco.mju_rotVecQuat(centre, joint.pos, link.quat)
    arm, anchor = (f"spring_{joint.name}_{end}" for end in ("arm", "anchor"))
    link.add_site(name=arm, pos=joint.pos + _SPRING_ARM * side)
    link.parent.add_site(name=anchor, pos=link.pos + centre + _SPRING_ANCHOR * turned)
    spring = spec.add_tendon(name=f"spring_{joint.name}", springlength=[0.0, 0.0])
    spring.stiffness[0] = torque / (_SPRING_ARM * _SPRING_ANCHOR)
    spring.wrap_site(arm)
    spring.wrap_site(anchor)


def mjcf_text(arm: Arm, target: Target, fits: Sequence[FrictionFit]) -> str:
    """Return the arm as MJCF. The controls are the motor torques, motor side, Nm, in the order of the motors.

    Args:
        arm: robot and drives.
        target: "mujoco", or "mujoco-classic".
        fits: the friction of each element.
    """
    spec = arm_spec(arm)
    model = spec.compile()
    root = ET.fromstring(spec.to_xml())
    _write_all_digits(root, model)
    places = {one.get("name", ""): one for tag in ("joint", "fixed") for one in root.iter(tag)}
    actuators = ET.SubElement(root, "actuator")
    _add_motors(actuators, arm)
    for fit, (name, _) in zip(fits, _transmissions(arm, arm.drives.turning.element_matrix), strict=True):
        law, viscous = fit.law, _text(*np.trim_zeros(fit.law.viscous, "b"))
        if target.bristles:
            ET.SubElement(
                actuators, "dcmotor", {"name": f"friction_{name}", _kind(arm, name): name}, input="none",
                motorconst=_NO_MOTOR, resistance="1", damping=viscous or "0",
                lugre=_text(law.c0, law.c1, law.tau_c, law.tau_s, law.omega_s),
            )  # fmt: skip
            continue
        constraint = {"solimpfriction": SOLIMP, "solreffriction": _text(SOLREF_STEPS * _period(arm), 1.0)}
        for key, value in {"frictionloss": _text(law.tau_c), "damping": viscous, **constraint}.items():
            if value:
                places[name].set(key, value)
    ET.indent(root)
    return ET.tostring(root, encoding="unicode") + "\n"


def _kind(arm: Arm, name: str) -> str:
    return "joint" if name in arm.robot.joint_names else "tendon"


def _write_all_digits(root: ET.Element, model: Any) -> None:
    """Write the numbers of bodies and joints, of which MuJoCo's writer has six digits, so that they read back equal."""
    for body in root.iter("body"):
        found = model.body(body.get("name", ""))
        body.attrib |= {"pos": _text(*found.pos), "quat": _text(*found.quat)}
        inertia = {"pos": found.ipos, "quat": found.iquat, "mass": found.mass, "diaginertia": found.inertia}
        for inertial in body.findall("inertial"):
            inertial.attrib = {key: _text(*values) for key, values in inertia.items()}
        for joint in body.findall("joint"):
            of = model.joint(joint.get("name", ""))
            joint.attrib |= {"range": _text(*of.range), "axis": _text(*of.axis), "pos": _text(*of.pos)}
            joint.attrib |= {"armature": _text(*of.armature)}


def _add_motors(actuators: ET.Element, arm: Arm) -> None:
    """Add a motor for each drive, one that feels its temperature where its windings get warm, and then the cogging."""
    drives, cogging = arm.drives, []
    warm, waves = drives.winding, drives.cogging
    for i, (name, _) in enumerate(_transmissions(arm, arm.drives.turning.turns)):
        turned = {_kind(arm, name): name, "gear": _text(drives.gear[i])}
        peak = float(drives.peak_torque[i])
        motor = {"name": f"motor_{i + 1}", **turned, "ctrllimited": "true", "ctrlrange": _text(-peak, peak)}
        if warm.resistance[i] > 0.0:
            heat = (warm.thermal_resistance[i], warm.heat_capacity[i], 0.0, 0.0, warm.reference, warm.ambient)
            motor |= {"motorconst": _text(drives.torque_constant[i]), "resistance": _text(warm.resistance[i])}
            ET.SubElement(actuators, "dcmotor", motor, input="ff", thermal=_text(*heat))
        else:
            ET.SubElement(actuators, "motor", motor)
        for k, harmonic in enumerate(waves.harmonic):
            if waves.amplitude[k, i]:  # a cosine here, a sine there
                wave = _text(waves.amplitude[k, i], harmonic, waves.phase[k, i] + 0.5 * np.pi)
                cogging.append({"name": f"cogging_{i + 1}_{k + 1}", **turned, "cogging": wave})
    for one in cogging:
        ET.SubElement(actuators, "dcmotor", one, input="none", motorconst=_NO_MOTOR, resistance="1")


def _text(*numbers: float) -> str:
    return " ".join(repr(float(one)) for one in numbers)


def creep(text: str, arm: Arm, fits: Sequence[FrictionFit]) -> list[float]:
    """Return how fast each joint creeps under half of the friction that holds it, rad/s: measured in MuJoCo.

    Args:
        text: of `mjcf_text`, with friction as frictionloss.
        arm: the robot.
        fits: the friction of its elements.
    """
    model = mujoco.MjModel.from_xml_string(text)
    model.opt.gravity[:] = 0.0
    model.tendon_stiffness[:] = 0.0
    coulomb = np.array([fit.law.tau_c for fit in fits]) @ np.abs(arm.drives.turning.element_matrix)
    speeds = []
    for i, name in enumerate(arm.robot.joint_names):
        data = mujoco.MjData(model)
        joint = model.joint(name)
        data.qfrc_applied[joint.dofadr[0]] = 0.5 * coulomb[i]
        mujoco.mj_step(model, data, nstep=round(_CREEP_TIME / model.opt.timestep))
        speeds.append(float(abs(data.qvel[joint.dofadr[0]])))
    return speeds


def write_mjcf(arm: Arm, target: Target, fits: Sequence[FrictionFit]) -> tuple[dict[str, str], list[str]]:
    """Return the file of the arm by its name, and how fast joints creep where friction is a constraint."""
    text, lost = mjcf_text(arm, target, fits), []
    if not target.bristles:
        fastest = max(creep(text, arm, fits))
        lost.append(f"rest: under half of its friction a joint creeps by up to {fastest:.2g} rad/s, measured in MuJoCo")
    return {f"{arm.robot.model.name}.xml": text}, lost
