"""Friction along a prescribed velocity, of elements with other bristles than LuGre's."""

from __future__ import annotations

import numpy as np
import pytest

from rx90_common.friction import FrictionElement
from rx90_common.friction.compiled_elements import prescribed_torque
from rx90_common.friction.parts.bristles import BristlesPart, ElastoPlastic, MaxwellSlip

PLAIN = FrictionElement(25.0, 25.0, 28.0, 28.0, 0.05, 1.0, 1e5, 100.0, 14.0)


@pytest.mark.parametrize("bristles", [ElastoPlastic(0.7), MaxwellSlip((0.6, 0.4), (0.7, 0.3), 5000.0)])
def test_other_bristles_are_springs_below_break_away(bristles: BristlesPart) -> None:
    """Below break-away the mean torque of a step is c0 x + (c1 + c2) v in its middle; LuGre's beside it bends.

    A step of no time, as between repeated stamps, has the torque of that moment.
    """
    steps = np.full(400, 1e-3)
    steps[[0, 200]] = 0.0
    time = np.cumsum(steps)
    velocity = np.where(steps > 0.0, 2e-4 * np.pi * np.cos(2.0 * np.pi * 5.0 * time), 0.0)
    middle = np.cumsum(velocity * steps) - 0.5 * velocity * steps
    elements = (PLAIN, FrictionElement(**{**vars(PLAIN), "bristles": bristles}))
    lugre, other = prescribed_torque(elements, np.column_stack([velocity, velocity]), steps).T
    exact = 1e5 * middle + (100.0 + 14.0) * velocity
    assert np.ptp(exact) > 3.0
    assert other == pytest.approx(exact, abs=1e-9)
    assert np.abs(lugre - exact).max() > 1e-3
