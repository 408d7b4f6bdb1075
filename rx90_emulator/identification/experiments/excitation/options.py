"""Options of a plan of excitation runs. Imports nothing slow, for --help."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from enum import Enum

from rx90_common.base.errors import IdentificationError

_MOST_HARMONICS, _MOST_RUNS, _MOST_PERIODS = 50, 20, 100
_LONGEST = 600.0  # s, of a run's periodic part
_FARTHEST = 1000.0  # m, of a plane from the base
_NOISE = (1e-6, 1e6)  # Nm

QUICK = {"runs": 1, "periods": 1, "steps": 15}
"""Options of a short plan: one run, which a validation follows."""


class Criterion(str, Enum):
    """What the motions are optimised for."""

    CONDITION = "condition"
    D = "d"

    def __str__(self) -> str:
        return self.value


@dataclass(frozen=True)
class Wall:
    """A plane that the arm stays on one side of.

    Attributes:
        normal: unit vector in the base's frame, shape (3,), from the plane to where the arm may be.
        distance: of points x of the plane, normal @ x, m.
        name: for messages.

    Raises:
        IdentificationError: for a normal without length, and for a distance that is no number or beyond 1 km.
    """

    normal: tuple[float, float, float]
    distance: float
    name: str

    def __post_init__(self) -> None:
        length = math.hypot(*self.normal)
        if not (math.isfinite(length) and length > 0.0 and math.isfinite(self.distance)):
            raise IdentificationError(f"{self.name}: accepted: finite numbers, of which the first three are not all 0")
        if abs(length - 1.0) > 1e-9:
            raise IdentificationError(f"{self.name}: a normal of length {length:g}; accepted: a unit vector")
        if abs(self.distance) > _FARTHEST:
            raise IdentificationError(
                f"{self.name}: {abs(self.distance):g} m from the base; accepted: up to {_FARTHEST:g} m"
            )

    @classmethod
    def above(cls, height: float) -> Wall:
        """Return a horizontal table at a height, m, over the base's origin."""
        return cls((0.0, 0.0, 1.0), height, f"--keep-above {height:g}")

    @classmethod
    def through(cls, numbers: Sequence[float]) -> Wall:
        """Return the wall n x = d of four numbers, n not necessarily of length 1: the arm stays where n x > d."""
        name = f"--wall {' '.join(f'{one:g}' for one in numbers)}"
        length = math.hypot(*numbers[:3])
        if not (len(numbers) == 4 and math.isfinite(length) and length > 0.0):
            raise IdentificationError(f"{name}; accepted: NX NY NZ D, of which the first three are not all 0")
        x, y, z, distance = (one / length for one in numbers)
        return cls((x, y, z), distance, name)


@dataclass(frozen=True)
class ExcitationOptions:
    """What can be chosen.

    Attributes:
        criterion: the condition number of the weighted columns, each of length 1, or the determinant of the
            information.
        runs: how many are identified from; their speeds differ.
        harmonics: of the base frequency, in each joint's series.
        period: s.
        periods: how often each run repeats its motion.
        share: of the limits of speed, acceleration and torque that may be used.
        seed: of the random motions that the search begins with.
        walls: planes that links and tool keep away from.
        clearance: least distance to the walls, m.
        torque_noise: standard deviation of the noise of each joint's torque, Nm, shape (n,); by default 1 % of the
            URDF's effort.
        steps: of the search for one run.
        validation: whether a run is planned that the identification does not use.

    Raises:
        IdentificationError: naming option, value and what is accepted.
    """

    criterion: Criterion = Criterion.D
    runs: int = 3
    harmonics: int = 10
    period: float = 12.0
    periods: int = 3
    share: float = 0.8
    seed: int = 0
    walls: tuple[Wall, ...] = ()
    clearance: float = 0.02
    torque_noise: tuple[float, ...] | None = None
    steps: int = 60
    validation: bool = True

    def __post_init__(self) -> None:
        for name, most in (("runs", _MOST_RUNS), ("periods", _MOST_PERIODS)):
            _check(name, getattr(self, name), 1, most)
        _check("steps", self.steps, 2, 10_000)
        _check("harmonics", self.harmonics, 3, _MOST_HARMONICS)
        _check("seed", self.seed, 0, 2**31)
        _check("period", self.period, 1.0, _LONGEST)
        _check("period times periods", self.period * self.periods, 1.0, _LONGEST)
        _check("share", self.share, 0.05, 1.0)
        _check("clearance", self.clearance, 0.0, 10.0)
        for value in self.torque_noise or ():
            _check("torque-noise", value, *_NOISE)


def _check(name: str, value: float, low: float, high: float) -> None:
    if not low <= value <= high:
        accepted = f"{low} to {high}" if isinstance(low, int) else f"{low:g} to {high:g}"
        raise IdentificationError(f"{name} {value}; accepted: {accepted}")
