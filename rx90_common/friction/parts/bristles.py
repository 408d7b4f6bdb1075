"""The kinds of bristles: accepted contents of `bristles` in a friction file, and limits of c1 for passivity.

Their equations stand with their compiled steps in elasto_plastic.py and maxwell_slip.py of rx90_common/friction/.
"""

from __future__ import annotations

import math
from typing import Annotated, Any, Literal, TypeAlias

import numpy as np
from numpy.typing import ArrayLike
from pydantic import (
    ConfigDict,
    Field,
    SerializerFunctionWrapHandler,
    model_serializer,
    model_validator,
)

from rx90_common.base.arrays import Array, RecordType, record_type
from rx90_common.base.models import JsonSchema, NotNegative, Positive, quantity, refusal
from rx90_common.friction.maxwell_slip import MAX_BLOCKS, blocks_dtype
from rx90_common.friction.parts.part import FrictionPart, Part, Surroundings
from rx90_common.kernels.compiled import inlined
from rx90_common.kernels.lanes import Lanes

LUGRE_PASSIVITY = 4.0
"""Of `passivity_factor`: LuGre's bristle is passive where c1 |v| < 4 c0 g(v) (Barahanov and Ortega 2000)."""

MAX_BREAK_AWAY = 0.9
"""Of `break_away`: nearer to 1 the way from break-away to sliding is a corner."""

_SUM_ERROR = 1e-9  # of stiffnesses and shares, which are given in decimals


def _require_kind(schema: JsonSchema) -> None:
    schema["required"] = ["kind", *schema.get("required", ())]


class BristlesPart(FrictionPart):
    """Bristles of another kind than LuGre's."""

    model_config = ConfigDict(json_schema_extra=_require_kind)

    @model_serializer(mode="wrap")
    def _with_kind(self, dump: SerializerFunctionWrapHandler) -> dict[str, Any]:
        return {"kind": type(self).model_fields["kind"].default, **dump(self)}

    def passivity_factor(self, c0: float, speed: ArrayLike) -> Array | float:  # noqa: ARG002 - of other kinds
        """Return the factor p for which the element is passive where c1 |v| < p c0 g(v).

        Args:
            c0: of the element, Nm/rad.
            speed: rad/s, any shape.
        """
        return LUGRE_PASSIVITY


class ElastoPlastic(BristlesPart):
    """Elasto-plastic bristles (Dupont, Hayward, Armstrong, Altpeter 2002).

    They are purely elastic up to break-away.
    """

    kind: Literal["elasto_plastic"] = "elasto_plastic"
    break_away: Annotated[
        NotNegative, quantity(
            "1", "Deflection up to which the bristles are purely elastic, in parts of tau_c / c0.", le=MAX_BREAK_AWAY,
        ),
    ]  # fmt: skip


_Shares: TypeAlias = Annotated[
    tuple[Annotated[float, Field(gt=0.0, le=1.0)], ...],
    Field(strict=False, min_length=1, max_length=MAX_BLOCKS),
]


class MaxwellSlip(BristlesPart):
    """Generalised Maxwell slip (Lampaert, Al-Bender, Swevers 2003).

    Parallel blocks, 1 to MAX_BLOCKS, each of which sticks or slips.
    """

    kind: Literal["maxwell_slip"] = "maxwell_slip"
    stiffness: Annotated[
        _Shares, quantity("1", "Stiffness of each block in parts of c0; they sum to 1.")
    ]
    share: Annotated[
        _Shares, quantity("1", "Share of each block in the sliding torque; they sum to 1.")
    ]
    attraction: Annotated[
        Positive, quantity(
            "Nm/s", "Attraction of the sliding curve; torques come to it at the rate attraction / sliding torque.",
        ),
    ]  # fmt: skip

    @model_validator(mode="after")
    def _check_blocks(self) -> MaxwellSlip:
        if len(self.share) != len(self.stiffness):
            raise refusal(
                "share", self.share, f"{len(self.stiffness)} numbers, as many as stiffness has"
            )
        for name, shares in (("stiffness", self.stiffness), ("share", self.share)):
            if abs(math.fsum(shares) - 1.0) > _SUM_ERROR:
                raise refusal(
                    name, shares, f"numbers that sum to 1; these sum to {math.fsum(shares):.10g}"
                )
        return self

    def passivity_factor(self, c0: float, speed: ArrayLike) -> Array:
        """Return the least of a_i / k_i (1 + sqrt(|v| / A_i))^2 over the blocks."""
        ratio = np.divide(self.share, self.stiffness)
        above = 1.0 + np.sqrt(np.asarray(speed)[..., None] * c0 / (self.attraction * ratio))
        return np.asarray(np.min(ratio * above**2, axis=-1))


Bristles: TypeAlias = Annotated[ElastoPlastic | MaxwellSlip, Field(discriminator="kind")]


def bristles_dtype(width: int) -> RecordType:
    """Return the type of the constants of `width` elements' bristles."""
    return record_type(
        ("blocked", np.int64, (width,)),  # 1 where it has blocks
        elastic_used=np.int64,  # 1 if any element is elasto-plastic
        blocks_used=np.int64,  # 1 if any element has blocks
        blocks=blocks_dtype(width),
        elastic=width,  # 1 where it is elasto-plastic
        break_away=width,
    )


def bristles_state_dtype(width: int) -> RecordType:
    """Return the type of the bristles' state besides the deflection that every element has."""
    return record_type(
        blocks=(width, 2, MAX_BLOCKS),  # deflections and senses, as `maxwell_slip_step` has them
        deflection=width,  # workspace of a step
        torque=width,
    )


def fill_bristles(record: Any, e: int, kind: BristlesPart, _: Surroundings | None = None) -> None:
    """Write the bristles of element e into a record of `bristles_dtype`, zero before: zeros are LuGre's."""
    if isinstance(kind, ElastoPlastic):
        record["elastic_used"] = record["elastic"][e] = 1
        record["break_away"][e] = kind.break_away
    elif isinstance(kind, MaxwellSlip):
        record["blocks_used"] = record["blocked"][e] = 1
        blocks = record["blocks"]
        used = slice(len(kind.stiffness))
        blocks["stiffness"][e, used] = kind.stiffness
        blocks["reach"][e] = 1.0
        blocks["reach"][e, used] = np.divide(kind.share, kind.stiffness)
        blocks["attraction"][e] = kind.attraction


@inlined
def reset_bristles(_parts: Any, state: Any, transmitted: Lanes, _step: float, _width: int) -> Lanes:
    """Put all blocks at rest; the elements' deflections are the caller's."""
    state.bristles.blocks[:] = 0.0
    return transmitted


BRISTLES = Part(
    (ElastoPlastic, MaxwellSlip),
    bristles_dtype,
    fill_bristles,
    state=bristles_state_dtype,
    settle=reset_bristles,
)
