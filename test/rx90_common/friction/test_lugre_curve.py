"""The sliding regime: the Stribeck curve and what is left at constant velocity (equation 19)."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from rx90_common.base.rates import Rates
from rx90_common.friction import FrictionElement
from rx90_common.friction.bristle import bristle_step, friction_torque
from rx90_emulator.loop.setup import Setup

Record = Callable[[FrictionElement], Any]
TICK = Rates().period

ONE_SIDED = FrictionElement(
    tau_c_positive=25.0,
    tau_c_negative=31.0,
    tau_s_positive=32.0,
    tau_s_negative=47.0,
    omega_s=0.05,
    delta=1.0,
    c0=1e5,
    c1=100.0,
    c2=14.0,
    omega_d=1.0,
)
SPEEDS = [sign * speed for speed in np.geomspace(1e-7, 20.0, 25) for sign in (1.0, -1.0)]


def stribeck(element: FrictionElement, v: float) -> float:
    """Return equation 19 with its sign, plus the viscous part, from the paper's text."""
    coulomb, static = (
        (element.tau_c_positive, element.tau_s_positive) if v > 0 else (element.tau_c_negative, element.tau_s_negative)
    )
    curve = coulomb + (static - coulomb) * math.exp(-((abs(v) / element.omega_s) ** element.delta))
    return math.copysign(curve, v) + element.c2 * v


@pytest.mark.parametrize("delta", [0.5, 1.0, 2.0, 2.7])
def test_steady_state_is_the_stribeck_curve_of_each_sign(record: Record, delta: float) -> None:
    """After a long way at constant velocity the torque is the Stribeck curve of that sign to 1e-9 Nm."""
    element = FrictionElement(**{**vars(ONE_SIDED), "delta": delta})
    compiled = record(element)
    for v in SPEEDS:
        # Forty times the bristle's own deflection, in 400 steps.
        step = 40 * 47.0 / element.c0 / abs(v) / 400
        z, torque = -math.copysign(1e-4, v), 0.0
        for _ in range(400):
            z, torque = bristle_step(compiled, z, v, step)
        assert torque == pytest.approx(stribeck(element, v), abs=1e-9)
        assert friction_torque(compiled, z, v) == pytest.approx(stribeck(element, v), abs=1e-9)
        assert element.steady_torque(v) == pytest.approx(stribeck(element, v), abs=1e-9)


def test_steady_state_at_the_tick_of_the_plant(shipped: Setup, record: Record) -> None:
    """The seven shipped elements reach their curves in ticks of 250 us up to full joint speed."""
    reach = [*shipped.robot.max_velocity, shipped.robot.max_velocity[4:].sum()]
    for element, compiled, top in zip(
        shipped.friction.elements, map(record, shipped.friction.elements), reach, strict=True
    ):
        for v in (0.02 * top, -0.3 * top, top, -top):
            z, torque = 0.0, 0.0
            for _ in range(4000):
                z, torque = bristle_step(compiled, z, v, TICK)
            assert torque == pytest.approx(stribeck(element, v), abs=1e-9)


def test_torque_at_rest_is_the_bristle_s_alone(record: Record) -> None:
    """At zero velocity the torque is c0 z and the deflection keeps every bit, for either sign of it."""
    compiled = record(ONE_SIDED)
    for z in (0.0, 1.234e-5, -2.5e-4, 5e-324):
        for v in (0.0, -0.0):
            kept, torque = bristle_step(compiled, z, v, TICK)
            assert kept == z
            assert torque == ONE_SIDED.c0 * z
            assert friction_torque(compiled, z, v) == ONE_SIDED.c0 * z
    assert ONE_SIDED.steady_torque(0.0) == 0.0


def test_the_deflection_saturates_at_the_side_it_slides_to(record: Record) -> None:
    """Sliding deflects the bristle by g of equation 19, positive and negative sides each with their own."""
    compiled = record(ONE_SIDED)
    for v, torque in ((5.0, 25.0), (-5.0, -31.0)):
        z = 0.0
        for _ in range(2000):
            z, _ = bristle_step(compiled, z, v, TICK)
        assert z * ONE_SIDED.c0 == pytest.approx(torque, abs=1e-9)
