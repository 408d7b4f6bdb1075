"""Windings of the motors: how warm they get, and what the amplifier does about it."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import partial
from typing import Any

import numpy as np

from rx90_common.base.arrays import Array
from rx90_common.base.entries import LEFT_OUT, Number, Numbers
from rx90_common.base.errors import ConfigError
from rx90_common.base.groups import Group

COPPER = 0.00393
"""Temperature coefficient of copper's resistance at 20 degrees, 1/K (IEC 60028)."""
_ABSOLUTE_ZERO = -273.15
_positive = partial(Numbers, count=6, low=0.0, above=True)
_degrees = partial(Number, unit="°C", low=_ABSOLUTE_ZERO, high=1000.0)

WINDING = Group(
    "Windings of the motors, a thermal node each; left out: they stay as warm as they are.",
    keys={
        "resistance": _positive("Resistance at the reference temperature.", "Ohm"),
        "thermal_resistance": _positive("Between winding and surroundings.", "K/W"),
        "heat_capacity": _positive("Of the winding.", "J/K"),
        "ambient": _degrees("Temperature of the surroundings."),
        "initial": _degrees("Temperature of the windings at the start; as warm as the surroundings if left out.",
                            default=LEFT_OUT),
        "reference": _degrees("Temperature at which the resistance holds.", default=20.0),
        "coefficient": Number("Rise of the resistance with temperature.", "1/K", low=0.0, high=0.1, default=COPPER),
        "derating": _degrees("Temperature from which on the amplifier limits the current."),
        "limit": _degrees("Temperature at which it gives none."),
    },
    default=LEFT_OUT,
)  # fmt: skip
"""What a drives file may hold of them."""


def _endless() -> Array:
    return np.full(6, math.inf)


@dataclass(frozen=True)
class Windings:
    """A thermal node in each motor, heated by I^2 R; the arrays have shape (6,), temperatures are in degrees Celsius.

    Attributes:
        resistance: at `reference`, Ohm; 0 for windings that stay cold, which is off.
        thermal_resistance: between winding and surroundings, K/W.
        heat_capacity: J/K.
        ambient: of the surroundings.
        initial: of the windings after a reset.
        reference: where the resistance holds.
        coefficient: of the resistance, 1/K.
        derating: from where on the peak current falls, linearly.
        limit: where it is 0.

    Raises:
        ConfigError: for values out of range.
    """

    resistance: Array = field(default_factory=lambda: np.zeros(6))
    thermal_resistance: Array = field(default_factory=_endless)
    heat_capacity: Array = field(default_factory=_endless)
    ambient: float = 20.0
    initial: float = 20.0
    reference: float = 20.0
    coefficient: float = COPPER
    derating: float = math.inf
    limit: float = math.inf

    def __post_init__(self) -> None:
        for name in ("resistance", "thermal_resistance", "heat_capacity"):
            value = np.asarray(getattr(self, name))
            good = value > 0 if name != "resistance" else np.isfinite(value) & (value >= 0)
            if value.shape != (6,) or not np.all(good):
                raise ConfigError(f"winding: {name} is {value.tolist()}; accepted: 6 numbers > 0")
        for name in ("ambient", "initial", "reference", "coefficient", "derating", "limit"):
            value = getattr(self, name)
            if math.isnan(value) or (math.isinf(value) and name not in ("derating", "limit")):
                raise ConfigError(f"winding: {name} is {value}; accepted: a finite number")
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
    def of_file(cls, block: Mapping[str, Any] | None) -> Windings:
        """Return what a block of a drives file says, checked by WINDING; cold ones for none."""
        if block is None:
            return cls()
        return cls(**{
            **{name: np.array(value) if isinstance(value, tuple) else value for name, value in block.items()},
            "initial": block.get("initial", block["ambient"]),
        })  # fmt: skip
