"""What a drive measures, for one motor or for lanes of them: the encoder's counts and the observed velocity."""

from __future__ import annotations

from rx90_common.kernels.compiled import inlined
from rx90_common.kernels.lane_bits import WHOLE
from rx90_common.kernels.lanes import Lanes


@inlined
def encoder_reading(position: Lanes, resolution: Lanes) -> Lanes:
    """Return a motor position, rad, rounded to whole counts of `resolution`, rad."""
    # Adding and subtracting a number whose last bit is worth 1 rounds to a whole number, half to even.
    whole = (position / resolution + WHOLE) - WHOLE
    return whole * resolution


@inlined
def observe(
    reading: Lanes, position: Lanes, velocity: Lanes, period: float, position_gain: float, velocity_gain: float
) -> tuple[Lanes, Lanes]:
    """Advance a critically damped observer of second order, as resolver-to-digital converters have it.

    Args:
        reading: the encoder's position, rad.
        position: the observer's position before, rad.
        velocity: the observed velocity before, rad/s.
        period: the tick, s.
        position_gain: gain of the innovation on the position.
        velocity_gain: gain of the innovation on the velocity, 1/s.

    Returns:
        The observer's position and velocity now.
    """
    predicted = position + period * velocity
    innovation = reading - predicted
    return predicted + position_gain * innovation, velocity + velocity_gain * innovation
