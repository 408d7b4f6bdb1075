"""From other simulators: BAM's JSON and MuJoCo's LuGre to a friction file, an MJCF arm to a robot folder.

Only exact conversions are accepted: BAM's models m1 and m2, whose friction depends on speed alone, m5 if it depends on
the external torque alone, and dcmotor actuators with lugre. Values that a source does not have are marked as assumed.
"""

from __future__ import annotations

import json
import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, NoReturn

import numpy as np
import pinocchio as pin

from rx90_common.base.arrays import Array
from rx90_common.base.config import yaml_text
from rx90_common.base.errors import ConfigError, located, warn_caller
from rx90_common.base.quoting import listed, plain, quoted
from rx90_common.description.coupling import Coupling
from rx90_common.description.robot import MOUNT_LINK, load_robot
from rx90_common.description.robot_files import FILES
from rx90_common.friction.element import FrictionElement
from rx90_common.friction.friction_file import ALL_ELEMENTS, FrictionFile
from rx90_common.friction.parts.load import LoadPart
from rx90_emulator.export.files import render
from rx90_emulator.identification.output.assumed_files import assumed_files
from rx90_emulator.identification.output.robot_files import Identified, marked

DEFLECTION = 2.5e-4
"""Assumed deflection at break-away, rad, that gives the c0 of elements without bristles."""

_DAMPING_TIME = 1e-3  # s: c1 over c0, assumed
_FADING = 1.0  # rad/s: omega_d of elements without bristles, assumed
_BAM = ("friction_base", "friction_stribeck", "dtheta_stribeck", "alpha", "friction_viscous")
_BAM_LOAD = tuple(f"load_friction_{of}{at}" for of in ("external", "motor") for at in ("", "_stribeck"))
_EXACT = {"m1": (_BAM[0], _BAM[4]), "m2": _BAM, "m5": _BAM + _BAM_LOAD}
_DERIVED = ("c2", "delta", "omega_s", "tau_c", "tau_s")
_BRISTLES = {
    "c0": f"tau_s over a guessed deflection at break-away, {DEFLECTION:g} rad",
    "c1": f"{_DAMPING_TIME:g} s c0",
    "omega_d": f"{_FADING:g} rad/s, so that the element is passive (Olsson 1996)",
}
_NONE = 1e-6  # Nm, for a joint without friction: an element needs some
_PEAK_VELOCITY, _PEAK_EFFORT = math.pi, 1000.0  # rad/s and Nm, assumed: MJCF need not limit them
_FLANGE_SITES = ("tcp", "attachment_site")  # the first by rx90_export, the second by convention


def import_bam(paths: Sequence[Path | str]) -> FrictionFile:
    """Return BAM's parameters as a friction file, an element for each file, named after it.

    Raises:
        ConfigError: for an invalid file, a missing parameter, or a model whose friction depends on the load.
    """
    elements: dict[str, FrictionElement] = {}
    for path in map(Path, paths):
        try:
            found = json.loads(path.read_text(encoding="utf-8-sig"), parse_int=float)
        except (OSError, ValueError, RecursionError) as error:
            raise ConfigError(f"{plain(path)}: no JSON ({error}); accepted: a file of BAM's parameters") from error
        model = found.get("model") if isinstance(found, dict) else None
        if not isinstance(model, str) or model not in _EXACT:
            accepted = "m1, m2, or m5; the others' friction depends on the load in another way than here"
            raise ConfigError(f"{plain(path)}: model is {quoted(model)}; accepted: {accepted}")
        for name in _EXACT[model]:
            if not isinstance(found.get(name), float) or not math.isfinite(found[name]):
                raise ConfigError(f"{plain(path)}: {name} is {quoted(found.get(name))}; accepted: a number")
        by_motor = [name for name in _BAM_LOAD[2:] if found.get(name, 0.0) and model == "m5"]
        if by_motor:
            accepted = "0; friction that grows with the motor's torque, of which it is a part, is another law than here"
            raise ConfigError(f"{plain(path)}: {by_motor[0]} is {found[by_motor[0]]:g}; accepted: {accepted}")
        if path.stem in elements:
            raise ConfigError(f"{plain(path)}: a second element {quoted(path.stem)}; accepted: each name once")
        elements[path.stem] = _rigid(
            path, found["friction_base"], found.get("friction_stribeck", 0.0), found["friction_viscous"],
            found.get("dtheta_stribeck", 1.0), found.get("alpha", 1.0),
            (found[_BAM_LOAD[0]], found[_BAM_LOAD[1]]) if model == "m5" else None,
        )  # fmt: skip
    return _file(elements, listed(plain(path) for path in paths))


def _rigid(
    path: Path, tau_c: float, rise: float, c2: float, omega_s: float = 1.0, delta: float = 1.0,
    load: tuple[float, float] | None = None,
) -> FrictionElement:  # fmt: skip
    """Return an element without bristles; load: factor of the load torque, and its additional part at rest."""
    tau_s, c0 = tau_c + rise, (tau_c + rise) / DEFLECTION
    with located(plain(path)):
        part = None if load is None else LoadPart(load[0], load[0], load[1], load[1])
        return FrictionElement(
            tau_c, tau_c, tau_s, tau_s, omega_s, delta, c0, _DAMPING_TIME * c0, c2, omega_d=_FADING, load=part
        )


def _file(elements: Mapping[str, FrictionElement], source: str) -> FrictionFile:
    """Return a file of elements, in which missing bristles are assumed."""
    about: dict[str, dict[str, Any]] = {ALL_ELEMENTS: {"provenance": dict.fromkeys(_DERIVED, "derived")}}
    for name, one in elements.items():
        assumed = math.isfinite(one.omega_d)
        about[name] = {"source": dict(_BRISTLES)} if assumed else {"provenance": {"c0": "derived", "c1": "derived"}}
    why = f"imported from {source}; what that does not have is assumed"
    return FrictionFile(dict(elements), "assumed", why, about=about)


def import_mjcf_friction(path: Path | str) -> FrictionFile:
    """Return the LuGre friction of an MJCF as a friction file, an element for each dcmotor, named after its joint.

    A joint without dcmotor but with frictionloss gets an element with tau_s = tau_c.

    Raises:
        ConfigError: if MuJoCo cannot read it, it contains no friction, or some that no element represents: a polynomial
            damping, LuGre at a site, two friction torques of one joint.
    """
    mjcf = _Mjcf(Path(path))
    elements = mjcf.friction()
    if not elements:
        mjcf.refuse("no dcmotor with lugre, no frictionloss", "an MJCF with friction")
    return _file(elements, plain(path))


def import_arm(path: Path | str) -> dict[str, str]:
    """Return the texts of a robot folder for an MJCF arm by the files' names: URDF, drives, friction, controller.

    Hinges become joints; a slide, such as that of a finger, is fixed at its start. Shapes are ignored, and need not
    exist if bodies have inertias of their own. A fixed tendon with an actuator is a motor that turns with several
    joints.
    Armatures are rotors; a site tcp or attachment_site is the flange. Other values of drives and controller are assumed
    in proportion to the arm. A joint without friction gets next to none.

    Raises:
        ConfigError: if MuJoCo cannot read it, it is no arm of 1 to 7 hinges in series, or has a spring or a tendon that
            a robot folder cannot represent.
    """
    path = Path(path)
    mjcf = _Mjcf(path)
    urdf = render("urdf.xml", name=path.stem, file=path.name, links=mjcf.links(), velocity=_PEAK_VELOCITY,
                  effort=_PEAK_EFFORT, drives=FILES["drives"])  # fmt: skip
    with TemporaryDirectory() as folder:
        file = Path(folder) / FILES["urdf"]
        file.write_text(urdf, encoding="utf-8")
        try:
            robot = load_robot(file)
        except ConfigError as error:
            raise ConfigError(str(error).replace(str(file), plain(path))) from error
    names = robot.joint_names
    springs = mjcf.springs(names)
    turns, tendons = mjcf.turns(names)
    with located(f"{plain(path)}: its tendons"):
        turning = Coupling(turns)
    motors = [tendons.get(i, name) for i, name in enumerate(names)]
    unread = [name for i, name in enumerate(names) if i in tendons and mjcf.own(name, "armature")]
    if unread:
        mjcf.refuse(f"armature of {unread[0]}, whose motor turns with others, too", "0")
    rotors = np.array([mjcf.own(name, "armature") for name in motors])
    found = mjcf.friction()
    sources = dict(zip(turning.element_names(names), (*names, *(motors[i] for i in turning.sums)), strict=True))
    if unread := sorted(found.keys() - set(sources.values()) - mjcf.slides):
        mjcf.refuse(f"friction of {unread[0]}", f"of {listed(sources.values())}")
    elements = {
        name: found[source] if source in found else _rigid(path, _NONE, 0.0, mjcf.own(source, "damping"))
        for name, source in sources.items()
    }
    try:
        with np.errstate(over="raise", invalid="raise"):
            drives, controller = assumed_files(robot, robot.model, turning, rotors, {})
    except (FloatingPointError, np.linalg.LinAlgError):
        heaviest, largest = max(one.mass for one in robot.model.inertias), float(rotors.max())
        mjcf.refuse(f"masses up to {heaviest:g} kg, armatures up to {largest:g} kg m^2", "those of an arm")
    about = {
        key: Identified(value, "derived", f"armatures and tendons of {path.name}")
        for key, value in (("rotor_inertia", rotors.tolist()), ("coupling", turns.tolist()))
    }
    drives["transmission"] = marked(drives["transmission"], about)
    drives["spring"] = marked(drives["spring"], {"torque": Identified(springs, "derived", f"springs of {path.name}")})
    head = "# {} for the arm of {}, which says little of it: ASSUMED where it is marked so. SI units.\n"
    return {
        FILES["urdf"]: urdf,
        FILES["drives"]: head.format("Drives", path.name) + yaml_text(drives),
        FILES["friction"]: _file(elements, plain(path)).text(),
        FILES["controller"]: head.format("Controller", path.name) + yaml_text(controller),
    }


class _Mjcf:
    """An MJCF as MuJoCo reads it.

    Raises:
        ConfigError: if MuJoCo cannot read it.
    """

    def __init__(self, path: Path) -> None:
        import mujoco

        self._path, self._mujoco = path, mujoco
        if not path.is_file():
            raise ConfigError(f"{plain(path)}: not there, or no file; accepted: an MJCF")
        warnings: list[str] = []
        mujoco.set_mju_user_warning(warnings.append)  # otherwise they go to the terminal and into a file MUJOCO_LOG.TXT
        try:
            spec = mujoco.MjSpec.from_file(str(path))
            self._drop_shapes(spec)
            for kind, things in (("body", spec.bodies[1:]), ("joint", spec.joints), ("tendon", spec.tendons)):
                for k, one in enumerate(things):
                    one.name = one.name or f"{kind}_{k + 1}"
            self._model = spec.compile()
        except ValueError as error:
            raise ConfigError(
                f"{plain(path)}: MuJoCo cannot read it ({' '.join(str(error).split())}); accepted: an MJCF"
            ) from error
        finally:
            mujoco.set_mju_user_warning(None)
        warn_caller(f"{plain(path)}: MuJoCo warns: {' '.join(one.split())}" for one in warnings)
        model = self._model
        self._joints = {model.joint(j).name: j for j in range(model.njnt)}
        kinds = {name: model.jnt_type[j] for name, j in self._joints.items()}
        self.slides = {name for name, kind in kinds.items() if kind == mujoco.mjtJoint.mjJNT_SLIDE}

    def _drop_shapes(self, spec: Any) -> None:
        """Delete elements without effect on the dynamics that may name missing files."""
        by_shape = spec.compiler.inertiafromgeom == self._mujoco.mjtInertiaFromGeom.mjINERTIAFROMGEOM_TRUE
        for shape in spec.geoms:
            if not by_shape and (shape.parent.explicitinertial or shape.parent == spec.worldbody):
                spec.delete(shape)
            else:
                shape.material = ""
        needed = {shape.meshname for shape in spec.geoms}
        meshes = [one for one in spec.meshes if (one.name or Path(one.file).stem) not in needed]
        for one in [*spec.sensors, *spec.pairs, *spec.skins, *spec.materials, *spec.textures, *spec.hfields, *meshes]:
            spec.delete(one)

    def refuse(self, what: str, accepted: str) -> NoReturn:
        """Raise a ConfigError."""
        raise ConfigError(f"{plain(self._path)}: {what}; accepted: {accepted}")

    def own(self, name: str, what: str) -> float:
        """Return the armature, damping or frictionloss of a joint, or else of a tendon."""
        model, joint = self._model, self._joints.get(name)
        kind, at = ("tendon", model.tendon(name).id) if joint is None else ("dof", model.jnt_dofadr[joint])
        if what == "damping" and np.any(getattr(model, f"{kind}_dampingpoly")[at]):
            self.refuse(f"the damping of {name} is a polynomial", "a linear one")
        value = float(getattr(model, f"{kind}_{what}")[at])
        if not math.isfinite(value):
            self.refuse(f"{what} of {name} is {value}", "a finite number")
        return value

    def friction(self) -> dict[str, FrictionElement]:
        """Return the elements by the names of their joints and tendons."""
        model, of = self._model, self._mujoco.mjtTrn
        elements: dict[str, FrictionElement] = {}
        for k in range(len(model.actuator_trntype)):  # more than nu if some have no input
            c0, c1 = model.actuator_dynprm[k, 5:7].tolist()
            if model.actuator_biastype[k] != self._mujoco.mjtBias.mjBIAS_DCMOTOR or c0 <= 0.0:
                continue
            kind = of(model.actuator_trntype[k])
            if kind not in {of.mjTRN_JOINT, of.mjTRN_TENDON}:
                self.refuse(f"lugre on {kind.name}", "one for a joint or a tendon")
            name = (model.joint if kind == of.mjTRN_JOINT else model.tendon)(model.actuator_trnid[k, 0]).name
            if name in elements:
                self.refuse(f"a second lugre on {name}", "one for a joint or a tendon")
            if np.any(model.actuator_dampingpoly[k]):
                self.refuse(f"the damping of {name} is a polynomial", "a linear one")
            tau_c, tau_s, omega_s = model.actuator_biasprm[k, 3:6].tolist()
            n = abs(float(model.actuator_gear[k, 0]))
            c2 = n * n * float(model.actuator_damping[k]) + self.own(name, "damping")
            elements[name] = FrictionElement(
                n * tau_c, n * tau_c, n * tau_s, n * tau_s, omega_s / n, 2.0, n * n * c0, n * n * c1, c2
            )
        for name in [*self._joints, *(model.tendon(k).name for k in range(model.ntendon))]:
            if (loss := self.own(name, "frictionloss")) > 0.0:
                if name in elements:
                    self.refuse(f"lugre and frictionloss of {name}", "one of both")
                elements[name] = _rigid(self._path, loss, 0.0, self.own(name, "damping"))
        return elements

    def links(self) -> list[dict[str, Any]]:
        """Return the links of a URDF, from the base on, each in the frame of the joint above it."""
        model, mujoco = self._model, self._mujoco
        data = mujoco.MjData(model)
        # At 0, the origin of ranges and springs; a joint's `ref` is its angle in the pose of the MJCF's frames.
        data.qpos[model.jnt_qposadr[model.jnt_type == mujoco.mjtJoint.mjJNT_HINGE]] = 0.0
        mujoco.mj_kinematics(model, data)
        names = [model.body(b).name for b in range(model.nbody)]
        names[0] = "world" if "base_link" in names else "base_link"
        frames = [pin.SE3.Identity()]
        links: list[dict[str, Any]] = [{"name": names[0], "mass": 0.0, "parent": ""}]

        def add(name: str, parent: int, turn: Array, position: Array, **more: Any) -> None:
            frames.append(pin.SE3(turn.reshape(3, 3), position.copy()))
            place = frames[parent].actInv(frames[-1])
            link = {"name": name, "mass": 0.0, "joint": "", "parent": names[parent], "position": place.translation}
            links.append(link | {"rpy": pin.rpy.matrixToRpy(place.rotation)} | more)

        for b in range(1, model.nbody):
            joints = range(model.body_jntadr[b], model.body_jntadr[b] + model.body_jntnum[b])
            hinges = [j for j in joints if model.jnt_type[j] == mujoco.mjtJoint.mjJNT_HINGE]
            if len(hinges) > 1 or any(j not in hinges and model.joint(j).name not in self.slides for j in joints):
                self.refuse(f"body {quoted(names[b])} turns in several ways", "one hinge, slides")
            position = data.xanchor[hinges[0]] if hinges else data.xpos[b]
            axes = np.empty(9)
            mujoco.mju_quat2Mat(axes, model.body_iquat[b])
            body = {
                "mass": float(model.body_mass[b]),
                "center": data.xmat[b].reshape(3, 3).T @ (data.xpos[b] - position) + model.body_ipos[b],
                "inertia": axes.reshape(3, 3) @ np.diag(model.body_inertia[b]) @ axes.reshape(3, 3).T,
            }
            add(names[b], model.body_parentid[b], data.xmat[b], position, **body, **self._hinge(hinges))
        flanges = [site for site in map(model.site, range(model.nsite)) if site.name in _FLANGE_SITES]
        if flanges and MOUNT_LINK not in names:
            one = data.site(flanges[0].name)
            add(MOUNT_LINK, flanges[0].bodyid[0], one.xmat, one.xpos)
        return links

    def _hinge(self, hinges: Sequence[int]) -> dict[str, Any]:
        """Return name, axis, range and effort of a hinge, if there is one.

        The effort is the largest of its actuators by their ranges of force, or for motors of control, Nm; without such
        ranges it is _PEAK_EFFORT, which the URDF states.
        """
        model, mujoco, effort = self._model, self._mujoco, 0.0
        if not hinges:
            return {}
        (j,) = hinges
        for k in range(len(model.actuator_trntype)):
            if (model.actuator_trntype[k], model.actuator_trnid[k, 0]) != (mujoco.mjtTrn.mjTRN_JOINT, j):
                continue
            gear = abs(float(model.actuator_gear[k, 0]))
            if model.actuator_forcelimited[k]:
                effort += gear * float(np.abs(model.actuator_forcerange[k]).max())
            elif model.actuator_biastype[k] == mujoco.mjtBias.mjBIAS_NONE and model.actuator(k).ctrllimited[0]:
                effort += gear * float(np.abs(model.actuator_gainprm[k, 0] * model.actuator(k).ctrlrange).max())
        if model.jnt_actfrclimited[j]:
            effort = float(np.abs(model.jnt_actfrcrange[j]).max())
        limits = model.jnt_range[j] if model.jnt_limited[j] else (-2.0 * math.pi, 2.0 * math.pi)
        return {"joint": model.joint(j).name, "axis": model.jnt_axis[j], "effort": effort or _PEAK_EFFORT,
                "limits": limits}  # fmt: skip

    def springs(self, names: Sequence[str]) -> list[float]:
        """Return the amplitudes k of the springs' total torques -k sin(q) at the joints, Nm."""
        model = self._model
        data = self._mujoco.MjData(model)
        at, dof = (getattr(model, key)[[self._joints[name] for name in names]] for key in ("jnt_qposadr", "jnt_dofadr"))

        def torque(q: Array) -> Array:
            data.qpos[at] = q
            self._mujoco.mj_forward(model, data)
            return np.asarray(data.qfrc_spring[dof])

        k = 0.0 - torque(np.full(len(names), 0.5 * math.pi))
        k[np.abs(k) < 1e-9] = 0.0
        for q in np.random.default_rng(0).uniform(-2.0, 2.0, (8, len(names))):
            off = np.abs(torque(q) + k * np.sin(q))
            if (off > 1e-4 * max(1.0, float(np.abs(k).max()))).any() or (k < 0.0).any():
                self.refuse(f"the springs of {names[int(np.argmax(off))]}", "torques of -k sin(q), k >= 0")
        if model.body_gravcomp.any() or model.opt.gravity.tolist() != [0.0, 0.0, -9.81]:
            self.refuse(f"gravity {model.opt.gravity.tolist()}, or gravcomp", "0 0 -9.81, none")
        return [float(each) for each in k]

    def turns(self, names: Sequence[str]) -> tuple[Array, dict[int, str]]:
        """Return motor turns for joint turns, shape (n, n), and the tendons of motors with several joints by number."""
        model, mujoco, turns = self._model, self._mujoco, np.eye(len(names))
        tendons: dict[int, str] = {}
        driven = model.actuator_trnid[model.actuator_trntype == mujoco.mjtTrn.mjTRN_TENDON, 0]
        for t in dict.fromkeys(driven.tolist()):
            name, wraps = model.tendon(t).name, slice(model.tendon_adr[t], model.tendon_adr[t] + model.tendon_num[t])
            kinds, ids = model.wrap_type[wraps], model.wrap_objid[wraps]
            joints = [
                model.joint(j).name if kind == mujoco.mjtWrap.mjWRAP_JOINT else ""
                for kind, j in zip(kinds, ids, strict=True)
            ]
            if self.slides.issuperset(joints):  # of a gripper
                continue
            shares = dict(zip(joints, model.wrap_prm[wraps].tolist(), strict=True))
            row = np.array([shares.get(joint, 0.0) for joint in names])
            own = [i for i in np.flatnonzero(row)[::-1].tolist() if i not in tendons]
            if not own or np.count_nonzero(row) != len(joints) or len(joints) < 2:
                self.refuse(f"tendon {quoted(name)}", f"fixed, of several of {listed(names)}")
            tendons[own[0]] = name
            turns[own[0]] = row
        return turns, tendons
