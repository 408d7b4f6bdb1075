"""The accurate answer: the same digital controller, the plant integrated by SciPy's stiff variable-step solver.

Between two ticks the motor torques are constant, so the plant is a smooth initial value problem of 19 states
(6 positions, 6 velocities, 7 bristle deflections). LSODA solves it at tight tolerance; equations 17 to 19 are
written out here once more, apart from the plant step that is judged by them. The samples that the controller
sees, encoder and observer, come from the plant step's own code: they are definitions, not approximations.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numba
import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.integrate import odeint
from tqdm import tqdm

from rx90_controller.trajectory import TrajectoryPoints
from rx90_description.wrist import to_joint_torque
from rx90_loop.setup import Setup
from rx90_sim.manipulator import mass_and_bias
from rx90_sim.plant import Plant
from rx90_sim.plant_step import sample_drives

Array = NDArray[np.float64]
RELATIVE, ABSOLUTE = 1e-11, 1e-13
"""Tolerances of LSODA on rad, rad/s and rad."""


class ReferenceRun(NamedTuple):
    """States on position ticks: q, v rad and rad/s, shape (m, 6); z rad, shape (m, 7)."""

    q: Array
    v: Array
    z: Array


@numba.njit(error_model="numpy")
def _derivative(y: Array, arm: Any, body: Any, friction: Any, drive: Array) -> Array:
    mass, bias = np.empty((6, 6)), np.empty(6)
    q, v, z = y[:6].copy(), y[6:12].copy(), y[12:]
    mass_and_bias(arm[0], body[0], q, v, mass, bias)
    derivative = np.empty(19)
    torque = drive - bias
    for i in range(7):
        velocity = v[i] if i < 6 else v[4] + v[5]
        e = friction[i]
        sign = 1 if velocity >= 0 else 0
        stribeck = np.exp(-((abs(velocity) * e.inverse_omega_s) ** e.delta))
        g = (e.tau_c[sign] + (e.tau_s[sign] - e.tau_c[sign]) * stribeck) / e.c0
        z_dot = velocity - abs(velocity) / g * z[i]
        c1 = e.c1 * np.exp(-((velocity * e.inverse_omega_d) ** 2))
        tau = e.c0 * z[i] + c1 * z_dot + e.c2 * velocity
        derivative[12 + i] = z_dot
        if i < 6:
            torque[i] -= tau
        else:
            torque[4] -= tau
            torque[5] -= tau
    derivative[:6] = v
    derivative[6:12] = np.linalg.solve(mass, torque)
    return derivative


def hybrid_reference(
    setup: Setup, points: TrajectoryPoints, initial_position: ArrayLike, duration: float, *, quiet: bool = False
) -> ReferenceRun:
    """Run the closed loop with the plant solved by LSODA between ticks."""
    plant, controller = setup.plant(), setup.cs7b()
    plant.reset(initial_position)
    controller.reset(plant.motor_states()[0])
    controller.trajectory.accept(points, 0, 0)
    rates = setup.rates
    ticks = round(duration * rates.base_hz)
    rows: list[Array] = []
    state = plant.state[0]
    y = np.concatenate([state["q"], state["v"], state["z"]])
    drive = np.empty(6)
    friction = setup.friction.records()
    for tick in tqdm(range(ticks), desc="stiff reference", unit="tick", disable=quiet, leave=False):
        if tick % rates.ratio == 0:
            rows.append(y.copy())
        position, velocity, _ = plant.motor_states()
        to_joint_torque(setup.drives.gear, controller.step(position, velocity), drive)
        y = _advance(plant, friction, y, drive, rates.period)
        plant.state["q"][0] = y[:6]
        sample_drives(plant.constants, plant.state)
    table = np.array(rows)
    return ReferenceRun(table[:, :6], table[:, 6:12], table[:, 12:])


def _advance(plant: Plant, friction: NDArray[Any], y: Array, drive: Array, period: float) -> Array:
    constants = plant.constants
    arguments = (constants["arm"], plant.state["body"], friction, drive)
    solution = odeint(_derivative, y, (0.0, period), args=arguments, rtol=RELATIVE, atol=ABSOLUTE, mxstep=20000)
    return np.asarray(solution[1])
