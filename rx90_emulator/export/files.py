"""The files of each target: an arm's links and motors and its friction, filled into the templates of this folder."""

from __future__ import annotations

import json
import math
import re
import xml.etree.ElementTree as ET
from collections.abc import Sequence
from functools import cache
from typing import Any

import numpy as np
import pinocchio as pin
from jinja2 import Environment, PackageLoader, StrictUndefined, select_autoescape

from rx90_common.base.arrays import Array
from rx90_common.base.rates import Rates
from rx90_common.process.files import file_stem
from rx90_emulator.export.fit import FrictionFit
from rx90_emulator.export.targets import Target
from rx90_emulator.loop.setup import Arm, Setup

SOLIMP = (0.999, 0.999, 0.001, 0.5, 2.0)
"""Impedance of MuJoCo's friction constraint: with its default, 0.9 0.95, joints creep a hundred times as fast."""
SOLREF_STEPS = 2.0
"""Time constant of that constraint in steps, the shortest that MuJoCo accepts unchanged."""

# m; any two lengths give the same torque
_SPRING_ARM = 0.1
_SPRING_ANCHOR = 0.3


@cache
def _environment() -> Environment:
    environment = Environment(
        loader=PackageLoader("rx90_emulator.export"), autoescape=select_autoescape(("xml",)), undefined=StrictUndefined,
        trim_blocks=True, lstrip_blocks=True, keep_trailing_newline=True,
    )  # fmt: skip
    environment.filters |= {
        "numbers": _numbers,
        "word": _word,
        "python": _python,
        "pattern": re.escape,
        "turn": _quaternion,
    }
    return environment


def _render(template: str, **values: object) -> str:
    """Return a template of this folder with these values; in those that end with .xml, text is escaped."""
    text = _environment().get_template(template).render(values)
    return _indented(ET.fromstring(text)) if template.endswith(".xml") else text


def _indented(root: ET.Element) -> str:
    ET.indent(root)
    return ET.tostring(root, encoding="unicode", xml_declaration=True) + "\n"


def _numbers(values: Any) -> str:
    """Return a number, or an array of them, with all digits, without -0.0."""
    return " ".join(map(repr, (np.ravel(values) + 0.0).tolist()))


def _python(text: str) -> str:
    """Return a text as a literal of Python, in double quotes."""
    return json.dumps(text, ensure_ascii=False)


def _word(name: str) -> str:
    """Return a name as an identifier of letters without accents, digits and underscores."""
    word = re.sub(r"\W", "_", name, flags=re.ASCII)
    return f"_{word}" if word[:1].isdigit() else word


def files_of(arm: Arm, target: Target, fits: Sequence[FrictionFit]) -> dict[str, str]:
    """Return the text of a target's file by its name.

    Args:
        arm: the robot and its drives.
        target: the simulator.
        fits: the friction of each element, or of each joint if the target has no coupled elements.
    """
    robot = arm.robot
    drives = arm.drives
    turning = arm.drives.turning
    name = str(robot.model.name)
    file = target.file.format(name=file_stem(name))
    if not target.template:
        return {file: _urdf(arm, fits)}
    period = (arm.rates if isinstance(arm, Setup) else Rates()).period
    motors = [_place(arm, row) for row in turning.turns]
    values = {
        "name": name, "target": target, "robot": robot, "drives": drives, "fits": fits, "links": _links(arm),
        "fixed": [placement for placement in robot.placements if placement.name not in robot.joint_names],
        "base": _body(robot.model.inertias[0]) | {"name": robot.placements[0].parent},
        "tcp": robot.model.frames[robot.model.getFrameId(robot.tcp_frame, pin.BODY)].placement,
        "rotors": drives.rotor_inertia @ turning.turns**2,
        "efforts": np.abs(turning.turns).T @ np.abs(drives.gear * drives.peak_torque),
        "motors": motors, "armature": dict(zip(motors, drives.rotor_inertia, strict=True)),
        "elements": [_place(arm, row) for row in turning.element_matrix],
        "element_turns": dict(zip(arm.friction.names, turning.element_matrix, strict=True)),
        "period": period, "solimp": SOLIMP, "solref": (SOLREF_STEPS * period, 1.0), "pi": math.pi,
    }  # fmt: skip
    return {file: _render(target.template, **values)}


def _place(arm: Arm, row: Array) -> tuple[str, str]:
    """Return "joint" or, if several turn a motor or element, "tendon", and its name."""
    if np.count_nonzero(row) == 1:
        return "joint", arm.robot.joint_names[int(np.argmax(row))]
    matches = (arm.drives.turning.element_matrix == row).all(axis=1)
    return "tendon", arm.friction.names[int(np.argmax(matches))]


def _body(inertia: pin.Inertia) -> dict[str, Any]:
    """Return mass, centre of mass, inertia about it in the link's axes, and its principal moments and axes."""
    moments, axes = np.linalg.eigh(inertia.inertia)
    axes[:, 2] *= np.linalg.det(axes)
    return {
        "mass": inertia.mass, "center": inertia.lever, "inertia": inertia.inertia, "moments": moments,
        "axes": _quaternion(axes),
    }  # fmt: skip


def _quaternion(turn: Array) -> list[float]:
    """Return w, x, y, z of a rotation matrix."""
    x, y, z, w = pin.Quaternion(turn).coeffs().tolist()
    return [w, x, y, z]


def _links(arm: Arm) -> list[dict[str, Any]]:
    """Return the links from base to tip, each with its joint and the bodies fixed to it, in the frame of the joint."""
    robot = arm.robot
    springs = arm.drives.spring_torque
    children = {one.name: one.child for one in robot.placements}
    data = robot.model.createData()
    links = []
    pin.forwardKinematics(robot.model, data, np.zeros(robot.model.nq))
    for k, joint in enumerate(robot.joint_names):
        number = robot.model.getJointId(joint)
        place = robot.model.jointPlacements[number]
        axis = data.oMi[number].rotation.T @ robot.chain.axis[k]
        # The spring: a tendon of free length 0 between a point of the link and one above the joint gives -k sin(q).
        side = np.cross(axis, np.eye(3)[np.argmin(np.abs(axis))])
        side /= np.linalg.norm(side)
        links.append(_body(robot.model.inertias[number]) | {
            "name": children[joint], "joint": joint, "axis": axis,
            "position": place.translation, "turn": _quaternion(place.rotation),
            "rpy": pin.rpy.matrixToRpy(place.rotation),
            "spring": springs[k] / (_SPRING_ARM * _SPRING_ANCHOR), "spring_arm": _SPRING_ARM * side,
            "spring_anchor": place.translation + _SPRING_ANCHOR * place.rotation @ side,
        })  # fmt: skip
    return links


def _urdf(arm: Arm, fits: Sequence[FrictionFit]) -> str:
    """Return the robot's URDF with its tool, and friction and damping of its joints."""
    root = ET.fromstring(arm.robot.urdf)
    joints = {joint.get("name"): joint for joint in root.findall("joint")}
    for name, fit in zip(arm.robot.joint_names, fits, strict=True):
        for earlier in joints[name].findall("dynamics"):
            joints[name].remove(earlier)
        damping = _numbers(fit.law.viscous[0])
        friction = _numbers(fit.law.tau_c)
        ET.SubElement(joints[name], "dynamics", damping=damping, friction=friction)
    return _indented(root)
