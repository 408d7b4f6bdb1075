"""URDF and tool file to the constants that compiled code, the nodes and the tests share."""

from __future__ import annotations

import xml.etree.ElementTree as ET
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin

from rx90_common.base.arrays import Array
from rx90_common.description.chain import RigidChain, rigid_chain
from rx90_common.description.tool import MOUNT_LINK, TCP_LINK, attach, load_tool
from rx90_common.description.urdf import JOINT_COUNT, Placement, UrdfFile


@dataclass(frozen=True, eq=False)
class RobotModel:
    """A serial arm of six revolute joints.

    Attributes:
        joint_names: from base to tip.
        urdf: the URDF with the tool merged, for `robot_description`.
        model: Pinocchio's model of that text.
        lower: (6,) rad.
        upper: (6,) rad.
        max_velocity: (6,) rad/s.
        max_effort: (6,) Nm.
        chain: the same arm for compiled code.
        tcp_frame: the link whose frame is the tool centre point.
        placements: the frames of all joints, fixed ones and the tool's too.
    """

    joint_names: tuple[str, ...]
    urdf: str
    model: Any
    lower: Array
    upper: Array
    max_velocity: Array
    max_effort: Array
    chain: RigidChain
    tcp_frame: str
    placements: tuple[Placement, ...]


def load_robot(urdf: Path, tool: Path | None = None) -> RobotModel:
    """Read a URDF of a fixed-base serial arm with six revolute joints, and the tool it carries.

    Without a tool the tool centre point is link `tool0`, or the last link where there is none.

    Raises:
        ConfigError: naming file, element, value and what is accepted.
    """
    file = UrdfFile(urdf)
    if tool is not None:
        attach(file, load_tool(tool))
    text = ET.tostring(file.root, encoding="unicode")
    try:
        model = pin.buildModelFromXML(text)
    except (ValueError, RuntimeError) as error:
        file.refuse("the URDF", " ".join(str(error).split()), "what Pinocchio can read")
    names = tuple(file.limits)
    limits = np.array([(lim.lower, lim.upper, lim.velocity, lim.effort) for lim in file.limits.values()])
    lower, upper, velocity, effort = (np.ascontiguousarray(column) for column in limits.T)
    frame = _tcp_frame(file, model, tool is not None)
    chain, placements = rigid_chain(file, frame), tuple(file.placements())
    return RobotModel(names, text, model, lower, upper, velocity, effort, chain, frame, placements)


def _tcp_frame(file: UrdfFile, model: Any, has_tool: bool) -> str:
    if has_tool:
        return TCP_LINK
    if file.has_link(MOUNT_LINK):
        return MOUNT_LINK
    bodies = [frame for frame in model.frames if frame.type == pin.BODY]
    # Pinocchio 2 calls it `parent`.
    parents = [(f.name, f.parentJoint if hasattr(f, "parentJoint") else f.parent) for f in bodies]
    return str([name for name, joint in parents if joint == JOINT_COUNT][-1])
