"""The steps of elasto-plastic bristles and Maxwell-slip blocks: exact at constant velocity, numbers for every one."""

import math
from typing import Any

import numpy as np
import pytest
from bristle_oracles import ElastoPlasticOracle, MaxwellSlipOracle, random_element
from hypothesis import given, settings
from hypothesis import strategies as st
from lugre_oracle import one_element
from signed_element import ELEMENT

from rx90_common.friction import FrictionElement
from rx90_common.friction.compiled_elements import bristles_dtype, element_arrays
from rx90_common.friction.elasto_plastic import elasto_plastic_step, elasto_plastic_torque
from rx90_common.friction.maxwell_slip import MAX_BLOCKS, maxwell_slip_step, maxwell_slip_torque
from rx90_common.friction.parts.bristles import MaxwellSlip, fill_bristles

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


@given(
    velocity=st.floats(-1e6, 1e6) | st.sampled_from([0.0, -0.0, 5e-324, -1e-300, 1e-300]),
    part=st.floats(-1.0, 1.0),
    step=st.floats(1e-9, 0.1),
    break_away=st.floats(0.0, 0.9),
)
@settings(max_examples=120)
def test_every_velocity_keeps_the_bristle_s_range(velocity: float, part: float, step: float, break_away: float) -> None:
    """No velocity gives NaN, and a deflection within the static range never leaves it."""
    low, high = -47.0 / ELEMENT.c0, 32.0 / ELEMENT.c0
    z, torque = elasto_plastic_step(COMPILED, break_away, part * high if part > 0 else -part * low, velocity, step)
    assert math.isfinite(torque)
    assert low * (1 + 1e-12) <= z <= high * (1 + 1e-12)


BLOCKS = MaxwellSlip(stiffness=(0.5, 0.3, 0.2), share=(0.2, 0.3, 0.5), attraction=2000.0)


def record_of(blocks: MaxwellSlip) -> Any:
    record = np.zeros(1, bristles_dtype(1))
    fill_bristles(record[0], 0, blocks)
    return record[0]["blocks"]


@pytest.mark.parametrize("seed", range(50))
def test_a_step_of_blocks_at_constant_velocity_is_exact(seed: int) -> None:
    """Deflections and mean torque are those of a solver with located events: stick, slip and what bounds it."""
    rng = np.random.default_rng(seed)
    element, count = random_element(rng), int(rng.integers(1, 6))
    stiffness, share = rng.dirichlet(np.full(count, 3.0), 2)
    blocks = MaxwellSlip(stiffness=tuple(stiffness), share=tuple(share), attraction=10.0 ** rng.uniform(2.0, 4.0))
    oracle = MaxwellSlipOracle(element, stiffness, share, blocks.attraction)
    compiled, arrays = one_element(element_arrays((element,))[0], 0), record_of(blocks)
    state, forces = np.zeros((2, MAX_BLOCKS)), np.zeros(count)
    for sign in (1.0, 1.0, 1.0, -1.0, -1.0, 1.0):
        velocity, step = sign * 10.0 ** rng.uniform(-2.5, 0.7), 10.0 ** rng.uniform(-4.0, -2.2)
        forces, exact = oracle.hold(forces, velocity, step)
        z, torque = maxwell_slip_step(compiled, arrays, 0, state, velocity, step)
        limit = 1e-11 * element.tau_s.positive
        np.testing.assert_allclose(state[0, :count] * stiffness * element.c0, forces, atol=limit)
        assert z * element.c0 == pytest.approx(np.sum(forces), abs=limit)
        assert torque == pytest.approx(exact, abs=2.0 * limit)
        now = maxwell_slip_torque(compiled, arrays, 0, state, velocity)
        assert now == pytest.approx(oracle.torque(forces, velocity), rel=1e-9)


def test_a_slipping_block_that_moves_as_a_stuck_one_still_slips() -> None:
    """Slow steps in which the attraction asks for more than the velocity make no block stick: faster, it slips on."""
    arrays, state, forces = record_of(BLOCKS), np.zeros((2, MAX_BLOCKS)), np.zeros(3)
    oracle = MaxwellSlipOracle(ELEMENT, np.array(BLOCKS.stiffness), np.array(BLOCKS.share), BLOCKS.attraction)
    moved = []
    for velocity, step in ((1.0, 0.05), (1e-3, 1e-3), (2e-3, 2e-3), (0.05, 2e-3), (0.01, 1e-3)):
        before = state[0, :3].copy()
        forces, exact = oracle.hold(forces, velocity, step)
        assert maxwell_slip_step(COMPILED, arrays, 0, state, velocity, step)[1] == pytest.approx(exact, rel=1e-10)
        np.testing.assert_allclose(state[0, :3] * BLOCKS.stiffness * ELEMENT.c0, forces, atol=1e-10)
        moved.append((state[0, :3] - before) / (velocity * step))
    assert moved[1] == pytest.approx(np.ones(3))  # as stuck ones
    assert np.all(moved[3] < 0.99)


@given(
    velocities=st.lists(st.floats(-1e6, 1e6) | st.sampled_from([0.0, 5e-324, -1e-300]), min_size=1, max_size=8),
    step=st.floats(1e-9, 0.1),
    attraction=st.floats(1e-6, 1e12),
)
@settings(max_examples=100)
def test_any_history_keeps_blocks_within_their_range(velocities: list[float], step: float, attraction: float) -> None:
    """No history gives NaN or a block beyond its share of the static torque."""
    arrays = record_of(MaxwellSlip(stiffness=BLOCKS.stiffness, share=BLOCKS.share, attraction=attraction))
    state = np.zeros((2, MAX_BLOCKS))
    for velocity in velocities:
        z, torque = maxwell_slip_step(COMPILED, arrays, 0, state, velocity, step)
        assert math.isfinite(torque)
        assert math.isfinite(maxwell_slip_torque(COMPILED, arrays, 0, state, velocity))
        forces = 1e5 * state[0, :3] * BLOCKS.stiffness
        assert np.all(np.abs(forces) <= np.multiply(BLOCKS.share, 47.0 * (1.0 + 1e-12)))
        assert abs(z) <= 47.0 / 1e5 * (1.0 + 1e-12)


def test_the_bound_of_c1_is_sharp() -> None:
    """A block that slips with the torque that takes least power dissipates below the bound and creates above it."""
    one = MaxwellSlip(stiffness=(1.0,), share=(1.0,), attraction=5e4)
    arrays, speed = record_of(one), 2.0
    tau, attracted = 25.0, one.attraction / 1e5
    beyond = 1.0 + math.sqrt(speed / attracted)
    bound = tau * float(one.passivity_factor(1e5, speed)) / speed
    for c1, created in ((0.99 * bound, False), (1.01 * bound, True)):
        element = FrictionElement(tau_c=tau, tau_s=20.0 * tau, omega_s=1e-3, delta=1.0, c0=1e5, c1=c1, c2=0.0)
        compiled, step = one_element(element_arrays((element,))[0], 0), 1e-9
        state = np.zeros((2, MAX_BLOCKS))
        state[0, 0], state[1, 0] = z0, _ = beyond * tau / 1e5, 1.0
        z, torque = maxwell_slip_step(compiled, arrays, 0, state, speed, step)
        dissipated = torque * speed * step - 0.5e5 * (z - z0) * (z + z0)
        assert (dissipated < 0.0) == created
