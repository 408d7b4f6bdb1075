"""From other simulators: BAM's JSON and MuJoCo's LuGre to a friction file, an MJCF arm to a robot folder.

Only what is exact is taken: BAM's models m1 and m2, which have friction by speed alone, and dcmotor actuators with
lugre. What a source does not have stands in the files as assumed.
"""

from __future__ import annotations

import json
import math
import xml.etree.ElementTree as ET
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from rx90_common.base.arrays import Array
from rx90_common.base.errors import ConfigError
from rx90_common.base.quoting import listed, plain, quoted
from rx90_common.description.robot_files import FILES
from rx90_common.friction.element import FrictionElement
from rx90_common.friction.friction_file import ALL_ELEMENTS, FrictionFile

DEFLECTION = 2.5e-4
"""Assumed deflection at break-away, rad, that gives the c0 of elements without bristles."""

_DAMPING_TIME = 1e-3  # s: c1 over c0, assumed
_BAM = ("friction_base", "friction_stribeck", "dtheta_stribeck", "alpha", "friction_viscous")
_EXACT = {"m1": (_BAM[0], _BAM[4]), "m2": _BAM}
_BRISTLES = {
    "c0": f"tau_s over a guessed deflection at break-away, {DEFLECTION:g} rad",
    "c1": f"{_DAMPING_TIME:g} s c0",
    "omega_d": "1 rad/s, so that the element is passive (Olsson 1996)",
}
_PEAK_VELOCITY, _PEAK_EFFORT = math.pi, 1000.0  # rad/s and Nm, assumed: MJCF need not limit them


def import_bam(paths: Sequence[Path | str]) -> FrictionFile:
    """Return BAM's parameters as a friction file, an element for each file, named after it.

    Raises:
        ConfigError: for a file that is none, lacks a parameter, or has a model whose friction depends on the load.
    """
    elements: dict[str, FrictionElement] = {}
    for path in map(Path, paths):
        try:
            found = json.loads(path.read_text(encoding="utf-8"))
        except (OSError, ValueError) as error:
            raise ConfigError(f"{plain(path)}: no JSON ({error}); accepted: a file of BAM's parameters") from error
        model = found.get("model") if isinstance(found, dict) else None
        if model not in _EXACT:
            accepted = "m1 or m2; the others' friction depends on the load in another way than here"
            raise ConfigError(f"{plain(path)}: model is {quoted(model)}; accepted: {accepted}")
        for name in _EXACT[model]:
            if not isinstance(found.get(name), int | float):
                raise ConfigError(f"{plain(path)}: {name} is {quoted(found.get(name))}; accepted: a number")
        if path.stem in elements:
            raise ConfigError(f"{plain(path)}: a second element {quoted(path.stem)}; accepted: each name once")
        base, rise = found["friction_base"], found.get("friction_stribeck", 0.0)
        speed, exponent = found.get("dtheta_stribeck", 1.0), found.get("alpha", 1.0)
        elements[path.stem] = _rigid(path, base, base + rise, speed, exponent, found["friction_viscous"])
    known = {"tau_c", "tau_s", "omega_s", "delta", "c2"}
    return _file(elements, known, listed(plain(path) for path in paths), dict.fromkeys(elements, False))


def _rigid(path: Path, tau_c: float, tau_s: float, omega_s: float, delta: float, c2: float) -> FrictionElement:
    """Return an element of a source that has no bristles."""
    c0 = tau_s / DEFLECTION
    try:
        return FrictionElement(tau_c, tau_c, tau_s, tau_s, omega_s, delta, c0, _DAMPING_TIME * c0, c2, omega_d=1.0)
    except ConfigError as error:
        raise ConfigError(f"{plain(path)}: {error}") from error


def _file(
    elements: dict[str, FrictionElement], known: set[str], source: str, bristles: dict[str, bool]
) -> FrictionFile:
    """Return a file whose known parameters are derived, those of elements without bristles otherwise assumed."""
    about: dict[str, dict[str, Any]] = {ALL_ELEMENTS: {"provenance": dict.fromkeys(sorted(known), "derived")}}
    for name, has in bristles.items():
        about[name] = {"provenance": {"c0": "derived", "c1": "derived"}} if has else {"source": dict(_BRISTLES)}
    return FrictionFile(elements, "assumed", f"imported from {source}; what that does not have is assumed", about=about)


def import_mjcf_friction(path: Path | str) -> FrictionFile:
    """Return the LuGre friction of an MJCF as a friction file, an element for each dcmotor, named after its joint.

    A joint without one that has frictionloss gets an element with tau_s = tau_c.

    Raises:
        ConfigError: if MuJoCo cannot read it, there is no friction in it, or a damping is no linear one.
    """
    path, model = Path(path), _model(Path(path))
    import mujoco

    elements: dict[str, FrictionElement] = {}
    bristles: dict[str, bool] = {}
    kinds = {mujoco.mjtTrn.mjTRN_JOINT: model.joint, mujoco.mjtTrn.mjTRN_TENDON: model.tendon}
    for k in range(len(model.actuator_trntype)):
        c0, c1 = model.actuator_dynprm[k, 5:7].tolist()
        if model.actuator_biastype[k] != mujoco.mjtBias.mjBIAS_DCMOTOR or c0 <= 0.0:
            continue
        name = kinds[mujoco.mjtTrn(model.actuator_trntype[k])](model.actuator_trnid[k, 0]).name
        if np.any(model.actuator_dampingpoly[k]):
            raise ConfigError(f"{plain(path)}: the damping of {name} is a polynomial; accepted: a linear one")
        tau_c, tau_s, omega_s = model.actuator_biasprm[k, 3:6].tolist()
        n = abs(float(model.actuator_gear[k, 0]))
        c2 = n * n * float(model.actuator_damping[k]) + _damping(model, name)
        elements[name] = FrictionElement(
            n * tau_c, n * tau_c, n * tau_s, n * tau_s, omega_s / n, 2.0, n * n * c0, n * n * c1, c2
        )
        bristles[name] = True
    for k in range(model.njnt):
        name, loss = model.joint(k).name, float(model.dof_frictionloss[model.jnt_dofadr[k]])
        if name not in elements and loss > 0.0:
            elements[name], bristles[name] = _rigid(path, loss, loss, 1.0, 1.0, _damping(model, name)), False
    if not elements:
        raise ConfigError(f"{plain(path)}: no dcmotor with lugre, no frictionloss; accepted: an MJCF with friction")
    return _file(elements, {"tau_c", "tau_s", "omega_s", "delta", "c2"}, plain(path), bristles)


def _damping(model: Any, name: str) -> float:
    """Return the linear damping that a joint, or else a tendon, has itself."""
    joints = {model.joint(k).name: k for k in range(model.njnt)}
    if name in joints:
        return float(model.dof_damping[model.jnt_dofadr[joints[name]]])
    return float(model.tendon_damping[model.tendon(name).id])


def _model(path: Path) -> Any:
    import mujoco

    try:
        return mujoco.MjModel.from_xml_path(str(path))
    except ValueError as error:
        reason = " ".join(str(error).split())
        raise ConfigError(f"{plain(path)}: MuJoCo cannot read it ({reason}); accepted: an MJCF") from error


def import_arm(path: Path | str) -> dict[str, str]:
    """Return the texts of a robot folder for an MJCF arm by the files' names: the URDF, and its friction if it has any.

    Hinges become joints; a slide, such as that of a finger, stays where it is at the start. Shapes are left out.

    Raises:
        ConfigError: if MuJoCo cannot read it, a body has several joints, or two of them have one name.
    """
    import mujoco

    path, model = Path(path), _model(Path(path))
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    robot = ET.Element("robot", name=path.stem)
    remark = f" From {path.name}, read by MuJoCo. Velocities of {_PEAK_VELOCITY:.3f} rad/s are ASSUMED, and "
    remark += f"efforts of {_PEAK_EFFORT:g} Nm where nothing limits them. "
    rotors = {model.joint(j).name: float(model.dof_armature[model.jnt_dofadr[j]]) for j in range(model.njnt)}
    held = ", ".join(f"{name} {value:g}" for name, value in rotors.items() if value)
    robot.append(ET.Comment(remark + f"Armatures, kg m^2, are no part of it: {held or 'none'}. "))
    names = ["base_link", *(model.body(b).name or f"body_{b}" for b in range(1, model.nbody))]
    origins, turns = np.zeros((model.nbody, 3)), np.zeros((model.nbody, 3, 3))
    turns[0] = np.eye(3)
    for b, name in enumerate(names):
        link = ET.SubElement(robot, "link", name=name)
        if b == 0:
            continue
        joints = range(model.body_jntadr[b], model.body_jntadr[b] + model.body_jntnum[b])
        hinges = [j for j in joints if model.jnt_type[j] == mujoco.mjtJoint.mjJNT_HINGE]
        slides = [j for j in joints if model.jnt_type[j] == mujoco.mjtJoint.mjJNT_SLIDE]
        if len(hinges) > 1 or len(hinges) + len(slides) < len(joints):
            raise ConfigError(f"{plain(path)}: body {quoted(name)} turns in several ways; accepted: one hinge, slides")
        turns[b] = data.xmat[b].reshape(3, 3)
        # A link's frame is that of its joint.
        origins[b] = data.xanchor[hinges[0]] if hinges else data.xpos[b]
        parent = model.body_parentid[b]
        _add_joint(robot, model, names, b, hinges, turns[parent].T @ (origins[b] - origins[parent]),
                   turns[parent].T @ turns[b])  # fmt: skip
        if model.body_mass[b] > 0.0:
            axes = np.empty(9)
            mujoco.mju_quat2Mat(axes, model.body_iquat[b])
            tensor = axes.reshape(3, 3) @ np.diag(model.body_inertia[b]) @ axes.reshape(3, 3).T
            inertial = ET.SubElement(link, "inertial")
            center = turns[b].T @ (data.xpos[b] - origins[b]) + model.body_ipos[b]
            ET.SubElement(inertial, "origin", xyz=_text(center))
            ET.SubElement(inertial, "mass", value=repr(float(model.body_mass[b])))
            upper = {"ixx": (0, 0), "ixy": (0, 1), "ixz": (0, 2), "iyy": (1, 1), "iyz": (1, 2), "izz": (2, 2)}
            ET.SubElement(inertial, "inertia", {key: repr(float(tensor[at])) for key, at in upper.items()})
    ET.indent(robot)
    texts = {FILES["urdf"]: ET.tostring(robot, encoding="unicode") + "\n"}
    try:
        friction = import_mjcf_friction(path)
    except ConfigError:  # without friction: the arm alone
        return texts
    given = {name: {"rotor_inertia": rotors[name]} for name in friction.elements if rotors.get(name)}
    whole = FrictionFile(friction.elements, friction.provenance, friction.source, about=friction.about, joints=given)
    return texts | {FILES["friction"]: whole.text()}


def _add_joint(
    robot: ET.Element, model: Any, names: Sequence[str], b: int, hinges: Sequence[int], at: Array, turn: Array
) -> None:
    """Add the joint above a body, revolute with its limits where it has a hinge."""
    import pinocchio as pin

    name = model.joint(hinges[0]).name if hinges else f"{names[b]}_fixed"
    joint = ET.SubElement(robot, "joint", name=name, type="revolute" if hinges else "fixed")
    ET.SubElement(joint, "origin", xyz=_text(at), rpy=_text(pin.rpy.matrixToRpy(turn)))
    ET.SubElement(joint, "parent", link=names[model.body_parentid[b]])
    ET.SubElement(joint, "child", link=names[b])
    if hinges:
        j = hinges[0]
        low, high = model.jnt_range[j] if model.jnt_limited[j] else (-2.0 * math.pi, 2.0 * math.pi)
        effort = model.jnt_actfrcrange[j, 1] if model.jnt_actfrclimited[j] else _peak(model, j)
        ET.SubElement(joint, "axis", xyz=_text(model.jnt_axis[j]))
        numbers = {"lower": low, "upper": high, "velocity": _PEAK_VELOCITY, "effort": effort}
        ET.SubElement(joint, "limit", {key: repr(float(value)) for key, value in numbers.items()})


def _peak(model: Any, joint: int) -> float:
    """Return the most that the actuators of a joint give by their ranges of force, or as motors of control, Nm.

    Where they have none it is _PEAK_EFFORT, which the URDF says.
    """
    import mujoco

    most = 0.0
    for k in range(len(model.actuator_trntype)):
        if (model.actuator_trntype[k], model.actuator_trnid[k, 0]) != (mujoco.mjtTrn.mjTRN_JOINT, joint):
            continue
        one, is_motor = model.actuator(k), model.actuator_biastype[k] == mujoco.mjtBias.mjBIAS_NONE
        gear = abs(float(model.actuator_gear[k, 0]))
        if model.actuator_forcelimited[k]:
            most += gear * float(model.actuator_forcerange[k, 1])
        elif is_motor and one.ctrllimited[0]:
            most += gear * float(model.actuator_gainprm[k, 0] * one.ctrlrange[1])
    return most or _PEAK_EFFORT


def _text(values: Array) -> str:
    return " ".join(repr(float(value)) for value in values)
