"""The arm as URDF, for Drake beside it the LuGre law as a system, and as SDF for Gazebo."""

from __future__ import annotations

import json
import math
import xml.etree.ElementTree as ET
from collections.abc import Sequence
from pathlib import Path

from rx90_common.friction.curves import LINEAR_SPEED
from rx90_common.friction.element import FRICTION_UNITS
from rx90_emulator.export.fit import FrictionFit
from rx90_emulator.export.targets import Target
from rx90_emulator.loop.setup import Arm

Files = tuple[dict[str, str], list[str]]

_SDF_VERSION = "1.9"  # of Gazebo Garden and Harmonic; frames and relative poses came with 1.7
_DRAKE = "http://drake.mit.edu"


def write_urdf(arm: Arm, target: Target, fits: Sequence[FrictionFit]) -> Files:  # noqa: ARG001 - as of every target
    """Return the robot's URDF with its tool, and friction and damping of its joints."""
    root = ET.fromstring(arm.robot.urdf)
    for fit in fits:
        joint = _joint(root, fit.name)
        for old in joint.findall("dynamics"):
            joint.remove(old)
        viscous, coulomb = fit.law.viscous[0], fit.law.tau_c
        ET.SubElement(joint, "dynamics", damping=repr(viscous), friction=repr(coulomb))
    largest = arm.drives.rotor_inertia.max()
    return _named(arm, root, "urdf"), [
        f"rotor inertias, which a URDF does not have: up to {largest:g} kg m^2 at a joint"
    ]


def write_drake(arm: Arm, target: Target, fits: Sequence[FrictionFit]) -> Files:  # noqa: ARG001
    """Return the URDF with Drake's rotors, and a module with the friction elements as a LeafSystem.

    Drake's reader takes the damping of a joint and leaves dry friction out, so the URDF has neither.
    """
    root, drives = ET.fromstring(arm.robot.urdf), arm.drives
    ET.register_namespace("drake", _DRAKE)
    for i, name in enumerate(arm.robot.joint_names):
        for old in _joint(root, name).findall("dynamics"):
            _joint(root, name).remove(old)
        transmission = ET.SubElement(root, "transmission", name=f"transmission_{i + 1}")
        ET.SubElement(transmission, "type").text = "transmission_interface/SimpleTransmission"
        ET.SubElement(transmission, "joint", name=name)
        actuator, gear = ET.SubElement(transmission, "actuator", name=f"motor_{i + 1}"), float(drives.gear[i])
        # As large as Drake squares it with the gear; where a motor turns with two joints, it stands in both.
        turning = drives.rotor_inertia @ (arm.drives.turning.turns[:, i] ** 2)
        ET.SubElement(actuator, f"{{{_DRAKE}}}gear_ratio", value=repr(gear))
        ET.SubElement(actuator, f"{{{_DRAKE}}}rotor_inertia", value=repr(float(turning) / gear**2))
    numbers = {fit.name: {name: _plain(getattr(fit.elements[0], name)) for name in FRICTION_UNITS} for fit in fits}
    template = (Path(__file__).parent / "templates" / "drake_friction.py.txt").read_text(encoding="utf-8")
    text = template.replace("@ELEMENTS@", json.dumps(numbers, indent=4).replace("null", "math.inf"))
    text = text.replace("@INPUTS@", json.dumps(arm.drives.turning.element_matrix.tolist())).replace(
        "@LINEAR@", repr(LINEAR_SPEED)
    )
    return {**_named(arm, root, "urdf"), "friction.py": text}, []


def _plain(value: float) -> float | None:
    return float(value) if math.isfinite(value) else None


def write_sdf(arm: Arm, target: Target, fits: Sequence[FrictionFit]) -> Files:  # noqa: ARG001
    """Return the robot as SDF. Links without a mass, such as tool0, are frames; meshes and shapes are left out."""
    urdf, robot = ET.fromstring(arm.robot.urdf), arm.robot
    sdf = ET.Element("sdf", version=_SDF_VERSION)
    model = ET.SubElement(sdf, "model", name=str(robot.model.name))
    bodies = {one.get("name", ""): one.find("inertial") for one in urdf.findall("link")}
    places = {place.child: place for place in robot.placements}
    (base,) = [name for name in bodies if name not in places]
    _add_link(model, base, bodies[base], None)
    fixed = ET.SubElement(model, "joint", name="world_fixed", type="fixed")
    _texts(fixed, parent="world", child=base)
    moving = {fit.name: fit for fit in fits}
    for place in robot.placements:
        pose = " ".join(map(repr, (*place.xyz, *place.rpy)))
        if place.name not in moving and bodies[place.child] is None:
            frame = ET.SubElement(model, "frame", {"name": place.child, "attached_to": place.parent})
            ET.SubElement(frame, "pose").text = pose
            continue
        joint = ET.SubElement(model, "joint", name=place.name, type="revolute" if place.name in moving else "fixed")
        ET.SubElement(joint, "pose", {"relative_to": place.parent}).text = pose
        _texts(joint, parent=place.parent, child=place.child)
        _add_link(model, place.child, bodies[place.child], place.name)
        if place.name in moving:
            k, law = robot.joint_names.index(place.name), moving[place.name].law
            axis = ET.SubElement(joint, "axis")
            _texts(axis, xyz=" ".join(map(repr, place.axis)))
            limits = (robot.lower[k], robot.upper[k], robot.max_effort[k], robot.max_velocity[k])
            names = ("lower", "upper", "effort", "velocity")
            numbers = {name: repr(float(value)) for name, value in zip(names, limits, strict=True)}
            _texts(ET.SubElement(axis, "limit"), **numbers)
            _texts(ET.SubElement(axis, "dynamics"), damping=repr(law.viscous[0]), friction=repr(law.tau_c))
    largest = arm.drives.rotor_inertia.max()
    return _named(arm, sdf, "sdf"), [f"rotor inertias, which SDF does not have: up to {largest:g} kg m^2 at a joint"]


def _add_link(model: ET.Element, name: str, inertial: ET.Element | None, joint: str | None) -> None:
    """Add a link in the frame of the joint above it, with the <inertial> of the URDF."""
    link = ET.SubElement(model, "link", name=name)
    if joint is not None:
        ET.SubElement(link, "pose", {"relative_to": joint})
    if inertial is None:
        return
    own, origin = ET.SubElement(link, "inertial"), inertial.find("origin")
    at = ("0 0 0", "0 0 0") if origin is None else (origin.get("xyz", "0 0 0"), origin.get("rpy", "0 0 0"))
    mass, inertia = inertial.find("mass"), inertial.find("inertia")
    assert mass is not None
    assert inertia is not None
    _texts(own, pose=" ".join(at), mass=mass.get("value", ""))
    _texts(ET.SubElement(own, "inertia"), **inertia.attrib)


def _texts(element: ET.Element, /, **texts: str) -> None:
    for tag, text in texts.items():
        ET.SubElement(element, tag).text = text


def _joint(root: ET.Element, name: str) -> ET.Element:
    return next(one for one in root.findall("joint") if one.get("name") == name)


def _named(arm: Arm, root: ET.Element, suffix: str) -> dict[str, str]:
    ET.indent(root)
    text = ET.tostring(root, encoding="unicode", xml_declaration=True) + "\n"
    return {f"{arm.robot.model.name}.{suffix}": text}
