"""What can be chosen for excitation runs, declared once for checks and --help. Imports nothing slow."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, get_type_hints

from rx90_common.base.entries import Entry, Integer, Number, Text
from rx90_common.base.errors import IdentificationError
from rx90_common.base.section import Section

QUICK = {"runs": 1, "periods": 1, "steps": 15}
"""Options of a short plan: one run, which a validation follows."""
_LONGEST_S = 600.0  # of a run's periodic part
_FARTHEST = 1000.0  # m, of a plane from the base


@dataclass(frozen=True)
class Wall:
    """A plane that the arm stays on one side of.

    Attributes:
        normal: unit vector in the base's frame, shape (3,), from the plane to where the arm may be.
        distance: of points x of the plane, normal @ x, m.
        name: for messages.
    """

    normal: tuple[float, float, float]
    distance: float
    name: str

    @classmethod
    def above(cls, height: float) -> Wall:
        """Return a horizontal table at a height, m, over the base's origin; refuses as `through`."""
        return cls.through((0.0, 0.0, 1.0, height), f"--keep-above {height:g}")

    @classmethod
    def through(cls, numbers: Sequence[float], name: str = "") -> Wall:
        """Return the wall n x = d of four numbers, n not necessarily of length 1: the arm stays where n x > d.

        Raises:
            IdentificationError: for other numbers, a normal without length and a plane farther away than 1 km.
        """
        name = name or f"--wall {' '.join(f'{one:g}' for one in numbers)}"
        length = math.hypot(*numbers[:3])
        if not (len(numbers) == 4 and length > 0.0 and all(map(math.isfinite, (*numbers, length)))):
            raise IdentificationError(f"{name}; accepted: NX NY NZ D, of which the first three are not all 0")
        x, y, z, distance = (one / length for one in numbers)
        if abs(distance) > _FARTHEST:
            raise IdentificationError(f"{name}: {abs(distance):g} m from the base; accepted: up to {_FARTHEST:g} m")
        return cls((x, y, z), distance, name)


_NOISE = Number("standard deviation of a joint's torque", "Nm", low=1e-6, high=1e6)


@dataclass(frozen=True)
class ExcitationOptions:
    """What can be chosen for a plan; the other fields declare what they mean and may be.

    Attributes:
        walls: planes that links and tool keep away from.
        torque_noise: standard deviation of the noise of each joint's torque, Nm, shape (n,); by default 1 % of the
            URDF's effort.
        validation: whether a run is planned that the identification does not use.

    Raises:
        ConfigError: naming option, value and what is accepted.
    """

    criterion: Annotated[str, Text("condition: condition number of the weighted columns; d: determinant of the "
                                   "information", choices=("condition", "d"))] = "d"  # fmt: skip
    runs: Annotated[int, Integer("to identify from, of different speeds; one more is for the validation",
                                 low=1, high=20)] = 3  # fmt: skip
    harmonics: Annotated[int, Integer("of the base frequency in each joint's series", low=3, high=50)] = 10
    period: Annotated[float, Number("s, of the base frequency", "s", low=1.0, high=_LONGEST_S)] = 12.0
    periods: Annotated[int, Integer("of each run", low=1, high=100)] = 3
    share: Annotated[float, Number("of the limits of speed, acceleration and torque that may be used",
                                   low=0.05, high=1.0)] = 0.8  # fmt: skip
    seed: Annotated[int, Integer("of the random motions that the search begins with; the same seed gives the same "
                                 "plan", low=0, high=2**31)] = 0  # fmt: skip
    clearance: Annotated[float, Number("m, least distance to the planes", "m", low=0.0, high=10.0)] = 0.02
    steps: Annotated[int, Integer("of the search, for each run", low=2, high=10_000)] = 60
    walls: tuple[Wall, ...] = ()
    torque_noise: tuple[float, ...] | None = None
    validation: bool = True

    def __post_init__(self) -> None:
        place, whole = Path("--excitation"), "period times periods"
        given = Section({**vars(self), whole: self.period * self.periods}, place)
        for name, entry in {**DECLARED, whole: DECLARED["period"]}.items():
            entry.take(given, name)
        for value in self.torque_noise or ():
            _NOISE.take(Section({"torque-noise": value}, place), "torque-noise")


_hints = get_type_hints(ExcitationOptions, include_extras=True)
DECLARED: dict[str, Entry] = {
    name: hint.__metadata__[0] for name, hint in _hints.items() if hasattr(hint, "__metadata__")
}
"""What each of the options means and may be."""
