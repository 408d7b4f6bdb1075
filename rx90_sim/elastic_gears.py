"""The plant's step with elastic gears: motors and links move on their own, springs and dampers between them.

Arm, friction and end stops are evaluated once, at the predicted midpoint of the step, as in the rigid plant's step; the
transmitted torques are implicit, so that no stiffness limits the step. With the twists t of the gears, their torques s
and the matrix C of the coupling (rx90_common.description.coupling), for a step's mean accelerations

    M a + h = C^T s - friction on the links + end stops,   B (C a + d2t/dt2) = drive torque - friction - s.

M is the mass matrix of the links alone, B contains the rotors; that a rotor's inertia acts only on its own rotation is
Spong's assumption (1987, "Modeling and control of elastic joint robots", Journal of Dynamic Systems, Measurement, and
Control 109). s depends on the end of the step. It is linearised for each drive, s = offset + slope d2t/dt2, and the
motors are eliminated:

    (M + C^T W C) a + h = C^T (B offset + slope drive) / (B + slope) + ...,   W = B slope / (B + slope),

which is the rigid plant if the slope is infinite. With play s is piecewise linear, and Newton's method repeats this.

**The transmitted torque.** A spring and a damper connect the motor, converted to the joint by its gear, and the driven
side. The twist t is the motor's angle minus that of the driven side. Without play

    torque = k t + d dt/dt.

With play of the width 2 b they push where the flanks touch, and never pull:

    torque = max(0, k (t - b) + d dt/dt)   where t > b,   min(0, k (t + b) + d dt/dt)   where t < -b,   else 0

(the dead-zone model of Nordin and Gutman 2002, "Controlling mechanical systems with backlash - a survey", Automatica
38, with the damper acting in contact only). A step applies the mean of this torque over the motion of the twist, at its
mean rate. For the spring that is the difference of its energy divided by the motion, a discrete gradient (Gonzalez
1996, "Time integration and discrete Hamiltonian systems", Journal of Nonlinear Science 6): for any step size the spring
returns the energy that was put into it, also if flanks meet or part within the step.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from rx90_common.arm_dynamics import factorise, mass_and_bias, solve
from rx90_common.base.arrays import Array, RecordType, record_type
from rx90_common.description.coupling import (
    add_drive,
    add_drive_torques,
    add_twist,
    ratios,
    share_among_drives,
    turn_of_drive,
)
from rx90_common.friction.arm_elements import add_to_joints
from rx90_common.kernels.compiled import inlined, kernel
from rx90_common.kernels.lanes import load, size
from rx90_sim.drives import add_cogging
from rx90_sim.joint_friction import (
    add_brakes,
    add_element_friction,
    add_friction,
    add_stops,
    advance_loads,
)

_MAX_ITERATIONS = 50  # of Newton's method, which takes two or three
_TOLERANCE = 1e-12  # of a transmitted torque, relative to the torques about it
_MAX_SAG_ROUNDS = 100


def transmission_dtype(drives: int) -> RecordType:
    """Return the type of the constants."""
    return record_type(
        ("elastic", np.int64, (drives,)),
        flexible=np.int64,  # whether any drive is elastic; if not, nothing else is used
        link_friction=np.int64,  # whether the friction of the joints acts on the links
        rotor=drives,  # joint side, kg m^2
        stiffness=drives,  # 0 for rigid drives
        damping=drives,
        half_play=drives,
    )


def transmission_state_dtype(drives: int) -> RecordType:
    """Return the type of the state."""
    return record_type(
        twist=drives,  # motor angle at the gear's output minus that of the driven side, rad
        rate=drives,
        torque=drives,  # mean over the last step, Nm
        friction=drives,  # on the motors, with brakes and cogging, mean over the last step, Nm
        link_torque=drives,  # on the links, but for the transmitted one, in the last step, Nm
        # Workspace of a step.
        acceleration=drives,  # of the twist
        twist_mid=drives,
        rate_mid=drives,
        motor_angle=drives,  # of the joints as the motors have them, rad
        motor_velocity=drives,
        drive=drives,  # torque of the motors less friction, Nm
        offset=drives,  # torque = offset + slope acceleration
        slope=drives,
        matrix=(drives, drives),
    )


@kernel
def mean_torque(
    stiffness: float, damping: float, half_play: float, twist: float, way: float, step: float
) -> tuple[float, float]:
    """Return the mean torque, Nm, over a step in which the twist changes by `way`, and its derivative by `way`.

    Args:
        stiffness: Nm/rad, > 0.
        damping: Nm s/rad.
        half_play: b, rad; 0 for none.
        twist: at the start of the step, rad.
        way: rad.
        step: s.
    """
    if half_play == 0.0:
        return stiffness * (
            twist + 0.5 * way
        ) + damping * way / step, 0.5 * stiffness + damping / step
    ahead, ahead_slope = _push(stiffness, damping, twist - half_play, way, step)
    behind, behind_slope = _push(stiffness, damping, -twist - half_play, -way, step)
    return ahead - behind, ahead_slope + behind_slope


@kernel
def _push(
    stiffness: float, damping: float, depth: float, way: float, step: float
) -> tuple[float, float]:
    """Return the torque of one flank, and its derivative, for a depth of contact that changes by `way`."""
    damper = damping * way / step
    drag = damping / step
    if way < 0.0:
        # The flank pushes no more as soon as the damper would pull as much as the spring pushes.
        depth += damper / stiffness
        damper = 0.0
    end = depth + way
    if depth <= 0.0 and end <= 0.0:
        return 0.0, 0.0
    if depth >= 0.0 and end >= 0.0:
        return 0.5 * stiffness * (depth + end) + damper, 0.5 * stiffness + drag
    if way > 0.0:
        share = end / way  # of the way, in contact
        return share * (0.5 * stiffness * end + damper), stiffness * share * (
            1.0 - 0.5 * share
        ) + drag
    share = -depth / way
    return share * 0.5 * stiffness * depth, share * (0.5 * stiffness * share + drag)


@kernel
def hang_links(plant: Any, state: Any) -> None:
    """Move the links, `state.q`, from where the motors are to where they rest in the twisted gears; `state.v` is 0."""
    gears = state.transmission
    n = size(state.q)
    gears.motor_angle[:] = state.q
    # The weight changes little with the sag: each round leaves a hundredth or so of the error.
    for _ in range(_MAX_SAG_ROUNDS):
        mass_and_bias(plant.arm, state.body, state.q, state.v, state.mass_matrix, state.bias)
        _twist_by_weight(plant, gears, state.bias)
        add_twist(plant.gear, gears.motor_angle, gears.twist, -1.0, state.q_mid)
        settled = True
        for i in range(n):
            settled = settled and state.q_mid[i] == state.q[i]
            state.q[i] = state.q_mid[i]
        if settled:
            return


@inlined
def _twist_by_weight(plant: Any, gears: Any, weight: Array) -> None:
    """Write the torques that the gears transmit to an arm at rest, and their twists; mid-play for none."""
    constants = plant.transmission
    share_among_drives(plant.gear, weight, gears.torque)
    for i in range(size(constants.rotor)):
        gears.twist[i] = 0.0
        if constants.elastic[i]:
            torque = gears.torque[i]
            gears.twist[i] = torque / constants.stiffness[i]
            gears.twist[i] += np.sign(torque) * constants.half_play[i]


@kernel
def elastic_reset(plant: Any, state: Any) -> None:
    """Twist the gears such that they carry the arm at rest, on closed brakes; its weight is `state.bias`."""
    gears = state.transmission
    _twist_by_weight(plant, gears, state.bias)
    gears.rate[:] = gears.acceleration[:] = 0.0
    gears.friction[:] = -gears.torque
    gears.link_torque[:] = -state.bias


@kernel
def elastic_substep(plant: Any, state: Any, step: float) -> None:
    """Evaluate arm and friction at the predicted midpoint and step with the mean accelerations found there."""
    gears = state.transmission
    half = 0.5 * step
    gear = ratios(plant.gear)
    n = size(state.q)
    for i in range(n):
        gears.drive[i] = gear[i] * state.motor_torque[i] - gears.friction[i]
    # The last step's torques, with those that the motors have now, predict the midpoint to second order. The last
    # step's accelerations would not do: those of a very stiff spring may alternate from step to step.
    _balance(plant, state, step)
    for i in range(n):
        state.v_mid[i] = state.v[i] + half * state.acceleration[i]
        state.q_mid[i] = state.q[i] + half * (state.v[i] + 0.5 * half * state.acceleration[i])
        gears.rate_mid[i] = gears.rate[i] + half * gears.acceleration[i]
        gears.twist_mid[i] = gears.twist[i] + half * (
            gears.rate[i] + 0.5 * half * gears.acceleration[i]
        )
        state.rhs[i] = 0.0
    _add_friction(plant, state, step)
    add_stops(plant, state)
    mass_and_bias(plant.arm, state.body, state.q_mid, state.v_mid, state.mass_matrix, state.bias)
    for i in range(n):
        gears.link_torque[i] = state.rhs[i] - state.bias[i]
    _balance(plant, state, step)
    for i in range(n):
        acceleration = state.acceleration[i]
        turn = gears.acceleration[i]
        state.q[i] += step * (state.v[i] + half * acceleration)
        state.v[i] += step * acceleration
        gears.twist[i] += step * (gears.rate[i] + half * turn)
        gears.rate[i] += step * turn
    if plant.parts.used:
        for i in range(n):
            state.rhs[i] = 0.0
        add_drive_torques(plant.gear, gears.torque, state.rhs)
        # lies between gear and link: the link gets what friction leaves
        if plant.transmission.link_friction:
            add_to_joints(plant.gear, state.rhs, -load(state.parts.friction, size(state.z)))
        advance_loads(plant, state, state.rhs, state.acceleration, step)


@kernel
def on_motor_side(plant: Any, state: Any) -> tuple[Array, Array]:
    """Return the positions and velocities of the joints as the motors have them, rad and rad/s; workspace."""
    gears = state.transmission
    add_twist(plant.gear, state.q, gears.twist, 1.0, gears.motor_angle)
    add_twist(plant.gear, state.v, gears.rate, 1.0, gears.motor_velocity)
    return gears.motor_angle, gears.motor_velocity


@kernel
def add_twists(plant: Any, state: Any, motor: Array) -> None:
    """Add the twists of the gears to motor positions, rad, shape (n,)."""
    gear = ratios(plant.gear)
    for i in range(size(state.q)):
        motor[i] += gear[i] * state.transmission.twist[i]


@kernel
def _add_friction(plant: Any, state: Any, step: float) -> None:
    """Write the motors' torques with cogging; take those of friction and closed brakes off motors or links."""
    gears = state.transmission
    gear = ratios(plant.gear)
    n = size(state.q)
    add_twist(plant.gear, state.q_mid, gears.twist_mid, 1.0, gears.motor_angle)
    add_twist(plant.gear, state.v_mid, gears.rate_mid, 1.0, gears.motor_velocity)
    for i in range(n):
        gears.drive[i] = state.drive_torque[i]
    if plant.cogging.terms > 0:
        add_cogging(plant, state, gears.motor_angle, gears.motor_velocity, gears.drive, step)
    if plant.transmission.link_friction:
        add_element_friction(plant, state, state.q_mid, state.v_mid, state.rhs, step)
        add_brakes(plant, state, gears.motor_velocity, gears.drive, step)
    else:
        add_friction(plant, state, gears.motor_angle, gears.motor_velocity, gears.drive, step)
    # As torques of the motors.
    share_among_drives(plant.gear, gears.drive, gears.drive)
    for i in range(n):
        gears.friction[i] = gear[i] * state.motor_torque[i] - gears.drive[i]


@kernel
def _balance(plant: Any, state: Any, step: float) -> None:
    """Find the accelerations of links and twists, and the transmitted torques, for the torques on links and motors."""
    constants = plant.transmission
    gears = state.transmission
    for _ in range(_MAX_ITERATIONS):
        _linearise(constants, gears, step)
        _accelerate_links(plant, gears, state)
        if _accelerate_twists(plant, gears, state.acceleration, step):
            return


@inlined
def _linearise(constants: Any, gears: Any, step: float) -> None:
    """Write the transmitted torques as functions of the accelerations of the twists, about their present ones."""
    for i in range(size(constants.rotor)):
        if constants.elastic[i]:
            torque, slope = _torque_of_gear(constants, gears, i, step)
            gears.slope[i] = 0.5 * step * step * slope
            gears.offset[i] = torque - gears.slope[i] * gears.acceleration[i]


@inlined
def _torque_of_gear(constants: Any, gears: Any, i: int, step: float) -> tuple[float, float]:
    """Return what `mean_torque` does, for the present acceleration of a gear's twist."""
    way = step * (gears.rate[i] + 0.5 * step * gears.acceleration[i])
    return mean_torque(
        constants.stiffness[i],
        constants.damping[i],
        constants.half_play[i],
        gears.twist[i],
        way,
        step,
    )


@inlined
def _accelerate_links(plant: Any, gears: Any, state: Any) -> None:
    """Write the mean acceleration of the links, the motors eliminated."""
    constants = plant.transmission
    matrix = gears.matrix
    a = state.acceleration
    n = size(gears.matrix)
    for i in range(n):
        for j in range(i + 1):
            matrix[i, j] = state.mass_matrix[i, j]
        a[i] = gears.link_torque[i]
    for i in range(n):
        inertia = constants.rotor[i]
        torque = gears.drive[i]
        if constants.elastic[i]:
            share = 1.0 / (inertia + gears.slope[i])
            torque = (inertia * gears.offset[i] + gears.slope[i] * torque) * share
            inertia *= gears.slope[i] * share
        add_drive(plant.gear, i, inertia, torque, gears.matrix, state.acceleration)
    factorise(gears.matrix, state.factor)
    solve(state.factor, a)


@inlined
def _accelerate_twists(plant: Any, gears: Any, a: Array, step: float) -> bool:
    """Write accelerations of the twists and transmitted torques; return whether the torques are those of the twists."""
    found = True
    constants = plant.transmission
    for i in range(size(constants.rotor)):
        inertia = constants.rotor[i]
        drive = gears.drive[i]
        inertial = inertia * turn_of_drive(plant.gear, a, i)
        if not constants.elastic[i]:
            gears.torque[i] = drive - inertial
            continue
        turn = (drive - gears.offset[i] - inertial) / (inertia + gears.slope[i])
        torque = gears.offset[i] + gears.slope[i] * turn
        gears.acceleration[i] = turn
        gears.torque[i] = torque
        if constants.half_play[i] > 0.0:
            true, _ = _torque_of_gear(constants, gears, i, step)
            found = found and abs(true - torque) <= _TOLERANCE * (
                abs(true) + abs(torque) + abs(drive) + abs(inertial)
            )
    return found
