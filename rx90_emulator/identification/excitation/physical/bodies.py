"""The links of a URDF that move with each joint of an arm: what shares the inertial parameters of one joint's body.

Pinocchio, and so the regressor, takes all links that are fixed to each other for one body. A URDF has them apart.
"""

from __future__ import annotations

import xml.etree.ElementTree as ET
from collections.abc import Collection, Sequence
from dataclasses import dataclass

import numpy as np

from rx90_common.base.arrays import Array
from rx90_common.base.errors import IdentificationError
from rx90_common.base.quoting import listed, quoted
from rx90_common.description.rotations import rpy_rotation
from rx90_emulator.identification.excitation.physical.pseudo_inertia import about_center

_MOMENTS = ("ixx", "ixy", "ixz", "ixy", "iyy", "iyz", "ixz", "iyz", "izz")


@dataclass(frozen=True, eq=False)
class MovingBody:
    """One link of a URDF that moves with a joint.

    Attributes:
        link: its name.
        joint: which of the joints it moves with, from 0.
        frame: its frame in the frame of that joint, homogeneous, shape (4, 4).
        pseudo: pseudo-inertia by the URDF in the joint's frame, shape (4, 4); zeros without <inertial>.
    """

    link: str
    joint: int
    frame: Array
    pseudo: Array


class MovingLinks:
    """The links of a URDF, by the joint that each of them moves with.

    Args:
        urdf: the description as XML, readable by Pinocchio.
        joints: the moving joints from base to tip; all others are held at zero.

    Raises:
        IdentificationError: for a joint that the URDF does not have.
    """

    def __init__(self, urdf: str, joints: Sequence[str]) -> None:
        self.joints = tuple(joints)
        self._root = ET.fromstring(urdf)
        self._above = {_end(joint, "child"): joint for joint in self._root.findall("joint")}
        self._moved = {str(joint.get("name")): link for link, joint in self._above.items()}
        for name in joints:
            if name not in self._moved:
                raise IdentificationError(f"no joint {quoted(name)} in the URDF; accepted: {listed(self._moved)}")

    def bodies(self, without: Collection[str] = ()) -> tuple[MovingBody, ...]:
        """Return the links that move, but those named, each joint's own link before those that are fixed to it."""
        found = []
        for element in self._root.findall("link"):
            link = element.get("name", "")
            joint, frame = self._place(link)
            if joint is not None and link not in without:
                found.append(MovingBody(link, joint, frame, _pseudo(element, frame)))
        return tuple(sorted(found, key=lambda body: (body.joint, body.link != self._moved[self.joints[body.joint]])))

    def ends(self) -> Array:
        """Return the frame farthest from each joint that moves with it, the next joint's as well, m, shape (n, 3)."""
        far = np.zeros((len(self.joints), 3))
        for link, above in self._above.items():
            joint, frame = self._place(link)
            if above.get("name") in self.joints:
                joint, frame = self._place(_end(above, "parent"))
                frame = frame @ _origin(above)
            if joint is not None and np.linalg.norm(frame[:3, 3]) > np.linalg.norm(far[joint]):
                far[joint] = frame[:3, 3]
        return far

    def _place(self, link: str) -> tuple[int | None, Array]:
        """Return the joint that a link moves with, None if it does not move, and its frame in that of the joint."""
        frame = np.eye(4)
        while link in self._above:
            above = self._above[link]
            if above.get("name") in self.joints:
                return self.joints.index(str(above.get("name"))), frame
            frame, link = _origin(above) @ frame, _end(above, "parent")
        return None, frame


def _end(joint: ET.Element, end: str) -> str:
    element = joint.find(end)
    return "" if element is None else element.get("link", "")


def _origin(parent: ET.Element) -> Array:
    """Return the homogeneous transform of an <origin>, shape (4, 4)."""
    origin = parent.find("origin")
    given = {} if origin is None else origin.attrib
    xyz, rpy = ([float(word) for word in given.get(key, "0 0 0").split()] for key in ("xyz", "rpy"))
    transform = np.eye(4)
    transform[:3, :3], transform[:3, 3] = rpy_rotation(rpy), xyz
    return transform


def _pseudo(link: ET.Element, frame: Array) -> Array:
    inertial = link.find("inertial")
    if inertial is None:
        return np.zeros((4, 4))
    mass, inertia = inertial.find("mass"), inertial.find("inertia")
    weight = 0.0 if mass is None else float(mass.get("value", "0"))
    moments = [0.0 if inertia is None else float(inertia.get(key, "0")) for key in _MOMENTS]
    transform = frame @ _origin(inertial)
    return np.asarray(transform @ about_center(weight, np.zeros(3), np.reshape(moments, (3, 3))) @ transform.T)
