"""A URDF as XML and as Pinocchio's model; what neither would refuse is refused here, in one line."""

from __future__ import annotations

import os
import sys
import tempfile
import xml.etree.ElementTree as ET
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pinocchio as pin

from rx90_common.base.errors import ConfigError
from rx90_common.base.quoting import plain, quoted
from rx90_common.base.text_lines import read_bytes
from rx90_common.description.rotations import symmetric

TURNING = ("revolute", "continuous")
"""Types of joints that turn about an axis."""
_INERTIA_KEYS = ("ixx", "iyy", "izz", "ixy", "ixz", "iyz")
# A thin body may miss the triangle inequality by the rounding of its printed digits.
_TRIANGLE_TOLERANCE = 1e-6
_MOST_BYTES = 4 << 20  # elements take many times the memory of their text
_MAX_MASS = 1e5  # kg
_MAX_NUMBER = 1e12  # m and kg m^2: beyond any unit, and its square is a number
_NUMBERS = "link/inertial/origin", "link/inertial/inertia", "joint/origin", "joint/axis"
_STDERR = 2


def inertia_fault(values: tuple[float, ...]) -> str | None:
    """Say why no rigid body has the inertia (Ixx, Iyy, Izz, Ixy, Ixz, Iyz) in kg m², or return None."""
    principal = np.linalg.eigvalsh(symmetric(values))
    if principal[0] <= 0.0:
        return "a positive definite inertia"
    if principal[0] + principal[1] < principal[2] * (1.0 - _TRIANGLE_TOLERANCE):
        return "principal moments of which any two add up to at least the third"
    return None


def robot_name(urdf: str) -> str:
    """Return the name of the robot in a description, empty if it has none.

    Raises:
        ET.ParseError, ValueError: for what is no XML.
    """
    return ET.fromstring(urdf).get("name", "")


def read_urdf(file: Path) -> ET.Element:
    """Return the root of a URDF of accepted size and names, without <dynamics>: nothing here uses its values.

    Raises:
        ConfigError: naming what is not accepted.
    """
    try:
        root = ET.fromstring(read_bytes(file, _MOST_BYTES))
    except (ET.ParseError, ValueError, LookupError) as error:
        raise ConfigError(f"{plain(file)}: not well-formed XML ({error})") from error
    for element in root.iter():
        name = element.get("name", "")
        if not name.isprintable():
            raise ConfigError(
                f"{plain(file)}: the name of an element {quoted(element.tag)} is {quoted(name)}; accepted: one line of "
                "printable characters"
            )
        if "xacro" in element.tag:
            raise ConfigError(
                f"{plain(file)}: an element is xacro; accepted: a plain URDF (expand it with xacro first)"
            )
    for joint in root.findall("joint"):
        for dynamics in joint.findall("dynamics"):
            joint.remove(dynamics)
    return root


def pinocchio_model(file: Path, root: ET.Element) -> Any:
    """Return Pinocchio's model of a URDF.

    Args:
        file: for messages.
        root: of the URDF.

    Raises:
        ConfigError: with the parser's reason; for a joint outside of the tree or without an axis, and for masses and
            lengths that no arm has.
    """
    lines: list[str] = []
    fault: object = ""
    model = None
    try:
        with _caught_errors(lines):
            model = pin.buildModelFromXML(ET.tostring(root, encoding="unicode"))
    except (ValueError, RuntimeError) as error:
        fault = error
    if model is None or lines:  # of an inertial that cannot be read there are lines alone
        reason = " ".join(("; ".join(lines) or str(fault)).split())
        raise ConfigError(f"{plain(file)}: no URDF that Pinocchio can read ({reason})")
    frames = {frame.name for frame in model.frames if frame.type != pin.FrameType.BODY}
    for joint in root.findall("joint"):
        where = f"{plain(file)}: joint {quoted(joint.get('name'))}"
        if joint.get("name") not in frames:
            raise ConfigError(f"{where} hangs at no link of the tree; accepted: one tree of links")
        axis = joint.find("axis")
        if joint.get("type") in TURNING and axis is not None and not any(_numbers(axis, "xyz")):
            raise ConfigError(f"{where}: axis is 0 0 0; accepted: a direction")
    for link in root.findall("link"):
        weight = _numbers(link.find("inertial/mass"), "value")[0]
        if not 0.0 <= weight <= _MAX_MASS:
            raise ConfigError(
                f"{plain(file)}: the mass of link {quoted(link.get('name'))} is {weight:g} kg; accepted: 0 to "
                f"{_MAX_MASS:g} kg"
            )
    for path in _NUMBERS:
        for element in root.iterfind(path):
            for key in ("xyz", "rpy", *_INERTIA_KEYS):
                if not all(abs(number) <= _MAX_NUMBER for number in _numbers(element, key)):
                    text = quoted(element.get(key))
                    raise ConfigError(
                        f"{plain(file)}: <{element.tag} {key}={text}>; accepted: numbers up to {_MAX_NUMBER:g}"
                    )
    return model


@contextmanager
def _caught_errors(lines: list[str]) -> Iterator[None]:
    """Collect the errors that the parser below Pinocchio writes to file descriptor 2, the only place where it does.

    All that it writes without an error, and other threads, comes behind.
    """
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
            written = file.read()
            for line in written.decode("utf-8", "replace").splitlines():
                if line.startswith("Error:"):
                    lines.append(line.removeprefix("Error:").strip())
            if not lines:
                os.write(_STDERR, written)


class Placement(NamedTuple):
    """A joint's frame in its parent link, m and rad (roll, pitch, yaw about fixed axes), and its axis in that frame."""

    name: str
    parent: str
    child: str
    xyz: tuple[float, ...]
    rpy: tuple[float, ...]
    axis: tuple[float, ...]


class LinkBody(NamedTuple):
    """The <inertial> of a link: kg, m, rad, and Ixx, Iyy, Izz, Ixy, Ixz, Iyz in kg m²."""

    link: str
    mass: float
    xyz: tuple[float, ...]
    rpy: tuple[float, ...]
    inertia: tuple[float, ...]


def placements(root: ET.Element) -> list[Placement]:
    """Return the frames of all joints of a URDF that `pinocchio_model` accepts, each after those before it."""
    left = root.findall("joint")
    known = {link.get("name") for link in root.findall("link")}
    known -= {_end(joint, "child") for joint in left}
    ordered = []
    while left:
        for joint in list(left):
            parent = _end(joint, "parent")
            if parent in known:
                child = _end(joint, "child")
                axis = _numbers(joint.find("axis"), "xyz", "1 0 0")
                ordered.append(
                    Placement(joint.get("name", ""), parent, child, *_origin(joint), axis)
                )
                known.add(child)
                left.remove(joint)
    return ordered


def bodies(root: ET.Element) -> list[LinkBody]:
    """Return the bodies of all links that have one."""
    found = []
    for link in root.findall("link"):
        inertial = link.find("inertial")
        if inertial is not None:
            mass = _numbers(inertial.find("mass"), "value")[0]
            inertia = tuple(_numbers(inertial.find("inertia"), key)[0] for key in _INERTIA_KEYS)
            if mass or any(inertia):  # some write zeros where there is nothing but a frame
                found.append(LinkBody(link.get("name", ""), mass, *_origin(inertial), inertia))
    return found


def _end(joint: ET.Element, end: str) -> str:
    """Return the link at the "parent" or "child" end of a joint."""
    element = joint.find(end)
    return "" if element is None else element.get("link", "")


def _origin(element: ET.Element) -> tuple[tuple[float, ...], tuple[float, ...]]:
    origin = element.find("origin")
    return _numbers(origin, "xyz", "0 0 0"), _numbers(origin, "rpy", "0 0 0")


def _numbers(element: ET.Element | None, key: str, default: str = "0") -> tuple[float, ...]:
    text = default if element is None else element.get(key, default)
    return tuple(map(float, text.split()))
