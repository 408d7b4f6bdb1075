"""Temperature of the windings in compiled code, and what the amplifier does about it.

    C dT/dt = R I^2 (1 + a (T - T_r)) - (T - T_a) / R_th

is linear in T where the current I is held, as it is for a tick, and is advanced exactly. From `derating` on the peak
current falls linearly and is 0 at `limit`: servo amplifiers fold their current back before they give up, so that a
motor that is too warm still brakes; what the arm then cannot follow, the controller's supervision switches off.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from rx90_common.base.arrays import Array, Record
from rx90_common.description.winding import Windings
from rx90_common.friction.bristle import decay
from rx90_common.kernels.compiled import inlined, kernel
from rx90_common.kernels.lanes import Lanes, load, store

WINDING_DTYPE = np.dtype(
    [
        ("used", np.int64),
        ("heat", np.float64, 6),  # of the square of the torque at the reference temperature, K/s / Nm^2
        ("coefficient", np.float64),
        ("reference", np.float64),
        ("cooling", np.float64, 6),  # 1/s
        ("ambient", np.float64),
        ("initial", np.float64),
        ("limit", np.float64),
        ("slope", np.float64),  # share of the peak current for each degree below the limit
    ],
    align=True,
)
"""Constants, motor side."""


def fill_windings(record: Any, windings: Windings, torque_constant: Array) -> None:
    """Write the constants."""
    record["used"], record["initial"] = windings.used, windings.initial
    if windings.used:
        record["heat"] = windings.resistance / (windings.heat_capacity * torque_constant * torque_constant)
        record["cooling"] = 1.0 / (windings.heat_capacity * windings.thermal_resistance)
        record["slope"] = 1.0 / (windings.limit - windings.derating)
        for name in ("coefficient", "reference", "ambient", "limit"):
            record[name] = getattr(windings, name)


@kernel
def current_share(winding: Any, temperature: float) -> float:
    """Return the share of its peak current that an amplifier gives a winding of a temperature, degrees Celsius."""
    share: float = winding.slope * (winding.limit - temperature)
    return min(1.0, max(0.0, share))


@inlined
def relative_resistance(winding: Any, temperature: Lanes) -> Lanes:
    """Return the resistance of windings at their temperatures, degrees Celsius, over that at the reference."""
    resistance: Lanes = 1.0 + winding.coefficient * (temperature - winding.reference)
    return resistance


@kernel
def warm_windings(winding: Any, torque: Array, temperature: Array, duration: float) -> None:
    """Advance the temperatures, degrees Celsius, shape (6,), over a time, s, of constant torques, Nm, shape (6,)."""
    pushed, before = load(torque, 6), load(temperature, 6)
    heat = load(winding.heat, 6) * pushed * pushed
    cooling = load(winding.cooling, 6)
    rate = heat * relative_resistance(winding, before) - cooling * (before - winding.ambient)
    mean, _ = decay(duration * (cooling - heat * winding.coefficient))
    store(temperature, before + duration * rate * mean)


def current_shares(plant: Record, temperature: Array) -> Array:
    """Return the share of its peak current that each amplifier gives its winding, 1 where it is not too warm.

    Args:
        plant: constants, shape (1,), PLANT_DTYPE.
        temperature: of the windings, degrees Celsius, shape (6,).
    """
    winding = plant["winding"][0]
    return np.array([current_share(winding, float(one)) if winding["used"] else 1.0 for one in temperature])


def warm_motors(plant: Record, temperature: Array) -> str:
    """Return in words which amplifiers give less than their peak current; '' if none; arguments as above."""
    pairs = enumerate(zip(temperature, current_shares(plant, temperature), strict=True), 1)
    return ", ".join(
        f"motor_{k} at {warm:.1f} °C has {math.floor(100.0 * share)} % of its peak current"
        for k, (warm, share) in pairs
        if share < 1.0
    )
