"""The kinds of bristles: accepted contents of `bristles` in a friction file, and limits of c1 for passivity.

Their equations stand with their compiled steps in elasto_plastic.py and maxwell_slip.py of rx90_common/friction/.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Annotated, Any, ClassVar, Final

import numpy as np
from numpy.typing import ArrayLike

from rx90_common.base.arrays import Array
from rx90_common.base.entries import LEFT_OUT, ListOf, Number
from rx90_common.base.errors import ConfigError
from rx90_common.base.groups import Variants
from rx90_common.base.quoting import counted
from rx90_common.friction.maxwell_slip import MAX_BLOCKS
from rx90_common.friction.parts.part import FrictionPart

LUGRE_PASSIVITY: Final = 4.0
"""Of `passivity_factor`: LuGre's bristle is passive where c1 |v| < 4 c0 g(v) (Barahanov and Ortega 2000)."""

MAX_BREAK_AWAY: Final = 0.9
"""Of `break_away`: nearer to 1 the way from break-away to sliding is a corner."""

_SUM_ERROR = 1e-9  # of stiffnesses and shares, which are given in decimals


@dataclass(frozen=True)
class BristlesPart(FrictionPart):
    """Bristles of another kind than LuGre's.

    Attributes:
        kind: its name in a file.
    """

    name = "bristles"
    kind: ClassVar[str]

    @classmethod
    def entry(cls) -> Variants:
        """Return the accepted content of a file under the name."""
        groups = {name: kind.group() for name, kind in KINDS.items()}
        return Variants("Bristles of another kind than LuGre's.", key="kind", groups=groups, default=LEFT_OUT)

    @classmethod
    def read(cls, content: Mapping[str, Any]) -> BristlesPart:
        """Return the bristles for the values that `entry` has read."""
        return KINDS[content["kind"]].of_file(content)

    @classmethod
    def legend(cls) -> str:
        """Return the tables of all kinds as lines of comment."""
        lines = f"# {cls.name:<8} other bristles than LuGre's, by their kind:\n"
        for name, kind in KINDS.items():
            lines += f"#   kind: {name}\n" + "".join(super(BristlesPart, kind).legend().splitlines(True)[1:])
        return lines

    def values(self) -> dict[str, Any]:
        """Return the block as in a file."""
        return {"kind": self.kind, **super().values()}

    def passivity_factor(self, c0: float, speed: ArrayLike) -> Array | float:  # noqa: ARG002 - of other kinds
        """Return the factor p for which the element is passive where c1 |v| < p c0 g(v).

        Args:
            c0: of the element, Nm/rad.
            speed: rad/s, any shape.
        """
        return LUGRE_PASSIVITY


@dataclass(frozen=True)
class ElastoPlastic(BristlesPart):
    """Elasto-plastic bristles, which are purely elastic up to break-away."""

    kind = "elasto_plastic"
    about = "Elasto-plastic bristles (Dupont, Hayward, Armstrong, Altpeter 2002)."

    break_away: Annotated[
        float,
        Number(
            "Deflection up to which the bristles are purely elastic, in parts of tau_c / c0.", "1",
            low=0.0, high=MAX_BREAK_AWAY,
        ),
    ]  # fmt: skip


def _parts(about: str) -> ListOf:
    number = Number(about, "1", low=0.0, high=1.0, above=True)
    return ListOf(about, "1", item=number, accepted=f"a list of 1 to {MAX_BLOCKS} numbers", least=1)


@dataclass(frozen=True)
class MaxwellSlip(BristlesPart):
    """Parallel blocks, 1 to MAX_BLOCKS, each of which sticks or slips.

    Raises:
        ConfigError: also for another number of blocks, and another sum.
    """

    kind = "maxwell_slip"
    about = "Generalised Maxwell slip (Lampaert, Al-Bender, Swevers 2003)."

    stiffness: Annotated[tuple[float, ...], _parts("Stiffness of each block in parts of c0; they sum to 1.")]
    share: Annotated[tuple[float, ...], _parts("Share of each block in the sliding torque; they sum to 1.")]
    attraction: Annotated[
        float,
        Number(
            "Attraction of the sliding curve; torques come to it at the rate attraction / sliding torque.", "Nm/s",
            low=0.0, above=True,
        ),
    ]  # fmt: skip

    def __post_init__(self) -> None:
        super().__post_init__()
        count = len(self.stiffness)
        if count > MAX_BLOCKS:
            raise ConfigError(
                f"bristles: stiffness has {counted(count, 'number')}; accepted: 1 to {MAX_BLOCKS}, one for a block"
            )
        if len(self.share) != count:
            raise ConfigError(
                f"bristles: share has {counted(len(self.share), 'number')}; accepted: {count}, as stiffness has"
            )
        for name, whole in (("stiffness", "c0"), ("share", "the sliding torque")):
            total = math.fsum(getattr(self, name))
            if not abs(total - 1.0) <= _SUM_ERROR:
                raise ConfigError(f"bristles: {name} sums to {total:.10g}; accepted: 1, as parts of {whole}")

    def passivity_factor(self, c0: float, speed: ArrayLike) -> Array:
        """Return the least of a_i / k_i (1 + sqrt(|v| / A_i))^2 over the blocks."""
        ratio = np.divide(self.share, self.stiffness)
        above = 1.0 + np.sqrt(np.asarray(speed)[..., None] * c0 / (self.attraction * ratio))
        return np.asarray(np.min(ratio * above**2, axis=-1))


KINDS: dict[str, type[BristlesPart]] = {kind.kind: kind for kind in (ElastoPlastic, MaxwellSlip)}
"""By their names in a file."""


def fill_bristles(record: Any, kinds: Sequence[BristlesPart | None]) -> None:
    """Write the bristles of elements into a record of `bristles_dtype(len(kinds))`, zero before; None is LuGre's."""
    blocks = record["blocks"]
    blocks["reach"] = blocks["attraction"] = 1.0
    for e, kind in enumerate(kinds):
        if isinstance(kind, ElastoPlastic):
            record["elastic_used"] = record["elastic"][e] = 1
            record["break_away"][e] = kind.break_away
        elif isinstance(kind, MaxwellSlip):
            record["blocks_used"] = record["blocked"][e] = 1
            used = slice(len(kind.stiffness))
            blocks["stiffness"][e, used] = kind.stiffness
            blocks["reach"][e, used] = np.divide(kind.share, kind.stiffness)
            blocks["attraction"][e] = kind.attraction
