"""From other simulators: BAM's JSON and MuJoCo's LuGre to a friction file, an MJCF arm to a robot folder.

Only what is exact is taken: BAM's models m1 and m2, whose friction depends on speed alone, m5 where it depends on the
external torque alone, and dcmotor actuators with lugre. What a source does not have stands in the files as assumed.
"""

from __future__ import annotations

import json
import math
import xml.etree.ElementTree as ET
from collections.abc import Sequence
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np

from rx90_common.base.arrays import Array
from rx90_common.base.config import yaml_text
from rx90_common.base.errors import ConfigError
from rx90_common.base.quoting import listed, plain, quoted
from rx90_common.description.coupling import Coupling
from rx90_common.description.robot import RobotModel, load_robot
from rx90_common.description.robot_files import FILES
from rx90_common.friction.element import FrictionElement
from rx90_common.friction.friction_file import ALL_ELEMENTS, FrictionFile
from rx90_common.friction.parts.load import LoadPart
from rx90_emulator.identification.output.assumed_files import assumed_files
from rx90_emulator.identification.output.robot_files import Identified, marked

DEFLECTION = 2.5e-4
"""Assumed deflection at break-away, rad, that gives the c0 of elements without bristles."""

_DAMPING_TIME = 1e-3  # s: c1 over c0, assumed
_BAM = ("friction_base", "friction_stribeck", "dtheta_stribeck", "alpha", "friction_viscous")
_BAM_LOAD = tuple(f"load_friction_{of}{at}" for of in ("external", "motor") for at in ("", "_stribeck"))
_EXACT = {"m1": (_BAM[0], _BAM[4]), "m2": _BAM, "m5": _BAM + _BAM_LOAD}
_BRISTLES = {
    "c0": f"tau_s over a guessed deflection at break-away, {DEFLECTION:g} rad",
    "c1": f"{_DAMPING_TIME:g} s c0",
    "omega_d": "1 rad/s, so that the element is passive (Olsson 1996)",
}
_NONE = 1e-6  # Nm: of a joint without friction, which no element can be
_OF_MJCF = {"tau_c", "tau_s", "omega_s", "delta", "c2"}
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
            accepted = "m1, m2, or m5; the others' friction depends on the load in another way than here"
            raise ConfigError(f"{plain(path)}: model is {quoted(model)}; accepted: {accepted}")
        for name in _EXACT[model]:
            if not isinstance(found.get(name), int | float):
                raise ConfigError(f"{plain(path)}: {name} is {quoted(found.get(name))}; accepted: a number")
        by_motor = [name for name in _BAM_LOAD[2:] if found.get(name, 0.0) and model == "m5"]
        if by_motor:
            accepted = "0; friction that grows with the motor's torque, of which it is a part, is another law than here"
            raise ConfigError(f"{plain(path)}: {by_motor[0]} is {found[by_motor[0]]:g}; accepted: {accepted}")
        if path.stem in elements:
            raise ConfigError(f"{plain(path)}: a second element {quoted(path.stem)}; accepted: each name once")
        base, rise = found["friction_base"], found.get("friction_stribeck", 0.0)
        speed, exponent = found.get("dtheta_stribeck", 1.0), found.get("alpha", 1.0)
        load = (found[_BAM_LOAD[0]], found[_BAM_LOAD[1]]) if model == "m5" else None
        elements[path.stem] = _rigid(path, base, base + rise, speed, exponent, found["friction_viscous"], load)
    known = {"tau_c", "tau_s", "omega_s", "delta", "c2"}
    return _file(elements, known, listed(plain(path) for path in paths), dict.fromkeys(elements, False))


def _rigid(
    path: Path, tau_c: float, tau_s: float, omega_s: float, delta: float, c2: float,
    load: tuple[float, float] | None = None,
) -> FrictionElement:  # fmt: skip
    """Return an element without bristles; load: share of the load torque, and what comes to it at rest."""
    c0 = tau_s / DEFLECTION
    try:
        part = None if load is None else LoadPart(load[0], load[0], load[1], load[1])
        return FrictionElement(
            tau_c, tau_c, tau_s, tau_s, omega_s, delta, c0, _DAMPING_TIME * c0, c2, omega_d=1.0, load=part
        )
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
        ConfigError: if MuJoCo cannot read it, there is no friction in it, or some that is no element: a damping that is
            a polynomial, LuGre behind a site, two friction torques of one joint.
    """
    path = Path(path)
    elements, bristles = _friction(path, _model(path))
    if not elements:
        raise ConfigError(f"{plain(path)}: no dcmotor with lugre, no frictionloss; accepted: an MJCF with friction")
    return _file(elements, _OF_MJCF, plain(path), bristles)


def _friction(path: Path, model: Any) -> tuple[dict[str, FrictionElement], dict[str, bool]]:
    """Return the elements by the names of their joints and tendons, and whether each has bristles."""
    import mujoco

    elements: dict[str, FrictionElement] = {}
    kinds = {mujoco.mjtTrn.mjTRN_JOINT: model.joint, mujoco.mjtTrn.mjTRN_TENDON: model.tendon}
    for k in range(len(model.actuator_trntype)):  # more than nu where some have no input
        c0, c1 = model.actuator_dynprm[k, 5:7].tolist()
        if model.actuator_biastype[k] != mujoco.mjtBias.mjBIAS_DCMOTOR or c0 <= 0.0:
            continue
        kind = mujoco.mjtTrn(model.actuator_trntype[k])
        name = kinds[kind](model.actuator_trnid[k, 0]).name if kind in kinds else ""
        if not name or name in elements:
            what = f"a second lugre on {name}" if name else f"lugre on {kind.name}"
            raise ConfigError(f"{plain(path)}: {what}; accepted: one for a joint or a tendon")
        if np.any(model.actuator_dampingpoly[k]):
            raise ConfigError(f"{plain(path)}: the damping of {name} is a polynomial; accepted: a linear one")
        tau_c, tau_s, omega_s = model.actuator_biasprm[k, 3:6].tolist()
        n = abs(float(model.actuator_gear[k, 0]))
        c2 = n * n * float(model.actuator_damping[k]) + _linear(path, model, name, "damping")
        elements[name] = FrictionElement(
            n * tau_c, n * tau_c, n * tau_s, n * tau_s, omega_s / n, 2.0, n * n * c0, n * n * c1, c2
        )
    bristles = dict.fromkeys(elements, True)
    for name in [model.joint(k).name for k in range(model.njnt)] + [model.tendon(k).name for k in range(model.ntendon)]:
        if (loss := _linear(path, model, name, "frictionloss")) > 0.0:
            if name in elements:
                raise ConfigError(f"{plain(path)}: lugre and frictionloss of {name}; accepted: one of both")
            elements[name] = _rigid(path, loss, loss, 1.0, 1.0, _linear(path, model, name, "damping"))
            bristles[name] = False
    return elements, bristles


def _linear(path: Path, model: Any, name: str, what: str) -> float:
    """Return what a joint, or else a tendon, has itself of armature, damping, frictionloss or stiffness."""
    joints = {model.joint(k).name: k for k in range(model.njnt)}
    kind, at = ("jnt" if what == "stiffness" else "dof", joints[name]) if name in joints else (
        "tendon", model.tendon(name).id)  # fmt: skip
    at = model.jnt_dofadr[at] if kind == "dof" else at
    if np.any(getattr(model, f"{kind}_{what}poly", [[0.0]] * (at + 1))[at]):
        raise ConfigError(f"{plain(path)}: the {what} of {name} is a polynomial; accepted: a linear one")
    return float(getattr(model, f"{kind}_{what}")[at])


def _model(path: Path) -> Any:
    import mujoco

    try:
        return mujoco.MjModel.from_xml_path(str(path))
    except ValueError as error:
        reason = " ".join(str(error).split())
        raise ConfigError(f"{plain(path)}: MuJoCo cannot read it ({reason}); accepted: an MJCF") from error


def import_arm(path: Path | str) -> dict[str, str]:
    """Return the texts of a robot folder for an MJCF arm by the files' names: URDF, drives, friction, controller.

    Hinges become joints; a slide, such as that of a finger, stays where it is at the start. Shapes are left out. A
    fixed tendon with an actuator is a motor that turns with several joints. Armatures are rotors; what else drives and
    controller need is assumed in proportion to the arm. A joint without friction gets next to none.

    Raises:
        ConfigError: if MuJoCo cannot read it, it is no arm of 1 to 7 hinges in series, or has a spring or a tendon that
            no robot folder holds.
    """
    import mujoco

    path, model = Path(path), _model(Path(path))
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    robot = ET.Element("robot", name=path.stem)
    remark = f" From {path.name}, read by MuJoCo. Velocities of {_PEAK_VELOCITY:.3f} rad/s are ASSUMED, and "
    remark += f"efforts of {_PEAK_EFFORT:g} Nm where nothing limits them. "
    robot.append(ET.Comment(remark + f"Armatures are no part of it: they stand in {FILES['drives']}. "))
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
    return texts | _drives_and_friction(path, model, _robot_of(path, texts[FILES["urdf"]]))


def _robot_of(path: Path, urdf: str) -> RobotModel:
    """Return the arm of a URDF that was made of an MJCF."""
    with TemporaryDirectory() as folder:
        file = Path(folder) / FILES["urdf"]
        file.write_text(urdf, encoding="utf-8")
        try:
            return load_robot(file)
        except ConfigError as error:
            raise ConfigError(str(error).replace(str(file), plain(path))) from error


def _drives_and_friction(path: Path, model: Any, robot: RobotModel) -> dict[str, str]:
    """Return the texts of the other files by their names."""
    names = robot.joint_names
    springs = _springs(path, model, names)
    turns, tendons = _turns(path, model, names)
    try:
        turning = Coupling(turns)
    except ConfigError as error:
        raise ConfigError(f"{plain(path)}: its tendons: {error}") from error
    motors = [tendons.get(i, name) for i, name in enumerate(names)]
    lost = [name for i, name in enumerate(names) if i in tendons and _linear(path, model, name, "armature")]
    if lost:
        raise ConfigError(f"{plain(path)}: armature of {lost[0]}, whose motor turns with others, too; accepted: 0")
    rotors = np.array([_linear(path, model, name, "armature") for name in motors])
    elements, bristles = _friction(path, model)
    sources = dict(zip(turning.element_names(names), (*names, *(motors[i] for i in turning.sums)), strict=True))
    if left := sorted(elements.keys() - set(sources.values()) - _fixed(model)):
        raise ConfigError(f"{plain(path)}: friction of {left[0]}; accepted: of {listed(sources.values())}")
    for source in sources.values():
        if source not in elements:
            elements[source] = _rigid(path, _NONE, _NONE, 1.0, 1.0, _linear(path, model, source, "damping"))
            bristles[source] = False
    friction = _file({name: elements[source] for name, source in sources.items()}, _OF_MJCF, plain(path),
                     {name: bristles[source] for name, source in sources.items()})  # fmt: skip
    drives, controller = assumed_files(robot, robot.model, turning, rotors, {})
    about = {
        key: Identified(value, "derived", f"armatures and tendons of {path.name}")
        for key, value in (("rotor_inertia", rotors.tolist()), ("coupling", turns.tolist()))
    }
    drives["transmission"] = marked(drives["transmission"], about)
    drives["spring"] = marked(drives["spring"], {"torque": Identified(springs, "derived", f"springs of {path.name}")})
    return {
        FILES["drives"]: _head("Drives", path) + yaml_text(drives),
        FILES["friction"]: friction.text(),
        FILES["controller"]: _head("Controller", path) + yaml_text(controller),
    }


def _springs(path: Path, model: Any, names: Sequence[str]) -> list[float]:
    """Return k of the torques -k sin(q) that all springs together are, Nm, by the joints."""
    import mujoco

    data = mujoco.MjData(model)
    at = [model.joint(name).qposadr[0] for name in names]
    dof = [model.joint(name).dofadr[0] for name in names]

    def torque(q: Array) -> Array:
        data.qpos[at] = q
        mujoco.mj_forward(model, data)
        return np.asarray(data.qfrc_spring[dof])

    k = 0.0 - torque(np.full(len(names), 0.5 * math.pi))
    k[np.abs(k) < 1e-9] = 0.0
    for q in np.random.default_rng(0).uniform(-2.0, 2.0, (8, len(names))):
        off = np.abs(torque(q) + k * np.sin(q))
        if (off > 1e-4 * max(1.0, float(np.abs(k).max()))).any() or (k < 0.0).any():
            worst = names[int(np.argmax(off))]
            raise ConfigError(f"{plain(path)}: the springs of {worst}; accepted: torques of -k sin(q), k >= 0")
    if model.body_gravcomp.any() or model.opt.gravity.tolist() != [0.0, 0.0, -9.81]:
        raise ConfigError(
            f"{plain(path)}: gravity {model.opt.gravity.tolist()}, or gravcomp; accepted: 0 0 -9.81, none"
        )
    return [float(each) for each in k]


def _head(what: str, path: Path) -> str:
    return f"# {what} for the arm of {path.name}, which says little of it: ASSUMED where it is marked so. SI units.\n"


def _fixed(model: Any) -> set[str]:
    """Return the names of joints that stay where they are."""
    import mujoco

    return {model.joint(j).name for j in range(model.njnt) if model.jnt_type[j] == mujoco.mjtJoint.mjJNT_SLIDE}


def _turns(path: Path, model: Any, names: Sequence[str]) -> tuple[Array, dict[int, str]]:
    """Return turns of motors for those of joints, shape (n, n), and the tendons of those that turn with several."""
    import mujoco

    turns, tendons = np.eye(len(names)), {}
    driven = model.actuator_trnid[model.actuator_trntype == mujoco.mjtTrn.mjTRN_TENDON, 0]
    for t in dict.fromkeys(driven.tolist()):
        name, row = model.tendon(t).name, np.zeros(len(names))
        wraps = range(model.tendon_adr[t], model.tendon_adr[t] + model.tendon_num[t])
        joints = [model.joint(model.wrap_objid[w]).name if model.wrap_type[w] == mujoco.mjtWrap.mjWRAP_JOINT else None
                  for w in wraps]  # fmt: skip
        if set(joints) <= _fixed(model):  # of a gripper
            continue
        for w, joint in zip(wraps, joints, strict=True):
            if joint in names:
                row[names.index(joint)] = model.wrap_prm[w]
        own = [i for i in np.flatnonzero(row)[::-1].tolist() if i not in tendons]
        if not own or np.count_nonzero(row) != len(joints) or len(joints) < 2:
            raise ConfigError(f"{plain(path)}: tendon {quoted(name)}; accepted: fixed, of several of {listed(names)}")
        tendons[own[0]] = name
        turns[own[0]] = row
    return turns, tendons


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
