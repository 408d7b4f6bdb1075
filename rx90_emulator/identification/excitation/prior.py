"""Where the search for bodies that can exist begins: the <inertial> of the URDF, or the geometry of the arm.

Pseudo-inertia matrices: the mass distribution of a body as one symmetric matrix of order 4.

    P = [[S, h], [h^T, m]],   S = integral of r r^T = tr(I) / 2 - I,   h = m c,   I the inertia about the origin.

A body of positive density exists for m, h and I if and only if P is positive definite (Wensing, Kim and Slotine 2018).
In another frame the same body has T P T^T, with T the homogeneous transform of its old frame to the new one.
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

_MOMENTS = np.array([0, 0, 1, 0, 1, 2]), np.array([0, 1, 1, 2, 2, 2])
"""Rows and columns of Ixx, Ixy, Iyy, Ixz, Iyz, Izz, in Pinocchio's order."""
_MIN_EIGENVALUE = 1e-12  # of P scaled to ones on its diagonal: less is rounding


def inertial_parameters(pseudo: Array) -> Array:
    """Return m, mx, my, mz, Ixx, Ixy, Iyy, Ixz, Iyz, Izz, shape (..., 10), of pseudo-inertias, shape (..., 4, 4).

    They are about the origin of the frame, and linear in the pseudo-inertias.
    """
    inertia = _other(pseudo[..., :3, :3], 1.0)[..., _MOMENTS[0], _MOMENTS[1]]
    return np.concatenate([pseudo[..., 3, 3][..., None], pseudo[..., :3, 3], inertia], axis=-1)


def _other(matrix: Array, share: float) -> Array:
    """Return share tr(M) - M: S of an inertia for a share of 1/2, the inertia of S for 1."""
    trace = np.trace(matrix, axis1=-2, axis2=-1)
    return np.asarray(share * trace[..., None, None] * np.eye(3) - matrix)


def _about_center(mass: float, center: Array, inertia: Array) -> Array:
    """Return P, shape (4, 4), of a mass with its centre, shape (3,), and inertia about it, shape (3, 3)."""
    place = np.append(center, 1.0)
    pseudo = mass * np.outer(place, place)
    pseudo[:3, :3] += _other(inertia, 0.5)
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


_URDF_MOMENTS = ("ixx", "ixy", "ixz", "ixy", "iyy", "iyz", "ixz", "iyz", "izz")


def _moving_links(urdf: str, joints: Sequence[str]) -> tuple[list[MovingBody], Array]:
    """Return the links that move, and the frame farthest from each joint that moves with it, m, shape (n, 3).

    Pinocchio, and so the regressor, takes all links that are fixed to each other for one body; a URDF has them apart.
    Each joint's own link stands before those that are fixed to it. The farthest frame may be that of the next joint.

    Raises:
        IdentificationError: for a joint that the URDF does not have.
    """
    root = ET.fromstring(urdf)
    above = {_end(joint, "child"): joint for joint in root.findall("joint")}
    own = {str(joint.get("name")): link for link, joint in above.items()}
    for name in joints:
        if name not in own:
            raise IdentificationError(f"no joint {quoted(name)} in the URDF; accepted: {listed(own)}")

    def place(link: str) -> tuple[int | None, Array]:
        """Return the joint that a link moves with, None if it does not move, and its frame in that of the joint."""
        frame = np.eye(4)
        while link in above:
            if above[link].get("name") in joints:
                return joints.index(str(above[link].get("name"))), frame
            frame, link = _origin(above[link]) @ frame, _end(above[link], "parent")
        return None, frame

    bodies = []
    for element in root.findall("link"):
        link, inertial = element.get("name", ""), element.find("inertial")
        joint, frame = place(link)
        if joint is not None:
            pseudo = np.zeros((4, 4))
            if inertial is not None:
                mass, inertia = inertial.find("mass"), inertial.find("inertia")
                weight = 0.0 if mass is None else float(mass.get("value", "0"))
                moments = [0.0 if inertia is None else float(inertia.get(key, "0")) for key in _URDF_MOMENTS]
                to_joint = frame @ _origin(inertial)
                pseudo = to_joint @ _about_center(weight, np.zeros(3), np.reshape(moments, (3, 3))) @ to_joint.T
            bodies.append(MovingBody(link, joint, frame, pseudo))
    ends = np.zeros((len(joints), 3))
    for link, joint_above in above.items():
        joint, frame = place(link)
        if joint_above.get("name") in joints:
            joint, frame = place(_end(joint_above, "parent"))
            frame = frame @ _origin(joint_above)
        if joint is not None and np.linalg.norm(frame[:3, 3]) > np.linalg.norm(ends[joint]):
            ends[joint] = frame[:3, 3]
    return sorted(bodies, key=lambda body: (body.joint, body.link != own[joints[body.joint]])), ends


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
        rotors: inertia of each rotor that has a column, seen at its joint, kg m^2, shape (k,); 0 for all of them
            where the torque has no part of theirs.
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
    replaced: tuple[str, ...]
    dropped: tuple[str, ...]

    @classmethod
    def of_urdf(
        cls,
        urdf: Path | str,
        joints: Sequence[str],
        rotors: ArrayLike | None = (),
        springs: ArrayLike = (),
        known: Collection[str] = (),
    ) -> InertialPrior:
        """Return the prior of an arm.

        Args:
            urdf: file, or its text.
            joints: n names from base to tip.
            rotors: inertia of the rotors of the first k joints, seen at these, kg m^2, shape (k,); 0 for one of which
                nothing is known: it begins at the mean moment of inertia of its joint's body. None for torques that
                hold nothing of rotors.
            springs: as the attribute.
            known: links whose <inertial> is known and stays, such as a tool that was weighed.

        Raises:
            IdentificationError: for a joint that is not there, and rotors or springs that are negative or too many.
        """
        names, text = tuple(joints), urdf.read_text(encoding="utf-8") if isinstance(urdf, Path) else urdf
        links, ends = _moving_links(text, names)
        stay, free = np.zeros((len(names), 10)), [body for body in links if body.link not in known]
        for body in links:
            if body.link in known:
                stay[body.joint] += inertial_parameters(body.pseudo)
        own = [next(body for body in free if body.joint == joint) for joint in range(len(names))]
        # As exporters fill it in: all joints' own links the same.
        same = all(np.abs(one.pseudo - own[0].pseudo).max() <= _EQUAL for one in own)
        filled = len(own) >= _MIN_EQUAL_LINKS and bool(own[0].pseudo.any()) and same
        bodies: list[MovingBody] = []
        guessed, words = [], []
        for joint, name in enumerate(names):
            mine = [body for body in free if body.joint == joint]
            real = [] if filled else [body for body in mine if is_body(body.pseudo)]
            guessed += [False] * len(real) or [True]
            bodies += real
            if not real:
                bodies.append(_by_geometry(mine[0], ends))
                given = any(one.pseudo.any() for one in mine)
                why = "the same for all links" if filled else "none that a body can have" if given else "missing"
                words.append(
                    f"{mine[0].link} at {name}: <inertial> is {why}; begins as an ellipsoid of {_DENSITY:g} kg/m^3 "
                    f"along the link, {bodies[-1].pseudo[3, 3]:.3g} kg"
                )
        kept = {body.link for body in bodies}
        dropped = tuple(body.link for body in free if body.pseudo.any() and body.link not in kept)
        sizes: ArrayLike = np.zeros(len(names)) if rotors is None else rotors
        begun, amplitudes = (np.array(values, dtype=np.float64).reshape(-1) for values in (sizes, springs))
        for what, values in (("rotor inertias", begun), ("springs", amplitudes)):
            if len(values) > len(names) or not np.isfinite(values).all() or (values < 0.0).any():
                accepted = f"finite numbers >= 0, at most {len(names)}"
                raise IdentificationError(f"{what} {values.tolist()}; accepted: {accepted}")
        unknown = (begun == 0.0) if rotors is not None else np.zeros(len(begun), dtype=np.bool_)
        guesses = np.append(np.array(guessed, dtype=bool), unknown)
        for i in np.flatnonzero(unknown).tolist():
            total = np.sum([inertial_parameters(body.pseudo) for body in bodies if body.joint == i], axis=0)
            begun[i] = total[[4, 6, 9]].mean()
            words.append(f"rotor of {names[i]}: begins at {begun[i]:.3g} kg m^2, the mean moment of its link")
        return cls(names, tuple(bodies), stay, begun, amplitudes, guesses, tuple(words), dropped)


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
    return replace(body, pseudo=_about_center(mass, 0.5 * end, _other(spread, 1.0)))
