"""A viscous part that grows less, or more, than linearly: c2 |v|^alpha sign(v)."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from lugre_oracle import LuGreOracle
from scipy.integrate import solve_ivp

from rx90_common.friction import FrictionElement
from rx90_common.friction.bristle import bristle_step, friction_torque

Record = Callable[[FrictionElement], Any]
PAPER = FrictionElement(25.0, 31.0, 32.0, 47.0, 0.05, 1.0, 1e5, 100.0, 14.0, 1.0)
STEP = 2.5e-4


@pytest.mark.parametrize("alpha", [0.3, 0.6, 0.9, 2.0])
def test_the_exponent_changes_the_viscous_part_alone(record: Record, alpha: float) -> None:
    """Deflections keep their bits; torques differ by c2 (|v|^alpha - |v|) sign(v), below 1 mrad/s by its chord."""
    element = dataclasses.replace(PAPER, alpha=alpha)
    linear, bent = record(PAPER), record(element)
    for v in (sign * speed for speed in (1e-12, 1e-4, 1e-3, 0.3, 1.0, 7.0) for sign in (1, -1)):
        power = abs(v) ** alpha if abs(v) > 1e-3 else abs(v) / 1e-3 * 1e-3**alpha
        difference = math.copysign(14.0, v) * (power - abs(v))
        (z, torque), (z_bent, torque_bent) = (bristle_step(each, 1e-4, v, STEP) for each in (linear, bent))
        assert z_bent == z
        assert torque_bent - torque == pytest.approx(difference, abs=1e-12)
        instant = friction_torque(bent, 1e-4, v) - friction_torque(linear, 1e-4, v)
        assert instant == pytest.approx(difference, abs=1e-12)
        assert element.steady_torque(v) - PAPER.steady_torque(v) == pytest.approx(difference, abs=1e-12)


def test_a_joint_at_rest_sticks_whatever_the_exponent(record: Record) -> None:
    """At zero velocity the torque is the bristle's and z keeps every bit."""
    for alpha in (0.3, 0.6, 2.0):
        compiled = record(dataclasses.replace(PAPER, alpha=alpha))
        for v in (0.0, -0.0):
            assert bristle_step(compiled, -1.7e-4, v, STEP) == (-1.7e-4, PAPER.c0 * -1.7e-4)
            assert friction_torque(compiled, -1.7e-4, v) == PAPER.c0 * -1.7e-4


@pytest.mark.parametrize(
    ("alpha", "through_zero", "least"), [(0.6, False, 1.9), (0.6, True, 1.5), (0.3, True, 1.2), (1.5, True, 1.9)]
)
def test_the_order_is_two_and_one_and_alpha_where_the_joint_reverses(
    record: Record, alpha: float, through_zero: bool, least: float
) -> None:
    """Against a stiff solver the torque's impulse converges with order two, in coarse reversals 1 + alpha at least."""
    element = dataclasses.replace(PAPER, alpha=alpha)
    # The bristle's own error would cover that of the viscous part.
    element = dataclasses.replace(
        element, tau_c_positive=1e-6, tau_c_negative=1e-6, tau_s_positive=1e-6, tau_s_negative=1e-6, c1=0.0
    )
    oracle, compiled = LuGreOracle((element,)), record(element)
    end, reversal = 0.2, 0.2 / 3

    def velocity(t: float) -> float:
        return 3.0 * (reversal - t) * (1.0 + t) if through_zero else 0.2 + 3.0 * t * (1.0 + t)

    def rhs(t: float, y: np.ndarray[Any, Any]) -> list[float]:
        z_dot, torque = oracle.rates(y[:1], np.array([velocity(t)]))
        return [z_dot[0], torque[0]]

    y = np.zeros(2)
    for start, stop in ((0.0, reversal), (reversal, end)):
        y = solve_ivp(rhs, (start, stop), y, "Radau", rtol=1e-11, atol=[1e-16, 1e-12]).y[:, -1]
    errors, counts = [], np.array([100, 200, 400, 800])
    for steps in counts:
        z, impulse = 0.0, 0.0
        for k in range(steps):
            z, torque = bristle_step(compiled, z, velocity((k + 0.5) * end / steps), end / steps)
            impulse += torque * end / steps
        errors.append(abs(impulse - y[1]))
    assert -np.polyfit(np.log(counts), np.log(errors), 1)[0] > least


def test_a_cycle_dissipates_and_the_damping_s_limit_stays(record: Record) -> None:
    """With alpha 0.6 cycles of any size cost what the viscous part takes; passivity's c1 is the linear element's."""
    element = dataclasses.replace(PAPER, alpha=0.6)
    compiled = record(element)
    for amplitude in (1e-2, 1.0, 6.0):
        z, works = 0.0, []
        for _ in range(3):
            work = 0.0
            for phase in (np.arange(400) + 0.5) * (math.tau / 400):
                v = amplitude * math.sin(phase)
                z, torque = bristle_step(compiled, z, v, STEP)
                work += torque * v * STEP
            works.append(work)
        # The viscous part alone: c2 A^(1 + alpha) times the mean of |sin|^(1 + alpha).
        period, mean = 400 * STEP, math.gamma(1.3) / (math.sqrt(math.pi) * math.gamma(1.8))
        assert min(works[1:]) >= 0.99 * 14.0 * amplitude**1.6 * mean * period > 0.0
    constant = dataclasses.replace(PAPER, omega_d=math.inf)
    bent = dataclasses.replace(constant, alpha=0.6)
    assert bent.passivity_limit(6.0) == constant.passivity_limit(6.0) < 6.0
    assert bent.passive_damping(6.0) == constant.passive_damping(6.0)
