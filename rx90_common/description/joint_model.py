"""The URDF of any robot as Pinocchio's model of the joints of interest, or a refusal in one line.

`urdf` and `robot` read the arms that this project simulates; here the joints may be some of a tree's.
"""

from __future__ import annotations

import os
import sys
import tempfile
import xml.etree.ElementTree as ET
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pinocchio as pin

from rx90_common.base.errors import IdentificationError
from rx90_common.base.quoting import listed, plain, quoted
from rx90_common.description.robot import RobotModel, load_robot
from rx90_common.description.urdf import read_urdf

_MAX_MASS = 1e5  # kg
_MAX_NUMBER = 1e12  # m and kg m^2: beyond any unit, and its square is a number
_NUMBERS = "link/inertial/origin", "link/inertial/inertia", "joint/origin", "joint/axis"
_KEYS = {"xyz", "rpy", "ixx", "ixy", "ixz", "iyy", "iyz", "izz"}
_TURNING = ("revolute", "continuous")
_STDERR = 2


def joint_model(
    urdf: Path,
    joints: Sequence[str] | None,
    *,
    massless: bool = False,
    followed: Sequence[str] = (),
) -> Any:
    """Return Pinocchio's model of these joints; the others are held at zero.

    Args:
        urdf: the robot's description.
        joints: from base to tip; by default all movable joints.
        massless: whether joints that move no mass are accepted, because only kinematics are wanted.
        followed: further joints that are not held.
    """
    model, root = _read_urdf(urdf)
    there = [str(name) for name in model.names][1:]
    requested = there if joints is None else list(joints)
    in_order = [name for name in there if name in requested]
    bad = {}
    for joint in root.findall("joint"):
        mimic = joint.find("mimic")
        if joint.get("type") not in _TURNING:
            bad[joint.get("name")] = f"is {joint.get('type')}"
        elif mimic is not None:
            bad[joint.get("name")] = f"mimics {mimic.get('joint')}"
    wrong = ""
    if unknown := [name for name in requested if name not in there]:
        wrong = f"no movable joint {quoted(unknown[0])}; there are {listed(there) or 'none'}"
    elif requested != in_order:
        wrong = f"joints {listed(requested)}; accepted: from base to tip, {listed(in_order)}"
    elif not requested:
        wrong = "no movable joint; accepted: one or more"
    elif unfit := [name for name in requested if name in bad]:
        good = " ".join(name for name in there if name not in bad) or "(there are none)"
        wrong = (
            f"joint {quoted(unfit[0])} {plain(bad[unfit[0]])}; accepted: revolute and continuous joints with a drive "
            f"of their own, --joints {good}"
        )
    if wrong:
        raise IdentificationError(f"{urdf}: {wrong}")
    fixed = [model.getJointId(name) for name in there if name not in (*requested, *followed)]
    reduced = pin.buildReducedModel(model, fixed, pin.neutral(model)) if fixed else model
    data = reduced.createData()
    pin.computeSubtreeMasses(reduced, data)
    for name, mass in zip(reduced.names, data.mass, strict=True):
        if name in requested and not massless and not mass > 0.0:
            raise IdentificationError(
                f"{urdf}: joint {quoted(name)} moves a mass of {mass:g} kg; accepted: links with <inertial>"
            )
    return reduced


def movable_joints(urdf: Path) -> tuple[str, ...]:
    """Return the joints of a URDF with one coordinate, as logs have: revolute, continuous or prismatic, no mimics."""
    model, root = _read_urdf(urdf)
    mimics = {
        joint.get("name") for joint in root.findall("joint") if joint.find("mimic") is not None
    }
    pairs = zip(list(model.names)[1:], list(model.joints)[1:], strict=True)
    return tuple(str(name) for name, joint in pairs if joint.nv == 1 and str(name) not in mimics)


def all_joints(urdf: Path) -> tuple[str, ...]:
    """Return all movable joints of a URDF, mimics and joints of several coordinates included."""
    return tuple(
        joint.get("name", "")
        for joint in _read_urdf(urdf)[1].findall("joint")
        if joint.get("type") != "fixed"
    )


def robot_of_urdf(
    urdf: Path, joints: Sequence[str] | None = None, tool: Path | None = None
) -> RobotModel:
    """Read a serial arm from the URDF of any robot.

    Args:
        urdf: the robot's description.
        joints: of interest, from base to tip; by default all that turn and mimic no other. The others are held at 0.
        tool: a tool file; the link `tool0` carries it.
    """
    names = list(joint_model(urdf, joints).names)[1:]
    return load_robot(
        urdf, tool, [name for name in all_joints(urdf) if name not in names], replaced=True
    )


def _read_urdf(urdf: Path) -> tuple[Any, ET.Element]:
    """Return Pinocchio's model of the whole robot, and the root of the file."""
    lines: list[str] = []
    try:
        # Written anew: the XML parser of Pinocchio 2 accepts no document type, and the parser used here fetches
        # nothing.
        root = read_urdf(urdf, "utf-8")
        with _caught_stderr(lines):
            model = pin.buildModelFromXML(ET.tostring(root, encoding="unicode"))
        # an inertial that cannot be read is left out
        if any(line.startswith("Error:") for line in lines):
            raise ValueError
        _check_numbers(urdf, root)
        return model, root
    except UnicodeDecodeError as error:
        raise IdentificationError(
            f"{plain(urdf)}: cannot be read ({error}); accepted: a URDF file"
        ) from error
    except (ValueError, RuntimeError, ET.ParseError) as error:
        message = next(
            (line.removeprefix("Error:") for line in lines if line.startswith("Error:")), str(error)
        )
        reason = " ".join(message.split()) or type(error).__name__
        raise IdentificationError(f"{urdf}: no URDF that Pinocchio can read ({reason})") from error


def _check_numbers(urdf: Path, root: ET.Element) -> None:
    """Refuse axes of length 0, and masses, places and moments that no arm has."""
    for joint in root.findall("joint"):
        axis = joint.find("axis") if joint.get("type") in _TURNING else None
        if axis is not None and not any(map(float, axis.get("xyz", "1").split())):
            raise ValueError(f"axis of joint [{joint.get('name')}] is 0 0 0")
    for link in root.findall("link"):
        mass = link.find("inertial/mass")
        weight = 0.0 if mass is None else float(mass.get("value", "0"))
        if not 0.0 <= weight <= _MAX_MASS:
            name = quoted(link.get("name"))
            raise IdentificationError(
                f"{plain(urdf)}: the mass of link {name} is {weight:g} kg; accepted: 0 to {_MAX_MASS:g} kg"
            )
    for path in _NUMBERS:
        for element in root.iterfind(path):
            for key, text in element.items():
                if key in _KEYS and not all(
                    abs(float(word)) <= _MAX_NUMBER for word in text.split()
                ):
                    raise IdentificationError(
                        f"{plain(urdf)}: <{element.tag} {key}={quoted(text)}>; accepted: numbers up to {_MAX_NUMBER:g}"
                    )


@contextmanager
def _caught_stderr(lines: list[str]) -> Iterator[None]:
    """Collect what is written to file descriptor 2, the only place where the parser below Pinocchio gives reasons."""
    sys.stderr.flush()
    with tempfile.TemporaryFile() as file:
        before = os.dup(_STDERR)
        os.dup2(file.fileno(), _STDERR)
        try:
            yield
        finally:
            os.dup2(before, _STDERR)
            os.close(before)
            file.seek(0)
            lines += file.read().decode("utf-8", "replace").splitlines()
