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
    """A cylinder along z of the mount, for display, m."""

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
        cylinders: its shape, for display.
    """

    mass: float
    center_of_mass: tuple[float, ...]
    inertia: tuple[float, ...]
    tcp_position: tuple[float, ...]
    tcp_rpy: tuple[float, ...]
    cylinders: tuple[Cylinder, ...]


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
        cylinders=_cylinders(root.section("visual")) if "visual" in root else (),
    )
    fault = inertia_fault(tool.inertia)
    if fault is not None:
        inertial.refuse("inertia", list(tool.inertia), fault)
    for section in (inertial, tcp, root):
        section.finish()
    return tool


def _cylinders(visual: Section) -> tuple[Cylinder, ...]:
    section = visual.section("cylinders")
    visual.finish()
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
    for cylinder in tool.cylinders:
        visual = ET.SubElement(link, "visual")
        middle = (0.0, 0.0, (cylinder.start + cylinder.end) / 2.0)
        ET.SubElement(visual, "origin", xyz=_text(middle), rpy=_text(zero))
        geometry = ET.SubElement(visual, "geometry")
        length = repr(cylinder.end - cylinder.start)
        ET.SubElement(geometry, "cylinder", radius=repr(cylinder.radius), length=length)
        material = ET.SubElement(visual, "material", name="tool")
        ET.SubElement(material, "color", rgba=_COLOR)
    _fixed_joint(urdf.root, TOOL_LINK, zero, zero)
    ET.SubElement(urdf.root, "link", name=TCP_LINK)
    _fixed_joint(urdf.root, TCP_LINK, tool.tcp_position, tool.tcp_rpy)
