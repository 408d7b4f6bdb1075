"""The perturbation step, compiled: a group of runs about one nominal motion, a lane for each run.

Deviations take the same steps as the plant (rx90_sim.plant_step): arm and friction are evaluated at the midpoint,
which the last step's mean acceleration and the jump of the torque predict, and the bristles are advanced
exactly for the midpoint velocity. Friction, drives and controllers are the full simulation's own formulas. Only the
arm is linear. There are no end stops: a nominal motion keeps away from them, and deviations are small.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from rx90_common.base.arrays import Array, Record
from rx90_common.description.coupling import RX_WRIST
from rx90_common.friction import FrictionSet
from rx90_common.friction.bristle import bristle_step
from rx90_common.friction.compiled_elements import (
    bristles_dtype,
    bristles_state_dtype,
    bristles_step,
    element_arrays,
    elements_dtype,
    load_elements,
)
from rx90_common.friction.parts.bristles import fill_bristles
from rx90_common.kernels.compiled import inlined, kernel
from rx90_common.kernels.lanes import Lanes, absolute, fma, load, select, store
from rx90_controller.law.cs7b import position_servo, velocity_servo
from rx90_controller.law.parameters import controller_dtype
from rx90_sim.drives import observe, whole_steps

FEW, MANY = 4, 16
"""Runs that go through the formulas together: one vector of the processor, or several to hide latency."""

_SERVO_NAMES = tuple(name for name in controller_dtype(RX_WRIST.size).names or () if name not in ("gear", "model"))
_STATE_ROWS = {
    "q": 6,  # deviation of the joints, rad
    "v": 6,
    "acceleration": 6,  # mean over the last step
    "excess": 6,  # drive torque beyond tau0, Nm
    "z": RX_WRIST.size.elements,
    "motor_position": 6,  # the drives' and the controllers' states as in the full simulation
    "motor_velocity": 6,
    "observer": 6,
    "integrator": 6,
    "position_torque": 6,
    "feed_forward": 6,
    "current": 6,
    "limited": 6,
    "saturated": 6,
    "tripped": 1,  # 1 where the supervision would have cut the power
    "diverged": 1,  # 1 where a joint exceeded its speed limit, or is not a number
    # Workspace of a step.
    "q_mid": 6,
    "v_mid": 6,
    "rhs": 6,
    "velocity": RX_WRIST.size.elements,  # of the elements, nominal motion included
}


def lanes_for(runs: int) -> int:
    """Return how many runs go together in a batch of `runs`: few lanes leave fewer idle."""
    return FEW if runs <= 2 * FEW else MANY


class Groups(NamedTuple):
    """All runs, group by group; idle lanes of the last group repeat the last run.

    Attributes:
        elements: friction elements, shape (groups, 7).
        kinds: their bristles, shape (groups, 7).
        blocks: what these remember, all zero, shape (groups, 7).
        servos: controllers of the motors, shape (groups, 6), with the fields of `controller_dtype`.
        states: all zero, shape (groups,), with the fields of _STATE_ROWS.
    """

    elements: Record
    kinds: Record
    blocks: Record
    servos: Record
    states: Record


def pack(frictions: Sequence[FrictionSet], laws: Sequence[Record], lanes: int) -> Groups:
    """Return the runs' parameters, lane by lane, and room for their states.

    Args:
        frictions: one for each run.
        laws: one for each run, shape (1,), of `controller_dtype`.
        lanes: runs in a group.
    """
    groups = -(-len(frictions) // lanes)
    elements = np.zeros((groups, RX_WRIST.size.elements), elements_dtype(lanes))
    kinds = np.zeros((groups, RX_WRIST.size.elements), bristles_dtype(lanes))
    blocks = np.zeros((groups, RX_WRIST.size.elements), bristles_state_dtype(lanes))
    servos = np.zeros((groups, 6), np.dtype([(name, np.float64, lanes) for name in _SERVO_NAMES], align=True))
    fields = [(name, np.float64, (rows, lanes)) for name, rows in _STATE_ROWS.items()]
    # The inverse of M0, C0 and K0 in the present tick serve all runs.
    states = np.zeros(groups, np.dtype([*fields, ("coefficients", np.float64, (3, 6, 6))], align=True))
    sources = np.minimum(np.arange(groups * lanes), len(frictions) - 1).reshape(groups, lanes)
    for (group, lane), source in np.ndenumerate(sources):
        arrays = element_arrays(frictions[source].elements)
        for name in arrays.dtype.names or ():
            elements[name][group, ..., lane] = arrays[name][0].T
        for name in _SERVO_NAMES:
            servos[name][group, :, lane] = laws[source][name][0]
    for group, element in np.ndindex(kinds.shape):
        fill_bristles(kinds[group, element], [frictions[run].elements[element].bristles for run in sources[group]])
    return Groups(elements, kinds, blocks, servos, states)


class Tables(NamedTuple):
    """What the runs share, over n base ticks and m position ticks.

    Attributes:
        position: q0 on base ticks, rad, shape (n + 1, 6).
        velocity: v0 in the middle of the steps, rad/s, shape (n, 6).
        torque: tau0 there, Nm, shape (n, 6).
        slip: of the nominal positions, rad, shape (n, 6).
        coefficients: inverse of M0, C0 and K0 at every `spacing`-th tick, shape (points, 3, 6, 6).
        reference: motor-side set-points on position ticks, shape (m, 3, 6).
        jacobian: of the tip's position at q0 on position ticks, m/rad, shape (m, 3, 6).
    """

    position: Array
    velocity: Array
    torque: Array
    slip: Array
    coefficients: Array
    reference: Array
    jacobian: Array


class Series(NamedTuple):
    """What runs leave on position ticks.

    Attributes:
        joint_deviation: rad, shape (runs, m, 6).
        bristles: deflection, rad, shape (runs, m, 7).
        tip_deviation: m, shape (runs, m, 3).
    """

    joint_deviation: Array
    bristles: Array
    tip_deviation: Array


@kernel
def run_few(plants: Record, tables: Tables, spacing: int, ratio: int, groups: Groups, series: Series) -> None:
    """Run all groups of FEW lanes through the whole motion.

    Args:
        plants: constants of the plant, shape (1,), of `plant_dtype`; its friction is not used.
        tables: what the runs share.
        spacing: base ticks from one point of the coefficients to the next.
        ratio: base ticks in a position tick.
        groups: the runs; their states are advanced in place.
        series: written for the runs that exist.
    """
    _run(plants[0], tables, spacing, ratio, groups, series, FEW)


@kernel
def run_many(plants: Record, tables: Tables, spacing: int, ratio: int, groups: Groups, series: Series) -> None:
    """Run all groups of MANY lanes as `run_few` does; vectors have their width in their type."""
    _run(plants[0], tables, spacing, ratio, groups, series, MANY)


@inlined
def _run(plant: Any, tables: Tables, spacing: int, ratio: int, groups: Groups, series: Series, lanes: int) -> None:
    for group in range(len(groups.states)):
        state, servos = groups.states[group], groups.servos[group]
        for i in range(6):  # counts and observers start where the arm is
            angle = _motor_angle(plant, tables.position[0], state, i, lanes)
            store(state.observer[i], angle)
            store(state.motor_position[i], whole_steps(angle, plant.resolution[i]))
        for k in range(len(tables.velocity)):
            row = k // ratio
            if k % ratio == 0:
                _record(tables.jacobian[row], state, group * lanes, row, series, lanes)
                _position_loops(plant, servos, tables.reference[row], state, lanes)
            _interpolate(tables.coefficients, k, spacing, state)
            _velocity_loops(servos, plant.gear, tables.reference[row, 1], tables.torque[k], state, lanes)
            _substep(tables, k, groups, group, state, plant.period, lanes)
            _sample(plant, tables.position[k + 1], state, lanes)


@inlined
def _record(jacobian: Array, state: Any, first: int, row: int, series: Series, lanes: int) -> None:
    runs = min(lanes, len(series.tip_deviation) - first)
    for i in range(3):
        tip = jacobian[i, 0] * load(state.q[0], lanes)
        for j in range(1, 6):
            tip = fma(jacobian[i, j], load(state.q[j], lanes), tip)
        store(state.rhs[i], tip)
    for run in range(runs):
        for i in range(6):
            series.joint_deviation[first + run, row, i] = state.q[i, run]
        for i in range(7):
            series.bristles[first + run, row, i] = state.z[i, run]
        for i in range(3):
            series.tip_deviation[first + run, row, i] = state.rhs[i, run]


@inlined
def _position_loops(plant: Any, servos: Record, reference: Array, state: Any, lanes: int) -> None:
    """Run PI and FF, and mark runs beyond a limit of the supervision, as `rx90_controller.law.cs7b`, or diverged."""
    for i in range(6):
        error, integrator, position_torque, feed_forward = position_servo(
            servos[i], lanes, reference[0, i], reference[1, i], reference[2, i], load(state.motor_position[i], lanes),
            load(state.integrator[i], lanes), load(state.limited[i], lanes),
        )  # fmt: skip
        store(state.integrator[i], integrator)
        store(state.position_torque[i], position_torque)
        store(state.feed_forward[i], feed_forward)
        store(state.rhs[i], error)
    tripped, diverged = load(state.tripped[0], lanes), load(state.diverged[0], lanes)
    for i in range(6):
        error, speed = load(state.rhs[i], lanes), load(state.motor_velocity[i], lanes)
        if i == 5:  # motor 6 turns with joints 5 and 6 together
            share = plant.gear[5] / plant.gear[4]
            error = error - share * load(state.rhs[4], lanes)
            speed = speed - share * load(state.motor_velocity[4], lanes)
        # The comparisons are false for NaN too.
        tripped = select(absolute(error) <= load(servos[i].following_error, lanes), tripped, 1.0)
        tripped = select(absolute(speed) <= load(servos[i].over_speed, lanes), tripped, 1.0)
        diverged = select(absolute(load(state.velocity[i], lanes)) <= plant.speed_limit[i], diverged, 1.0)
    store(state.tripped[0], tripped)
    store(state.diverged[0], diverged)


@inlined
def _velocity_loops(servos: Record, gear: Array, velocity: Array, nominal: Array, state: Any, lanes: int) -> None:
    """Run D and C; leave what the drives give beyond tau0, and predict what its jump does to the acceleration."""
    coupled = 0.0 * load(state.rhs[0], lanes)
    for n in range(6):
        i = 5 - n  # motor 6 first: it acts on joint 5, too
        _, current, command, limited = velocity_servo(
            servos[i], lanes, load(servos[i].current_gain, lanes), load(state.position_torque[i], lanes),
            load(state.feed_forward[i], lanes), velocity[i], load(state.motor_velocity[i], lanes),
            load(state.current[i], lanes),
        )  # fmt: skip
        store(state.current[i], current)
        store(state.limited[i], limited)
        store(state.saturated[i], load(state.saturated[i], lanes) + limited * limited)
        torque = gear[i] * command
        if i == 5:
            coupled = torque
        if i == 4:
            torque = torque + coupled
        excess = torque - nominal[i]
        store(state.rhs[i], excess - load(state.excess[i], lanes))
        store(state.excess[i], excess)
    inverse = state.coefficients[0]
    for i in range(6):
        store(state.acceleration[i], _product(inverse, i, state.rhs, load(state.acceleration[i], lanes), 1.0, lanes))


@inlined
def _interpolate(points: Array, tick: int, spacing: int, state: Any) -> None:
    """Write the coefficients in the middle of a tick."""
    point = tick // spacing
    share = (tick - point * spacing + 0.5) / spacing
    for n in range(3):
        for i in range(6):
            before, after = load(points[point, n, i], 6), load(points[point + 1, n, i], 6)
            store(state.coefficients[n, i], fma(share, after - before, before))


@inlined
def _product(matrix: Array, i: int, vectors: Array, total: Lanes, sign: float, lanes: int) -> Lanes:
    """Return total + sign * (row i of a matrix, shape (6, 6), times vectors, shape (6, lanes))."""
    for j in range(6):
        total = fma(sign * matrix[i, j], load(vectors[j], lanes), total)
    return total


@inlined
def _substep(tables: Tables, tick: int, groups: Groups, group: int, state: Any, step: float, lanes: int) -> None:
    """Evaluate arm and friction at the predicted midpoint and step with the mean acceleration found there."""
    velocity, slip = tables.velocity[tick], tables.slip[tick]
    half = 0.5 * step
    for i in range(6):
        v, acceleration = load(state.v[i], lanes), load(state.acceleration[i], lanes)
        v_mid = v + half * acceleration
        store(state.v_mid[i], v_mid)
        store(state.q_mid[i], load(state.q[i], lanes) + half * (v + 0.5 * half * acceleration))
        store(state.velocity[i], velocity[i] + v_mid)
        store(state.rhs[i], load(state.excess[i], lanes))
    store(state.velocity[6], load(state.velocity[4], lanes) + load(state.velocity[5], lanes))
    for i in range(7):  # the bristles advance, and their torques are taken from `rhs`
        element, kind = load_elements(groups.elements[group, i], lanes), groups.kinds[group, i]
        z, speed = load(state.z[i], lanes), load(state.velocity[i], lanes)
        if kind.elastic_used or kind.blocks_used:
            z, torque = bristles_step(element, kind, groups.blocks[group, i], z, speed, step, lanes)
        else:
            z, torque = bristle_step(element, z, speed, step)
        store(state.z[i], z)
        if i < 6:
            store(state.rhs[i], load(state.rhs[i], lanes) - torque)
        else:
            store(state.rhs[4], load(state.rhs[4], lanes) - torque)
            store(state.rhs[5], load(state.rhs[5], lanes) - torque)
    for i in range(6):
        rhs = _product(state.coefficients[1], i, state.v_mid, load(state.rhs[i], lanes), -1.0, lanes)
        store(state.rhs[i], _product(state.coefficients[2], i, state.q_mid, rhs, -1.0, lanes))
    for i in range(6):
        acceleration = _product(state.coefficients[0], i, state.rhs, 0.0 * load(state.rhs[i], lanes), 1.0, lanes)
        v = load(state.v[i], lanes)
        store(state.q[i], load(state.q[i], lanes) + (step * (v + half * acceleration) - slip[i]))
        store(state.v[i], v + step * acceleration)
        store(state.acceleration[i], acceleration)


@inlined
def _sample(plant: Any, nominal: Array, state: Any, lanes: int) -> None:
    """Sample the resolvers: counts, and the converters' velocity."""
    for i in range(6):
        angle = _motor_angle(plant, nominal, state, i, lanes)
        position, velocity = observe(
            angle, load(state.observer[i], lanes), load(state.motor_velocity[i], lanes), plant.period,
            plant.observer_position, plant.observer_velocity,
        )  # fmt: skip
        store(state.observer[i], position)
        store(state.motor_velocity[i], velocity)
        store(state.motor_position[i], whole_steps(angle, plant.resolution[i]))


@inlined
def _motor_angle(plant: Any, nominal: Array, state: Any, i: int, lanes: int) -> Any:
    q = nominal[i] + load(state.q[i], lanes)
    if i == 5:  # motor 6 turns with joints 5 and 6 together
        q = q + (nominal[4] + load(state.q[4], lanes))
    return plant.gear[i] * q
