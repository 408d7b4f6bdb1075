"""The one control law, compiled: six SISO servo controllers as in section 5 and figure 4 of the paper.

Blocks of the paper: PI on the position error and FF from the set-points at the position rate, D on the
measured velocity and C, the current loop with its amplifier, at the base rate. All quantities are on the
motor side, because each controller serves one motor. The formulas are for one motor or for lanes of them. The drives'
supervision compares following errors and speeds of the joints with their limits.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from rx90_common.base.arrays import Array, Record
from rx90_common.description.drives import to_motor
from rx90_common.kernels.compiled import inlined, kernel
from rx90_common.kernels.elementary import signed_power
from rx90_common.kernels.lanes import Lanes, absolute, any_lane, append, first, lane, load, select, store
from rx90_controller.law.model import FRESH, MODEL_STATE_DTYPE, add_model_torque, begin_parts, hand_over

_LARGEST = float(np.finfo(np.float64).max)

LAW_STATE_DTYPE = np.dtype(
    [
        ("reference", np.float64, (3, 6)),  # motor-side position, velocity, acceleration set-points
        ("offset", np.float64, 6),  # of the position set-point, motor side, rad; workspace
        ("error", np.float64, 6),  # position error at the last position tick
        ("velocity_error", np.float64, 6),
        ("integrator", np.float64, 6),
        ("position_torque", np.float64, 6),  # PI block, held between position ticks
        ("feed_forward", np.float64, 6),  # FF block, held between position ticks
        ("commanded", np.float64, 6),  # current that the amplifier is asked for, within its limit, A
        ("current", np.float64, 6),
        ("command", np.float64, 6),  # torque constant times current
        ("limited", np.float64, 6),  # sign of the amplifier's saturation in the last tick, 0 if none
        ("saturated", np.float64, 6),  # ticks in saturation
        ("model", MODEL_STATE_DTYPE),
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
    wanted = (position_torque + feed_forward + damping) / constant
    limited = select(wanted > peak, 1.0, select(wanted < -peak, -1.0, 0.0 * wanted))
    commanded = clip(wanted, peak)
    change = current_gain * (commanded - current)
    current = current + clip(change, load(law.current_step, width))
    return commanded, current, constant * current, limited


@inlined
def _beyond_limits(law: Any, error: Lanes, velocity: Lanes) -> bool:
    """Return whether a joint is beyond a limit, or NaN, by position errors and velocities of the motors."""
    # Motor 6 turns with joints 5 and 6 together.
    share = law.gear[5] / law.gear[4]
    following = append(first(error, 5), lane(error, 5) - share * lane(error, 4))
    speed = append(first(velocity, 5), lane(velocity, 5) - share * lane(velocity, 4))
    # The comparisons are false for NaN too.
    fast = select(absolute(speed) <= load(law.over_speed, 6), 0.0, 1.0)
    return any_lane(select(absolute(following) <= load(law.following_error, 6), fast, 1.0) > 0.0)


@kernel
def law_reset(states: Record) -> None:
    """Begin anew: as `law_release`, and the joints of the model are as warm as its file has them at the start."""
    law_release(states)
    states[0].model.friction.warm = 0


@kernel
def law_release(states: Record) -> None:
    """Set integrators, currents and errors to zero; the next position tick does so with the model's bristles."""
    state = states[0]
    for i in range(6):
        state.integrator[i] = state.position_torque[i] = state.feed_forward[i] = 0.0
        state.error[i] = state.velocity_error[i] = 0.0
        state.commanded[i] = state.current[i] = state.command[i] = 0.0
        state.limited[i] = state.saturated[i] = 0
        for k in range(3):
            state.reference[k, i] = 0.0
    state.model.parts = FRESH


@kernel
def position_loop(laws: Record, states: Record, setpoint: Array, position: Array, velocity: Array) -> bool:
    """Run PI, FF, with what a model of arm and friction adds to it, and the supervision for one position tick.

    Args:
        laws: constants, shape (1,), CONTROLLER_DTYPE.
        states: state, shape (1,), LAW_STATE_DTYPE, advanced in place.
        setpoint: joint position rad, velocity rad/s, acceleration rad/s^2, shape (3, 6); with a fourth row, an offset
            of the position, rad, that only PI sees.
        position: motor positions by the encoders, rad, shape (6,).
        velocity: measured motor velocities, rad/s, shape (6,); for the supervision and the velocity error that is
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
    wanted = load(state.reference[0], 6)
    if setpoint.shape[0] > 3:
        to_motor(law.gear, setpoint[3], state.offset)
        offset = load(state.offset, 6)
        wanted = select(offset == 0.0, wanted, wanted + offset)  # none leaves the bits, also those of -0
    error, integrator, position_torque, feed_forward = position_servo(
        law,
        6,
        wanted,
        load(state.reference[1], 6),
        load(state.reference[2], 6),
        load(position, 6),
        load(state.integrator, 6),
        load(state.limited, 6),
    )
    measured = load(velocity, 6)
    store(state.error, error)
    store(state.velocity_error, load(state.reference[1], 6) - measured)
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
        laws: constants, shape (1,), CONTROLLER_DTYPE.
        states: state, shape (1,), LAW_STATE_DTYPE, advanced in place.
        velocity: measured motor velocities, rad/s, shape (6,).

    Returns:
        Whether a torque is not finite: the drives are to be switched off.
    """
    law, state = laws[0], states[0]
    commanded, current, command, limited = velocity_servo(
        law,
        6,
        law.current_gain,
        load(state.position_torque, 6),
        load(state.feed_forward, 6),
        load(state.reference[1], 6),
        load(velocity, 6),
        load(state.current, 6),
    )
    store(state.commanded, commanded)
    store(state.current, current)
    store(state.command, command)
    store(state.limited, limited)
    store(state.saturated, load(state.saturated, 6) + limited * limited)
    return any_lane(select(absolute(command) <= _LARGEST, 0.0, 1.0) > 0.0)
