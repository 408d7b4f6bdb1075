"""Fits, deviations and choices of laws on synthetic rows whose truth is known."""

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.optimize import least_squares
from scipy.stats import t

from rx90_common.base.arrays import Array
from rx90_common.estimation.choose import Gain, choose, held_out_squares, needed_errors
from rx90_common.estimation.deviations import deviations, law_deviations
from rx90_common.estimation.elements import FrictionRows, SteadyRows, fit_laws
from rx90_common.estimation.fit import Problem, fit
from rx90_common.estimation.law import Law, Part, Speeds
from rx90_common.friction import FrictionElement

STRIBECK = Law(frozenset({Part.STRIBECK}))
FULL = Law(frozenset(Part), signed=True)
SPEEDS = np.geomspace(0.01, 2.0, 14)


def sweeps(
    elements: Sequence[FrictionElement], seed: int = 1, noise: float = 0.02, common: float = 0.05, blocks: int = 4
) -> FrictionRows:
    """Return rows of elements that slide at plateaus of constant velocity, which have a common error each."""
    rng = np.random.default_rng(seed)
    velocity = np.concatenate([-SPEEDS, SPEEDS])
    plateau = np.repeat(np.arange(len(velocity)), blocks)
    parts = []
    for e, element in enumerate(elements):
        torque = element.steady_torque(velocity) + common * rng.normal(size=len(velocity))
        parts.append((torque[plateau] + noise * rng.normal(size=len(plateau)), e))
    count = len(plateau)
    target = np.concatenate([torque for torque, _ in parts])
    group = np.repeat(np.arange(len(elements)), count)
    tilt = np.sin(3.0 * np.arange(len(target)))[:, None]
    limits = Speeds(SPEEDS[0], SPEEDS[-1])
    rows = [
        SteadyRows(np.flatnonzero(group == e), velocity[plateau], np.ones(count), limits) for e in range(len(elements))
    ]
    block = np.tile(plateau, len(elements)) + len(velocity) * group
    return FrictionRows(target + 2.0 * tilt[:, 0], tilt, rows, group, block, np.empty((0, tilt.shape[1])))


def element(**changes: float) -> FrictionElement:
    numbers = {"tau_c": 5.0, "tau_s": 6.5, "omega_s": 0.1, "delta": 1.0, "c0": 1e5, "c1": 10.0, "c2": 3.0}
    return FrictionElement.of({**numbers, **changes})


def test_fit_is_that_of_scipy_without_elimination() -> None:
    """All parameters in one least-squares problem give the same values and cost."""
    rows = sweeps([element()], blocks=1)
    weight = np.random.default_rng(3).uniform(0.5, 2.0, len(rows.target))
    result = fit_laws(rows, [STRIBECK], weight)
    velocity = np.concatenate([-SPEEDS, SPEEDS])

    def residual(x: Array) -> Array:
        tau_c, rise, c2, omega_s, offset = x
        torque = np.sign(velocity) * (tau_c + rise * np.exp(-np.abs(velocity) / np.exp(omega_s))) + c2 * velocity
        return np.asarray(np.sqrt(weight) * (rows.target - torque - offset * rows.linear[:, 0]))

    direct = least_squares(residual, [5.0, 1.0, 3.0, np.log(0.1), 0.0], xtol=1e-12, ftol=1e-12)
    np.testing.assert_allclose([*result.x, *result.linear], direct.x, rtol=1e-4)
    assert result.cost == pytest.approx(2.0 * direct.cost, rel=1e-6)


def test_outliers_and_noisy_groups_hardly_count() -> None:
    """A row in forty that is far out moves no value by a half percent."""
    rows = sweeps([element(), element(tau_c=1.0, tau_s=1.2)], noise=0.01, common=0.0)
    rows.target[::37] += 40.0
    laws = [STRIBECK, STRIBECK]
    x = fit_laws(rows, laws).x
    assert STRIBECK.natural(x[:4])[0]["tau_c_positive"] == pytest.approx(5.0, abs=0.02)
    assert STRIBECK.natural(x[4:])[0]["tau_c_negative"] == pytest.approx(1.0, abs=0.02)


def linear_problem(rng: np.random.Generator, blocks: int, in_block: int, columns: int = 4) -> Problem:
    number = np.repeat(np.arange(blocks), in_block)
    matrix = rng.normal(size=(len(number), columns)) + rng.normal(size=(blocks, columns))[number]
    target = rng.normal(size=len(number)) + rng.normal(size=blocks)[number]
    empty = np.empty(0)
    return Problem(
        target=target,
        linear=matrix,
        model=lambda _: (np.zeros(len(number)), np.empty((len(number), 0))),
        start=empty,
        lower=empty,
        upper=empty,
        group=np.zeros(len(number), dtype=np.intp),
        block=number,
        prior=np.empty((0, columns)),
        spread=empty,
    )


def test_deviations_are_the_jackknifes_with_student() -> None:
    """The covariance is that of the formula with full matrices."""
    problem = linear_problem(np.random.default_rng(5), 9, 6)
    result = fit(problem, np.ones(54))
    inverse = np.linalg.inv(problem.linear.T @ problem.linear)
    middle = np.zeros((4, 4))
    for k in range(9):
        own = problem.linear[problem.block == k]
        adjusted = np.linalg.inv(np.eye(6) - own @ inverse @ own.T)
        score = own.T @ adjusted @ result.residual[problem.block == k]
        middle += np.outer(score, score)
    factor = t.ppf(0.975, 8) / 1.959963984540054
    np.testing.assert_allclose(deviations(result).covariance, inverse @ middle @ inverse * factor**2, rtol=1e-8)


def test_unknown_and_bound_parameters_have_no_deviation() -> None:
    """Friction that falls holds c2 at 0; an empty column is not determined."""
    rows = sweeps([element()])
    linear = np.hstack([rows.linear, np.zeros((len(rows.target), 1))])
    rows = replace(rows, linear=linear, prior=np.empty((0, linear.shape[1])))
    falling = replace(rows, target=rows.target - 6.0 * np.repeat(np.concatenate([-SPEEDS, SPEEDS]), 4))
    result = fit_laws(falling, [Law()])
    known = deviations(result)
    assert result.at_bound.tolist() == [False, True]
    assert known.determined.tolist() == [True, False, True, False]
    assert np.isinf(known.deviation[[1, 3]]).all()


def test_intervals_hold_the_truth() -> None:
    """Intervals of 95 % hold it in 95 % of fits to plateaus with common errors."""
    truth = element(delta=1.0)
    names = ("tau_c_positive", "tau_s_positive", "c2", "omega_s")
    inside = []
    for seed in range(120):
        result = fit_laws(sweeps([truth], seed), [STRIBECK], known=[{"omega_s": np.log(0.1)}])
        values, slopes = STRIBECK.natural(result.x)
        covariance = slopes @ deviations(result).covariance[:4, :4] @ slopes.T
        size = dict(zip(values, np.sqrt(np.diag(covariance)), strict=True))
        inside += [abs(values[name] - truth.parameters[name]) < 1.96 * size[name] for name in names]
    assert 0.92 < np.mean(inside) < 0.98


def test_intervals_know_of_parts_that_were_left_out() -> None:
    """An exponent of 0.98 that the law lacks is in tau_c and c2: their intervals hold only if they allow for one."""
    truth = element(tau_s=5.0, alpha=0.98)
    inside = []
    for seed in range(60):
        rows = sweeps([truth], seed)
        result = fit_laws(rows, [Law()])
        known = deviations(result), law_deviations(rows, [Law()], result, [Part.STRIBECK, Part.EXPONENT])
        inside.append([np.abs(result.x - [5.0, 3.0]) < 1.96 * one.deviation[:2] for one in known])
    without, share = np.mean(inside, axis=(0, 2))
    assert without < 0.8
    assert share > 0.92


def test_curve_is_the_elements_and_its_slopes_are_differences() -> None:
    """The law is that of FrictionElement."""
    x = np.array([5.0, 4.0, 1.0, 2.0, 3.0, 10.0, np.log(0.1), np.log(1.3), np.log(0.8), np.log(2e4)])
    velocity = np.concatenate([-SPEEDS, SPEEDS])
    torque, slopes = FULL.curve(velocity, x)
    here = FULL.element(x, {})
    np.testing.assert_allclose(torque, here.steady_torque(velocity), rtol=1e-12)
    assert here.c0 == pytest.approx(2e4 * 4.5)
    values, jacobian = FULL.natural(x)
    for k in range(len(x)):
        step = 1e-6 * np.eye(len(x))[k]
        difference = (FULL.curve(velocity, x + step)[0] - FULL.curve(velocity, x - step)[0]) / 2e-6
        np.testing.assert_allclose(slopes[:, k], difference, atol=1e-7)
        higher = np.array([*FULL.natural(x + step)[0].values()])
        np.testing.assert_allclose(jacobian[:, k], (higher - [*values.values()]) / 1e-6, rtol=1e-4, atol=1e-4)


def test_bristle_is_the_solution_of_the_differential_equation() -> None:
    """The deflected bristle is SciPy's solution of equation 17."""
    law = Law(frozenset({Part.STRIBECK, Part.BRISTLE}))
    x = np.array([5.0, 1.0, 3.0, 8.0, np.log(0.1), np.log(400.0)])
    step = 1e-4
    time = step * np.arange(4000)
    velocity = 0.3 * np.sin(2.0 * np.pi * 5.0 * time)
    here = law.element(x, {})

    def rate(now: Any, z: Any) -> Any:
        v = 0.3 * np.sin(2.0 * np.pi * 5.0 * (now - 0.5 * step))
        return v - here.c0 * abs(v) / here.sliding_torque(v) * z

    z = solve_ivp(rate, (0.0, time[-1] + step), [0.0], t_eval=time + 0.5 * step, rtol=1e-8, atol=1e-12, max_step=1e-3)
    expected = here.c0 * z.y[0] + here.c1 * np.array([rate(now, q) for now, q in zip(z.t, z.y[0], strict=True)])
    torque, slopes = law.along(velocity, step, x)
    np.testing.assert_allclose(torque, expected, atol=0.02)
    assert np.ptp(torque) > 9.0
    moved = x + 1e-4 * np.eye(6)[5]
    np.testing.assert_allclose(slopes[:, 5], (law.along(velocity, step, moved)[0] - torque) / 1e-4, atol=1e-6)


def test_held_out_errors_are_those_of_refits() -> None:
    """Leaving out blocks in one step is exact for a linear problem."""
    problem = linear_problem(np.random.default_rng(7), 6, 5)
    squares = held_out_squares(fit(problem, np.ones(30)))
    for k in range(6):
        inside = problem.block == k
        value = np.linalg.lstsq(problem.linear[~inside], problem.target[~inside], rcond=None)[0]
        np.testing.assert_allclose(squares[inside], (problem.target - problem.linear @ value)[inside] ** 2, rtol=1e-8)


def test_each_element_gets_the_parts_that_it_has() -> None:
    """Also where friction falls up to the top speed."""
    plain = element(tau_s=5.0)
    truths = [plain, element(), element(tau_s=5.0, alpha=0.6), element(tau_c=1.0, tau_s=3.0, omega_s=1.5, c2=0.0)]
    rows = sweeps(truths, noise=0.005, common=0.005)
    chosen = choose(rows, [Part.STRIBECK, Part.EXPONENT, Part.STRIBECK_EXPONENT], [Law()] * 4)
    parts = [law.parts for law in chosen.laws]
    assert Part.STRIBECK in parts[1]
    assert Part.STRIBECK in parts[3]
    assert Part.EXPONENT in parts[2]
    assert parts[0] == frozenset()
    place = 0
    for law, truth in zip(chosen.laws, truths, strict=True):
        fitted = law.element(chosen.fit.x[place : place + len(law.names)], {"c0": 1e5, "c1": 1.0})
        np.testing.assert_allclose(fitted.steady_torque(SPEEDS), truth.steady_torque(SPEEDS), rtol=0.02, atol=0.01)
        place += len(law.names)


@pytest.mark.parametrize("seed", [2, 7, 8])
def test_evidence_for_an_exponent_is_that_of_the_whole_arm(seed: int) -> None:
    """Little shows in an element that has it; it gets it beside others that have it, but not beside others without."""
    weak = element(tau_s=5.0, c2=0.1, alpha=0.6)
    for alpha, expected in ((0.6, frozenset({Part.EXPONENT})), (1.0, frozenset())):
        strong = element(tau_s=5.0, alpha=alpha)
        rows = sweeps([strong, strong, weak], seed, noise=0.01, common=0.02)
        chosen = choose(rows, [Part.EXPONENT], [Law()] * 3)
        assert chosen.laws[2].parts == expected


def test_a_gain_at_a_bound_or_within_its_errors_is_not_kept() -> None:
    """However clear it is, and whatever all elements together gain."""
    assert Gain(0.03, 0.02).kept
    assert not Gain(0.03, 0.02, "alpha", together=True).kept
    assert not Gain(0.03, 0.02, errors=2.0).kept


def test_a_bristle_beside_rise_and_exponent_needs_one_standard_error() -> None:
    """Two are for the rise and the exponent, which imitate each other."""
    rise, both = frozenset({Part.STRIBECK}), frozenset({Part.STRIBECK, Part.EXPONENT})
    assert needed_errors(rise, both) == needed_errors(frozenset(), both) == 2.0
    assert needed_errors(both, both | {Part.BRISTLE}) == needed_errors(frozenset(), rise) == 1.0


@pytest.mark.parametrize("seed", [2, 3, 16, 23])
def test_a_rise_does_not_stand_in_for_an_exponent(seed: int) -> None:
    """Elements with an exponent and common errors of plateaus, on which a rise imitates it, get no rise."""
    rows = sweeps([element(tau_s=5.0, alpha=0.7)] * 3, seed, noise=0.01, common=0.05, blocks=3)
    chosen = choose(rows, [Part.STRIBECK, Part.EXPONENT], [Law()] * 3)
    assert not any(Part.STRIBECK in law.parts for law in chosen.laws)
