"""The elasto-plastic step: exact at constant velocity, its instant torque, and numbers for every velocity."""

from __future__ import annotations

import math

import numpy as np
import pytest
from bristle_oracles import ElastoPlasticOracle, random_element
from hypothesis import given, settings
from hypothesis import strategies as st
from signed_element import ELEMENT

from rx90_common.friction.bristle import bristle_step
from rx90_common.friction.compiled_elements import element_arrays, one_element
from rx90_common.friction.elasto_plastic import elasto_plastic_step, elasto_plastic_torque

COMPILED = one_element(element_arrays((ELEMENT,))[0], 0)


@pytest.mark.parametrize("seed", range(50))
def test_a_step_at_constant_velocity_is_exact(seed: int) -> None:
    """Deflection and mean torque are those of a solver with located kinks, through all branches and both signs."""
    rng = np.random.default_rng(seed)
    element = random_element(rng)
    compiled = one_element(element_arrays((element,))[0], 0)
    oracle = ElastoPlasticOracle(element, rng.uniform(0.0, 0.9))
    z, share = 0.0, 2e-9 * element.tau_c.positive
    for sign in (1.0, 1.0, -1.0, 1.0):
        velocity, step = sign * 10.0 ** rng.uniform(-2.0, 0.7), 10.0 ** rng.uniform(-4.0, -2.5)
        assert elasto_plastic_torque(compiled, oracle.break_away, z, velocity) == pytest.approx(
            oracle.torque(z, velocity), rel=1e-12, abs=share
        )
        exact, exact_torque = oracle.hold(z, velocity, step)
        z, torque = elasto_plastic_step(compiled, oracle.break_away, z, velocity, step)
        assert z * element.c0 == pytest.approx(exact * element.c0, abs=share)
        assert torque == pytest.approx(exact_torque, abs=2.0 * share)


def test_near_steady_sliding_a_step_is_exact() -> None:
    """However near a bristle begins to its steady deflection, it is where a solver has it to 1e-12 of it."""
    oracle, velocity, step = ElastoPlasticOracle(ELEMENT, 0.7), 0.02, 5e-3
    elastic, steady = oracle.limits(velocity)
    for n in 10.0 ** np.arange(-9.0, -1.0):
        z = steady - n * (steady - elastic)
        exact, _ = oracle.hold(z, velocity, step)
        found, _ = elasto_plastic_step(COMPILED, 0.7, z, velocity, step)
        assert found == pytest.approx(exact, rel=1e-12, abs=0.0)


def test_beyond_the_steady_deflection_it_is_lugre() -> None:
    """Where the sliding curve has fallen below the deflection, and in steady sliding, the step has LuGre's numbers."""
    for z, velocity in ((3.1e-4, 0.3), (-4.4e-4, -0.2), (2.5e-4, 3.0)):
        ours, lugre = (
            elasto_plastic_step(COMPILED, 0.7, z, velocity, 2.5e-4),
            bristle_step(COMPILED, z, velocity, 2.5e-4),
        )
        assert ours == pytest.approx(lugre, rel=1e-12, abs=0.0)


@given(
    velocity=st.floats(-1e6, 1e6) | st.sampled_from([0.0, -0.0, 5e-324, -1e-300, 1e-300]),
    part=st.floats(-1.0, 1.0),
    step=st.floats(1e-9, 0.1),
    break_away=st.floats(0.0, 0.9),
)
@settings(max_examples=120)
def test_every_velocity_gives_numbers_within_the_bristle_s_range(
    velocity: float, part: float, step: float, break_away: float
) -> None:
    """No velocity gives NaN, and a deflection within the static range never leaves it."""
    low, high = -47.0 / ELEMENT.c0, 32.0 / ELEMENT.c0
    z, torque = elasto_plastic_step(COMPILED, break_away, part * high if part > 0 else -part * low, velocity, step)
    assert math.isfinite(torque)
    assert low * (1 + 1e-12) <= z <= high * (1 + 1e-12)
