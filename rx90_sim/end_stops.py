"""The mechanical end stops of the joints."""

from __future__ import annotations

from typing import Any

from rx90_common.kernels.compiled import kernel


@kernel
def add_stops(plant: Any, state: Any) -> None:
    """Add to `state.rhs` what the stops push: a spring and damper beyond the limits that only push back."""
    for i in range(6):
        q, push = state.q_mid[i], 0.0
        if q > plant.upper[i]:
            push = min(0.0, plant.stop_stiffness[i] * (plant.upper[i] - q) - plant.stop_damping[i] * state.v_mid[i])
        elif q < plant.lower[i]:
            push = max(0.0, plant.stop_stiffness[i] * (plant.lower[i] - q) - plant.stop_damping[i] * state.v_mid[i])
        state.rhs[i] += push
