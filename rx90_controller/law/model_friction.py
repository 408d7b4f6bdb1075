"""Friction of the controller's model, compiled: seven elements whose bristles and parts follow the set-points.

The parts are those of rx90_common/friction/parts, stepped by the same functions as the plant's:

- load: the torque that the joints transmit where the arm moves as wanted, M(q) a + h less what the rotors take. It
  follows from the set-points alone, so that here it is no algebraic loop;
- ripple: by the angles of the set-points;
- bristles of another kind: driven by the velocities of the set-points, as LuGre's;
- temperature: a thermal node of the model's own, heated by what the model's friction takes and by the torques that the
  motors must give, with windings as warm as the resistance is given for. The arm measures no temperature of its joints.
  One that is given would be right for a moment; a node is right for a day, and forgets within capacity times resistance
  what it began with wrong. It begins at `start`, cools while the torque is off, and rests while the model is off;
- scatter: its mean, which is nothing: nobody knows what a random walk will do.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from rx90_common.base.arrays import Array, Record
from rx90_common.description.wrist import to_motor_torque
from rx90_common.friction import ELEMENT_COUNT
from rx90_common.friction.arm_elements import add_to_joints, element_inputs, of_motors, transmit
from rx90_common.friction.bristle import bristle_step
from rx90_common.friction.compiled_elements import elements_dtype, load_elements
from rx90_common.friction.parts.load import advance_load
from rx90_common.friction.parts.record import parts_dtype, parts_state_dtype
from rx90_common.friction.parts.step import parts_energy, parts_step, settle_parts
from rx90_common.friction.parts.temperature import (
    add_work,
    advance_temperatures,
    follow_temperatures,
    start_temperatures,
)
from rx90_common.kernels.compiled import inlined, kernel
from rx90_common.kernels.lanes import Lanes, load, store

FRICTION_DTYPE = np.dtype(
    [("elements", elements_dtype(ELEMENT_COUNT)), ("parts", parts_dtype(ELEMENT_COUNT))], align=True
)
"""Constants."""

FRICTION_STATE_DTYPE = np.dtype(
    [
        ("z", np.float64, ELEMENT_COUNT),  # deflections of the bristles, rad
        ("parts", parts_state_dtype(ELEMENT_COUNT)),
        ("warm", np.int64),  # whether the temperatures are those of what has been, not those of the start
        # Workspace.
        ("joint", np.float64, 6),
        ("motor", np.float64, 6),
    ],
    align=True,
)


@inlined
def plain_friction(friction: Any, own: Any, velocity: Array, period: float) -> Lanes:
    """Advance the bristles of elements without parts by a period; return their mean torques over it, Nm.

    Args:
        friction: constants, a record of FRICTION_DTYPE.
        own: a record of FRICTION_STATE_DTYPE.
        velocity: of the joints, rad/s, shape (6,).
        period: s.
    """
    z, torque = bristle_step(load_elements(friction.elements, 7), load(own.z, 7), element_inputs(velocity), period)
    store(own.z, z)
    return torque


@kernel
def parted_friction(law: Any, own: Any, begins: bool) -> None:
    """Do the same with elements that have parts, and write the torques to `own.friction.parts.friction`.

    Args:
        law: constants, a record of CONTROLLER_DTYPE.
        own: a record of MODEL_STATE_DTYPE, whose `joint` is what the arm takes without friction, Nm.
        begins: whether the bristles are undeflected, and the load is at once what is transmitted.
    """
    friction, state, period = law.model.friction, own.friction, law.model.period
    transmit(law.model.arm.rotor, own.joint, own.a, state.parts.transmitted)
    transmitted = load(state.parts.transmitted, 7)
    if begins:
        _begin_parts(friction.parts, state, transmitted)
    velocity = element_inputs(own.v)
    z, torque = parts_step(
        friction.elements, friction.parts, state.parts, load(state.z, 7), element_inputs(own.q), velocity, period, 7
    )
    store(state.z, z)
    store(state.parts.friction, torque)
    advance_load(friction.parts.load, state.parts, transmitted, period, 7)
    if friction.parts.temperature.used:
        add_work(state.parts.temperature, torque, velocity, period, 7)
        _warm(law, own)


@inlined
def _begin_parts(parts: Any, state: Any, transmitted: Lanes) -> None:
    settle_parts(parts, state.parts, transmitted)
    if state.warm:
        follow_temperatures(parts.temperature, state.parts.temperature, 7)
    else:
        start_temperatures(parts.temperature, state.parts.temperature, 7)
        state.warm = 1


@inlined
def _warm(law: Any, own: Any) -> None:
    """Let friction, and motors that move the arm against it, heat the joints over a period."""
    friction, state = law.model.friction, own.friction
    store(state.joint, load(own.joint, 6))
    add_to_joints(state.joint, load(state.parts.friction, 7))
    to_motor_torque(law.gear, state.joint, state.motor)
    motor = load(state.motor, 6)
    stored = parts_energy(friction.elements, friction.parts, state.parts, load(state.z, 7), 7)
    _heat(law.model, state, stored, of_motors(motor * motor))


@inlined
def _heat(model: Any, state: Any, stored: Lanes, motor: Lanes) -> None:
    advance_temperatures(model.friction.parts.temperature, state.parts.temperature, stored, motor, model.period, 7)


@kernel
def cool_model(laws: Record, states: Record, count: int) -> None:
    """Let the joints of the model cool over `count` position ticks without motion and torque.

    Args:
        laws: constants, shape (1,), CONTROLLER_DTYPE.
        states: state, shape (1,), LAW_STATE_DTYPE.
        count: ticks.
    """
    model, state = laws[0].model, states[0].model.friction
    if state.warm and model.friction.parts.temperature.used:
        nothing = 0.0 * load(state.parts.temperature.stored, 7)
        store(state.parts.temperature.stored, nothing)
        for _ in range(count):
            _heat(model, state, nothing, nothing)


class ModelTemperatures:
    """Views of a controller's state; all stays at 0 where its model has no temperatures, or its friction is off.

    Args:
        law: constants, shape (1,), CONTROLLER_DTYPE.
        state: of the law, shape (1,), LAW_STATE_DTYPE.

    Attributes:
        now: of the seven friction elements, degrees Celsius, shape (7,).
        heat: of friction and motors since they were set, or since the start, J, shape (7,).
    """

    def __init__(self, law: np.ndarray[Any, Any], state: np.ndarray[Any, Any]) -> None:
        self._law, self._state = law, state
        warmth = state["model"]["friction"]["parts"]["temperature"]
        self.now: Array = warmth["temperature"][0]
        self.heat: Array = warmth["heat"][0]

    def set(self, temperatures: Array) -> None:
        """Let them go on from these, degrees Celsius, shape (7,), instead of the start that the file gives."""
        _set(self._law, self._state, np.ascontiguousarray(temperatures))


@kernel
def _set(laws: Record, states: Record, temperatures: Array) -> None:
    part, state = laws[0].model.friction.parts.temperature, states[0].model.friction
    start_temperatures(part, state.parts.temperature, 7)
    store(state.parts.temperature.temperature, load(temperatures, 7))
    follow_temperatures(part, state.parts.temperature, 7)
    state.warm = 1
