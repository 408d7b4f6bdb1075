"""The parts that an element may have, in one table: file, checks, legends and paths follow from it."""

from __future__ import annotations

from rx90_common.friction.parts.bristles import BristlesPart
from rx90_common.friction.parts.load import LoadPart
from rx90_common.friction.parts.part import FrictionPart
from rx90_common.friction.parts.ripple import RipplePart
from rx90_common.friction.parts.scatter import ScatterPart
from rx90_common.friction.parts.temperature import TemperaturePart

PARTS: dict[str, type[FrictionPart]] = {
    part.name: part for part in (LoadPart, TemperaturePart, RipplePart, ScatterPart, BristlesPart)
}
"""By the keys of their blocks, which are the attributes of FrictionElement."""
