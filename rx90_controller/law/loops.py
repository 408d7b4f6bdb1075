"""The one control law, compiled: SISO servo controllers, one for each motor, as in section 5 and figure 4 of the paper.

Blocks of the paper: PI on the position error and FF from the set-points at the position rate, D on the
measured velocity and C, the current loop with its amplifier, at the base rate. All quantities are on the
motor side, because each controller serves one motor. The formulas are for one motor or for lanes of them. The drives'
supervision compares following errors and speeds of the joints with their limits.
"""

from __future__ import annotations

from functools import cache
from typing import Any

import numpy as np

from rx90_common.base.arrays import Array, Record
from rx90_common.description.coupling import (
    ArmSize,
    joints_as_motors_have_them,
    to_joint,
    to_joint_torque,
    to_motor,
)
from rx90_common.kernels.compiled import inlined, kernel
from rx90_common.kernels.elementary import signed_power
from rx90_common.kernels.lanes import Lanes, absolute, any_lane, load, select, size, store
from rx90_controller.law.model import FRESH, add_model_torque, begin_parts, hand_over, model_state_dtype

_LARGEST = float(np.finfo(np.float64).max)


@cache
def law_state_dtype(arm: ArmSize) -> np.dtype[np.void]:
    """Return the type of the state of a control law."""
    n = arm.joints
    return np.dtype(
        [
            ("reference", np.float64, (3, n)),  # motor-side position, velocity, acceleration set-points
            ("offset", np.float64, (n,)),  # of the position set-point, motor side, rad; workspace
            ("error", np.float64, (n,)),  # position error at the last position tick
            ("velocity_error", np.float64, (n,)),
            ("integrator", np.float64, (n,)),
            ("position_torque", np.float64, (n,)),  # PI block, held between position ticks
            ("feed_forward", np.float64, (n,)),  # FF block, held between position ticks
            ("commanded", np.float64, (n,)),  # current commanded to the amplifier, within its limit, A
            ("current", np.float64, (n,)),
            ("command", np.float64, (n,)),  # torque constant times current
            ("limited", np.float64, (n,)),  # sign of the amplifier's saturation in the last tick, 0 if none
            ("saturated", np.float64, (n,)),  # ticks in saturation
            ("model", model_state_dtype(arm)),
        ],
        align=True,
    )


@inlined
def clip(x: Lanes, bound: Lanes) -> Lanes:
    """Return x limited to +-bound; NaN stays NaN."""
    return select(x > bound, bound, select(x < -bound, -bound, x))


@inlined
def position_servo(
    law: Any,
    width: int,
    position_setpoint: Lanes,
    velocity_setpoint: Lanes,
    acceleration_setpoint: Lanes,
    position: Lanes,
    integrator: Lanes,
    limited: Lanes,
) -> tuple[Lanes, Lanes, Lanes, Lanes]:
    """Return position error, integrator, torque of PI and torque of FF of one position tick.

    `width` lanes of the law's constants are used, a literal; `limited` is the sign of the last tick's saturation.
    """
    error = position_setpoint - position
    # Anti-windup: no integration further into the amplifier's saturation.
    advanced = clip(integrator + load(law.integral, width) * error, load(law.integrator_limit, width))
    integrator = select(error * limited <= 0.0, advanced, integrator)
    # The sign function, made continuous: a set-point that crosses zero must not switch the torque back and forth.
    sign = clip(velocity_setpoint / load(law.coulomb_velocity, width), 1.0)
    viscous = load(law.viscous, width) * signed_power(velocity_setpoint, load(law.viscous_exponent, width))
    feed_forward = load(law.inertia, width) * acceleration_setpoint + load(law.coulomb, width) * sign + viscous
    return error, integrator, load(law.proportional, width) * error + integrator, feed_forward


@inlined
def velocity_servo(
    law: Any,
    width: int,
    current_gain: Lanes,
    position_torque: Lanes,
    feed_forward: Lanes,
    velocity_setpoint: Lanes,
    velocity: Lanes,
    current: Lanes,
) -> tuple[Lanes, Lanes, Lanes, Lanes]:
    """Return commanded current, motor current, torque and sign of the saturation of one base tick.

    D's damping, the amplifier's limit, and C, the current loop of first order with limited slew.
    """
    damping = load(law.derivative, width) * (load(law.velocity_weight, width) * velocity_setpoint - velocity)
    peak, constant = load(law.peak_current, width), load(law.torque_constant, width)
    requested = (position_torque + feed_forward + damping) / constant
    limited = select(requested > peak, 1.0, select(requested < -peak, -1.0, 0.0 * requested))
    commanded = clip(requested, peak)
    change = current_gain * (commanded - current)
    current = current + clip(change, load(law.current_step, width))
    return commanded, current, constant * current, limited


@inlined
def _beyond_limits(law: Any, error: Lanes, velocity: Lanes) -> bool:
    """Return whether a joint is beyond a limit, or NaN, by position errors and velocities of the motors."""
    following = joints_as_motors_have_them(law.gear, error)
    speed = joints_as_motors_have_them(law.gear, velocity)
    n = size(law.over_speed)
    # The comparisons are false for NaN too.
    fast = select(absolute(speed) <= load(law.over_speed, n), 0.0, 1.0)
    return any_lane(select(absolute(following) <= load(law.following_error, n), fast, 1.0) > 0.0)


@kernel
def law_reset(states: Record) -> None:
    """Begin anew: as `law_release`, and the joints of the model are as warm as its file has them at the start."""
    law_release(states)
    states[0].model.friction.warm = 0


@kernel
def law_release(states: Record) -> None:
    """Set integrators, currents and errors to zero; the next position tick does so with the model's bristles."""
    state = states[0]
    for i in range(size(state.integrator)):
        state.integrator[i] = state.position_torque[i] = state.feed_forward[i] = 0.0
        state.error[i] = state.velocity_error[i] = 0.0
        state.commanded[i] = state.current[i] = state.command[i] = 0.0
        state.limited[i] = state.saturated[i] = 0
        for k in range(3):
            state.reference[k, i] = 0.0
    state.model.parts = FRESH


@kernel
def position_loop(laws: Record, states: Record, setpoint: Array, position: Array, velocity: Array) -> bool:
    """Run PI, FF, with the torque of a model of arm and friction, and the supervision for one position tick.

    Args:
        laws: constants, shape (1,), of `controller_dtype`.
        states: state, shape (1,), of `law_state_dtype`, advanced in place.
        setpoint: joint position rad, velocity rad/s, acceleration rad/s^2, shape (3, n); with a fourth row, an offset
            of the position, rad, that only PI sees.
        position: motor positions by the encoders, rad, shape (n,).
        velocity: measured motor velocities, rad/s, shape (n,); for the supervision and the velocity error that is
            published.

    Returns:
        Whether the following error or the speed of a joint is beyond its limit: the drives are to be switched off.
    """
    law, state = laws[0], states[0]
    other_parts = law.model.parts != state.model.parts
    if other_parts:
        begin_parts(state)
    for k in range(3):
        to_motor(law.gear, setpoint[k], state.reference[k])
    n = size(state.error)
    requested = load(state.reference[0], n)
    if setpoint.shape[0] > 3:
        to_motor(law.gear, setpoint[3], state.offset)
        offset = load(state.offset, n)
        requested = select(offset == 0.0, requested, requested + offset)  # none leaves the bits, also those of -0
    error, integrator, position_torque, feed_forward = position_servo(
        law,
        n,
        requested,
        load(state.reference[1], n),
        load(state.reference[2], n),
        load(position, n),
        load(state.integrator, n),
        load(state.limited, n),
    )
    measured = load(velocity, n)
    store(state.error, error)
    store(state.velocity_error, load(state.reference[1], n) - measured)
    store(state.integrator, integrator)
    store(state.position_torque, position_torque)
    store(state.feed_forward, feed_forward)
    if law.model.parts != 0:
        add_model_torque(law, state, setpoint)
    if other_parts:
        hand_over(law, state)
    return _beyond_limits(law, error, measured)


@kernel
def velocity_loop(laws: Record, states: Record, velocity: Array) -> bool:
    """Run D and C for one base tick and write `command`, motor torques in Nm, into the state.

    Args:
        laws: constants, shape (1,), of `controller_dtype`.
        states: state, shape (1,), of `law_state_dtype`, advanced in place.
        velocity: measured motor velocities, rad/s, shape (n,).

    Returns:
        Whether a torque is not finite: the drives are to be switched off.
    """
    law, state = laws[0], states[0]
    n = size(state.current)
    commanded, current, command, limited = velocity_servo(
        law,
        n,
        law.current_gain,
        load(state.position_torque, n),
        load(state.feed_forward, n),
        load(state.reference[1], n),
        load(velocity, n),
        load(state.current, n),
    )
    store(state.commanded, commanded)
    store(state.current, current)
    store(state.command, command)
    store(state.limited, limited)
    store(state.saturated, load(state.saturated, n) + limited * limited)
    return any_lane(select(absolute(command) <= _LARGEST, 0.0, 1.0) > 0.0)


@kernel
def joints_of(laws: Record, motor: Array, joint: Array) -> None:
    """Write positions (or velocities, or errors) of the joints for those of the motors, shape (n,)."""
    to_joint(laws[0].gear, motor, joint)


@kernel
def joint_torques_of(laws: Record, motor: Array, joint: Array) -> None:
    """Write the joint torques that motor torques make, Nm, shape (n,)."""
    to_joint_torque(laws[0].gear, motor, joint)
