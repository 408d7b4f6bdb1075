"""The one control law, compiled: six SISO servo controllers as in section 5 and figure 4 of the paper.

Blocks of the paper: PI on the position error and FF from the set-points at the position rate, D on the
measured velocity and C, the current loop with its amplifier, at the base rate. All quantities are on the
motor side, because each controller serves one motor.
"""

from __future__ import annotations

import numpy as np

from rx90_common.base.arrays import Array, Record
from rx90_common.description.wrist import to_motor
from rx90_common.kernels.compiled import kernel
from rx90_common.kernels.lanes import load, store
from rx90_controller.law.model_torque import FRESH, MODEL_STATE_DTYPE, add_model_torque, begin_parts, hand_over
from rx90_controller.law.servo import load_gains, position_servo, velocity_servo
from rx90_controller.law.supervision import beyond_limits, not_finite

LAW_STATE_DTYPE = np.dtype(
    [
        ("reference", np.float64, (3, 6)),  # motor-side position, velocity, acceleration set-points
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
        setpoint: joint position rad, velocity rad/s, acceleration rad/s^2, shape (3, 6).
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
    loop = position_servo(
        load_gains(law, 6),
        load(state.reference[0], 6),
        load(state.reference[1], 6),
        load(state.reference[2], 6),
        load(position, 6),
        load(state.integrator, 6),
        load(state.limited, 6),
    )
    store(state.error, loop.error)
    measured = load(velocity, 6)
    store(state.velocity_error, load(state.reference[1], 6) - measured)
    store(state.integrator, loop.integrator)
    store(state.position_torque, loop.position_torque)
    store(state.feed_forward, loop.feed_forward)
    if law.model.parts != 0:
        add_model_torque(law, state, setpoint)
    if other_parts:
        hand_over(law, state)
    return beyond_limits(law, loop.error, measured)


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
    loop = velocity_servo(
        load_gains(law, 6),
        law.current_gain,
        load(state.position_torque, 6),
        load(state.feed_forward, 6),
        load(state.reference[1], 6),
        load(velocity, 6),
        load(state.current, 6),
    )
    store(state.commanded, loop.commanded)
    store(state.current, loop.current)
    store(state.command, loop.command)
    store(state.limited, loop.limited)
    store(state.saturated, load(state.saturated, 6) + loop.limited * loop.limited)
    return not_finite(loop.command)
