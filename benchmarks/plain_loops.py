"""One tick of the closed loop as plain loops over arrays: what the kernels with lanes are measured and tested against.

One motor, friction element or link is computed after the other, products and sums are rounded apart, and the C
library gives exponential, sine and cosine. Plant and control law are those of the product, equation by equation;
brakes and end stops, which the reference line does not meet, are left out. The records are the product's, too.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rx90_common.arm_dynamics import factorise, solve
from rx90_common.base.arrays import Array
from rx90_common.friction.parts.part import LINEAR_SPEED
from rx90_common.kernels.compiled import inlined, kernel
from rx90_controller.law.cs7b import position_loop, velocity_loop
from rx90_sim.plant_step import plant_step

Record = NDArray[Any]
Vector = tuple[float, float, float]

WORKSPACE_DTYPE = np.dtype(
    [
        ("axis", np.float64, (6, 3)),
        ("lever", np.float64, (6, 3)),  # origin x axis
        ("moment", np.float64, (6, 3)),  # first moment of a link, kg m
        # xx, yy, zz, xy, xz, yz of a link about the base origin, kg m^2
        ("inertia", np.float64, (6, 6)),
        ("torque", np.float64, (6, 3)),  # on a link, about the base origin, Nm
        ("force", np.float64, (6, 3)),
    ],
    align=True,
)


@kernel
def run_lanes(
    plants: Record,
    states: Record,
    laws: Record,
    law_states: Record,
    setpoints: Array,
    ratio: int,
    q: Array,
) -> None:
    """Run the product's kernels over all set-points, shape (m, 3, 6); write joint positions, rad, shape (m, 6)."""
    state, law_state = states[0], law_states[0]
    for row in range(len(setpoints)):
        q[row] = state.q
        position_loop(laws, law_states, setpoints[row], state.motor_position, state.motor_velocity)
        for _ in range(ratio):
            velocity_loop(laws, law_states, state.motor_velocity)
            plant_step(plants, states, law_state.command, True)


@kernel
def run_plain(
    plants: Record,
    states: Record,
    laws: Record,
    law_states: Record,
    setpoints: Array,
    ratio: int,
    q: Array,
) -> None:
    """Run the plain loops as `run_lanes` does its kernels; the brakes are open from the beginning."""
    plant, state, law, law_state = plants[0], states[0], laws[0], law_states[0]
    work = np.empty(1, WORKSPACE_DTYPE)[0]
    for row in range(len(setpoints)):
        q[row] = state.q
        _position_loop(law, law_state, setpoints[row], state.motor_position)
        for _ in range(ratio):
            _velocity_loop(law, law_state, state.motor_velocity)
            _plant_step(plant, state, work, law_state.command)


@inlined
def _clip(x: float, bound: float) -> float:
    return min(bound, max(-bound, x))


@inlined
def _signed_power(x: float, exponent: float) -> float:
    return x if exponent == 1.0 else math.copysign(abs(x) ** exponent, x)


@kernel
def _position_loop(law: Any, state: Any, setpoint: Array, position: Array) -> None:
    for i in range(6):
        for k in range(3):
            joint = setpoint[k, 4] + setpoint[k, 5] if i == 5 else setpoint[k, i]
            state.reference[k, i] = law.gear[i] * joint
        velocity = state.reference[1, i]
        error = state.reference[0, i] - position[i]
        if error * state.limited[i] <= 0.0:
            state.integrator[i] = _clip(
                state.integrator[i] + law.integral[i] * error, law.integrator_limit[i]
            )
        sign = _clip(velocity / law.coulomb_velocity[i], 1.0)
        forward = law.inertia[i] * state.reference[2, i] + law.coulomb[i] * sign
        forward += law.viscous[i] * _signed_power(velocity, law.viscous_exponent[i])
        state.position_torque[i] = law.proportional[i] * error + state.integrator[i]
        state.feed_forward[i] = forward


@kernel
def _velocity_loop(law: Any, state: Any, velocity: Array) -> None:
    for i in range(6):
        damping = law.derivative[i] * (law.velocity_weight[i] * state.reference[1, i] - velocity[i])
        asked = (state.position_torque[i] + state.feed_forward[i] + damping) / law.torque_constant[
            i
        ]
        peak = law.peak_current[i]
        state.limited[i] = (asked > peak) - (asked < -peak)
        change = law.current_gain * (_clip(asked, peak) - state.current[i])
        state.current[i] += _clip(change, law.current_step[i])
        state.command[i] = law.torque_constant[i] * state.current[i]


@kernel
def _plant_step(plant: Any, state: Any, work: Any, command: Array) -> None:
    """Step as rx90_sim.plant_step does: arm and friction at the predicted midpoint, one substep."""
    step, half = plant.period, 0.5 * plant.period
    for i in range(6):
        state.motor_torque[i] = _clip(command[i], plant.peak_torque[i])
        drive = plant.gear[i] * state.motor_torque[i]
        if i == 4:
            drive += plant.gear[5] * _clip(command[5], plant.peak_torque[5])
        state.rhs[i] = drive - state.drive_torque[i]
        state.drive_torque[i] = drive
    solve(state.factor, state.rhs)
    for i in range(6):
        acceleration = state.acceleration[i] + state.rhs[i]
        state.v_mid[i] = state.v[i] + half * acceleration
        state.q_mid[i] = state.q[i] + half * (state.v[i] + 0.5 * half * acceleration)
        state.rhs[i] = state.drive_torque[i]
    for i in range(7):
        velocity = state.v_mid[4] + state.v_mid[5] if i == 6 else state.v_mid[i]
        state.z[i], torque = _element_step(plant.friction, i, state.z[i], velocity, step)
        if i < 6:
            state.rhs[i] -= torque
        else:
            state.rhs[4] -= torque
            state.rhs[5] -= torque
    mass_and_bias(plant.arm, work, state.q_mid, state.v_mid, state.mass_matrix, state.bias)
    for i in range(6):
        state.rhs[i] -= state.bias[i]
    factorise(state.mass_matrix, state.factor)
    solve(state.factor, state.rhs)
    for i in range(6):
        acceleration = state.rhs[i]
        state.q[i] += step * (state.v[i] + half * acceleration)
        state.v[i] += step * acceleration
        state.acceleration[i] = acceleration
    for i in range(6):
        motor = plant.gear[i] * (state.q[4] + state.q[5] if i == 5 else state.q[i])
        state.motor_position[i] = np.rint(motor / plant.resolution[i]) * plant.resolution[i]
        predicted = state.observer[i] + step * state.motor_velocity[i]
        innovation = motor - predicted
        state.observer[i] = predicted + plant.observer_position * innovation
        state.motor_velocity[i] += plant.observer_velocity * innovation


@kernel
def _element_step(
    elements: Any, i: int, z: float, velocity: float, step: float
) -> tuple[float, float]:
    """Return the new deflection, rad, and the mean torque, Nm, of friction element i (equations 17 to 19)."""
    side, speed = (0 if velocity >= 0.0 else 1), abs(velocity)
    ratio, delta = speed * elements.inverse_omega_s[i], elements.delta[i]
    power = ratio if delta == 1.0 else ratio * ratio if delta == 2.0 else ratio**delta
    coulomb = elements.tau_c[side, i]
    sliding = coulomb + (elements.tau_s[side, i] - coulomb) * math.exp(-power)
    damping = elements.c1[i] * math.exp(-((velocity * elements.inverse_omega_d[i]) ** 2))
    rate = elements.c0[i] * speed / sliding
    x = rate * step
    if x < 0.02:
        psi = 1 / 2 - x * (1 / 6 - x * (1 / 24 - x * (1 / 120 - x * (1 / 720 - x / 5040))))
        phi = 1.0 - x * psi
    else:
        phi = (1.0 - math.exp(-x)) / x
        psi = (1.0 - phi) / x
    z_dot = velocity - rate * z
    alpha = elements.alpha[i]
    viscous = (
        elements.c2[i]
        * velocity
        * (1.0 if alpha == 1.0 else max(speed, LINEAR_SPEED) ** (alpha - 1.0))
    )
    torque = elements.c0[i] * (z + step * z_dot * psi) + damping * z_dot * phi + viscous
    return z + step * z_dot * phi, torque


@inlined
def _add(a: Vector, b: Vector) -> Vector:
    return a[0] + b[0], a[1] + b[1], a[2] + b[2]


@inlined
def _scale(factor: float, a: Vector) -> Vector:
    return factor * a[0], factor * a[1], factor * a[2]


@inlined
def _dot(a: Vector, b: Vector) -> float:
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


@inlined
def _cross(a: Vector, b: Vector) -> Vector:
    return a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]


@inlined
def _along(x: Vector, y: Vector, z: Vector, a: Vector) -> Vector:
    return _add(_add(_scale(a[0], x), _scale(a[1], y)), _scale(a[2], z))


@inlined
def _turn(w: Vector, a: Vector, r: Vector) -> Vector:
    """Return the acceleration a x r + w x (w x r) of a point at r from the origin of a turning link."""
    return _add(_cross(a, r), _cross(w, _cross(w, r)))


@inlined
def _inertia(
    second_moment: tuple[float, ...], x: Vector, y: Vector, z: Vector
) -> tuple[float, ...]:
    """Return tr(S) - S, shape (6,), xx to yz, for S = xx x x^T + yy y y^T + c z^T + z c^T, c = xz x + yz y."""
    xx, yy, xz, yz = second_moment
    a, b, c = _scale(xx, x), _scale(yy, y), _add(_scale(xz, x), _scale(yz, y))
    trace = xx + yy
    return (
        trace - (a[0] * x[0] + b[0] * y[0] + 2.0 * c[0] * z[0]),
        trace - (a[1] * x[1] + b[1] * y[1] + 2.0 * c[1] * z[1]),
        trace - (a[2] * x[2] + b[2] * y[2] + 2.0 * c[2] * z[2]),
        -(a[0] * x[1] + b[0] * y[1] + c[0] * z[1] + c[1] * z[0]),
        -(a[0] * x[2] + b[0] * y[2] + c[0] * z[2] + c[2] * z[0]),
        -(a[1] * x[2] + b[1] * y[2] + c[1] * z[2] + c[2] * z[1]),
    )


@inlined
def _about_base(inertia: tuple[float, ...], m: Vector, p: Vector) -> tuple[float, ...]:
    """Move an inertia without mass, with the first moment m, from p to the base origin."""
    trace = 2.0 * _dot(m, p)
    return (
        inertia[0] + trace - 2.0 * m[0] * p[0],
        inertia[1] + trace - 2.0 * m[1] * p[1],
        inertia[2] + trace - 2.0 * m[2] * p[2],
        inertia[3] - m[0] * p[1] - m[1] * p[0],
        inertia[4] - m[0] * p[2] - m[2] * p[0],
        inertia[5] - m[1] * p[2] - m[2] * p[1],
    )


@inlined
def _apply(inertia: tuple[float, ...], a: Vector) -> Vector:
    xx, yy, zz, xy, xz, yz = inertia
    return (
        xx * a[0] + xy * a[1] + xz * a[2],
        xy * a[0] + yy * a[1] + yz * a[2],
        xz * a[0] + yz * a[1] + zz * a[2],
    )


@inlined
def _row(rows: Array, i: int) -> Vector:
    return rows[i, 0], rows[i, 1], rows[i, 2]


@inlined
def _column(columns: Array, i: int) -> Vector:
    return columns[0, i], columns[1, i], columns[2, i]


@kernel
def mass_and_bias(arm: Any, work: Any, q: Array, v: Array, mass_matrix: Array, bias: Array) -> None:
    """Write M(q), shape (6, 6), and h(q, v), shape (6,), by Newton's and Euler's equations from link to link.

    The equations of rx90_common.arm_dynamics in the same base parameters: masses are zero, moments are not.
    """
    x, y, z = (1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0)
    origin = w = a = (0.0, 0.0, 0.0)
    step = (arm.first_origin[0], arm.first_origin[1], arm.first_origin[2])
    acceleration = (arm.base_acceleration[0], arm.base_acceleration[1], arm.base_acceleration[2])
    for i in range(6):
        origin = _add(origin, step)
        acceleration = _add(acceleration, _turn(w, a, step))
        sine, cosine = math.sin(q[i]), math.cos(q[i])
        before_x, before_y = (
            _along(x, y, z, _column(arm.frame[0], i)),
            _along(x, y, z, _column(arm.frame[1], i)),
        )
        z = _along(x, y, z, _column(arm.frame[2], i))
        x = _add(_scale(cosine, before_x), _scale(sine, before_y))
        y = _add(_scale(cosine, before_y), _scale(-sine, before_x))
        turn = _scale(v[i], z)
        a = _add(a, _cross(w, turn))
        w = _add(w, turn)
        step = _along(x, y, z, _column(arm.next_origin, i))

        moment = _add(_scale(arm.first_moment[0, i], x), _scale(arm.first_moment[1, i], y))
        second = arm.second_moment
        inertia = _inertia((second[0, i], second[1, i], second[2, i], second[3, i]), x, y, z)
        force = _turn(w, a, moment)
        torque = _add(_apply(inertia, a), _cross(w, _apply(inertia, w)))
        torque = _add(_add(torque, _cross(moment, acceleration)), _cross(origin, force))
        bias[i] = arm.spring_torque[i] * sine
        lever, about_base = _cross(origin, z), _about_base(inertia, moment, origin)
        for k in range(3):
            work.axis[i, k], work.lever[i, k], work.moment[i, k] = z[k], lever[k], moment[k]
            work.torque[i, k], work.force[i, k] = torque[k], force[k]
        for k in range(6):
            work.inertia[i, k] = about_base[k]

    moment = torque = force = (0.0, 0.0, 0.0)
    xx = yy = zz = xy = xz = yz = 0.0
    for i in range(5, -1, -1):
        moment = _add(moment, _row(work.moment, i))
        torque, force = _add(torque, _row(work.torque, i)), _add(force, _row(work.force, i))
        own = work.inertia[i]
        xx, yy, zz, xy, xz, yz = (
            xx + own[0],
            yy + own[1],
            zz + own[2],
            xy + own[3],
            xz + own[4],
            yz + own[5],
        )
        axis, lever = _row(work.axis, i), _row(work.lever, i)
        bias[i] += _dot(axis, torque) + _dot(lever, force)
        # The momentum of all that joint i moves, for a unit of its velocity.
        angular = _add(_apply((xx, yy, zz, xy, xz, yz), axis), _cross(moment, lever))
        linear = _cross(axis, moment)
        for j in range(i + 1):
            entry = (
                arm.rotor[i, j]
                + _dot(_row(work.axis, j), angular)
                + _dot(_row(work.lever, j), linear)
            )
            mass_matrix[i, j] = mass_matrix[j, i] = entry
