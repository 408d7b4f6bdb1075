"""The one plant step, compiled: drives, brakes, end stops, friction and the arm.

Second order with a single evaluation of the arm and of the friction in a step: both are evaluated at the
midpoint of the step, which the last step's mean acceleration and the jump of the drive torque predict. The
bristles are advanced exactly for the midpoint velocity, so their rate, far above the tick rate at full joint
speed, sets no limit to the step. With elastic gears another step takes its place (rx90_sim.elastic_gears).
"""

from __future__ import annotations

import math
from typing import Any

from rx90_common.arm_dynamics import factorise, mass_and_bias, solve
from rx90_common.base.arrays import Array, Record
from rx90_common.description.coupling import to_joint_torque, to_motor
from rx90_common.friction.arm_elements import element_inputs, element_of_motor
from rx90_common.friction.bristle import friction_torque
from rx90_common.friction.compiled_elements import load_elements
from rx90_common.friction.parts.step import parts_torque
from rx90_common.kernels.compiled import kernel
from rx90_common.kernels.lanes import load, size, store
from rx90_sim.drives import (
    add_cogging,
    current_share,
    reset_sensors,
    sense_currents,
    warm_windings,
    whole_steps,
)
from rx90_sim.elastic_gears import (
    add_twists,
    elastic_reset,
    elastic_substep,
    hang_links,
    on_motor_side,
)
from rx90_sim.joint_friction import (
    add_friction,
    add_stops,
    advance_loads,
    advance_parts,
    reset_friction,
)

# Compiled code reads records through 1-element arrays: those pass the boundary from Python fastest.


@kernel
def plant_reset(plants: Record, states: Record, position: Array) -> None:
    """Put the arm at rest, brakes closed, in static equilibrium, with the motors where `position` has the joints.

    Args:
        plants: constants, shape (1,), `plant_dtype`.
        states: state, shape (1,), `state_dtype`, overwritten.
        position: rad, shape (n,). Links that hang in elastic gears are a little off it.
    """
    plant = plants[0]
    state = states[0]
    state.q[:] = position
    state.v[:] = state.acceleration[:] = state.drive_torque[:] = state.motor_torque[:] = 0.0
    state.saturated[:] = 0
    state.temperature[:] = plant.winding.initial
    state.brakes_closed = 1
    if plant.transmission.flexible:
        hang_links(plant, state)
    mass_and_bias(plant.arm, state.body, state.q, state.v, state.mass_matrix, state.bias)
    factorise(state.mass_matrix, state.factor)
    reset_friction(plant, state)
    if plant.cogging.terms > 0:
        _hold_cogging(plant, state, position)
    if plant.sensor.used:
        reset_sensors(plant.sensor, state.sensor)
    to_motor(plant.gear, state.q, state.observer)
    if plant.transmission.flexible:
        elastic_reset(plant, state)
        add_twists(plant, state, state.observer)
    n = size(state.q)
    store(state.motor_position, whole_steps(load(state.observer, n), load(plant.resolution, n)))
    state.motor_velocity[:] = 0.0


@kernel
def _hold_cogging(plant: Any, state: Any, position: Array) -> None:
    """Let the brakes hold the motors against their cogging, too."""
    state.rhs[:] = 0.0
    add_cogging(plant, state, position, state.v, state.rhs, plant.period)
    for i in range(size(state.rhs)):
        element = element_of_motor(plant.gear, i)
        state.brake_z[element] += state.cogging.torque[i] / plant.brake.c0[element]


@kernel
def plant_step(plants: Record, states: Record, command: Array, powered: bool) -> int:
    """Hold the motor torques of `command` for one tick, then sample the encoders.

    Args:
        plants: constants, shape (1,), `plant_dtype`.
        states: state, shape (1,), `state_dtype`, advanced in place.
        command: motor torques, motor side, Nm, shape (n,); ignored without power.
        powered: false takes the torque away and closes the brakes.

    Returns:
        -1, or the index of the joint that exceeds its speed limit most, or whose command is NaN.
    """
    plant = plants[0]
    state = states[0]
    _actuate(plant, state, command, powered)
    step = plant.period / plant.substeps
    flexible = plant.transmission.flexible
    for _ in range(plant.substeps):
        if flexible:
            elastic_substep(plant, state, step)
        else:
            _substep(plant, state, step)
    if plant.parts.used:
        advance_parts(plant, state)
    if plant.winding.used:
        warm_windings(plant.winding, state.motor_torque, state.temperature, plant.period)
    for i in range(size(state.v)):
        # The comparison is false for NaN too.
        if not abs(state.v[i]) <= plant.speed_limit[i]:
            return _worst_joint(plant, state)
    sample_drives(plants, states)
    return -1


@kernel
def sample_drives(plants: Record, states: Record) -> None:
    """Sample the resolvers at the present position, once in a tick: counts, and the converters' velocity.

    That is the velocity of the tracking loop, of second order and critically damped, at the angle before rounding.
    """
    plant = plants[0]
    state = states[0]
    to_motor(plant.gear, state.q, state.motor_position)
    if plant.transmission.flexible:
        add_twists(plant, state, state.motor_position)
    n = size(state.q)
    angle = load(state.motor_position, n)
    velocity = load(state.motor_velocity, n)
    predicted = load(state.observer, n) + plant.period * velocity
    innovation = angle - predicted
    store(state.observer, predicted + plant.observer_position * innovation)
    store(state.motor_velocity, velocity + plant.observer_velocity * innovation)
    store(state.motor_position, whole_steps(angle, load(plant.resolution, n)))


@kernel
def _worst_joint(plant: Any, state: Any) -> int:
    """Return the joint that exceeds its speed limit most: those next to a diverging joint exceed theirs, too."""
    worst = 0
    most = -1.0
    for i in range(size(state.v)):
        if math.isnan(state.motor_torque[i]):
            return i
        excess = abs(state.v[i]) / plant.speed_limit[i]
        if math.isnan(excess):
            excess = math.inf
        if excess > most:
            worst = i
            most = excess
    return worst


@kernel
def friction_states(plants: Record, states: Record, velocity: Array, torque: Array) -> None:
    """Write input velocity, rad/s, and friction torque without the brakes', Nm, of the elements, shape (e,)."""
    plant = plants[0]
    state = states[0]
    angle = state.q
    speed = state.v
    if plant.transmission.flexible and not plant.transmission.link_friction:
        angle, speed = on_motor_side(plant, state)
    n = size(state.z)
    inputs = element_inputs(plant.gear, speed)
    store(velocity, inputs)
    z = load(state.z, n)
    if plant.parts.used:
        angles = element_inputs(plant.gear, angle)
        store(torque, parts_torque(plant.friction, plant.parts, state.parts, z, angles, inputs, n))
    else:
        store(torque, friction_torque(load_elements(plant.friction, n), z, inputs))


@kernel
def _actuate(plant: Any, state: Any, command: Array, powered: bool) -> None:
    """Turn motor torques into joint torques and predict how their jump changes the acceleration."""
    if powered == (state.brakes_closed == 1):
        state.brakes_closed = 0 if powered else 1
        state.brake_z[:] = 0.0
    for i in range(size(state.rhs)):
        torque = command[i] if powered else 0.0
        peak = plant.peak_torque[i]
        if plant.winding.used:
            peak *= current_share(plant.winding, state.temperature[i])
        if abs(torque) > peak:
            torque = math.copysign(peak, torque)
            state.saturated[i] += 1
        state.motor_torque[i] = torque
        state.rhs[i] = -state.drive_torque[i]
    if plant.sensor.used:
        sense_currents(plant.sensor, state.sensor, state.motor_torque, powered)
    to_joint_torque(plant.gear, state.motor_torque, state.drive_torque)
    if plant.transmission.flexible:
        return
    for i in range(size(state.rhs)):
        state.rhs[i] += state.drive_torque[i]
    solve(state.factor, state.rhs)
    for i in range(size(state.rhs)):
        state.acceleration[i] += state.rhs[i]


@kernel
def _substep(plant: Any, state: Any, step: float) -> None:
    """Evaluate arm and friction at the predicted midpoint and step with the mean acceleration found there."""
    half = 0.5 * step
    n = size(state.q)
    for i in range(n):
        state.v_mid[i] = state.v[i] + half * state.acceleration[i]
        state.q_mid[i] = state.q[i] + half * (state.v[i] + 0.5 * half * state.acceleration[i])
    for i in range(n):
        state.rhs[i] = state.drive_torque[i]
    if plant.cogging.terms > 0:
        add_cogging(plant, state, state.q_mid, state.v_mid, state.rhs, step)
    # Friction first: the arm does not wait for it, so the processor works on both where one would stall.
    add_friction(plant, state, state.q_mid, state.v_mid, state.rhs, step)
    if plant.parts.used:
        for i in range(n):
            state.after_friction[i] = state.rhs[i]
    add_stops(plant, state)
    mass_and_bias(plant.arm, state.body, state.q_mid, state.v_mid, state.mass_matrix, state.bias)
    for i in range(n):
        state.rhs[i] -= state.bias[i]
    factorise(state.mass_matrix, state.factor)
    solve(state.factor, state.rhs)
    for i in range(n):
        acceleration = state.rhs[i]
        state.q[i] += step * (state.v[i] + half * acceleration)
        state.v[i] += step * acceleration
        state.acceleration[i] = acceleration
    if plant.parts.used:
        advance_loads(plant, state, state.after_friction, state.acceleration, step)
