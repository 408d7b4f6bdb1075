"""Where the inertias begin: the <inertial> of the URDF, or the geometry of the arm where it has none."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike

from rx90_common.base.arrays import Array
from rx90_common.base.errors import IdentificationError
from rx90_emulator.identification.excitation.physical.bodies import MovingBody, MovingLinks
from rx90_emulator.identification.excitation.physical.pseudo_inertia import (
    about_center,
    inertial_parameters,
    is_body,
)

_DENSITY = 1500.0  # kg/m^3: castings with motors in them, and with room left
_SLIM = 6.0  # length over radius of a link without <inertial>
_THICK = 0.05  # its least radius, as a share of the arm's reach
_ROUND = 0.2  # radius of one that ends at its joint, as a share of the others' mean length
_ANY_REACH = 0.5  # m, of an arm whose joints all have one origin
_FEW = 3  # so many links with the same <inertial> are no chance
_ALIKE = 1e-9


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
        replaced: in words, what is not taken from the URDF, and what stands in its place.
        dropped: links whose <inertial> no body can have; the other links of their joint take their share.
    """

    joints: tuple[str, ...]
    bodies: tuple[MovingBody, ...]
    known: Array
    rotors: Array
    springs: Array
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
        for i in np.flatnonzero(begun == 0.0).tolist():
            total = np.sum([inertial_parameters(body.pseudo) for body in bodies if body.joint == i], axis=0)
            begun[i] = total[[4, 6, 9]].mean()
            words.append(f"rotor of {joints[i]}: begins at {begun[i]:.3g} kg m^2, the mean moment of its link")
        amplitudes = _amounts("springs", springs, len(joints))
        return cls(tuple(joints), tuple(bodies), stay, begun, amplitudes, tuple(words), tuple(dropped))


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
    return count >= _FEW and bool(first.any()) and all(np.abs(one.pseudo - first).max() <= _ALIKE for one in own)


def _by_geometry(body: MovingBody, ends: Array) -> MovingBody:
    """Return a link as a solid ellipsoid from its joint to the farthest frame that moves with it."""
    end = ends[body.joint]
    length = float(np.linalg.norm(end))
    reach = float(np.linalg.norm(ends, axis=1).sum()) or _ANY_REACH
    others = max(1, int(ends.any(axis=1).sum()))
    radius = max(length / _SLIM, _THICK * reach) if length else _ROUND * reach / others
    half = max(0.5 * length, radius)
    along = end / length if length > 0.0 else np.zeros(3)
    mass = _DENSITY * 4.0 / 3.0 * np.pi * half * radius**2
    spread = mass / 5.0 * (radius**2 * np.eye(3) + (half**2 - radius**2) * np.outer(along, along))
    return replace(body, pseudo=about_center(mass, 0.5 * end, np.trace(spread) * np.eye(3) - spread))
