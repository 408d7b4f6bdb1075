"""Windings of the motors: how warm they get, and what the amplifier does about it."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import partial
from typing import Annotated, Any

import numpy as np

from rx90_common.base.arrays import Array
from rx90_common.base.declared import Declared
from rx90_common.base.entries import LEFT_OUT, REQUIRED, Number, Numbers
from rx90_common.base.errors import ConfigError

COPPER = 0.00393
"""Temperature coefficient of copper's resistance at 20 degrees, 1/K (IEC 60028)."""
_ABSOLUTE_ZERO = -273.15
_positive = partial(Numbers, count=6, low=0.0, above=True)
_cold, _isolated = Numbers("", count=6, low=0.0), _positive("", infinite=True)
_degrees = partial(Number, unit="°C", low=_ABSOLUTE_ZERO, high=1000.0)
_never = Number("", low=_ABSOLUTE_ZERO, infinite=True)  # also warmer than any winding: no limit


def _endless() -> Array:
    return np.full(6, math.inf)


@dataclass(frozen=True)
class Windings(Declared):
    """A thermal node in each motor, heated by I^2 R; the arrays have shape (6,), temperatures are in degrees Celsius.

    A resistance of 0 stands for windings that stay as warm as they are. Between `derating` and `limit` the peak current
    falls linearly.

    Raises:
        ConfigError: for values out of range.
    """

    name = "winding"
    about = "Windings of the motors, a thermal node each; left out: they stay as warm as they are."

    resistance: Annotated[Array, _positive("Resistance at the reference temperature.", "Ohm"), _cold, REQUIRED] = field(
        default_factory=lambda: np.zeros(6)
    )
    thermal_resistance: Annotated[Array, _positive("Between winding and surroundings.", "K/W"), _isolated, REQUIRED] = (
        field(default_factory=_endless)
    )
    heat_capacity: Annotated[Array, _positive("Of the winding.", "J/K"), _isolated, REQUIRED] = field(
        default_factory=_endless
    )
    ambient: Annotated[float, _degrees("Temperature of the surroundings."), REQUIRED] = 20.0
    initial: Annotated[
        float,
        _degrees(
            "Temperature of the windings at the start; as warm as the surroundings if left out.", default=LEFT_OUT
        ),
    ] = 20.0
    reference: Annotated[float, _degrees("Temperature at which the resistance holds.")] = 20.0
    coefficient: Annotated[float, Number("Rise of the resistance with temperature.", "1/K", low=0.0, high=0.1)] = COPPER
    derating: Annotated[
        float, _degrees("Temperature from which on the amplifier limits the current."), _never, REQUIRED
    ] = math.inf
    limit: Annotated[float, _degrees("Temperature at which it gives none."), _never, REQUIRED] = math.inf

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.used and not self.derating < self.limit:
            raise ConfigError(f"winding: derating is {self.derating:g} °C; accepted: below limit = {self.limit:g} °C")
        if self.used and not max(self.ambient, self.initial) <= self.derating:
            warm = max(self.ambient, self.initial)
            raise ConfigError(
                f"winding: derating is {self.derating:g} °C; accepted: at least {warm:g} °C, as it begins"
            )

    @property
    def used(self) -> bool:
        """Return whether any winding gets warm."""
        return bool(np.any(self.resistance))

    @classmethod
    def of_file(cls, content: Mapping[str, Any] | None, **fields: Any) -> Windings:
        """Return what a block of a drives file says; cold ones for none."""
        return super().of_file(content and {"initial": content["ambient"], **content}, **fields)
