"""A payload of known inertia at the last link: the one torque in a run that needs no drive gain to be known."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike

from rx90_common.base.arrays import Array
from rx90_common.base.errors import IdentificationError


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
            raise IdentificationError(
                f"payload's inertia: {inertia.tolist()}; accepted: a symmetric 3 x 3 matrix, kg m^2"
            )
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
