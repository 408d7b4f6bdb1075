"""How warm the joints of a plant are: those of its friction elements that have a temperature."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from rx90_common.base.arrays import Array, Record
from rx90_common.friction import ELEMENT_COUNT, FrictionSet
from rx90_common.friction.parts.temperature import follow_temperatures
from rx90_common.kernels.compiled import kernel


class JointTemperatures:
    """Views of a plant's state.

    Args:
        friction: the seven elements.
        constants: of the plant, shape (1,), PLANT_DTYPE.
        state: of the plant, shape (1,), STATE_DTYPE.

    Attributes:
        elements: places of the elements that have a temperature in `FrictionSet.names`.
        now: degrees Celsius, shape (7,); 0 for the other elements.
        heat: of friction and motors since the last reset, J, shape (7,).
    """

    def __init__(self, friction: FrictionSet, constants: np.ndarray[Any, Any], state: np.ndarray[Any, Any]) -> None:
        self._friction, self._constants, self._state = friction, constants, state
        self.elements = tuple(i for i, element in enumerate(friction.elements) if element.temperature is not None)
        warmth = state["parts"]["temperature"]
        self.now: Array = warmth["temperature"][0]
        self.heat: Array = warmth["heat"][0]

    def set(self, temperatures: ArrayLike) -> None:
        """Make the joints so warm, degrees Celsius, shape (7,); those without a temperature take none."""
        wanted = np.broadcast_to(np.asarray(temperatures, dtype=np.float64), ELEMENT_COUNT)
        for i in self.elements:
            self.now[i] = wanted[i]
        _follow(self._constants, self._state)

    def beyond_law(self) -> str:
        """Return in words which joints are warmer than the law of their friction holds; '' if none is."""
        return beyond_law(self._friction, self.now)


def beyond_law(friction: FrictionSet, temperatures: Array) -> str:
    """Return the same for any temperatures of the seven elements, degrees Celsius."""
    return ", ".join(
        f"{name} at {now:.1f} °C keeps the friction of {part.highest:g} °C, the highest of its law"
        for name, element, now in zip(friction.names, friction.elements, temperatures, strict=True)
        if (part := element.temperature) is not None and now > part.highest
    )


@kernel
def _follow(plants: Record, states: Record) -> None:
    """Give the elements the friction of their temperatures."""
    follow_temperatures(plants[0].parts.temperature, states[0].parts.temperature, 7)
