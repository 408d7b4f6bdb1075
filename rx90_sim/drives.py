"""What a drive measures, for one motor or for lanes of them: the position in counts and the observed velocity.

The sensor is a resolver with a tracking converter. Such a converter rounds the position to its counts, but its velocity
is the analog signal inside the tracking loop (Analog Devices, data sheet of the AD2S83: it replaces a tachogenerator),
so counts do not appear in it. A velocity made from counts would jump by 1.8 mrad/s for one count of joint 1 or 2, which
the velocity loop answers with 10 Nm.
"""

from __future__ import annotations

from rx90_common.kernels.compiled import inlined
from rx90_common.kernels.lane_bits import WHOLE
from rx90_common.kernels.lanes import Lanes, Number


@inlined
def whole_steps(value: Number, step: Number) -> Number:
    """Return what a converter makes of a value: rounded to whole multiples of its `step`, in the value's unit."""
    # Adding and subtracting a number whose last bit is worth 1 rounds to a whole number, half to even.
    whole = (value / step + WHOLE) - WHOLE
    return whole * step


@inlined
def observe(
    angle: Lanes, position: Lanes, velocity: Lanes, period: float, position_gain: float, velocity_gain: float
) -> tuple[Lanes, Lanes]:
    """Advance the tracking loop of a resolver-to-digital converter: of second order, critically damped.

    Args:
        angle: the motor's position, rad, not rounded.
        position: the observer's position before, rad.
        velocity: the observed velocity before, rad/s.
        period: the tick, s.
        position_gain: gain of the innovation on the position.
        velocity_gain: gain of the innovation on the velocity, 1/s.

    Returns:
        The observer's position and velocity now.
    """
    predicted = position + period * velocity
    innovation = angle - predicted
    return predicted + position_gain * innovation, velocity + velocity_gain * innovation
