"""What acts in the joints in a step of the plant: the seven friction elements, closed brakes, end stops.

Elements with parts go through `_parted_friction`, those without through the same instructions as if there were no
parts.
"""

from __future__ import annotations

from typing import Any

from rx90_common.base.arrays import Array
from rx90_common.friction.arm_elements import (
    add_to_joints,
    element_inputs,
    of_motors,
    share_among_elements,
    transmit,
)
from rx90_common.friction.bristle import bristle_step, friction_torque
from rx90_common.friction.compiled_elements import load_elements
from rx90_common.friction.parts.load import advance_load
from rx90_common.friction.parts.scatter import advance_scatter
from rx90_common.friction.parts.step import parts_energy, parts_step, parts_torque, reset_parts
from rx90_common.friction.parts.temperature import add_work, advance_temperatures
from rx90_common.kernels.compiled import inlined, kernel
from rx90_common.kernels.lanes import Lanes, load, store
from rx90_sim.drives import relative_resistance


@kernel
def reset_friction(plant: Any, state: Any) -> None:
    """Begin with undeflected bristles, with brakes that carry all that `state.bias` asks for, Nm, shape (6,)."""
    for i in range(7):
        state.z[i] = 0.0
    for i in range(6):
        # Brake 6, the seventh element, holds q5 + q6, so what it carries of joint 6 also acts on joint 5.
        carried = state.bias[i] - (state.bias[5] if i == 4 else 0.0)
        element = i if i < 5 else 6
        state.brake_z[element] = -carried / plant.brake.c0[element]
        state.parts.transmitted[i] = state.bias[i]
    share_among_elements(state.parts.transmitted)
    reset_parts(plant.parts, state.parts, load(state.parts.transmitted, 7), 7)


@kernel
def add_friction(plant: Any, state: Any, angle: Array, velocity: Array, torque: Array, step: float) -> None:
    """Advance the bristles of the seven elements, and of closed brakes, and take their torques off.

    Args:
        plant: constants, PLANT_DTYPE.
        state: state, STATE_DTYPE.
        angle: of the joints, rad, in the middle of the step, shape (6,).
        velocity: the same, rad/s.
        torque: on the joints, Nm, shape (6,); the friction is taken off.
        step: s.
    """
    friction = _advance_elements(plant, state, angle, velocity, step)
    if state.brakes_closed:
        friction = friction + _advance_brakes(plant, state, velocity, step)
    add_to_joints(torque, -friction)


@kernel
def add_element_friction(plant: Any, state: Any, angle: Array, velocity: Array, torque: Array, step: float) -> None:
    """Do the same without the brakes, which then act elsewhere."""
    add_to_joints(torque, -_advance_elements(plant, state, angle, velocity, step))


@kernel
def add_brakes(plant: Any, state: Any, velocity: Array, torque: Array, step: float) -> None:
    """Advance the bristles of closed brakes, and take their torques off; arguments as above."""
    if state.brakes_closed:
        add_to_joints(torque, -_advance_brakes(plant, state, velocity, step))


@kernel
def take_last_friction(state: Any, torque: Array) -> None:
    """Take the torques of elements with parts in the last step off those of the joints, Nm, shape (6,)."""
    add_to_joints(torque, -load(state.parts.friction, 7))


@inlined
def _advance_elements(plant: Any, state: Any, angle: Array, velocity: Array, step: float) -> Lanes:
    """Advance the bristles of the elements; return their torques, Nm."""
    if plant.parts.used:
        _parted_friction(plant, state, angle, velocity, step)
        return load(state.parts.friction, 7)
    z, friction = bristle_step(load_elements(plant.friction, 7), load(state.z, 7), element_inputs(velocity), step)
    store(state.z, z)
    return friction


@inlined
def _advance_brakes(plant: Any, state: Any, velocity: Array, step: float) -> Lanes:
    """Advance the bristles of the brakes; return their torques, Nm."""
    inputs = element_inputs(velocity)
    z, torque = bristle_step(load_elements(plant.brake, 7), load(state.brake_z, 7), inputs, step)
    store(state.brake_z, z)
    return torque


@kernel
def _parted_friction(plant: Any, state: Any, angle: Array, velocity: Array, step: float) -> None:
    """Advance the bristles of elements with parts, and write their torques."""
    inputs = element_inputs(velocity)
    z, torque = parts_step(
        plant.friction, plant.parts, state.parts, load(state.z, 7), element_inputs(angle), inputs, step, 7
    )
    store(state.z, z)
    if plant.parts.temperature.used:
        add_work(state.parts.temperature, torque, inputs, step, 7)
    store(state.parts.friction, torque)


@kernel
def friction_now(plant: Any, state: Any, angle: Array, velocity: Array, torque: Array) -> None:
    """Write the friction torques of the seven elements at this instant, without the brakes', Nm, shape (7,).

    The angles, rad, and the velocities, rad/s, are those of the joints, shape (6,).
    """
    inputs, z = element_inputs(velocity), load(state.z, 7)
    if plant.parts.used:
        angles = element_inputs(angle)
        store(torque, parts_torque(plant.friction, plant.parts, state.parts, z, angles, inputs, 7))
    else:
        store(torque, friction_torque(load_elements(plant.friction, 7), z, inputs))


@kernel
def advance_loads(plant: Any, state: Any, torque: Array, acceleration: Array, step: float) -> None:
    """Let the parts follow what the joints transmitted over a step.

    Args:
        plant: constants, PLANT_DTYPE.
        state: state, STATE_DTYPE.
        torque: drive torque less friction, brakes included, at the joints, Nm, shape (6,).
        acceleration: of the rotors, seen at the joints, rad/s^2, shape (6,).
        step: s.
    """
    transmit(plant.arm.rotor, torque, acceleration, state.parts.transmitted)
    advance_load(plant.parts.load, state.parts, load(state.parts.transmitted, 7), step, 7)


@kernel
def advance_parts(plant: Any, state: Any) -> None:
    """Advance by a tick what changes slowly: random walks and temperatures of the friction."""
    advance_scatter(plant.parts.scatter, state.parts)
    if plant.parts.temperature.used:
        _warm_joints(plant, state)


@kernel
def _warm_joints(plant: Any, state: Any) -> None:
    """Let friction and motors heat the joints over a tick."""
    motor = load(state.motor_torque, 6)
    heating = relative_resistance(plant.winding, load(state.temperature, 6)) * motor * motor
    stored = parts_energy(plant.friction, plant.parts, state.parts, load(state.z, 7), 7)
    advance_temperatures(plant.parts.temperature, state.parts.temperature, stored, of_motors(heating), plant.period, 7)


@kernel
def add_stops(plant: Any, state: Any) -> None:
    """Add to `state.rhs` what the stops push: a spring and damper beyond the limits that only push back."""
    for i in range(6):
        q, push = state.q_mid[i], 0.0
        if q > plant.upper[i]:
            push = min(0.0, plant.stop_stiffness[i] * (plant.upper[i] - q) - plant.stop_damping[i] * state.v_mid[i])
        elif q < plant.lower[i]:
            push = max(0.0, plant.stop_stiffness[i] * (plant.lower[i] - q) - plant.stop_damping[i] * state.v_mid[i])
        state.rhs[i] += push
