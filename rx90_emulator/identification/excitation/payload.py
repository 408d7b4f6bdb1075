"""A payload of known inertia at the last link: the one torque in a run that needs no drive gain to be known."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike

from rx90_common.base.arrays import Array
from rx90_common.base.config import load_yaml
from rx90_common.base.entries import Number, Numbers
from rx90_common.base.errors import IdentificationError
from rx90_common.base.groups import Entries, Group
from rx90_common.base.quoting import listed, quoted

PAYLOADS = Entries(
    "What was fixed to the last link in each loaded run, by name or path of the bag.",
    of=Group(
        "A rigid body.",
        keys={
            "mass": Number("Mass.", "kg", low=0.0, above=True),
            "centre": Numbers("Centre of mass in the frame of the last joint.", "m", count=3),
            "inertia": Numbers(
                "About the centre of mass, along the axes of that frame: ixx, ixy, ixz, iyy, iyz, izz.",
                "kg m^2", count=6,
            ),
        },
    ),
)  # fmt: skip
"""What a payload file holds."""
_MOMENTS = [[0, 1, 2], [1, 3, 4], [2, 4, 5]]  # which of the six moments of a file each entry of the inertia is


@dataclass(frozen=True, eq=False)
class Payload:
    """A rigid body that is fixed to the last link during a run.

    Attributes:
        mass: kg.
        centre: of mass, in the frame of the last joint, m, shape (3,).
        inertia: about the centre of mass, along the axes of that frame, kg m^2, shape (3, 3).

    Raises:
        IdentificationError: for a mass that is not positive, a shape that does not fit, and an inertia that no body
            has.
    """

    mass: float
    centre: ArrayLike
    inertia: ArrayLike

    def __post_init__(self) -> None:
        centre, inertia = np.asarray(self.centre, dtype=np.float64), np.asarray(self.inertia, dtype=np.float64)
        if not 0.0 < self.mass < np.inf:
            raise IdentificationError(f"payload of {self.mass} kg; accepted: a mass above 0")
        if centre.shape != (3,) or not np.isfinite(centre).all():
            raise IdentificationError(f"payload's centre of mass: {centre.tolist()}; accepted: 3 numbers, m")
        if inertia.shape != (3, 3) or not np.isfinite(inertia).all() or not np.allclose(inertia, inertia.T):
            said = f"payload's inertia: {inertia.tolist()}; accepted: a symmetric 3 x 3 matrix, kg m^2"
            raise IdentificationError(said)
        moments = np.linalg.eigvalsh(inertia)
        if moments[0] < 0.0 or 2.0 * moments[2] > moments.sum() * (1.0 + 1e-9):
            raise IdentificationError(
                f"payload's principal moments: {moments.tolist()} kg m^2; accepted: not negative, and none above the "
                "sum of the others"
            )

    def parameters(self) -> Array:
        """Return mass, first moment and inertia about the joint in Pinocchio's order, shape (10,)."""
        body = pin.Inertia(self.mass, np.asarray(self.centre, float), np.asarray(self.inertia, float))
        return np.array(body.toDynamicParameters())


def read_payloads(path: Path | str) -> dict[str, Payload]:
    """Return what runs carried, by the names or paths of their bags.

    The file has an entry for each loaded bag: `mass`, kg, `centre` of mass in the frame of the last link, m, and
    `inertia` about the centre of mass, kg m^2: ixx, ixy, ixz, iyy, iyz, izz, as a URDF has them.

    Raises:
        ConfigError: for a file that cannot be used.
        IdentificationError: for a body that cannot be.
    """
    file, found = load_yaml(Path(path)), {}
    for name, body in PAYLOADS.read(file).items():
        try:
            found[name] = Payload(body["mass"], body["centre"], np.array(body["inertia"])[_MOMENTS])
        except IdentificationError as error:
            raise IdentificationError(f"{file.where(name)}: {error}") from None
    return found


def payloads_of(bags: Sequence[Path], payloads: Mapping[str, Payload]) -> dict[Path, Payload | None]:
    """Return what each bag carried, by its path; None for those that are not named.

    Args:
        bags: of all runs.
        payloads: by name or path of the bag.

    Raises:
        IdentificationError: for a name that is that of no bag, or of several.
    """
    carried: dict[Path, Payload | None] = dict.fromkeys(bags)
    for name, body in payloads.items():
        meant = [bag for bag in bags if name == bag.name or Path(name).resolve() == bag.resolve()]
        if len(meant) != 1 or carried[meant[0]] is not None:
            how = "two bags are called so, or it is named twice" if meant else "no such run"
            there = listed(bag.name for bag in bags)
            raise IdentificationError(
                f"payload of {quoted(name)}: {how}; accepted: each of {there} once, by name or path"
            )
        carried[meant[0]] = body
    return carried
