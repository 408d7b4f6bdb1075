"""The friction elements of an arm: one for each joint, and one for each motor that turns with several joints."""

from __future__ import annotations

import math
from collections.abc import Container, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from rx90_common.base.errors import ConfigError
from rx90_common.base.quoting import conjoined, quoted
from rx90_common.friction.element import FrictionElement
from rx90_common.friction.parts.bristles import MaxwellSlip


@dataclass(frozen=True)
class FrictionSet:
    """LuGre elements.

    The first n have the joint velocities as input. The others turn with several joints, as the motors do that have a
    coupling: element 7 of the RX family with joints 5 and 6, and its torque acts on both (section 4 of the paper).

    Attributes:
        names: names of the elements, as `Coupling.element_names` has them.
        elements: their parameters.
        file: where they were read, if they were.
    """

    names: tuple[str, ...]
    elements: tuple[FrictionElement, ...]
    file: Path | None = None

    def __post_init__(self) -> None:
        if len(self.names) != len(self.elements):
            counts = f"{len(self.elements)} elements and {len(self.names)} names"
            raise ConfigError(f"a friction set of {counts}; accepted: as many of each")

    def __getitem__(self, name: str) -> FrictionElement:
        """Return the element of this name.

        Raises:
            ConfigError: if there is none.
        """
        if name not in self.names:
            raise ConfigError(f"no friction element {quoted(name)}; accepted: {', '.join(self.names)}")
        return self.elements[self.names.index(name)]

    def passivity_warnings(self, reach: Sequence[float]) -> list[str]:
        """Return a line for each element that is not passive up to the speed, rad/s, that it reaches, shape (e,)."""
        where = "" if self.file is None else f"{self.file}: "
        warnings = [_passivity_warning(*each) for each in zip(self.names, self.elements, reach, strict=True)]
        return [f"{where}{warning}" for warning in warnings if warning]


def _passivity_warning(name: str, element: FrictionElement, speed: float) -> str:
    """Return a line for an element that is not passive up to a speed, rad/s; "" for one that is."""
    limit = element.passivity_limit(speed)
    if math.isinf(limit):
        return ""
    reducing = [part_name for part_name, part in element.parts.items() if part.leaves_less]
    leave = "leaves" if len(reducing) == 1 else "leave"
    least = f", where {conjoined(reducing)} {leave} least friction" if reducing else ""
    blocks = isinstance(element.bristles, MaxwellSlip)
    bound = "the bound of its blocks, docs/explanation/bristles.md," if blocks else "c1 < 4 c0 g / |v|"
    return (
        f"elements.{name}.c1 is {element.c1:g} Nm s/rad, not passive from {limit:.3g} rad/s on; "
        f"accepted: below {element.passive_damping(speed):.3g} ({bound} up to {speed:.3g} rad/s{least}), "
        "or a c1 that fades with omega_d"
    )


def refuse_parts(
    elements: Mapping[str, FrictionElement], what: str, where: str = "friction.", held: Container[str] = ()
) -> None:
    """Refuse elements with parts that something cannot hold.

    Args:
        elements: by their names.
        what: cannot hold them, such as "the perturbation method".
        where: what stands before their names in the message: the file and the path in it.
        held: the parts that it can.

    Raises:
        ConfigError: naming element and part.
    """
    for name, element in elements.items():
        for part in element.parts:
            if part not in held:
                raise ConfigError(f"{where}{name}.{part}: {what} cannot hold this part; accepted: left out")
