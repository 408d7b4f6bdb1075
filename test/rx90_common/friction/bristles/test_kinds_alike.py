"""What holds for every kind of bristles: sticking, sliding, energy, order of the step, and what tells them apart."""

import math
from itertools import pairwise

import numpy as np
import pytest
from bristle_oracles import ElastoPlasticOracle, MaxwellSlipOracle, swing
from signed_element import ELEMENT

from benchmarks.bristles import driven_mass, led
from rx90_common.base.arrays import Array
from rx90_common.friction import FrictionElement
from rx90_common.friction.compiled_elements import prescribed_torque
from rx90_common.friction.parts.bristles import BristlesPart, ElastoPlastic, MaxwellSlip

FLAT = FrictionElement(tau_c=25.0, tau_s=25.0, omega_s=0.05, delta=1.0, c0=1e5, c1=100.0, c2=0.0)
ELASTIC = ElastoPlastic(break_away=0.7)
BLOCKS = MaxwellSlip(stiffness=(0.5, 0.3, 0.2), share=(0.2, 0.3, 0.5), attraction=2000.0)
KINDS = {"LuGre": None, "elasto-plastic": ELASTIC, "Maxwell slip": BLOCKS}
STEP = 2.5e-4
each_kind = pytest.mark.parametrize("bristles", KINDS.values(), ids=KINDS.keys())


@each_kind
def test_at_rest_the_bristles_keep_every_bit(bristles: BristlesPart | None) -> None:
    """After any motion, rest leaves torque and stored energy as they were to the last bit, however long."""
    rng = np.random.default_rng(4)
    for scale in (1e-3, 0.1, 3.0):
        velocity = np.concatenate([scale * rng.standard_normal(50), np.zeros(50)])
        torque, stored = led(ELEMENT.replaced(bristles=bristles), velocity, STEP)
        assert np.unique(stored[49:]).size == 1
        assert np.unique(torque[50:]).size == 1
        assert abs(torque[-1]) > 1e-3


@each_kind
def test_no_kind_creates_energy(bristles: BristlesPart | None) -> None:
    """In 10^4 random cycles, with any viscous exponent, no step takes more work out than the bristles had stored."""
    rng = np.random.default_rng(5)
    for step, alpha in ((STEP, 1.0), (1e-2, 1.0), (STEP, 0.3), (1e-3, 2.0)):
        size = 10.0 ** rng.uniform(-6.0, 0.7, (10_000, 2, 1)) * np.array([[[1.0], [-1.0]]])  # a reversal in each cycle
        velocity = (size * 10.0 ** rng.uniform(-1.5, 0.0, (10_000, 2, 4))).ravel()
        torque, stored = led(ELEMENT.replaced(bristles=bristles, alpha=alpha), velocity, step)
        dissipated = torque * velocity * step - np.diff(stored, prepend=0.0)
        assert np.all(dissipated >= -1e-12 * (np.abs(torque * velocity * step) + stored))
        assert np.sum(dissipated) > 0.0


@each_kind
def test_prescribed_motion_has_the_torque_of_the_kind(bristles: BristlesPart | None) -> None:
    """What predicts torques along a measured motion has each kind's bristles, step by step."""
    element, velocity = ELEMENT.replaced(bristles=bristles), np.random.default_rng(9).standard_normal(200)
    torque = prescribed_torque((element,), velocity[:, None], np.full(200, STEP))[:, 0]
    assert torque == pytest.approx(led(element, velocity, STEP)[0], rel=1e-12)


def order_on_a_mass(element: FrictionElement, bristles: ElastoPlastic | MaxwellSlip) -> tuple[float, Array]:
    """Return the order of the plant's step on a mass that reverses, sticks and slips, and the errors, rad, rad/s."""

    def force(t: float) -> float:
        return 45.0 * math.sin(60.0 * t) + 6.0 * math.sin(171.0 * t)

    end, inertia, start, counts = 0.25, 1.5, 0.2, np.array([500, 1000, 2000, 4000, 8000])
    oracle: ElastoPlasticOracle | MaxwellSlipOracle
    if isinstance(bristles, ElastoPlastic):
        oracle = ElastoPlasticOracle(element, bristles.break_away)
    else:
        parts = np.array([bristles.stiffness, bristles.share])
        oracle = MaxwellSlipOracle(element, *parts, bristles.attraction)
    x, v, turns = swing(oracle, inertia, force, end, start)
    assert turns >= 3
    errors = []
    for steps in counts:
        h = end / steps
        middle = np.array([force((k + 0.5) * h) for k in range(steps)])
        motion = driven_mass(element.replaced(bristles=bristles), inertia, middle, h, start)
        errors.append([abs(motion.position[-1] - x), abs(motion.velocity[-1] - v)])
    # Where in a step a reversal falls changes the constant of the error from one step size to the next.
    return float(-np.polyfit(np.log(counts), np.log(np.array(errors)), 1)[0].mean()), np.array(errors)


def test_elasto_plastic_is_second_order_on_a_mass() -> None:
    """Against a solver with located kinks the error falls fourfold when the step is halved."""
    order, errors = order_on_a_mass(ELEMENT.replaced(tau_s={"positive": 28.0, "negative": 36.0}), ELASTIC)
    assert order == pytest.approx(2.0, abs=0.3)
    assert errors[0][0] < 2e-5


def test_maxwell_slip_is_second_order_on_a_mass_where_the_sliding_curve_is_flat() -> None:
    """With a Stribeck effect a block begins to slip at the torque of the middle of the step: first order."""
    order, errors = order_on_a_mass(FLAT.replaced(c2=14.0), BLOCKS)
    assert order == pytest.approx(2.0, abs=0.3)
    assert errors[0][0] < 2e-5
    order, errors = order_on_a_mass(ELEMENT.replaced(tau_s={"positive": 28.0, "negative": 36.0}), BLOCKS)
    assert order > 0.9
    assert errors[0][0] < 2e-5


def presliding_drift(bristles: BristlesPart | None, low: float, high: float, cycles: int) -> Array:
    """Return by how much each cycle of a load between two parts of the Coulomb torque moves a mass, rad."""
    per_cycle = 2000
    phase = (np.arange(cycles * per_cycle) + 0.5) / per_cycle
    load = 25.0 * (0.5 * (high + low) - 0.5 * (high - low) * np.cos(2.0 * math.pi * phase))
    ramp = 25.0 * low * np.linspace(0.0, 1.0, per_cycle)
    position = driven_mass(FLAT.replaced(bristles=bristles), 0.2, np.concatenate([ramp, load]), 2e-4).position
    return np.diff(position[per_cycle - 1 :: per_cycle])


def test_only_lugre_drifts_below_break_away() -> None:
    """Under a load that oscillates below break-away LuGre's bristle walks by the closed-form way in each cycle.

    Quasi-statically dz/dx = 1 - z/g forwards, 1 + z/g backwards: a cycle between parts l and h of the Coulomb torque
    leaves g ln((1 - l^2) / (1 - h^2)). An elasto-plastic bristle is elastic there, and Maxwell slip's loop closes.
    """
    low, high, g = 0.2, 0.6, 25.0 / 1e5
    lugre = presliding_drift(None, low, high, 12)
    assert np.mean(lugre[2:]) == pytest.approx(g * math.log((1.0 - low**2) / (1.0 - high**2)), rel=2e-3)
    assert np.max(np.abs(presliding_drift(ELASTIC, low, high, 12)[2:])) < 1e-9 * g
    assert np.max(np.abs(presliding_drift(BLOCKS, low, high, 12)[2:])) < 1e-9 * g
    # Above break-away the elasto-plastic bristle drifts, too.
    assert presliding_drift(ElastoPlastic(break_away=0.5), low, high, 6)[-1] > 1e-3 * g


def play(reach: float, path: Array) -> Array:
    """Return the play operator of a path that starts at 0: its output moves only where the input pushes it."""
    output, place = [], 0.0
    for x in path:
        place = max(x - reach, min(x + reach, place))
        output.append(place)
    return np.array(output)


def test_maxwell_slip_is_the_prandtl_operator_in_presliding() -> None:
    """With a flat sliding curve the blocks are stops side by side, whatever the velocity: closed form by plays."""
    rng = np.random.default_rng(6)
    turning = np.concatenate([[0.0], rng.uniform(-1e-3, 1e-3, 60)])
    velocity = np.concatenate([np.full(7, (b - a) / 7) for a, b in pairwise(turning)]) / STEP
    still = np.zeros((velocity.size, 2))
    still[:, 0] = velocity  # at rest after each step the torque is that of the deflections
    torque, _ = led(FLAT.replaced(c1=0.0, bristles=BLOCKS), still.ravel(), STEP)
    path = np.cumsum(velocity) * STEP
    expected = np.zeros(path.size)
    for stiffness, share in zip(BLOCKS.stiffness, BLOCKS.share, strict=True):
        expected += stiffness * 1e5 * (path - play(share * 25.0 / (stiffness * 1e5), path))
    np.testing.assert_allclose(torque[1::2], expected, atol=1e-10)
