"""The URDF of any robot as Pinocchio's model of the joints of interest, or a refusal in one line.

`urdf` and `robot` read the arms that this project simulates; here the joints may be some of a tree's.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import pinocchio as pin

from rx90_common.base.errors import IdentificationError
from rx90_common.base.quoting import listed, plain, quoted
from rx90_common.description.robot import RobotModel, load_robot
from rx90_common.description.urdf import TURNING, pinocchio_model, read_urdf


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
    root = read_urdf(urdf)
    model = pinocchio_model(urdf, root)
    there = [str(name) for name in model.names][1:]
    requested = there if joints is None else list(joints)
    in_order = [name for name in there if name in requested]
    bad = {}
    for joint in root.findall("joint"):
        mimic = joint.find("mimic")
        if joint.get("type") not in TURNING:
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
    root = read_urdf(urdf)
    model = pinocchio_model(urdf, root)
    mimics = {
        joint.get("name") for joint in root.findall("joint") if joint.find("mimic") is not None
    }
    pairs = zip(list(model.names)[1:], list(model.joints)[1:], strict=True)
    return tuple(str(name) for name, joint in pairs if joint.nv == 1 and str(name) not in mimics)


def all_joints(urdf: Path) -> tuple[str, ...]:
    """Return all movable joints of a URDF, mimics and joints of several coordinates included."""
    return tuple(
        joint.get("name", "")
        for joint in read_urdf(urdf).findall("joint")
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
