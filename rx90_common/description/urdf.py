"""Read a URDF and report errors in one line, before any library reads it.

Only a fixed-base arm of 1 to 7 revolute joints in series passes; fixed side branches are allowed. A continuous joint
with a speed and an effort counts as revolute, half a turn either way.
"""

from __future__ import annotations

import math
import xml.etree.ElementTree as ET
from collections.abc import Collection
from pathlib import Path
from typing import NamedTuple, NoReturn

import numpy as np

from rx90_common.base.arrays import MAX_JOINTS
from rx90_common.base.errors import ConfigError
from rx90_common.base.quoting import plain, quoted
from rx90_common.base.text_lines import read_bytes

_INERTIA_KEYS = ("ixx", "iyy", "izz", "ixy", "ixz", "iyz")
# A thin body may miss the triangle inequality by the rounding of its printed digits.
_TRIANGLE_TOLERANCE = 1e-6
_MOST_BYTES = 4 << 20  # elements take many times the memory of their text


def inertia_fault(values: tuple[float, ...]) -> str | None:
    """Say why no rigid body has the inertia (Ixx, Iyy, Izz, Ixy, Ixz, Iyz) in kg m², or return None."""
    ixx, iyy, izz, ixy, ixz, iyz = values
    principal = np.linalg.eigvalsh(np.array([[ixx, ixy, ixz], [ixy, iyy, iyz], [ixz, iyz, izz]]))
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


def read_urdf(file: Path, encoding: str | None = None) -> ET.Element:
    """Return the root of a URDF of accepted size, names and <dynamics>.

    Args:
        file: the URDF.
        encoding: of its text; None: the one that it states.

    Raises:
        ConfigError: naming what is not accepted.
        ValueError, LookupError: if it is no XML (ElementTree.ParseError).
    """
    content = read_bytes(file, _MOST_BYTES)
    root = ET.fromstring(content if encoding is None else content.decode(encoding))
    for element in root.iter():
        name = element.get("name", "")
        if not name.isprintable():
            raise ConfigError(
                f"{plain(file)}: the name of an element {quoted(element.tag)} is {quoted(name)}; accepted: one line of "
                "printable characters"
            )
    _check_dynamics(file, root)
    return root


def _check_dynamics(file: Path, root: ET.Element) -> None:
    """Refuse <dynamics> of a joint that Pinocchio refuses without naming the joint; nothing here uses its values."""
    for joint in root.findall("joint"):
        for dynamics in joint.findall("dynamics"):
            for key in ("damping", "friction"):
                text = dynamics.get(key, "0")
                try:
                    good = 0.0 <= float(text) < math.inf
                except ValueError:
                    good = False
                if not good:
                    raise ConfigError(
                        f"{plain(file)}: joint {quoted(joint.get('name'))} dynamics {key} is {quoted(text)}; accepted: "
                        f"a finite number >= 0, or no {key}: friction is in the friction file"
                    )


class Limits(NamedTuple):
    """Limits of one revolute joint: rad, rad/s, Nm."""

    lower: float
    upper: float
    velocity: float
    effort: float


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


def _bound(joint: ET.Element) -> None:
    """Let a continuous joint turn by half a turn either way."""
    limit = joint.find("limit")
    if limit is not None:
        joint.set("type", "revolute")
        limit.set("lower", str(-math.pi))
        limit.set("upper", str(math.pi))


class UrdfFile:
    """A checked URDF; every refusal names file, element, value and what is accepted.

    Args:
        file: where it is.
        held: joints to be fixed.
        replaced: whether the inertias of the moving links are to be replaced, and are not checked.

    Attributes:
        file: its path.
        root: the XML element `robot`.
        links: the elements of the links by name.
        limits: limits of the revolute joints by name, in chain order from the base.
    """

    def __init__(self, file: Path, held: Collection[str] = (), replaced: bool = False) -> None:
        self.file = file
        self._replaced = replaced
        self.root = self._parse()
        for joint in self.root.findall("joint"):
            if joint.get("name") in held:
                joint.set("type", "fixed")
                for mimic in joint.findall("mimic"):
                    joint.remove(mimic)
            elif joint.get("type") == "continuous":
                _bound(joint)
        self.links = self._named("link")
        self._joints = self._named("joint")
        self._parent_joint = self._tree()
        self.base_link = next(name for name in self.links if name not in self._parent_joint)
        self.limits = {name: self._limits(name, self._joints[name]) for name in self._chain()}

    def refuse(self, element: str, value: object, accepted: str) -> NoReturn:
        """Raise a ConfigError that names file, element, value and the accepted values."""
        raise ConfigError(f"{self.file}: {element} is {quoted(value)}; accepted: {accepted}")

    def _parse(self) -> ET.Element:
        try:
            root = read_urdf(self.file)
        except (ET.ParseError, ValueError, LookupError) as error:
            raise ConfigError(f"{self.file}: not well-formed XML ({error})") from error
        if root.tag != "robot":
            self.refuse("the root element", root.tag, "robot")
        if any("xacro" in element.tag for element in root.iter() if isinstance(element.tag, str)):
            self.refuse("an element", "xacro", "a plain URDF (expand it with xacro first)")
        return root

    def _named(self, tag: str) -> dict[str, ET.Element]:
        found: dict[str, ET.Element] = {}
        for element in self.root.findall(tag):
            name = element.get("name", "")
            if not name or name in found:
                self.refuse(f"a {tag} name", name, f"a name for each {tag}, used once")
            found[name] = element
        if not found:
            self.refuse(f"the number of {tag}s", 0, f"at least one {tag}")
        return found

    def _numbers(
        self, element: ET.Element | None, where: str, key: str, default: str | None
    ) -> list[float]:
        text = default if element is None else element.get(key, default)
        accepted = (
            "a finite number" if default is None else f"{len(default.split())} finite numbers"
        )
        if text is None:
            raise ConfigError(f"{self.file}: {where} {key} is missing; accepted: a finite number")
        try:
            values = [float(word) for word in text.split()]
        except ValueError:
            self.refuse(f"{where} {key}", text, accepted)
        count = 1 if default is None else len(default.split())
        if len(values) != count or not all(math.isfinite(value) for value in values):
            self.refuse(f"{where} {key}", text, accepted)
        return values

    def _origin(
        self, parent: ET.Element, where: str
    ) -> tuple[tuple[float, ...], tuple[float, ...]]:
        origin = parent.find("origin")
        xyz = self._numbers(origin, f"{where} origin", "xyz", "0 0 0")
        rpy = self._numbers(origin, f"{where} origin", "rpy", "0 0 0")
        return tuple(xyz), tuple(rpy)

    def _body(self, name: str, link: ET.Element) -> LinkBody | None:
        inertial = link.find("inertial")
        if inertial is None:
            return None
        where = f"link '{name}' inertial"
        origin = self._origin(inertial, where)
        mass = self._numbers(inertial.find("mass"), f"{where} mass", "value", None)[0]
        element = inertial.find("inertia")
        values = tuple(
            self._numbers(element, f"{where} inertia", key, None)[0] for key in _INERTIA_KEYS
        )
        if mass == 0.0 and not any(values):  # some write it so where there is nothing but a frame
            return None
        if mass <= 0.0:
            self.refuse(f"{where} mass", mass, "a number > 0 kg")
        return LinkBody(name, mass, *origin, values)

    def _axis(self, name: str, joint: ET.Element) -> tuple[float, ...]:
        return tuple(self._numbers(joint.find("axis"), f"joint '{name}' axis", "xyz", "1 0 0"))

    def _limits(self, name: str, joint: ET.Element) -> Limits:
        where = f"joint '{name}'"
        if not any(self._axis(name, joint)):
            self.refuse(f"{where} axis", "0 0 0", "a direction")
        element = joint.find("limit")
        if element is None:
            self.refuse(f"{where} limit", None, "lower, upper, velocity and effort")
        where += " limit"
        limits = Limits(*(self._numbers(element, where, key, None)[0] for key in Limits._fields))
        if not limits.lower < limits.upper:
            self.refuse(f"{where} lower", limits.lower, f"a number < upper = {limits.upper:g} rad")
        if limits.velocity <= 0.0:
            self.refuse(f"{where} velocity", limits.velocity, "a number > 0 rad/s")
        if limits.effort <= 0.0:
            self.refuse(f"{where} effort", limits.effort, "a number > 0 Nm")
        return limits

    def placements(self) -> list[Placement]:
        """Return the frames of all joints, a tool's that was attached too, each after those before it in the tree."""
        left = self._named("joint")
        known = {self.base_link}
        found = []
        while left:
            for name, joint in list(left.items()):
                if (parent := self._end(joint, "parent")) in known:
                    child = self._end(joint, "child")
                    origin = self._origin(joint, f"joint '{name}'")
                    found.append(Placement(name, parent, child, *origin, self._axis(name, joint)))
                    known.add(child)
                    del left[name]
        return found

    def bodies(self) -> list[LinkBody]:
        """Return the bodies of all links that have one, an attached tool's too."""
        bodies = (self._body(name, link) for name, link in self._named("link").items())
        return [body for body in bodies if body is not None]

    def _tree(self) -> dict[str, str]:
        """Return the joint above each link but the root; check that the links form one tree."""
        above: dict[str, str] = {}
        for name, joint in self._joints.items():
            kind = joint.get("type")
            if kind not in {"revolute", "fixed"}:
                self.refuse(
                    f"joint '{name}' type",
                    kind,
                    f"revolute, or continuous with a <limit> (1 to {MAX_JOINTS} in series), or fixed",
                )
            # what stands at a joint that does not move says nothing
            if kind == "revolute" and joint.find("mimic") is not None:
                self.refuse(f"joint '{name}'", "mimic", "joints that move by themselves")
            self._origin(joint, f"joint '{name}'")
            for end in ("parent", "child"):
                if self._end(joint, end) not in self.links:
                    self.refuse(
                        f"joint '{name}' {end} link", self._end(joint, end), "a link of this file"
                    )
            child = self._end(joint, "child")
            if child in above:
                self.refuse(
                    f"joint '{name}' child link", child, f"a link not yet below '{above[child]}'"
                )
            above[child] = name
        roots = [name for name in self.links if name not in above]
        if len(roots) != 1:
            self.refuse("the set of root links", roots, "exactly one, fixed to the ground")
        for name in self.links:
            self._path(name, above)
        return above

    @staticmethod
    def _end(joint: ET.Element, end: str) -> str:
        """Return the link at the "parent" or "child" end of a joint."""
        element = joint.find(end)
        return "" if element is None else element.get("link", "")

    def _path(self, link: str, above: dict[str, str]) -> list[str]:
        """Return the joints from the root to `link`."""
        path: list[str] = []
        while link in above:
            path.append(above[link])
            if len(path) > len(above):
                self.refuse(f"the tree above link '{link}'", "a loop", "links in a tree")
            link = self._end(self._joints[above[link]], "parent")
        return path[::-1]

    def _chain(self) -> list[str]:
        """Return the revolute joints from base to tip; check that there are not too many, in series, with mass."""
        moving = [name for name, joint in self._joints.items() if joint.get("type") == "revolute"]
        if not 1 <= len(moving) <= MAX_JOINTS:
            self.refuse(
                "the number of revolute joints", len(moving), f"1 to {MAX_JOINTS}, in series"
            )
        paths = {
            name: [
                j
                for j in self._path(self._end(self._joints[name], "child"), self._parent_joint)
                if j in moving
            ]
            for name in moving
        }
        last = max(paths, key=lambda name: len(paths[name]))
        if len(paths[last]) != len(moving):
            side = next(name for name in moving if name not in paths[last])
            self.refuse(f"joint '{side}'", "on a side branch", "revolute joints in series")
        self._check_masses(paths[last])
        return paths[last]

    def _check_masses(self, chain: list[str]) -> None:
        heavy = set()
        bodies = {body.link: body for body in self.bodies()}
        for name in self.links:
            body = bodies.get(name)
            carried = [j for j in self._path(name, self._parent_joint) if j in chain][-1:]
            # a fixed link may have any inertia, and in many files has
            if body is not None and carried:
                fault = None if self._replaced else inertia_fault(body.inertia)
                if fault is not None:
                    text = " ".join(
                        f"{key}={value:g}"
                        for key, value in zip(_INERTIA_KEYS, body.inertia, strict=True)
                    )
                    self.refuse(f"link '{name}' inertial inertia", text, fault)
                heavy.update(carried)
        for joint in chain:
            if joint not in heavy:
                link = self._end(self._joints[joint], "child")
                self.refuse(f"link '{link}' inertial", None, "mass and inertia")
