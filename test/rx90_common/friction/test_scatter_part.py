"""The scatter: statistics of the walk, its seed, its bound."""

import numpy as np
import pytest
from parted_joint import Record, Seven, any_element
from scipy.stats import kstest, norm

from rx90_common.base.arrays import Array
from rx90_common.friction.parts.scatter import BOUND, ScatterPart, advance_scatter
from rx90_common.kernels.compiled import kernel
from rx90_common.kernels.lanes import load

PERIOD = 2.5e-4


@kernel
def walk(parts: Record, states: Record, every: int, factors: Array) -> None:
    """Write the factors of the seven elements every so many ticks, shape (n, 7)."""
    for k in range(len(factors)):
        for _ in range(every):
            advance_scatter(parts[0], states[0], load(states[0].transmitted, 7), PERIOD, 7)
        for i in range(7):
            factors[k, i] = states[0].scatter.factor[i]


def factors_of(part: ScatterPart, seed: int, count: int, every: int = 1) -> Array:
    element = any_element(np.random.default_rng(0), scatter=part)
    seven = Seven.of([element] * 7, PERIOD, seed)
    factors = np.empty((count, 7))
    walk(seven.parts, seven.states, every, factors)
    return (factors - 1.0) / part.deviation


def test_variance_and_autocorrelation() -> None:
    """The walk has mean 0, the variance of a normal variable within its bound, and forgets as exp(-lag / time)."""
    time, every = 0.05, 20
    # 300 s of seven walks: 6,000 correlation times each
    x = factors_of(ScatterPart(deviation=0.1, correlation_time=time), 1, 60_000, every)
    lag = every * PERIOD
    independent = x.size * lag / (2.0 * time)  # of the mean
    assert abs(x.mean()) < 4.0 / np.sqrt(independent)
    bounded = norm.expect(lambda v: np.clip(v, -BOUND, BOUND) ** 2)
    assert (x**2).mean() == pytest.approx(bounded, abs=4.0 * np.sqrt(2.0 / (2.0 * independent)))
    for steps in (1, 5, 10, 30):
        found = (x[steps:] * x[:-steps]).mean() / (x**2).mean()
        assert found == pytest.approx(np.exp(-steps * lag / time), abs=4.0 / np.sqrt(independent))
    # Samples that are apart by six correlation times are independent, and normal.
    assert kstest(x[:: int(6 * time / lag)].ravel(), "norm").pvalue > 0.01


def test_the_tick_does_not_enter() -> None:
    """The decay over a tick is exp(-tick / time), and the kick keeps the variance at 1, for any tick."""
    for period in (1e-4, 1e-3, 0.05):
        for time in (0.01, 3.0, 1e5):
            element = any_element(np.random.default_rng(0), scatter=ScatterPart(deviation=0.1, correlation_time=time))
            scatter = Seven.of([element] * 7, period).parts["scatter"][0]
            assert scatter["decay"] == pytest.approx(np.exp(-period / time), rel=1e-15)
            assert scatter["kick"] == pytest.approx(np.sqrt(-np.expm1(-2.0 * period / time)), rel=1e-14)


def test_the_start_is_drawn_from_what_the_walk_keeps() -> None:
    """Over 300 seeds the first factors are normal with deviation 1; elements and seeds differ."""
    starts = np.array(
        [factors_of(ScatterPart(deviation=0.05, correlation_time=1e6), seed, 1)[0] for seed in range(300)]
    )
    assert kstest(starts.ravel(), "norm").pvalue > 0.01
    assert len(np.unique(starts)) == starts.size
    assert np.abs(np.corrcoef(starts.T) - np.eye(7)).max() < 4.0 / np.sqrt(300)


def splitmix(state: int) -> tuple[int, int]:
    """Return the next state and output of SplitMix64, as published, in whole numbers without bound."""
    mask = 2**64 - 1
    state = (state + 0x9E3779B97F4A7C15) & mask
    word = state
    word = ((word ^ (word >> 30)) * 0xBF58476D1CE4E5B9) & mask
    word = ((word ^ (word >> 27)) * 0x94D049BB133111EB) & mask
    return state, word ^ (word >> 31)


def test_the_random_numbers_are_splitmix64() -> None:
    """From the counter that an element begins with, its walk is that of SplitMix64's published numbers."""
    state, outputs = 1234567, []
    for _ in range(3):
        state, word = splitmix(state)
        outputs.append(word)
    assert outputs == [6457827717110365317, 3203168211198807973, 9817491932198370423]  # of the reference implementation
    part = ScatterPart(deviation=0.1, correlation_time=0.5)
    seven = Seven.of([any_element(np.random.default_rng(0), scatter=part)] * 7, PERIOD, 3)
    counter, x = int(seven.states["scatter"]["counter"][0, 2]), float(seven.states["scatter"]["walk"][0, 2])
    factors = np.empty((5, 7))
    walk(seven.parts, seven.states, 1, factors)
    decay = np.exp(-PERIOD / 0.5)
    for factor in factors[:, 2]:
        counter, word = splitmix(counter)
        total = sum((word >> (16 * k)) & 0xFFFF for k in range(4))
        x = decay * x + np.sqrt(1 - decay**2) * (total - 2 * 65535) / np.sqrt((2**32 - 1) / 3)
        assert factor == pytest.approx(1.0 + 0.1 * x, rel=1e-13)


def test_the_walk_stays_within_its_bound() -> None:
    """However far the walk goes, the factor leaves 1 - 4 deviations of the friction, and 1 + 4 at most."""
    part = ScatterPart(deviation=0.2, correlation_time=0.01)
    seven = Seven.of([any_element(np.random.default_rng(0), scatter=part)] * 7, PERIOD, 3)
    factors = np.empty((1, 7))
    for far, want in ((50.0, 1.8), (-50.0, 0.2)):
        seven.states["scatter"]["walk"][:] = far
        walk(seven.parts, seven.states, 1, factors)
        assert factors == pytest.approx(np.full((1, 7), want), rel=1e-14)
    assert part.least_factor == pytest.approx(0.2)
