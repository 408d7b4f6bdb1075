"""The formulas of one servo controller, for one motor or for lanes of them (section 5 of the paper).

PI and FF run at the position rate, D and C at the base rate; all quantities are on the motor side.
"""

from __future__ import annotations

from typing import Any, NamedTuple

from rx90_common.kernels.compiled import inlined
from rx90_common.kernels.elementary import signed_power
from rx90_common.kernels.lanes import Lanes, load, select


class Gains(NamedTuple):
    """Constants of CONTROLLER_DTYPE that the formulas use."""

    proportional: Lanes
    integral: Lanes
    integrator_limit: Lanes
    derivative: Lanes
    velocity_weight: Lanes
    inertia: Lanes
    coulomb: Lanes
    coulomb_velocity: Lanes
    viscous: Lanes
    viscous_exponent: Lanes
    torque_constant: Lanes
    peak_current: Lanes
    current_step: Lanes


class PositionLoop(NamedTuple):
    """What the position loop leaves for the velocity loop: errors and torques."""

    error: Lanes
    integrator: Lanes
    position_torque: Lanes
    feed_forward: Lanes


class VelocityLoop(NamedTuple):
    """What the velocity loop leaves: commanded and motor current, torque, the sign of the amplifier's saturation."""

    commanded: Lanes
    current: Lanes
    command: Lanes
    limited: Lanes


@inlined
def clip(x: Lanes, bound: Lanes) -> Lanes:
    """Return x limited to +-bound; NaN stays NaN."""
    return select(x > bound, bound, select(x < -bound, -bound, x))


@inlined
def load_gains(law: Any, width: int) -> Gains:
    """Return the first `width` lanes of a record of CONTROLLER_DTYPE; `width` is a literal."""
    return Gains(
        load(law.proportional, width),
        load(law.integral, width),
        load(law.integrator_limit, width),
        load(law.derivative, width),
        load(law.velocity_weight, width),
        load(law.inertia, width),
        load(law.coulomb, width),
        load(law.coulomb_velocity, width),
        load(law.viscous, width),
        load(law.viscous_exponent, width),
        load(law.torque_constant, width),
        load(law.peak_current, width),
        load(law.current_step, width),
    )


@inlined
def position_servo(
    gains: Any,
    position_setpoint: Lanes,
    velocity_setpoint: Lanes,
    acceleration_setpoint: Lanes,
    position: Lanes,
    integrator: Lanes,
    limited: Lanes,
) -> PositionLoop:
    """Return PI and FF of one position tick; `limited` is the sign of the last tick's saturation."""
    error = position_setpoint - position
    # Anti-windup: no integration further into the amplifier's saturation.
    advanced = clip(integrator + gains.integral * error, gains.integrator_limit)
    integrator = select(error * limited <= 0.0, advanced, integrator)
    # The sign function, made continuous: a set-point that crosses zero must not switch the torque back and forth.
    sign = clip(velocity_setpoint / gains.coulomb_velocity, 1.0)
    viscous = gains.viscous * signed_power(velocity_setpoint, gains.viscous_exponent)
    feed_forward = gains.inertia * acceleration_setpoint + gains.coulomb * sign + viscous
    return PositionLoop(error, integrator, gains.proportional * error + integrator, feed_forward)


@inlined
def velocity_servo(
    gains: Any,
    current_gain: Lanes,
    position_torque: Lanes,
    feed_forward: Lanes,
    velocity_setpoint: Lanes,
    velocity: Lanes,
    current: Lanes,
) -> VelocityLoop:
    """Return D and C of one base tick: damping, amplifier limit, current loop of first order with limited slew."""
    damping = gains.derivative * (gains.velocity_weight * velocity_setpoint - velocity)
    wanted = (position_torque + feed_forward + damping) / gains.torque_constant
    limited = select(wanted > gains.peak_current, 1.0, select(wanted < -gains.peak_current, -1.0, 0.0 * wanted))
    commanded = clip(wanted, gains.peak_current)
    change = current_gain * (commanded - current)
    current = current + clip(change, gains.current_step)
    return VelocityLoop(commanded, current, gains.torque_constant * current, limited)
