"""Torques in the joints within a step of the plant: friction elements, closed brakes, end stops.

Elements with parts go through `_parted_friction`, those without through the same instructions as if there were no
parts.
"""

from __future__ import annotations

from typing import Any

from rx90_common.base.arrays import Array
from rx90_common.description.coupling import share_among_drives
from rx90_common.friction.arm_elements import (
    add_to_joints,
    element_inputs,
    element_of_motor,
    of_motors,
    share_among_elements,
    transmit,
)
from rx90_common.friction.bristle import bristle_step
from rx90_common.friction.compiled_elements import load_elements
from rx90_common.friction.parts import step as part_steps
from rx90_common.friction.parts.step import (
    parts_energy,
    parts_step,
    reset_parts,
    tick_parts,
)
from rx90_common.friction.parts.temperature import add_work, advance_temperatures
from rx90_common.kernels.compiled import inlined, kernel
from rx90_common.kernels.lanes import Lanes, load, size, store
from rx90_sim.drives import relative_resistance


@kernel
def reset_friction(plant: Any, state: Any) -> None:
    """Begin with undeflected bristles, and with brakes that carry all of `state.bias`, Nm, shape (n,)."""
    state.z[:] = 0.0
    share_among_drives(plant.gear, state.bias, state.rhs)
    for i in range(size(state.bias)):
        element = element_of_motor(plant.gear, i)
        state.brake_z[element] = -state.rhs[i] / plant.brake.c0[element]
        state.parts.transmitted[i] = state.bias[i]
    share_among_elements(plant.gear, state.parts.transmitted)
    reset_parts(
        plant.parts, state.parts, load(state.parts.transmitted, size(state.z)), size(state.z)
    )


@kernel
def add_friction(
    plant: Any, state: Any, angle: Array, velocity: Array, torque: Array, step: float
) -> None:
    """Advance the bristles of the elements, and of closed brakes, and subtract their torques.

    Args:
        plant: constants, `plant_dtype`.
        state: state, `state_dtype`.
        angle: of the joints, rad, in the middle of the step, shape (n,).
        velocity: the same, rad/s.
        torque: on the joints, Nm, shape (n,); the friction is subtracted.
        step: s.
    """
    friction = _advance_elements(plant, state, angle, velocity, step)
    if state.brakes_closed:
        friction = friction + _advance_brakes(plant, state, velocity, step)
    add_to_joints(plant.gear, torque, -friction)


@kernel
def add_element_friction(
    plant: Any, state: Any, angle: Array, velocity: Array, torque: Array, step: float
) -> None:
    """Do the same without the brakes, which then act elsewhere."""
    add_to_joints(plant.gear, torque, -_advance_elements(plant, state, angle, velocity, step))


@kernel
def add_brakes(plant: Any, state: Any, velocity: Array, torque: Array, step: float) -> None:
    """Advance the bristles of closed brakes, and take their torques off; arguments as above."""
    if state.brakes_closed:
        add_to_joints(plant.gear, torque, -_advance_brakes(plant, state, velocity, step))


@inlined
def _advance_elements(plant: Any, state: Any, angle: Array, velocity: Array, step: float) -> Lanes:
    """Advance the bristles of the elements; return their torques, Nm."""
    if plant.parts.used:
        _parted_friction(plant, state, angle, velocity, step)
        return load(state.parts.friction, size(state.z))
    inputs: Lanes = element_inputs(plant.gear, velocity)
    z, friction = bristle_step(
        load_elements(plant.friction, size(state.z)), load(state.z, size(state.z)), inputs, step
    )
    store(state.z, z)
    return friction


@inlined
def _advance_brakes(plant: Any, state: Any, velocity: Array, step: float) -> Lanes:
    """Advance the bristles of the brakes; return their torques, Nm."""
    n = size(state.brake_z)
    inputs: Lanes = element_inputs(plant.gear, velocity)
    z, torque = bristle_step(load_elements(plant.brake, n), load(state.brake_z, n), inputs, step)
    store(state.brake_z, z)
    return torque


@kernel
def _parted_friction(plant: Any, state: Any, angle: Array, velocity: Array, step: float) -> None:
    """Advance the bristles of elements with parts, and write their torques."""
    n = size(state.z)
    inputs = element_inputs(plant.gear, velocity)
    angles = element_inputs(plant.gear, angle)
    z, torque = parts_step(
        plant.friction, plant.parts, state.parts, load(state.z, n), angles, inputs, step, n
    )
    store(state.z, z)
    if plant.parts.temperature.used:
        add_work(state.parts.temperature, torque, inputs, step, n)
    store(state.parts.friction, torque)


@kernel
def advance_loads(plant: Any, state: Any, torque: Array, acceleration: Array, step: float) -> None:
    """Update the parts with the torques that the joints transmitted over a step.

    Args:
        plant: constants, `plant_dtype`.
        state: state, `state_dtype`.
        torque: drive torque less friction, brakes included, at the joints, Nm, shape (n,).
        acceleration: of the rotors, converted to the joints, rad/s^2, shape (n,).
        step: s.
    """
    transmit(plant.gear, plant.arm.rotor, torque, acceleration, state.parts.transmitted)
    n = size(state.z)
    part_steps.advance_parts(plant.parts, state.parts, load(state.parts.transmitted, n), step, n)


@kernel
def advance_parts(plant: Any, state: Any) -> None:
    """Advance the slow states by a tick: random walks and temperatures of the friction."""
    n = size(state.z)
    tick_parts(plant.parts, state.parts, load(state.parts.transmitted, n), plant.period, n)
    if plant.parts.temperature.used:
        # Friction and motors heat the joints.
        motor = load(state.motor_torque, size(state.motor_torque))
        resistance = relative_resistance(
            plant.winding, load(state.temperature, size(state.temperature))
        )
        stored = parts_energy(plant.friction, plant.parts, state.parts, load(state.z, n), n)
        motors = of_motors(plant.gear, resistance * motor * motor)
        advance_temperatures(
            plant.parts.temperature, state.parts.temperature, stored, motors, plant.period, n
        )


@kernel
def add_stops(plant: Any, state: Any) -> None:
    """Add the torques of the stops to `state.rhs`: a spring and damper beyond the limits that only push back."""
    for i in range(size(state.q)):
        q = state.q_mid[i]
        above = q > plant.upper[i]
        limit = plant.upper[i] if above else plant.lower[i]
        push = plant.stop_stiffness[i] * (limit - q) - plant.stop_damping[i] * state.v_mid[i]
        state.rhs[i] += min(0.0, push) if above else max(0.0, push) if q < limit else 0.0
