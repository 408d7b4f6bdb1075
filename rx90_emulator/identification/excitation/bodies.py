"""The links of a URDF as bodies: where the search for physically consistent inertias begins.

Pseudo-inertia matrices: the mass distribution of a body as one symmetric matrix of order 4.

    P = [[S, h], [h^T, m]],   S = integral of r r^T = tr(I) / 2 - I,   h = m c,   I the inertia about the origin.

A body of positive density exists for m, h and I if and only if P is positive definite (Wensing, Kim and Slotine 2018).
In another frame the same body has T P T^T, with T the homogeneous transform of its old frame to the new one.

The links of a URDF that move with each joint of an arm: what shares the inertial parameters of one joint's body.

Pinocchio, and so the regressor, takes all links that are fixed to each other for one body. A URDF has them apart.

Where the inertias begin: the <inertial> of the URDF, or the geometry of the arm where it has none.
"""

from __future__ import annotations

import xml.etree.ElementTree as ET
from collections.abc import Collection, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike

from rx90_common.base.arrays import Array, Mask
from rx90_common.base.errors import IdentificationError
from rx90_common.base.quoting import listed, quoted
from rx90_common.description.rotations import rpy_rotation

_ROWS, _COLUMNS = np.array([0, 0, 1, 0, 1, 2]), np.array([0, 1, 1, 2, 2, 2])
"""Of Ixx, Ixy, Iyy, Ixz, Iyz, Izz, in Pinocchio's order."""


def pseudo_inertia(parameters: ArrayLike) -> Array:
    """Return P, shape (..., 4, 4).

    Args:
        parameters: m, mx, my, mz, Ixx, Ixy, Iyy, Ixz, Iyz, Izz about the origin of the frame, shape (..., 10).
    """
    values = np.asarray(parameters, dtype=np.float64)
    inertia = np.zeros((*values.shape[:-1], 3, 3))
    inertia[..., _ROWS, _COLUMNS] = inertia[..., _COLUMNS, _ROWS] = values[..., 4:]
    pseudo = np.zeros((*values.shape[:-1], 4, 4))
    pseudo[..., :3, :3] = _other(inertia, 0.5)
    pseudo[..., :3, 3] = pseudo[..., 3, :3] = values[..., 1:4]
    pseudo[..., 3, 3] = values[..., 0]
    return pseudo


def inertial_parameters(pseudo: Array) -> Array:
    """Return the parameters, shape (..., 10), of pseudo-inertias, shape (..., 4, 4); the inverse of `pseudo_inertia`.

    It is linear: differences of pseudo-inertias give differences of parameters.
    """
    inertia = _other(pseudo[..., :3, :3], 1.0)
    parts = [pseudo[..., 3, 3][..., None], pseudo[..., :3, 3], inertia[..., _ROWS, _COLUMNS]]
    return np.concatenate(parts, axis=-1)


def _other(matrix: Array, share: float) -> Array:
    """Return share tr(M) - M: S of an inertia for a share of 1/2, the inertia of S for 1."""
    trace = np.trace(matrix, axis1=-2, axis2=-1)
    return np.asarray(share * trace[..., None, None] * np.eye(3) - matrix)


def about_center(mass: float, center: ArrayLike, inertia: ArrayLike) -> Array:
    """Return P, shape (4, 4).

    Args:
        mass: kg.
        center: of mass, m, shape (3,).
        inertia: about the centre of mass, in the axes of the frame, kg m^2, shape (3, 3).
    """
    place = np.append(np.asarray(center, dtype=np.float64), 1.0)
    pseudo = mass * np.outer(place, place)
    pseudo[:3, :3] += _other(np.asarray(inertia, dtype=np.float64), 0.5)
    return pseudo


def central(pseudo: Array) -> tuple[float, Array, Array]:
    """Return mass, centre of mass (3,) and inertia about it (3, 3) of a positive definite P, shape (4, 4)."""
    mass = float(pseudo[3, 3])
    center = pseudo[:3, 3] / mass
    spread = pseudo[:3, :3] - mass * np.outer(center, center)
    return mass, center, _other(0.5 * (spread + spread.T), 1.0)


def is_body(pseudo: Array) -> bool:
    """Tell whether a body of positive density has this P, shape (4, 4), finite and positive definite."""
    if not np.isfinite(pseudo).all() or not (np.diag(pseudo) > 0.0).all():
        return False
    scale = np.sqrt(np.diag(pseudo))
    return bool(np.linalg.eigvalsh(pseudo / np.outer(scale, scale))[0] > _MIN_EIGENVALUE)


_MIN_EIGENVALUE = 1e-12
"""Of the eigenvalues of P scaled to ones on its diagonal: less is rounding."""


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


_DENSITY = 1500.0  # kg/m^3: castings with motors in them, and with room left
_SLENDERNESS = 6.0  # length over radius of a link without <inertial>
_MIN_RADIUS_SHARE = 0.05  # its least radius, as a share of the arm's reach
_END_RADIUS = 0.2  # radius of one that ends at its joint, as a share of the others' mean length
_DEFAULT_REACH = 0.5  # m, of an arm whose joints all have one origin
_MIN_EQUAL_LINKS = 3  # so many links with the same <inertial> are no chance
_EQUAL = 1e-9


@dataclass(frozen=True, eq=False)
class InertialPrior:
    """Mass distributions and rotors to begin with, and to stay near to where the data say nothing.

    Attributes:
        joints: names of the n joints.
        bodies: the links that share the parameters, at least one for each joint; their pseudo-inertias are positive
            definite.
        known: parameters of the bodies that stay, summed for each joint, shape (n, 10).
        rotors: inertia of each rotor that has a column, seen at its joint, kg m^2, > 0, shape (k,).
        springs: amplitude of each spring that has a column, Nm, shape (s,); 0 for one of which nothing is known.
        guessed: which bodies, and then rotors, the description does not have, shape (b + k,).
        replaced: in words, what is not taken from the URDF, and what stands in its place.
        dropped: links whose <inertial> no body can have; the other links of their joint take their share.
    """

    joints: tuple[str, ...]
    bodies: tuple[MovingBody, ...]
    known: Array
    rotors: Array
    springs: Array
    guessed: Mask
    replaced: tuple[str, ...] = ()
    dropped: tuple[str, ...] = ()

    @classmethod
    def of_urdf(
        cls,
        urdf: Path | str,
        joints: Sequence[str],
        rotors: ArrayLike = (),
        springs: ArrayLike = (),
        known: Collection[str] = (),
    ) -> InertialPrior:
        """Return the prior of an arm.

        Args:
            urdf: file, or its text.
            joints: n names from base to tip.
            rotors: inertia of the rotors of the first k joints, seen at these, kg m^2, shape (k,); 0 for one of which
                nothing is known: it begins at the mean moment of inertia of its joint's body.
            springs: as the attribute.
            known: links whose <inertial> is known and stays, such as a tool that was weighed.

        Raises:
            IdentificationError: for a joint that is not there, and rotors or springs that are negative or too many.
        """
        links = MovingLinks(urdf.read_text(encoding="utf-8") if isinstance(urdf, Path) else urdf, joints)
        stay = np.zeros((len(joints), 10))
        free = links.bodies(without=known)
        for body in links.bodies(without={body.link for body in free}):
            stay[body.joint] += inertial_parameters(body.pseudo)
        bodies, words, dropped = _usable(free, links)
        begun = _amounts("rotor inertias", rotors, len(joints))
        described = [body.pseudo.tobytes() for body in free]
        guessed = np.array([*(body.pseudo.tobytes() not in described for body in bodies), *(begun == 0.0)], dtype=bool)
        for i in np.flatnonzero(begun == 0.0).tolist():
            total = np.sum([inertial_parameters(body.pseudo) for body in bodies if body.joint == i], axis=0)
            begun[i] = total[[4, 6, 9]].mean()
            words.append(f"rotor of {joints[i]}: begins at {begun[i]:.3g} kg m^2, the mean moment of its link")
        amplitudes = _amounts("springs", springs, len(joints))
        return cls(tuple(joints), tuple(bodies), stay, begun, amplitudes, guessed, tuple(words), tuple(dropped))


def _amounts(what: str, values: ArrayLike, most: int) -> Array:
    given = np.array(values, dtype=np.float64).reshape(-1)
    if len(given) > most or not np.isfinite(given).all() or (given < 0.0).any():
        raise IdentificationError(f"{what} {given.tolist()}; accepted: finite numbers >= 0, at most {most}")
    return given


def _usable(bodies: Sequence[MovingBody], links: MovingLinks) -> tuple[list[MovingBody], list[str], list[str]]:
    """Return bodies that exist, at least one for each joint, what was replaced in words, and links to drop."""
    filled = _filled_in(bodies, len(links.joints))
    good: list[MovingBody] = []
    words, dropped = [], []
    for joint, name in enumerate(links.joints):
        mine = [body for body in bodies if body.joint == joint]
        real = [] if filled else [body for body in mine if is_body(body.pseudo)]
        if not real:
            body = _by_geometry(mine[0], links.ends())
            given = any(one.pseudo.any() for one in mine)
            why = "the same for all links" if filled else "none that a body can have" if given else "missing"
            words.append(
                f"{body.link} at {name}: <inertial> is {why}; begins as an ellipsoid of {_DENSITY:g} kg/m^3 along the "
                f"link, {body.pseudo[3, 3]:.3g} kg"
            )
            real = [body]
        good += real
        kept = {body.link for body in real}
        dropped += [body.link for body in mine if body.pseudo.any() and body.link not in kept]
    return good, words, dropped


def _filled_in(bodies: Sequence[MovingBody], count: int) -> bool:
    """Tell whether the joints' own links all have the same <inertial>, as exporters fill it in."""
    own = [next(body for body in bodies if body.joint == joint) for joint in range(count)]
    first = own[0].pseudo
    return (
        count >= _MIN_EQUAL_LINKS
        and bool(first.any())
        and all(np.abs(one.pseudo - first).max() <= _EQUAL for one in own)
    )


def _by_geometry(body: MovingBody, ends: Array) -> MovingBody:
    """Return a link as a solid ellipsoid from its joint to the farthest frame that moves with it."""
    end = ends[body.joint]
    length = float(np.linalg.norm(end))
    reach = float(np.linalg.norm(ends, axis=1).sum()) or _DEFAULT_REACH
    others = max(1, int(ends.any(axis=1).sum()))
    radius = max(length / _SLENDERNESS, _MIN_RADIUS_SHARE * reach) if length else _END_RADIUS * reach / others
    half = max(0.5 * length, radius)
    along = end / length if length > 0.0 else np.zeros(3)
    mass = _DENSITY * 4.0 / 3.0 * np.pi * half * radius**2
    spread = mass / 5.0 * (radius**2 * np.eye(3) + (half**2 - radius**2) * np.outer(along, along))
    return replace(body, pseudo=about_center(mass, 0.5 * end, np.trace(spread) * np.eye(3) - spread))
