"""URDF and tool file to the constants that compiled code, the nodes and the tests share.

The tool on the flange becomes links `tool` and `tcp` of the URDF.
"""

from __future__ import annotations

import math
import xml.etree.ElementTree as ET
from collections.abc import Collection
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, NoReturn, TypeAlias

import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike
from pydantic import Field, model_validator

from rx90_common.base.arrays import MAX_JOINTS, Array
from rx90_common.base.errors import ConfigError, Rx90Error
from rx90_common.base.models import (
    FileModel,
    Named,
    Positive,
    Triple,
    quantity,
    read_model,
    refusal,
)
from rx90_common.base.quoting import counted, plain, quoted
from rx90_common.description.chain import RigidChain, rigid_chain
from rx90_common.description.urdf import (
    Placement,
    inertia_fault,
    pinocchio_model,
    placements,
    read_urdf,
)

MOUNT_LINK = "tool0"
TOOL_LINK = "tool"
TCP_LINK = "tcp"
_MATERIAL = '<material name="tool"><color rgba="0.75 0.15 0.15 1"/></material>'
_Degrees: TypeAlias = Annotated[
    tuple[Annotated[float, Field(ge=-360.0, le=360.0)], ...],
    Field(strict=False, min_length=3, max_length=3),
]


class Inertial(FileModel):
    """The tool as a rigid body."""

    mass: Annotated[Positive, quantity("kg", "Mass.")]
    center_of_mass: Annotated[Triple, quantity("m", "Centre of mass.")]
    inertia: Annotated[
        Annotated[tuple[float, ...], Field(strict=False, min_length=6, max_length=6)],
        quantity(
            "kg m^2",
            "Ixx, Iyy, Izz, Ixy, Ixz, Iyz about the centre of mass; such as a body can have.",
        ),
    ]

    @model_validator(mode="after")
    def _check_inertia(self) -> Inertial:
        fault = inertia_fault(self.inertia)
        if fault is not None:
            raise refusal("inertia", list(self.inertia), fault)
        return self


class ToolCentrePoint(FileModel):
    """The tool centre point."""

    position: Annotated[Triple, quantity("m", "Where it is.")]
    rpy_degrees: Annotated[_Degrees, quantity("deg", "Its roll, pitch and yaw about fixed axes.")]


class Cylinders(Named[Triple]):
    """Cylinders along z of tool0, by names of your own: from, to, radius, m."""

    @model_validator(mode="after")
    def _check_shapes(self) -> Cylinders:
        for name, (start, end, radius) in self.entries.items():
            if not (start < end and radius > 0.0):
                raise refusal(name, [start, end, radius], "from < to, and a radius > 0")
        return self


class Shape(FileModel):
    """The tool's shape."""

    cylinders: Cylinders


class Tool(FileModel):
    """A tool on the flange, in the axes of link tool0."""

    inertial: Inertial
    tcp: ToolCentrePoint
    visual: Annotated[Shape | None, Field(description="The tool's shape, for display.")] = None
    collision: Annotated[
        Shape | None, Field(description="The tool's shape, for collision checks.")
    ] = None


def load_tool(file: Path) -> Tool:
    """Read a tool file."""
    return read_model(Tool, file)


def _text(values: tuple[float, ...]) -> str:
    return " ".join(map(repr, values))


def _shapes(kind: str, shape: Shape | None, material: str = "") -> str:
    """Return the cylinders of a shape as elements of this kind, "visual" or "collision"."""
    cylinders = () if shape is None else shape.cylinders.entries.values()
    return "".join(
        f'<{kind}><origin xyz="0.0 0.0 {(start + end) / 2.0}" rpy="0.0 0.0 0.0"/>'
        f'<geometry><cylinder radius="{radius}" length="{end - start}"/></geometry>{material}</{kind}>'
        for start, end, radius in cylinders
    )


def _fixed_joint(child: str, xyz: tuple[float, ...], rpy: tuple[float, ...]) -> str:
    return (
        f'<joint name="{child}_fixed" type="fixed"><origin xyz="{_text(xyz)}" rpy="{_text(rpy)}"/>'
        f'<parent link="{MOUNT_LINK}"/><child link="{child}"/></joint>'
    )


def attach(root: ET.Element, tool: Tool, urdf: Path) -> None:
    """Add the links `tool` (inertia, shape) and `tcp` (frame) below `tool0` to the root of a URDF, in place."""
    links = [link.get("name") for link in root.findall("link")]
    if MOUNT_LINK not in links:
        raise ConfigError(
            f"{urdf}: link '{MOUNT_LINK}' is None; accepted: a link of that name to carry the tool"
        )
    for name in (TOOL_LINK, TCP_LINK):
        if name in links:
            raise ConfigError(
                f"{urdf}: a link is '{name}'; accepted: a URDF without that link, where a tool file is given"
            )
    ixx, iyy, izz, ixy, ixz, iyz = tool.inertial.inertia
    zero = (0.0, 0.0, 0.0)
    angles = tuple(map(math.radians, tool.tcp.rpy_degrees))
    added = (
        f'<robot><link name="{TOOL_LINK}"><inertial>'
        f'<origin xyz="{_text(tool.inertial.center_of_mass)}" rpy="{_text(zero)}"/>'
        f'<mass value="{tool.inertial.mass}"/>'
        f'<inertia ixx="{ixx}" iyy="{iyy}" izz="{izz}" ixy="{ixy}" ixz="{ixz}" iyz="{iyz}"/></inertial>'
        f"{_shapes('visual', tool.visual, _MATERIAL)}{_shapes('collision', tool.collision)}</link>"
        f'{_fixed_joint(TOOL_LINK, zero, zero)}<link name="{TCP_LINK}"/>'
        f"{_fixed_joint(TCP_LINK, tool.tcp.position, angles)}</robot>"
    )
    root.extend(ET.fromstring(added))


@dataclass(frozen=True, eq=False)
class RobotModel:
    """A serial arm of n revolute joints.

    Attributes:
        joint_names: from base to tip.
        urdf: the URDF with the tool merged, for `robot_description`.
        model: Pinocchio's model of that text.
        lower: (n,) rad.
        upper: (n,) rad.
        max_velocity: (n,) rad/s.
        max_effort: (n,) Nm.
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

    def check_count(self, file: Path, name: str, values: Array) -> None:
        """Check that the lists of a file with one value for each joint have as many values as the arm has joints."""
        joints = len(self.joint_names)
        if len(values) != joints:
            accepted = f"accepted: {joints}, one for each joint of {plain(self.model.name)}"
            raise ConfigError(
                f"{plain(file)}: {name} has {counted(len(values), 'number')}; {accepted}"
            )

    def check_position(
        self, what: str, position: ArrayLike, kind: type[Rx90Error] = ConfigError
    ) -> None:
        """Check that a position, rad, is within the ranges of the joints; refused by an error of a kind."""
        if np.shape(position) != self.lower.shape:
            raise kind(f"{what} has shape {np.shape(position)}; accepted: {self.lower.shape}")
        for name, value, low, high in zip(
            self.joint_names, np.asarray(position), self.lower, self.upper, strict=True
        ):
            if not low <= value <= high:
                raise kind(
                    f"{what}: {name} is {value:.12g} rad; accepted: [{low:.5g}, {high:.5g}], the joint's limits"
                )


def load_robot(
    urdf: Path, tool: Path | None = None, held: Collection[str] = (), replaced: bool = False
) -> RobotModel:
    """Read a URDF of a fixed-base serial arm with 1 to 7 revolute joints, and the tool it carries.

    Without a tool the tool centre point is link `tool0`, or the last link if there is none. `held` joints
    are fixed, at the URDF's zero position. Inertias that are to be `replaced` may have any values.
    """
    root = read_urdf(urdf)
    for joint in root.findall("joint"):
        _hold_or_bound(urdf, joint, joint.get("name") in held)
    if tool is not None:
        attach(root, load_tool(tool), urdf)
    model = pinocchio_model(urdf, root)
    names = tuple(map(str, list(model.names)[1:]))
    _check_arm(urdf, model, names)
    frame = _tcp_frame(model, tool is not None)
    chain = rigid_chain(root, names, frame)
    for name, inertia in zip(names, chain.inertia, strict=True):
        fault = None if replaced else inertia_fault(tuple(inertia.tolist()))
        if fault is not None:
            _refuse(urdf, name, f"moves the inertia {inertia.tolist()} kg m^2", fault)
    return RobotModel(
        joint_names=names,
        urdf=ET.tostring(root, encoding="unicode"),
        model=model,
        lower=np.array(model.lowerPositionLimit),
        upper=np.array(model.upperPositionLimit),
        max_velocity=np.array(model.velocityLimit),
        max_effort=np.array(model.effortLimit),
        chain=chain,
        tcp_frame=frame,
        placements=tuple(placements(root)),
    )


def _hold_or_bound(urdf: Path, joint: ET.Element, held: bool) -> None:
    """Fix a joint; or let a continuous one with a speed and an effort turn by half a turn either way."""
    limit = joint.find("limit")
    mimic = joint.find("mimic")
    if held:
        joint.set("type", "fixed")
        if mimic is not None:
            joint.remove(mimic)
    elif joint.get("type") == "continuous" and limit is not None:
        joint.set("type", "revolute")
        limit.set("lower", str(-math.pi))
        limit.set("upper", str(math.pi))
    kind = joint.get("type")
    if kind not in {"revolute", "fixed"}:
        accepted = "revolute, or continuous with a <limit>, or fixed"
        _refuse(urdf, joint.get("name"), f"type is {quoted(kind)}", accepted)
    # what stands at a joint that does not move says nothing
    if kind == "revolute" and mimic is not None:
        _refuse(urdf, joint.get("name"), "is a mimic", "joints that move by themselves")


def _check_arm(urdf: Path, model: Any, names: tuple[str, ...]) -> None:
    """Refuse what is no arm of joints in series that can move and have a mass."""
    if not 1 <= len(names) <= MAX_JOINTS:
        raise ConfigError(
            f"{plain(urdf)}: {counted(len(names), 'revolute joint')}; accepted: 1 to {MAX_JOINTS}, in series"
        )
    for number, name in enumerate(names):
        lower = model.lowerPositionLimit[number]
        upper = model.upperPositionLimit[number]
        velocity = model.velocityLimit[number]
        effort = model.effortLimit[number]
        if model.parents[number + 1] != number:
            _refuse(urdf, name, "is on a side branch", "revolute joints in series")
        if not lower < upper:
            _refuse(urdf, name, f"limit lower is {lower:g}", f"a number < upper = {upper:g} rad")
        if not (velocity > 0.0 and effort > 0.0):
            fault = f"limit has velocity {velocity:g} and effort {effort:g}"
            _refuse(urdf, name, fault, "numbers > 0, rad/s and Nm")
        if not model.inertias[number + 1].mass > 0.0:
            _refuse(urdf, name, "moves no mass", "links with <inertial>")


def _refuse(urdf: Path, joint: str | None, fault: str, accepted: str) -> NoReturn:
    raise ConfigError(f"{plain(urdf)}: joint {quoted(joint)} {fault}; accepted: {accepted}")


def _tcp_frame(model: Any, has_tool: bool) -> str:
    if has_tool:
        return TCP_LINK
    links = [frame for frame in model.frames if frame.type == pin.BODY]
    if any(link.name == MOUNT_LINK for link in links):
        return MOUNT_LINK
    return str([link.name for link in links if joint_of(link) == model.njoints - 1][-1])


def joint_of(frame: Any) -> int:
    """Return the number of the joint that moves a frame, 0 for the base; Pinocchio 2 calls it `parent`."""
    return int(frame.parentJoint if hasattr(frame, "parentJoint") else frame.parent)
