"""What the LuGre paper (Canudas de Wit et al. 1995, section III) shows, on the plant's joints as masses."""

import itertools
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.integrate import solve_ivp

from rx90_common.base.arrays import Array
from rx90_common.friction import FrictionElement
from rx90_common.friction.bristle import bristle_step
from rx90_common.kernels.compiled import kernel
from rx90_emulator.loop.setup import Setup
from rx90_sim.plant import Plant
from rx90_sim.plant_step import plant_step

Masses = Callable[..., Plant]


@kernel
def pull(plants: NDArray[Any], states: NDArray[Any], rate: Array, stiffness: float, speed: float, path: Array) -> int:
    """Load masses by a force `rate * t` and a spring pulled at `speed`; record (x, v), shape (n, 2, 6)."""
    plant, state = plants[0], states[0]
    force = np.zeros(6)
    for k in range(path.shape[0]):
        middle = (k + 0.5) * plant.period
        for i in range(6):
            position = state.q[i] + 0.5 * plant.period * state.v[i]
            force[i] = rate[i] * middle + stiffness * (speed * middle - position)
        joint = plant_step(plants, states, force, True)
        if joint >= 0:
            return joint
        for i in range(6):
            path[k, 0, i], path[k, 1, i] = state.q[i], state.v[i]
    return -1


def mass_with_friction(oracle: Any, force: Callable[[float, float], float]) -> Callable[[float, Array], list[float]]:
    def rhs(t: float, y: Array) -> list[float]:
        z_dot, friction = oracle.rates(y[2:3], y[1:2])
        return [y[1], force(t, y[0]) - float(friction[0]), float(z_dot[0])]

    return rhs


def test_break_away_falls_as_the_rate_rises(masses: Masses, paper_element: FrictionElement, lugre_oracle: type) -> None:
    """The break-away force falls with the rate of the force, from tau_s on, and equals a stiff solver's."""
    rates = np.array([0.2, 1.0, 5.0, 25.0])
    plant = masses([paper_element] * 4)
    path = np.empty((8 * 4000, 2, 6))
    assert pull(plant.constants, plant.state, np.append(rates, [0.0, 0.0]), 0.0, 0.0, path) == -1
    # What the applied force does not accelerate, friction takes; its summit is the break-away force.
    middle = (np.arange(len(path)) + 0.5) / 4000
    friction = rates * middle[:, None] - np.diff(path[:, 1, :4], axis=0, prepend=0.0) * 4000
    ours = np.where(path[:, 1, :4] < 0.1, friction, 0.0).max(axis=0)
    assert np.all(np.diff(ours) < -0.01)
    assert ours[0] == pytest.approx(1.5, abs=0.03)
    assert np.all(ours > 1.0)

    oracle = lugre_oracle([paper_element])
    for rate, summit in zip(rates, ours, strict=True):

        def away(_: float, y: Array) -> float:
            return float(y[1]) - 0.1

        away.terminal = True  # type: ignore[attr-defined]
        rhs = mass_with_friction(oracle, lambda t, _, r=rate: r * t)  # type: ignore[misc]
        exact = solve_ivp(rhs, (0.0, 8.0), np.zeros(3), "LSODA", rtol=1e-8, atol=1e-11, events=away, dense_output=True)
        _, v, z = exact.sol(np.linspace(0.2 * exact.t[-1], exact.t[-1], 8001))
        assert summit == pytest.approx(oracle.rates(z, v)[1].max(), abs=2e-3)


def test_stick_slip_of_a_mass_on_a_spring(masses: Masses, paper_element: FrictionElement, lugre_oracle: type) -> None:
    """A mass pulled by a soft spring sticks and slips with the period and stroke of a stiff solver."""
    stiffness, speed, end = 2.0, 0.1, 30.0
    plant = masses([paper_element])
    path = np.empty((int(end * 4000), 2, 6))
    assert pull(plant.constants, plant.state, np.zeros(6), stiffness, speed, path) == -1
    x, v = path[:, 0, 0], path[:, 1, 0]
    stuck = np.abs(v) < 1e-3
    assert 0.5 < stuck.mean() < 0.95

    rhs = mass_with_friction(lugre_oracle([paper_element]), lambda t, y: stiffness * (speed * t - y))
    times = np.linspace(0.0, end, 3001)[1:]
    exact = solve_ivp(rhs, (0.0, end), np.zeros(3), "LSODA", times, rtol=1e-8, atol=1e-11).y
    # The same number of jumps, each as long and at the same time.
    assert np.abs(x[39::40] - exact[0]).max() < 2e-4
    slips = np.flatnonzero(np.diff((v > 0.05).astype(int)) == 1) / 4000
    exact_slips = times[np.flatnonzero(np.diff((exact[1] > 0.05).astype(int)) == 1)]
    assert len(slips) == len(exact_slips) >= 3
    assert np.diff(slips) == pytest.approx(np.diff(exact_slips), abs=0.02)


def presliding_loop(record: Any, amplitude: float, frequency: float, cycles: int, steps: int) -> Array:
    """Return (position, torque) over the last of several sine cycles of position, shape (steps, 2)."""
    period = 1.0 / frequency
    times = np.linspace(0.0, cycles * period, cycles * steps + 1)
    position = amplitude * np.sin(2 * np.pi * frequency * times)
    step, z, rows = period / steps, 0.0, []
    for start, end in itertools.pairwise(position):
        z, torque = bristle_step(record, z, (end - start) / step, step)
        rows.append(((start + end) / 2, torque))
    return np.array(rows).reshape(cycles, steps, 2)


@pytest.mark.parametrize(("amplitude", "slope"), [(2.5e-4, None), (1e-2, 2.0)])
def test_slope_behind_a_reversal_is_that_of_equation_17(
    record: Callable[[FrictionElement], Any], amplitude: float, slope: float | None
) -> None:
    """It is c0 (1 + |z| / g) behind and c0 (1 - |z| / g) before it: after sliding 2 c0 and 0."""
    c0 = 1e5
    static = 32.0
    element = FrictionElement(tau_c=25.0, tau_s=static, omega_s=0.05, delta=1.0, c0=c0, c1=100.0, c2=14.0)
    loop = presliding_loop(record(element), amplitude, 1e-4, cycles=2, steps=16_000)[-1]
    turn = 4_000  # a quarter period: the velocity reverses
    z = loop[turn, 1] / c0
    before = np.polyfit(*loop[turn - 12 : turn - 1].T, 1)[0]
    behind = np.polyfit(*loop[turn + 1 : turn + 12].T, 1)[0]
    assert behind == pytest.approx(c0 * (1.0 + z * c0 / static), rel=0.01)
    assert before == pytest.approx(c0 * (1.0 - z * c0 / static), abs=0.01 * c0)
    if slope is not None:
        assert behind == pytest.approx(slope * c0, rel=0.02)
        assert before == pytest.approx(0.0, abs=0.02 * c0)


def test_a_mass_under_constant_load_does_not_creep(
    masses: Masses, shipped: Setup, paper_element: FrictionElement
) -> None:
    """Below break-away a mass moves by its bristle, then keeps every bit of its position from then on."""
    first, second, third = shipped.friction.elements[:3]
    elements = [first, second.replaced(alpha=0.6), third.replaced(alpha=0.4), paper_element]
    load = np.array([0.8 * e.tau_c.positive for e in elements])
    load[1] *= -1
    force = np.append(load, [0.0, 0.0])
    hertz = 1000
    plant = masses(elements, inertia=3.0, base_hz=hertz)
    for _ in range(10 * hertz):
        plant.step(force)
    settled = plant.joint_states()[0][:4].copy()
    deflection = load / [e.c0 for e in elements]
    # The bristle settles at load / c0; on its way it loses what slid while it moved.
    assert np.all(np.abs(settled) >= np.abs(deflection) * (1 - 1e-6))
    assert np.all(np.abs(settled) <= 10 * np.abs(deflection))
    for _ in range(5 * hertz):
        plant.step(force)
    assert np.array_equal(plant.joint_states()[0][:4], settled)
    assert plant.friction_states()[0][:4] == pytest.approx(deflection, rel=1e-9)
