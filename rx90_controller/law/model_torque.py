"""Feed-forward by a model of arm and friction, compiled: inverse dynamics, and bristles that follow the set-points.

Both run at the position rate, as the paper's FF block does, and their torque is held for a period. They are evaluated
at the set-point of the time at which it acts in the mean, `lead` later: half a period, because it is held, and the
delay of the current loop. The set-points are driven on to there with their own accelerations: a trajectory that comes
later may change what the generator has ahead, and the nodes would know less of it than the loop without ROS.

The friction model is the plant's with the velocity of the set-points as input, the bristles' state included. With
LuGre's that is the observer of Canudas de Wit, Olsson, Astrom and Lischinsky (1995), without the correction by the
error and driven by what is wanted instead of what is measured. Nothing measured enters, so it cannot make the loop
oscillate, however wrong its parameters are. Each bristle takes its exact step over the period, and what is fed forward
is the mean torque over it; at rest both stay as they are, to the last bit. What an element has beyond the paper's law
stands in rx90_controller.law.model_friction.
"""

from __future__ import annotations

from typing import Any, Final

import numpy as np

from rx90_common.base.arrays import Array
from rx90_common.description.wrist import to_motor_torque
from rx90_common.dynamics import BODY_DTYPE, MANIPULATOR_DTYPE
from rx90_common.dynamics.manipulator import inverse_dynamics
from rx90_common.friction import ELEMENT_COUNT
from rx90_common.friction.arm_elements import add_to_joints
from rx90_common.kernels.compiled import inlined, kernel
from rx90_common.kernels.lanes import Lanes, fma, load, store
from rx90_controller.law.model_friction import (
    FRICTION_DTYPE,
    FRICTION_STATE_DTYPE,
    parted_friction,
    plain_friction,
)

INVERSE_DYNAMICS, FRICTION = 1, 2
"""Bits of `parts`: what is on."""
FRESH: Final = -1
"""`parts` of a state that has been through no position tick."""

MODEL_DTYPE = np.dtype(
    [
        ("parts", np.int64),
        ("arm", MANIPULATOR_DTYPE),
        ("friction", FRICTION_DTYPE),
        ("lead", np.float64),  # s
        ("period", np.float64),  # of the position loop, s
    ],
    align=True,
)
"""Constants; all zero where no part is on."""

MODEL_STATE_DTYPE = np.dtype(
    [
        ("parts", np.int64),  # of the last position tick
        ("friction", FRICTION_STATE_DTYPE),
        ("before", np.float64, 6),  # motor side, Nm: what was fed forward before the parts changed
        # Workspace.
        ("body", BODY_DTYPE),
        ("q", np.float64, 6),
        ("v", np.float64, 6),
        ("a", np.float64, 6),
        ("joint", np.float64, 6),
        ("motor", np.float64, 6),
    ],
    align=True,
)


@kernel
def add_model_torque(law: Any, state: Any, setpoint: Array) -> None:
    """Add the torque of the parts that are on to `feed_forward`, motor side, and advance the model's bristles.

    Args:
        law: constants, a record of CONTROLLER_DTYPE.
        state: a record of LAW_STATE_DTYPE.
        setpoint: joint position rad, velocity rad/s, acceleration rad/s^2, shape (3, 6).
    """
    model, own = law.model, state.model
    lead = model.lead
    a = load(setpoint[2], 6)
    v = fma(lead, a, load(setpoint[1], 6))
    q = fma(lead, fma(0.5 * lead, a, load(setpoint[1], 6)), load(setpoint[0], 6))
    store(own.q, q)
    store(own.v, v)
    store(own.a, a)
    rigid, friction = model.parts & INVERSE_DYNAMICS != 0, model.parts & FRICTION != 0
    parted = friction and model.friction.parts.used != 0
    if rigid or parted:
        inverse_dynamics(model.arm, own.body, own.q, own.v, own.a, own.joint)
    if parted:
        parted_friction(law, own, not _frictional(own.parts))
    if not rigid:
        store(own.joint, 0.0 * a)
    if friction:
        add_to_joints(own.joint, _torques(model, own, parted))
    to_motor_torque(law.gear, own.joint, own.motor)
    store(state.feed_forward, load(state.feed_forward, 6) + load(own.motor, 6))


@inlined
def _torques(model: Any, own: Any, parted: bool) -> Lanes:
    """Return the torques of the friction elements, Nm."""
    if parted:
        return load(own.friction.parts.friction, 7)
    return plain_friction(model.friction, own.friction, own.v, model.period)


@inlined
def _frictional(parts: int) -> bool:
    """Return whether the friction model was on in a position tick with these parts."""
    return parts != FRESH and parts & FRICTION != 0


@kernel
def begin_parts(state: Any) -> None:
    """Keep what was fed forward before other parts are on; bristles that were off begin undeflected."""
    own = state.model
    for i in range(6):
        own.before[i] = state.feed_forward[i]
    if not _frictional(own.parts):
        for i in range(ELEMENT_COUNT):
            own.friction.z[i] = 0.0


@kernel
def hand_over(law: Any, state: Any) -> None:
    """Let the integrators give, within their limits, what is no longer fed forward, and less where more is.

    Parts may be switched while the arm is held. The inverse dynamics then bring the weight, which the integrators have
    held until now: without this the arm would jump. After a reset the integrators hold nothing.
    """
    own = state.model
    if own.parts != FRESH:
        for i in range(6):
            limit = law.integrator_limit[i]
            wanted = state.integrator[i] + (own.before[i] - state.feed_forward[i])
            given = min(max(wanted, -limit), limit)
            state.position_torque[i] += given - state.integrator[i]
            state.integrator[i] = given
    own.parts = law.model.parts
