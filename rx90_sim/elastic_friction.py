"""Joint friction in a step of the plant."""

from __future__ import annotations

from typing import Any

from rx90_common.base.arrays import Array
from rx90_common.friction.bristle import bristle_step, friction_torque, load_elements
from rx90_common.kernels.compiled import inlined, kernel
from rx90_common.kernels.lanes import Lanes, append, first, lane, load, store


@inlined
def element_inputs(joint: Array) -> Lanes:
    """Return the angles or velocities of the seven elements, which are also the brakes', for those of the joints."""
    return append(load(joint, 6), joint[4] + joint[5])


@kernel
def add_friction(plant: Any, state: Any, angle: Array, velocity: Array, torque: Array, step: float) -> None:
    """Advance."""
    inputs = element_inputs(velocity)
    z, friction = bristle_step(load_elements(plant.friction, 7), load(state.z, 7), inputs, step)
    store(state.z, z)
    if state.brakes_closed:
        z, brake_torque = bristle_step(load_elements(plant.brake, 7), load(state.brake_z, 7), inputs, step)
        store(state.brake_z, z)
        friction = friction + brake_torque
    take_off(torque, friction)


@kernel
def add_elements(plant: Any, state: Any, angle: Array, velocity: Array, torque: Array, step: float) -> None:
    """Advance."""
    inputs = element_inputs(velocity)
    z, friction = bristle_step(load_elements(plant.friction, 7), load(state.z, 7), inputs, step)
    store(state.z, z)
    take_off(torque, friction)


@kernel
def add_brakes(plant: Any, state: Any, velocity: Array, torque: Array, step: float) -> None:
    """Advance."""
    if state.brakes_closed:
        inputs = element_inputs(velocity)
        z, friction = bristle_step(load_elements(plant.brake, 7), load(state.brake_z, 7), inputs, step)
        store(state.brake_z, z)
        take_off(torque, friction)


@inlined
def take_off(torque: Array, friction: Lanes) -> None:
    store(torque, load(torque, 6) - first(friction, 6))
    wrist = lane(friction, 6)
    torque[4] -= wrist
    torque[5] -= wrist
