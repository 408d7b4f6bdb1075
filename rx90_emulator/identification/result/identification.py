"""What is known of each parameter of one friction element."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

from rx90_common.friction import FrictionElement
from rx90_emulator.identification.model.estimates import (
    ParameterEstimate,
)
from rx90_emulator.identification.records.record import BagSource


@dataclass(frozen=True, eq=False)
class IdentifiedElement:
    """One friction element with what is known about each of its parameters.

    Attributes:
        element: values to simulate with.
        estimates: by the names in PARAMETERS, without the viscous exponent where it is 1; those of a part by names
            such as bristles.break_away.
        sources: the bags each parameter rests on.
        given_bristles: whether its bristles are those of the fallback, of another kind than LuGre's, as its c0 is.
    """

    element: FrictionElement
    estimates: dict[str, ParameterEstimate]
    sources: dict[str, tuple[BagSource, ...]]
    given_bristles: bool = False

    @classmethod
    def of(
        cls,
        element: FrictionElement,
        estimates: Mapping[str, ParameterEstimate],
        sources: dict[str, tuple[BagSource, ...]],
        fallback: FrictionElement | None,
    ) -> IdentifiedElement:
        """Return an element with the fallback's bristles where its c0 is the fallback's: they belong together.

        Args:
            element: its own bristles, if it has any, were identified, and stay.
            estimates: of it.
            sources: of the estimates.
            fallback: where values that are not identifiable come from; None without one, or where LuGre's are told.
        """
        part = None if fallback is None else fallback.bristles
        if part is None or element.bristles is not None or ("c0" in estimates and estimates["c0"].identifiable):
            return cls(element, dict(estimates), sources)
        unknown = ParameterEstimate.unknown("it goes with c0, which is not identified")
        numbers = {f"{part.name}.{name}": unknown for name in part.numbers()}
        return cls(replace(element, bristles=part), {**estimates, **numbers}, sources, given_bristles=True)

    def value(self, name: str) -> float:
        """Return what the element has under the name of an estimate."""
        part, _, key = name.rpartition(".")
        return float(self.element.parts[part].numbers()[key] if part else getattr(self.element, name))
