"""The tool on the flange: read its file and add it to a URDF as links `tool` and `tcp`."""

from __future__ import annotations

import math
import xml.etree.ElementTree as ET
from dataclasses import dataclass
from pathlib import Path

from rx90_common.base.config import Section, load_yaml
from rx90_common.description.urdf import UrdfFile, inertia_fault

MOUNT_LINK = "tool0"
TOOL_LINK = "tool"
TCP_LINK = "tcp"
_COLOR = "0.75 0.15 0.15 1"


@dataclass(frozen=True)
class Cylinder:
    """A cylinder along z of the mount, m."""

    start: float
    end: float
    radius: float


@dataclass(frozen=True)
class Tool:
    """A tool in the axes of link `tool0`.

    Attributes:
        mass: kg.
        center_of_mass: m.
        inertia: Ixx, Iyy, Izz, Ixy, Ixz, Iyz about the centre of mass, kg m².
        tcp_position: tool centre point, m.
        tcp_rpy: its roll, pitch and yaw about fixed axes, rad.
        visual: its shape, for display.
        collision: its shape, for collision checks.
    """

    mass: float
    center_of_mass: tuple[float, ...]
    inertia: tuple[float, ...]
    tcp_position: tuple[float, ...]
    tcp_rpy: tuple[float, ...]
    visual: tuple[Cylinder, ...]
    collision: tuple[Cylinder, ...]


def load_tool(file: Path) -> Tool:
    """Read a tool file.

    Raises:
        ConfigError: naming file, key, value and what is accepted.
    """
    root = load_yaml(file)
    inertial = root.section("inertial")
    tcp = root.section("tcp")
    tool = Tool(
        mass=inertial.number("mass", 0.0, above=True),
        center_of_mass=inertial.numbers("center_of_mass", 3),
        inertia=inertial.numbers("inertia", 6),
        tcp_position=tcp.numbers("position", 3),
        tcp_rpy=tuple(math.radians(angle) for angle in tcp.numbers("rpy_degrees", 3, -360.0, 360.0)),
        visual=_cylinders(root, "visual"),
        collision=_cylinders(root, "collision"),
    )
    fault = inertia_fault(tool.inertia)
    if fault is not None:
        inertial.refuse("inertia", list(tool.inertia), fault)
    for section in (inertial, tcp, root):
        section.finish()
    return tool


def _cylinders(root: Section, kind: str) -> tuple[Cylinder, ...]:
    """Return the shapes in a block that may be left out."""
    if kind not in root:
        return ()
    block = root.section(kind)
    section = block.section("cylinders")
    block.finish()
    shapes = []
    for name in section:
        shape = Cylinder(*section.numbers(name, 3))
        if not (shape.start < shape.end and shape.radius > 0.0):
            section.refuse(name, [shape.start, shape.end, shape.radius], "from < to, and a radius > 0")
        shapes.append(shape)
    return tuple(shapes)


def _text(values: tuple[float, ...]) -> str:
    return " ".join(repr(value) for value in values)


def _fixed_joint(robot: ET.Element, child: str, xyz: tuple[float, ...], rpy: tuple[float, ...]) -> None:
    joint = ET.SubElement(robot, "joint", name=f"{child}_fixed", type="fixed")
    ET.SubElement(joint, "origin", xyz=_text(xyz), rpy=_text(rpy))
    ET.SubElement(joint, "parent", link=MOUNT_LINK)
    ET.SubElement(joint, "child", link=child)


def _shape(link: ET.Element, kind: str, cylinder: Cylinder) -> ET.Element:
    """Add a cylinder to a link as its "visual" or "collision"; return that element."""
    element = ET.SubElement(link, kind)
    ET.SubElement(
        element, "origin", xyz=_text((0.0, 0.0, (cylinder.start + cylinder.end) / 2.0)), rpy=_text((0.0,) * 3)
    )
    geometry = ET.SubElement(element, "geometry")
    ET.SubElement(geometry, "cylinder", radius=repr(cylinder.radius), length=repr(cylinder.end - cylinder.start))
    return element


def attach(urdf: UrdfFile, tool: Tool) -> None:
    """Add the links `tool` (inertia, shape) and `tcp` (frame) below `tool0`, in place.

    Raises:
        ConfigError: if the URDF has no link `tool0`, or already has a `tool` or `tcp`.
    """
    if not urdf.has_link(MOUNT_LINK):
        urdf.refuse(f"link '{MOUNT_LINK}'", None, "a link of that name to carry the tool")
    for name in (TOOL_LINK, TCP_LINK):
        if urdf.has_link(name):
            urdf.refuse("a link", name, "a URDF without that link, where a tool file is given")
    zero = (0.0, 0.0, 0.0)
    link = ET.SubElement(urdf.root, "link", name=TOOL_LINK)
    inertial = ET.SubElement(link, "inertial")
    ET.SubElement(inertial, "origin", xyz=_text(tool.center_of_mass), rpy=_text(zero))
    ET.SubElement(inertial, "mass", value=repr(tool.mass))
    keys = ("ixx", "iyy", "izz", "ixy", "ixz", "iyz")
    ET.SubElement(inertial, "inertia", {key: repr(value) for key, value in zip(keys, tool.inertia, strict=True)})
    for cylinder in tool.visual:
        material = ET.SubElement(_shape(link, "visual", cylinder), "material", name="tool")
        ET.SubElement(material, "color", rgba=_COLOR)
    for cylinder in tool.collision:
        _shape(link, "collision", cylinder)
    _fixed_joint(urdf.root, TOOL_LINK, zero, zero)
    ET.SubElement(urdf.root, "link", name=TCP_LINK)
    _fixed_joint(urdf.root, TCP_LINK, tool.tcp_position, tool.tcp_rpy)
