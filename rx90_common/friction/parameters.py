"""The parameters of a LuGre element, in one table: checks, messages, reader, writer and legends come from it."""

from __future__ import annotations

import math
import sys
from collections.abc import Iterable
from dataclasses import dataclass, replace
from functools import cached_property

from rx90_common.base.entries import REQUIRED, Entry, Number
from rx90_common.base.errors import ConfigError
from rx90_common.base.groups import Either, Group
from rx90_common.base.quoting import quoted
from rx90_common.base.section import as_number
from rx90_common.friction.parts.part import LEAST_SPEED
from rx90_common.friction.parts.table import PARTS

SIGNS = ("positive", "negative")
"""Of the velocity, in the order in which everything keeps them."""

ALPHA_BOUNDS = (0.3, 2.0)
"""Of the viscous exponent.

Two is the drag of a turbulent fluid. Below 0.3 the slope at rest, LINEAR_SPEED^(alpha - 1) c2, comes near what a light
wrist can bear in a tick: the part would be a Coulomb torque without bristles.
"""

LINEAR_SPEED = 1e-3
"""The speed, rad/s, below which the viscous part is linear whatever its exponent: motion this slow is presliding."""


@dataclass(frozen=True)
class FrictionParameter:
    """One parameter, joint side, SI units.

    Attributes:
        name: its key in friction files.
        meaning: in words.
        unit: its unit, 1 for a pure number.
        positive: whether 0 is refused; negative values always are.
        signed: whether it has a value for each sign of the velocity.
        default: its value where it is left out; None where it is required.
        bounds: its least and its largest value, where it has such bounds.
    """

    name: str
    meaning: str
    unit: str
    positive: bool = True
    signed: bool = False
    default: float | None = None
    bounds: tuple[float, float] | None = None

    @cached_property
    def attributes(self) -> tuple[str, ...]:
        """Return the attributes of FrictionElement that hold it: one, or one for each of SIGNS."""
        return tuple(f"{self.name}_{sign}" for sign in SIGNS) if self.signed else (self.name,)

    @property
    def interval(self) -> tuple[float, float, bool]:
        """Return the least and the largest value, and whether values must be above the least."""
        return (0.0, math.inf, self.positive) if self.bounds is None else (*self.bounds, False)

    @property
    def accepted(self) -> str:
        """Return its range in words."""
        low, high, above = self.interval
        if high < math.inf:
            return f"a number in [{low:g}, {high:g}]"
        return f"a {'' if self.default == math.inf else 'finite '}number {'>' if above else '>='} {low:g}"

    def entry(self) -> Entry:
        """Return what may stand under its key in a file."""
        low, high, above = self.interval
        about = f"{self.meaning[0].upper()}{self.meaning[1:]}."
        if not self.signed:
            default = REQUIRED if self.default is None else self.default
            infinite = self.default == math.inf
            return Number(about, self.unit, low=low, high=high, above=above, default=default, infinite=infinite)
        number = Number(f"{about} For both signs of the velocity.", self.unit, low=low, high=high, above=above)
        pair = {sign: replace(number, about=f"{about} Of {sign} velocities.") for sign in SIGNS}
        return Either(
            about, self.unit, mapping=Group(f"{about} For each sign of the velocity.", keys=pair), plain=number
        )

    def check(self, attribute: str, value: object) -> float:
        """Return a value, a scalar of NumPy's as a float; refuse one that is no number or not in the range.

        Raises:
            ConfigError: naming attribute, value and range.
        """
        low, high, above = self.interval
        number = as_number(value)
        inside = (number > low if above else number >= low) and number <= high
        if not inside or (number > sys.float_info.max and self.default != math.inf):
            raise ConfigError(f"{attribute} is {quoted(value)}; accepted: {self.accepted}")
        return number


FRICTION_PARAMETERS = (
    FrictionParameter("tau_c", "Coulomb friction torque", "Nm", signed=True),
    FrictionParameter("tau_s", "static friction torque, at least tau_c", "Nm", positive=False, signed=True),
    FrictionParameter("omega_s", "Stribeck velocity", "rad/s", bounds=(LEAST_SPEED, math.inf)),
    FrictionParameter("delta", "Stribeck exponent", "1"),
    FrictionParameter("c0", "bristle stiffness", "Nm/rad"),
    FrictionParameter("c1", "micro-viscous damping at rest", "Nm s/rad", positive=False),
    FrictionParameter("c2", "viscous friction", "Nm (s/rad)^alpha", positive=False),
    FrictionParameter(
        "omega_d", "velocity in the fading c1 exp(-(v/omega_d)^2)", "rad/s", default=math.inf,
        bounds=(LEAST_SPEED, math.inf),
    ),
    FrictionParameter("alpha", "viscous exponent", "1", default=1.0, bounds=ALPHA_BOUNDS),
)  # fmt: skip

ELEMENT = Group(
    "A LuGre friction element (equations 17 to 19), joint side.",
    keys={parameter.name: parameter.entry() for parameter in FRICTION_PARAMETERS}
    | {name: part.entry() for name, part in PARTS.items()},
)
"""What stands in a file for one element."""

FRICTION_UNITS = {name: parameter.unit for parameter in FRICTION_PARAMETERS for name in parameter.attributes}
"""Units of the attributes of FrictionElement."""


def legend(parts: Iterable[str] = ()) -> str:
    """Return the table as lines of comment, as they stand at the head of friction files, and those of some parts."""
    lines = ""
    for parameter in FRICTION_PARAMETERS:
        signed = "; one value, or {positive: x, negative: y}" if parameter.signed else ""
        optional = "" if parameter.default is None else f"; {parameter.default:g} if it is left out"
        accepted = parameter.accepted.rpartition("number ")[2]
        lines += f"# {parameter.name:<8} {parameter.meaning}, {parameter.unit}, {accepted}{signed}{optional}\n"
    return lines + "".join(part.legend() for name, part in PARTS.items() if name in parts)
