"""The bristle: its sliding curve, exact steps at constant velocity, second order otherwise, passive, never NaN."""

import math
from collections.abc import Callable, Sequence
from itertools import pairwise
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from lugre_oracle import LuGreOracle, one_element
from numpy.typing import NDArray
from scipy.integrate import solve_ivp
from signed_element import ELEMENT

from rx90_common.friction import FrictionElement
from rx90_common.friction.bristle import bristle_step, friction_torque
from rx90_common.friction.compiled_elements import element_arrays

Record = Callable[[FrictionElement], Any]
CONSTANT_C1 = ELEMENT.replaced(omega_d=math.inf)
COMPILED = one_element(element_arrays((ELEMENT,))[0], 0)
SPEEDS = [sign * speed for speed in np.geomspace(1e-7, 20.0, 25) for sign in (1.0, -1.0)]
STEP = 2.5e-4
STORE = 0.5 * ELEMENT.c0


def closed_form(element: FrictionElement, z: float, v: float, step: float) -> tuple[float, float]:
    """Return deflection and mean torque at constant velocity, in extended precision."""
    wide = np.longdouble
    g = wide(element.sliding_torque(v)) / wide(element.c0)
    x = wide(abs(v)) / g * wide(step)
    settled = g * np.sign(wide(v))
    end = settled + (wide(z) - settled) * np.exp(-x)
    mean = settled + (wide(z) - settled) * -np.expm1(-x) / x if x > 0 else wide(z)
    c1 = wide(element.damping(v))
    torque = wide(element.c0) * mean + c1 * (end - wide(z)) / wide(step) + wide(element.c2) * wide(v)
    return float(end), float(torque)


@pytest.mark.parametrize("delta", [0.5, 1.0, 2.0, 2.7])
def test_steady_state_is_the_stribeck_curve_of_each_sign(record: Record, delta: float) -> None:
    """After a long way at constant velocity torque and c0 z are the Stribeck curve of that sign to 1e-9 Nm."""
    element = ELEMENT.replaced(delta=delta)
    compiled, oracle = record(element), LuGreOracle((element,))
    for v in SPEEDS:
        # Forty times the bristle's own deflection, in 400 steps.
        step = 40 * 47.0 / element.c0 / abs(v) / 400
        z, torque = -math.copysign(1e-4, v), 0.0
        for _ in range(400):
            z, torque = bristle_step(compiled, z, v, step)
        bristle = math.copysign(float(oracle.stribeck(np.array([v]))[0]), v)
        assert z * element.c0 == pytest.approx(bristle, abs=1e-9)
        for sliding in (torque, friction_torque(compiled, z, v), element.steady_torque(v)):
            assert sliding == pytest.approx(bristle + element.c2 * v, abs=1e-9)


@pytest.mark.parametrize("alpha", [1.0, 0.3, 0.6, 2.0])
def test_torque_at_rest_is_the_bristle_s_alone(record: Record, alpha: float) -> None:
    """At zero velocity the torque is c0 z and the deflection keeps every bit, for either sign and any exponent."""
    compiled = record(ELEMENT.replaced(alpha=alpha))
    for z in (0.0, 1.234e-5, -2.5e-4, 5e-324):
        for v in (0.0, -0.0):
            assert bristle_step(compiled, z, v, STEP) == (z, ELEMENT.c0 * z)
            assert friction_torque(compiled, z, v) == ELEMENT.c0 * z
    assert ELEMENT.steady_torque(0.0) == 0.0


@pytest.mark.parametrize("alpha", [0.3, 0.6, 0.9, 2.0])
def test_the_exponent_changes_the_viscous_part_alone(record: Record, alpha: float) -> None:
    """Deflections keep their bits; torques differ by c2 (|v|^alpha - |v|) sign(v), below 1 mrad/s by its chord."""
    element = ELEMENT.replaced(alpha=alpha)
    linear, bent = record(ELEMENT), record(element)
    for v in (sign * speed for speed in (1e-12, 1e-4, 1e-3, 0.3, 1.0, 7.0) for sign in (1, -1)):
        power = abs(v) ** alpha if abs(v) > 1e-3 else abs(v) / 1e-3 * 1e-3**alpha
        difference = math.copysign(14.0, v) * (power - abs(v))
        (z, torque), (z_bent, torque_bent) = (bristle_step(each, 1e-4, v, STEP) for each in (linear, bent))
        assert z_bent == z
        assert torque_bent - torque == pytest.approx(difference, abs=1e-12)
        instant = friction_torque(bent, 1e-4, v) - friction_torque(linear, 1e-4, v)
        assert instant == pytest.approx(difference, abs=1e-12)
        assert element.steady_torque(v) - ELEMENT.steady_torque(v) == pytest.approx(difference, abs=1e-12)


@pytest.mark.parametrize("v", [s * v for v in (1e-12, 1e-6, 1e-3, 0.0199, 0.3, 4.0, 100.0) for s in (1, -1)])
@pytest.mark.parametrize("step", [1e-5, 2.5e-4, 0.1])
@pytest.mark.parametrize("z", [0.0, 2.1e-4, -1.7e-4])
def test_a_step_at_constant_velocity_is_exact(v: float, step: float, z: float) -> None:
    """Deflection and mean torque equal the closed solution of equations 17 and 18 to rounding."""
    end, torque = bristle_step(COMPILED, z, v, step)
    exact_end, exact_torque = closed_form(ELEMENT, z, v, step)
    assert end == pytest.approx(exact_end, rel=1e-13, abs=1e-18)
    # What c1 adds is a difference of deflections over the step, so it carries their rounding.
    assert torque == pytest.approx(exact_torque, rel=1e-12, abs=1e-12)


def steps_errors(
    element: FrictionElement, velocity: Callable[[float], float], turn: Sequence[float], counts: Sequence[int]
) -> NDArray[np.float64]:
    """Return by how much c0 z, Nm, and the torque's impulse, Nm s, miss a stiff solver's, shape (counts, 2)."""
    oracle, compiled, end = LuGreOracle((element,)), one_element(element_arrays((element,))[0], 0), 0.2

    def rhs(t: float, y: NDArray[np.float64]) -> list[float]:
        z_dot, torque = oracle.rates(y[:1], np.array([velocity(t)]))
        return [z_dot[0], torque[0]]

    exact = np.zeros(2)
    for start, stop in pairwise([0.0, *turn, end]):
        exact = solve_ivp(rhs, (start, stop), exact, "LSODA", rtol=1e-11, atol=[1e-16, 1e-12]).y[:, -1]
    errors = []
    for steps in counts:
        h, z, impulse = end / steps, 0.0, 0.0
        for k in range(steps):
            z, torque = bristle_step(compiled, z, velocity((k + 0.5) * h), h)
            impulse += torque * h
        errors.append([abs(z - exact[0]) * element.c0, abs(impulse - exact[1])])
    return np.array(errors)


@pytest.mark.parametrize("element", [ELEMENT, CONSTANT_C1], ids=["fading c1", "constant c1"])
@pytest.mark.parametrize(
    ("velocity", "turn"),
    [
        (lambda t: 0.4 * math.sin(40.0 * t + 0.3), [math.pi * k / 40 - 0.3 / 40 for k in (1, 2)]),
        (lambda t: 0.2 - 3.0 * t, [0.2 / 3]),
    ],
    ids=["sine", "ramp"],
)
def test_second_order_for_a_changing_velocity(
    element: FrictionElement, velocity: Callable[[float], float], turn: list[float]
) -> None:
    """Against a stiff solver the error falls fourfold per halving, through reversals of both signs."""
    counts = [200, 400, 800, 1600, 3200]
    errors = steps_errors(element, velocity, turn, counts)
    deflection, total = -np.polyfit(np.log(counts), np.log(errors), 1)[0]
    assert deflection == pytest.approx(2.0, abs=0.1)
    # Where in a step the reversal falls changes the constant of the impulse's error, not its order.
    assert total == pytest.approx(2.0, abs=0.5)
    assert errors[1][0] < 1e-3  # Nm of 30


@pytest.mark.parametrize(
    ("alpha", "through_zero", "least"), [(0.6, False, 1.9), (0.6, True, 1.5), (0.3, True, 1.2), (1.5, True, 1.9)]
)
def test_the_order_is_two_or_one_and_alpha_in_reversals(alpha: float, through_zero: bool, least: float) -> None:
    """With another exponent the torque's impulse converges with order two, in coarse reversals 1 + alpha at least."""
    # The bristle's own error would cover that of the viscous part.
    element = FrictionElement(
        tau_c=1e-6, tau_s=1e-6, omega_s=0.05, delta=1.0, c0=1e5, c1=0.0, c2=14.0, omega_d=1.0, alpha=alpha
    )

    def velocity(t: float) -> float:
        return 3.0 * (0.2 / 3 - t) * (1.0 + t) if through_zero else 0.2 + 3.0 * t * (1.0 + t)

    counts = [100, 200, 400, 800]
    errors = steps_errors(element, velocity, [0.2 / 3], counts)[:, 1]
    assert -np.polyfit(np.log(counts), np.log(errors), 1)[0] > least


@given(
    v=st.floats(-1e6, 1e6) | st.sampled_from([0.0, -0.0, 5e-324, -1e-300, 1e-300, 1e6, -1e6]),
    part=st.floats(-1.0, 1.0),
    step=st.floats(1e-9, 0.1),
)
@settings(max_examples=150)
def test_every_velocity_gives_numbers_within_the_bristle_s_range(v: float, part: float, step: float) -> None:
    """No velocity gives NaN or infinity, and a deflection within the static range never leaves it."""
    low, high = -47.0 / ELEMENT.c0, 32.0 / ELEMENT.c0
    z, torque = bristle_step(COMPILED, part * high if part > 0 else -part * low, v, step)
    assert math.isfinite(torque)
    assert low * (1 + 1e-12) <= z <= high * (1 + 1e-12)
    assert math.isfinite(friction_torque(COMPILED, z, v))


@given(
    tau=st.floats(1e-6, 1e6),
    ratio=st.floats(1.0, 100.0),
    omega_s=st.floats(1e-9, 1e6),
    delta=st.floats(0.01, 50.0),
    c0=st.floats(1e-6, 1e12),
    v=st.floats(-1e6, 1e6),
)
@settings(max_examples=120)
def test_any_values_give_numbers(tau: float, ratio: float, omega_s: float, delta: float, c0: float, v: float) -> None:
    """Any accepted parameters, however far from a robot's, give finite deflection and torque."""
    static = tau * ratio
    element = FrictionElement(tau_c=tau, tau_s=static, omega_s=omega_s, delta=delta, c0=c0, c1=1.0, c2=1.0)
    compiled = one_element(element_arrays((element,))[0], 0)
    z, torque = bristle_step(compiled, 0.5 * tau / c0, v, 2.5e-4)
    assert math.isfinite(z)
    assert math.isfinite(torque)


def test_constant_damping_gives_energy_back_beyond_its_limit(record: Record) -> None:
    """A jump from stiction to sliding dissipates below the reported speed and creates energy above it."""
    element = FrictionElement(tau_c=25.0, tau_s=50.0, omega_s=0.01, delta=1.0, c0=1e5, c1=100.0, c2=0.0)
    compiled = record(element)
    limit = element.passivity_limit(10.0)
    assert limit == pytest.approx(1.0, rel=1e-12)  # c1 v = 4 c0 g: 100 v = 4 * 25
    assert [element.passivity_limit(top) for top in (0.99, 1.5)] == [math.inf, limit]

    def dissipated(v: float) -> float:
        step, stored = 1e-8, 50.0 / element.c0
        z, torque = bristle_step(compiled, stored, v, step)
        return float(torque * v * step - STORE * (z - stored) * (z + stored))

    assert dissipated(0.97 * limit) > 0.0
    assert dissipated(1.03 * limit) < 0.0
    assert math.isinf(element.replaced(omega_d=1.0).passivity_limit(10.0))


def test_the_damping_s_limit_does_not_depend_on_the_exponent() -> None:
    """The c1 that passivity accepts is the linear element's: the viscous part alone always takes power."""
    bent = CONSTANT_C1.replaced(alpha=0.6)
    assert bent.passivity_limit(6.0) == CONSTANT_C1.passivity_limit(6.0) < 6.0
    assert bent.passive_damping(6.0) == CONSTANT_C1.passive_damping(6.0)
