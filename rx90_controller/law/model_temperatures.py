"""How warm the joints are in the controller's model of their friction."""

from __future__ import annotations

from typing import Any

import numpy as np

from rx90_common.base.arrays import Array, Record
from rx90_common.friction.parts.temperature import follow_temperatures, start_temperatures
from rx90_common.kernels.compiled import kernel
from rx90_common.kernels.lanes import load, store


class ModelTemperatures:
    """Views of a controller's state; all stays at 0 where its model has no temperatures, or its friction is off.

    Args:
        law: constants, shape (1,), CONTROLLER_DTYPE.
        state: of the law, shape (1,), LAW_STATE_DTYPE.

    Attributes:
        now: of the seven friction elements, degrees Celsius, shape (7,).
        heat: of friction and motors since they were set, or since the start, J, shape (7,).
    """

    def __init__(self, law: np.ndarray[Any, Any], state: np.ndarray[Any, Any]) -> None:
        self._law, self._state = law, state
        warmth = state["model"]["friction"]["parts"]["temperature"]
        self.now: Array = warmth["temperature"][0]
        self.heat: Array = warmth["heat"][0]

    def set(self, temperatures: Array) -> None:
        """Let them go on from these, degrees Celsius, shape (7,), instead of the start that the file gives."""
        _set(self._law, self._state, np.ascontiguousarray(temperatures))


@kernel
def _set(laws: Record, states: Record, temperatures: Array) -> None:
    part, state = laws[0].model.friction.parts.temperature, states[0].model.friction
    start_temperatures(part, state.parts.temperature, 7)
    store(state.parts.temperature.temperature, load(temperatures, 7))
    follow_temperatures(part, state.parts.temperature, 7)
    state.warm = 1
