"""URDF and tool file to the constants that compiled code, the nodes and the tests share."""

from __future__ import annotations

import xml.etree.ElementTree as ET
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pinocchio as pin

from rx90_common.base.arrays import Array
from rx90_common.description.tool import MOUNT_LINK, TCP_LINK, attach, load_tool
from rx90_common.description.urdf import JOINT_COUNT, UrdfFile


class RigidChain(NamedTuple):
    """The arm in link frames that are all parallel to the base at q = 0.

    Link i rotates about `axis[i]` through `origin[i]`, both constant in the frame of link i-1 (the base for
    the first), so that no fixed rotation is left: R_i = R_(i-1)·Rot(axis_i, q_i) and
    p_i = p_(i-1) + R_(i-1)·origin_i.
    A NamedTuple, because numba takes one as an argument. The arrays are left writable, because numba
    compiles a kernel a second time for read-only ones; nothing writes to them.

    Attributes:
        origin: (6, 3) joint centre in the frame before it, m; the first from the base.
        axis: (6, 3) unit vectors.
        mass: (6,) kg, with everything fixed to the link, the tool on the last one.
        com: (6, 3) centre of mass in the link frame, m.
        inertia: (6, 6) Ixx, Iyy, Izz, Ixy, Ixz, Iyz about the centre of mass, kg m².
        gravity: (3,) acceleration in the base frame, m/s².
        tcp_position: (3,) tool centre point in the last link frame, m.
        tcp_rotation: (3, 3) its axes in the last link frame, hence in the base at q = 0.
    """

    origin: Array
    axis: Array
    mass: Array
    com: Array
    inertia: Array
    gravity: Array
    tcp_position: Array
    tcp_rotation: Array


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
    return RobotModel(names, text, model, lower, upper, velocity, effort, rigid_chain(model, frame), frame)


def _tcp_frame(file: UrdfFile, model: Any, has_tool: bool) -> str:
    if has_tool:
        return TCP_LINK
    if file.has_link(MOUNT_LINK):
        return MOUNT_LINK
    bodies = [f.name for f in model.frames if f.type == pin.BODY and f.parentJoint == JOINT_COUNT]
    return str(bodies[-1])


def rigid_chain(model: Any, tcp_frame: str) -> RigidChain:
    """Re-express a Pinocchio model of six revolute joints in link frames parallel to the base at q = 0."""
    data = model.createData()
    zero = np.zeros(JOINT_COUNT)
    pin.framesForwardKinematics(model, data, zero)
    pin.computeJointJacobians(model, data, zero)
    # At q = 0 the angular part of column i, in base axes, is the axis of joint i.
    axis = np.array(data.J[3:, :].T)
    position = np.array([data.oMi[i + 1].translation for i in range(JOINT_COUNT)])
    rotation = np.array([data.oMi[i + 1].rotation for i in range(JOINT_COUNT)])
    bodies = [model.inertias[i + 1] for i in range(JOINT_COUNT)]
    tensors = [r @ body.inertia @ r.T for r, body in zip(rotation, bodies, strict=True)]
    tcp = data.oMf[model.getFrameId(tcp_frame)]
    return RigidChain(
        origin=np.diff(position, axis=0, prepend=np.zeros((1, 3))),
        axis=np.ascontiguousarray(axis / np.linalg.norm(axis, axis=1, keepdims=True)),
        mass=np.array([body.mass for body in bodies]),
        com=np.array([r @ body.lever for r, body in zip(rotation, bodies, strict=True)]),
        inertia=np.array([[t[0, 0], t[1, 1], t[2, 2], t[0, 1], t[0, 2], t[1, 2]] for t in tensors]),
        gravity=np.array(model.gravity.linear),
        tcp_position=np.array(tcp.translation - position[-1]),
        tcp_rotation=np.ascontiguousarray(tcp.rotation),
    )
