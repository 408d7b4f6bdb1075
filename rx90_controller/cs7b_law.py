"""The one control law, compiled: six SISO servo controllers as in section 5 and figure 4 of the paper.

Blocks of the paper: PI on the position error and FF from the set-points at the position rate, D on the
measured velocity and C, the current loop with its amplifier, at the base rate. All quantities are on the
motor side, because each controller serves one motor.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rx90_common.compiled import kernel
from rx90_description.wrist import to_motor

Array = NDArray[np.float64]
Record = NDArray[Any]

LAW_STATE_DTYPE = np.dtype(
    [
        ("reference", np.float64, (3, 6)),  # motor-side position, velocity, acceleration set-points
        ("error", np.float64, 6),  # position error at the last position tick
        ("velocity_error", np.float64, 6),
        ("integrator", np.float64, 6),
        ("position_torque", np.float64, 6),  # PI block, held between position ticks
        ("feed_forward", np.float64, 6),  # FF block, held between position ticks
        ("current", np.float64, 6),
        ("command", np.float64, 6),  # torque constant times current
        ("limited", np.int64, 6),  # sign of the amplifier's saturation in the last tick, 0 if none
        ("saturated", np.int64, 6),  # ticks in saturation
    ],
    align=True,
)


@kernel
def law_reset(states: Record) -> None:
    """Discharge integrators and amplifiers."""
    state = states[0]
    for i in range(6):
        state.integrator[i] = state.position_torque[i] = state.feed_forward[i] = 0.0
        state.error[i] = state.velocity_error[i] = 0.0
        state.current[i] = state.command[i] = 0.0
        state.limited[i] = state.saturated[i] = 0
        for k in range(3):
            state.reference[k, i] = 0.0


@kernel
def position_loop(laws: Record, states: Record, setpoint: Array, position: Array, velocity: Array) -> None:
    """Run PI and FF for one position tick.

    Args:
        laws: constants, shape (1,), CONTROLLER_DTYPE.
        states: state, shape (1,), LAW_STATE_DTYPE, advanced in place.
        setpoint: joint position rad, velocity rad/s, acceleration rad/s^2, shape (3, 6).
        position: motor positions by the encoders, rad, shape (6,).
        velocity: measured motor velocities, rad/s, shape (6,); here only for the record of the error.
    """
    law, state = laws[0], states[0]
    for k in range(3):
        to_motor(law.gear, setpoint[k], state.reference[k])
    for i in range(6):
        error = state.reference[0, i] - position[i]
        state.error[i] = error
        state.velocity_error[i] = state.reference[1, i] - velocity[i]
        # Anti-windup: no integration further into the amplifier's saturation.
        if error * state.limited[i] <= 0.0:
            bound = law.integrator_limit[i]
            state.integrator[i] = min(bound, max(-bound, state.integrator[i] + law.integral[i] * error))
        state.position_torque[i] = law.proportional[i] * error + state.integrator[i]
        speed = state.reference[1, i]
        # The sign function, made continuous: a set-point that crosses zero must not switch the torque back
        # and forth.
        sign = min(1.0, max(-1.0, speed / law.coulomb_velocity[i]))
        state.feed_forward[i] = law.inertia[i] * state.reference[2, i] + law.coulomb[i] * sign + law.viscous[i] * speed


@kernel
def velocity_loop(laws: Record, states: Record, velocity: Array) -> None:
    """Run D and C for one base tick and write `command`, motor torques in Nm, into the state.

    Args:
        laws: constants, shape (1,), CONTROLLER_DTYPE.
        states: state, shape (1,), LAW_STATE_DTYPE, advanced in place.
        velocity: measured motor velocities, rad/s, shape (6,).
    """
    law, state = laws[0], states[0]
    for i in range(6):
        damping = law.derivative[i] * (state.reference[1, i] - velocity[i])
        asked = (state.position_torque[i] + state.feed_forward[i] + damping) / law.torque_constant[i]
        peak = law.peak_current[i]
        if abs(asked) > peak:
            asked = math.copysign(peak, asked)
            state.limited[i] = 1 if asked > 0.0 else -1
            state.saturated[i] += 1
        else:
            state.limited[i] = 0
        change = law.current_gain * (asked - state.current[i])
        step = law.current_step[i]
        state.current[i] += min(step, max(-step, change))
        state.command[i] = law.torque_constant[i] * state.current[i]
