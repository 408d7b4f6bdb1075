"""A plane of which an arm stays on one side; --help shows it, so that this module imports nothing slow."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

from rx90_common.base.errors import IdentificationError

_FARTHEST = 1000.0  # m, of a plane from the base


class Wall(NamedTuple):
    """A plane of which the arm stays on one side.

    Attributes:
        normal: unit vector in the base's frame, shape (3,), pointing to the side where the arm may be.
        distance: normal @ x for points x of the plane, m.
        name: for messages.
    """

    normal: tuple[float, ...]
    distance: float
    name: str

    @classmethod
    def above(cls, height: float) -> Wall:
        """Return a horizontal table at a height, m, over the base's origin; refuses as `through`."""
        return cls.through((0.0, 0.0, 1.0, height), f"--keep-above {height:g}")

    @classmethod
    def through(cls, numbers: Sequence[float], name: str = "") -> Wall:
        """Return the wall n x = d for four numbers n, d, with n of any length: the arm stays where n x > d."""
        name = name or f"--wall {' '.join(f'{number:g}' for number in numbers)}"
        length = math.hypot(*numbers[:3])
        if not (len(numbers) == 4 and length > 0.0 and math.isfinite(sum(numbers))):
            raise IdentificationError(
                f"{name}; accepted: NX NY NZ D, of which the first three are not all 0"
            )
        distance = numbers[3] / length
        if not abs(distance) <= _FARTHEST:
            raise IdentificationError(
                f"{name}: {abs(distance):g} m from the base; accepted: up to {_FARTHEST:g} m"
            )
        return cls(tuple(number / length for number in numbers[:3]), distance, name)
