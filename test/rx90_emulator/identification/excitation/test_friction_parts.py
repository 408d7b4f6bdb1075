"""Friction's parts from excitation runs, on two joints whose motion and torque are written down here."""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.integrate import solve_ivp
from scipy.signal import lfilter

from benchmarks.random_arms import FrictionLaw
from rx90_emulator.identification.arm import RigidArm, joint_groups
from rx90_emulator.identification.estimates import PARAMETERS, ElementEstimate, ParameterEstimate
from rx90_emulator.identification.excitation.choice import PartKey, Scored, Selection, TimeBlocks, left_out
from rx90_emulator.identification.excitation.filtering import Bandwidths, FilteredRun, filter_record, recording_notes
from rx90_emulator.identification.excitation.final_fit import FinalFit, blur_shifts, bounded_covariance
from rx90_emulator.identification.excitation.fit import SeparableFit, WeightedProblem, fit_shapes, nonnegative
from rx90_emulator.identification.excitation.friction import FrictionSelection, identify_friction_parts
from rx90_emulator.identification.excitation.law import ElementMotion, ElementShape, Part, element_rows
from rx90_emulator.identification.excitation.problem import ExcitationProblem
from rx90_emulator.identification.excitation.result import simulated_elements
from rx90_emulator.identification.records import BagSource, JointRecord

pytestmark = pytest.mark.slow

Array = NDArray[np.float64]
Law = Callable[[Array], Array]
RATE, SECONDS, NOISE = 100.0, 40.0, 0.05
A, B, C = 1.5, 0.4, 0.5  # kg m^2: planar arm, M = [[A + 2 C cos q2, B + C cos q2], [B + C cos q2, B]]
URDF = """<robot name="planar"><link name="base"/>
<joint name="one" type="continuous"><parent link="base"/><child link="a"/><axis xyz="0 0 1"/></joint>
<link name="a"><inertial><mass value="2"/><inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial></link>
<joint name="two" type="continuous"><origin xyz="0.5 0 0"/>
<parent link="a"/><child link="b"/><axis xyz="0 0 1"/></joint>
<link name="b"><inertial><mass value="1"/><inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial></link>
</robot>"""


def power_law(tau_c: float, c2: float, alpha: float, up: float = 0.0) -> Law:
    """Return friction that grows as |v|^alpha; for v > 0 its Coulomb torque is `up` more, for v < 0 less."""
    return lambda v: np.sign(v) * (tau_c + c2 * np.abs(v) ** alpha) + np.where(v != 0.0, up, 0.0)


def stribeck(tau_c: float, tau_s: float, omega_s: float, c2: float) -> Law:
    """Return friction with a Stribeck rise, delta = 1."""
    return lambda v: np.sign(v) * (tau_c + (tau_s - tau_c) * np.exp(-np.abs(v) / omega_s)) + c2 * v


def record(laws: tuple[Law, Law], seed: int = 0, load: float = 0.0, noise: float = NOISE) -> JointRecord:
    """Return a run of random Fourier series; Coulomb friction of joint one may grow with the load."""
    rng = np.random.default_rng(seed)
    time = np.arange(0.0, SECONDS, 1.0 / RATE)[:, None]
    q, v, a = np.zeros((3, len(time), 2))
    for k in range(2, 14):
        rate, phase = 2.0 * np.pi * 0.025 * k, rng.uniform(0.0, 2.0 * np.pi, 2)
        size = rng.uniform(0.2, 0.6, 2)
        q += size / rate * np.sin(rate * time + phase)
        v += size * np.cos(rate * time + phase)
        a -= size * rate * np.sin(rate * time + phase)
    c, s = C * np.cos(q[:, 1]), C * np.sin(q[:, 1])
    first = (A + 2.0 * c) * a[:, 0] + (B + c) * a[:, 1] - s * (2.0 * v[:, 0] + v[:, 1]) * v[:, 1]
    bare = np.column_stack([first, (B + c) * a[:, 0] + B * a[:, 1] + s * v[:, 0] ** 2])
    friction = np.column_stack([law(column) for law, column in zip(laws, v.T, strict=True)])
    friction[:, 0] += load * np.abs(bare[:, 0]) * np.sign(v[:, 0])
    torque = bare + friction + noise * rng.normal(size=q.shape)
    return JointRecord(("one", "two"), time[:, 0], q, v, torque, Path(f"run_{seed}"), str(seed))


@pytest.fixture(scope="module")
def arm(tmp_path_factory: pytest.TempPathFactory) -> RigidArm:
    """Return the arm's kinematics."""
    urdf = tmp_path_factory.mktemp("arm") / "arm.urdf"
    urdf.write_text(URDF)
    return RigidArm.from_urdf(urdf)


def problem_of(arm: RigidArm, *records: JointRecord) -> ExcitationProblem:
    """Return the equations of runs."""
    return ExcitationProblem.of(arm, [run for one in records for run in filter_record(one, Bandwidths(20.0, 10.0))])


def weighted_of(problem: ExcitationProblem, weight: float | Array = 1.0) -> WeightedProblem:
    """Return the equations with weights."""
    return WeightedProblem.of(problem, element_rows(problem), np.broadcast_to(weight, len(problem)))


def selected(weighted: WeightedProblem, fit: SeparableFit, *refused: PartKey) -> Any:
    """Return a fit as a selection leaves it that has refused some parts."""
    return SimpleNamespace(weighted=weighted, fit=fit, refused=dict.fromkeys(refused, ""))


LAWS = (power_law(3.0, 2.0, 0.7), power_law(1.0, 0.8, 1.0))


@pytest.fixture(scope="module")
def selection(arm: RigidArm) -> FrictionSelection:
    """Return what two runs tell of an element with an exponent and one without."""
    return identify_friction_parts(problem_of(arm, record(LAWS, 1), record(LAWS, 2)))


def held(selection: FrictionSelection, element: int, **truth: float) -> None:
    """Assert that values lie within three of their deviations, and that these say something."""
    for name, value in truth.items():
        found = selection.elements[element].parameters[name]
        assert abs(found.value - value) < 3.0 * found.deviation, name
        assert found.deviation < 0.2 * value, name


def test_an_exponent_is_found_where_there_is_one(selection: FrictionSelection) -> None:
    """The exponent comes out within 0.05, its part is kept on its element alone, and no Stribeck rise is claimed."""
    assert selection.parts == (frozenset({Part.EXPONENT}), frozenset())
    assert selection.elements[0].parameters["alpha"].value == pytest.approx(0.7, abs=0.05)
    held(selection, 0, tau_c_positive=3.0, tau_c_negative=3.0, c2=2.0, alpha=0.7)
    held(selection, 1, tau_c_positive=1.0, c2=0.8, alpha=1.0)
    for estimate in selection.elements:
        for name in ("tau_s_positive", "omega_s", "delta", "c0", "c1"):
            assert not estimate.parameters[name].identifiable
            assert estimate.parameters[name].reason
    kept = [row for row in selection.models if row.kept]
    assert [row.name for row in kept] == ["Coulomb + viscous", "+ viscous exponent: one"]
    assert kept[1].by_blocks.gain > kept[1].by_blocks.gain_deviation > 0.0
    assert kept[1].by_runs is not None
    assert np.isfinite(selection.fit.value).all()


def test_a_curve_has_the_band_of_its_parameters(selection: FrictionSelection) -> None:
    """The curve is the law's, and its deviation that of laws drawn from the covariance."""
    one = selection.fitted[0]
    curve = one.curve()
    truth = LAWS[0](curve.velocity)
    assert np.mean((curve.band[0] < truth) & (truth < curve.band[1])) > 0.95
    names = ["tau_c", "c2", "c1", "alpha"]
    center = np.array([one.linear[0], one.linear[1], 0.0, one.shape.alpha])
    drawn = np.random.default_rng(0).multivariate_normal(center, one.covariance[: len(names), : len(names)], 4000)
    torques = [power_law(tau_c, c2, alpha)(curve.velocity) for tau_c, c2, _, alpha in drawn]
    assert np.std(torques, axis=0) == pytest.approx(curve.deviation, rel=0.05)


def along(law: FrictionLaw) -> Law:
    """Return a law with a bristle along the runs of this file."""
    time = np.arange(0.0, SECONDS, 1.0 / RATE)
    return lambda v: law.torque(time, v)


BRISTLE = FrictionLaw((2.0, 2.0), c2=1.5, rise=0.5, omega_s=0.1, c0=500.0, c1=0.5)


def test_a_rise_is_found_beside_a_bristle_that_nobody_asked_for(arm: RigidArm) -> None:
    """Static torque, Stribeck velocity and stiffness come out within their deviations; no other element gets a rise."""
    laws = (along(BRISTLE), LAWS[1])
    selection = identify_friction_parts(problem_of(arm, record(laws, 4), record(laws, 5)))
    assert {Part.STRIBECK, Part.BRISTLE} <= selection.parts[0]
    assert Part.STRIBECK not in selection.parts[1]
    found = selection.elements[0].parameters
    for name, value in {"tau_c_positive": 2.0, "tau_s_positive": 3.0, "omega_s": 0.1, "c0": 500.0}.items():
        assert abs(found[name].value - value) < 3.0 * found[name].deviation, name
        assert found[name].deviation < 0.3 * value, name


@pytest.mark.parametrize(("distance", "found"), [(20e-3, True), (5e-4, False)])
def test_a_slow_log_has_the_bristles_that_outlast_its_samples(arm: RigidArm, distance: float, found: bool) -> None:
    """At 20 samples per second a bristle that breaks away after 20 mrad has a true c0, one after 0.5 mrad none."""
    law = FrictionLaw((2.0, 2.0), c2=1.5, c0=2.0 / distance)
    slow = [
        replace(one, **{name: getattr(one, name)[::5] for name in ("time", "position", "velocity", "torque")})
        for one in (record((along(law), LAWS[1]), seed) for seed in (4, 5))
    ]
    runs = [run for one in slow for run in filter_record(one, Bandwidths(6.0, 2.0))]
    assert all("such as stiff bristles (c0, c1)" in note for note in recording_notes(slow, runs[0].bandwidths))
    c0 = identify_friction_parts(ExcitationProblem.of(arm, runs), (Part.BRISTLE,)).elements[0].parameters["c0"]
    assert c0.identifiable == found
    if found:
        assert abs(c0.value - law.c0) < 2.0 * c0.deviation < 0.6 * law.c0


def test_a_blurred_motion_widens_what_depends_on_it(arm: RigidArm) -> None:
    """Without noise, stiffness and rise are off by what the filter takes, and what a second blur shifts is as much."""
    problem = problem_of(arm, record((along(BRISTLE), LAWS[1]), 4, noise=0.0))
    weighted = weighted_of(problem)
    parts = frozenset({Part.STRIBECK, Part.BRISTLE, Part.DAMPING})
    true = ElementShape(parts, rise=0.5, omega_s=0.1, stiffness=250.0)
    fit = fit_shapes(weighted, [true, ElementShape()])
    columns = weighted.tangent(fit, fit.inner())
    shifts = np.linalg.norm(blur_shifts(weighted, fit, columns), axis=0)[len(problem.names) :]
    found = dict(zip(true.free, fit.shapes[0].values - true.values, strict=True))
    for name in ("rise", "omega_s", "stiffness"):
        assert 1e-4 < abs(found[name]) < 2.0 * shifts[fit.inner().index((0, name))], name
    plain = fit_shapes(weighted, [ElementShape(), ElementShape()], ())
    assert blur_shifts(weighted, plain, weighted.tangent(plain, plain.inner())) == []


def test_a_bristle_without_its_damping_has_the_deviation_of_what_it_hides(arm: RigidArm) -> None:
    """Where damping is left out, the stiffness is off by more than its deviation, and the widened one reaches it."""
    damped = replace(BRISTLE, rise=0.0, c0=200.0, c1=3.0)
    weighted = weighted_of(problem_of(arm, record((along(damped), LAWS[1]), 4)), 1.0 / NOISE)
    fit = fit_shapes(weighted, [ElementShape(frozenset({Part.BRISTLE}), stiffness=100.0), ElementShape()])
    tried = selected(weighted, fit, (0, Part.DAMPING))
    final, without = FinalFit(tried, ()), FinalFit(selected(weighted, fit), ())
    place = len(weighted.problem.names) + final.inner.index((0, "stiffness"))
    off = fit.shapes[0].values[0] + final.fit.value[place] - np.log(damped.c0 / damped.coulomb)
    assert 3.0 * without.fit.deviation[place] < abs(off) < 1.96 * final.fit.deviation[place]


def test_a_rise_that_may_be_there_lies_between_bounds() -> None:
    """The covariance is that of the same draws, less those of which a rise is negative or more than tau_c."""
    root = np.array([[1.0, 0.0, 0.0], [0.3, 0.5, 0.0], [0.8, -0.4, 1.2]])
    covariance = root @ root.T
    value, deviation = -0.6, float(np.sqrt(covariance[2, 2]))
    drawn = np.random.default_rng(0).multivariate_normal([0.0, 0.0, value], covariance, 400_000)
    kept = drawn[(drawn[:, 2] >= 0.0) & (drawn[:, 2] <= 1.0)]
    # The values that are written are those for a rise of 0: conditional means of the draws there.
    kept[:, :2] += covariance[:2, 2] / covariance[2, 2] * value
    assert bounded_covariance(covariance, [(value, deviation)], [1.0]) == pytest.approx(
        kept[:, :2].T @ kept[:, :2] / len(kept), abs=0.01
    )


def test_asymmetry_is_told_to_be_an_offset(arm: RigidArm) -> None:
    """Of unequal directions the mean comes out, and it is said which offset holds half their difference."""
    laws = (power_law(3.0, 2.0, 1.0, up=0.5), LAWS[1])
    selection = identify_friction_parts(problem_of(arm, record(laws, 6)), ())
    held(selection, 0, tau_c_positive=3.0, tau_c_negative=3.0)
    (said,) = (remark for remark in selection.remarks if remark.startswith("one: "))
    assert "mean of both directions" in said
    assert float(said.split("joint, ")[1].split(" Nm")[0]) == pytest.approx(0.5, abs=0.05)


def test_load_dependent_friction_widens_the_deviation(arm: RigidArm) -> None:
    """Where friction grows with the load, a remark says so, and the interval of tau_c still holds that without load."""
    laws = (power_law(3.0, 2.0, 1.0), LAWS[1])
    selection = identify_friction_parts(problem_of(arm, record(laws, 7, load=0.2)), ())
    assert any("changes with the load" in remark for remark in selection.remarks)
    found = selection.elements[0].parameters["tau_c_positive"]
    assert found.value > 3.05
    low, high = found.bounds
    assert low < 3.0 < high


def test_a_bristle_follows_its_differential_equation() -> None:
    """Deflection, rate and derivative by the stiffness are those of SciPy's solution, with a Stribeck rise."""
    step, stiffness, rise, omega_s = 1e-4, 300.0, 0.5, 0.2
    time = np.arange(0.0, 0.5, step)

    def speed(t: Any) -> Any:
        return 0.6 * np.sin(9.0 * t)

    def limit(v: Any) -> Any:
        return 1.0 + rise * np.exp(-np.abs(v) / omega_s)

    def solved(sigma: float) -> Array:
        answer = solve_ivp(
            lambda t, u: sigma * (speed(t) - abs(speed(t)) * u / limit(speed(t))),
            (0.0, 0.5), [0.0], "LSODA", time, rtol=1e-7, atol=1e-8,
        )  # fmt: skip
        return np.asarray(answer.y[0])

    shape = ElementShape(
        frozenset({Part.STRIBECK, Part.BRISTLE, Part.DAMPING}), rise=rise, omega_s=omega_s, stiffness=stiffness
    )
    position = 0.6 / 9.0 * (1.0 - np.cos(9.0 * time))
    motion = [values[:, None] for values in (position, speed(time), time, time, speed(time))]
    run = FilteredRun(BagSource(Path("run"), "", 0.5, 0, 0), ("one",), time, *motion, None, Bandwidths(20.0, 10.0))
    columns = ElementMotion.of(run, np.ones(1)).columns(shape)
    u, inner = solved(stiffness), slice(10, -10)
    assert columns[0][inner] == pytest.approx(u[inner], abs=2e-3)
    rate = speed(time) - np.abs(speed(time)) * u / limit(speed(time))
    assert columns[2][inner] == pytest.approx(rate[inner], abs=2e-3)
    by_stiffness = (solved(stiffness * 1.01) - solved(stiffness / 1.01)) / (2.0 * np.log(1.01))
    of_stiffness = columns[3 * (1 + shape.free.index("stiffness"))]
    assert of_stiffness[inner] == pytest.approx(by_stiffness[inner], abs=5e-3)


@pytest.fixture(scope="module")
def weighted(arm: RigidArm) -> WeightedProblem:
    """Return the equations of a run with weights that differ."""
    problem = problem_of(arm, record(LAWS, 8))
    return weighted_of(problem, np.random.default_rng(1).uniform(5.0, 20.0, len(problem)))


def test_a_block_is_predicted_by_a_fit_without_it(weighted: WeightedProblem) -> None:
    """The residuals of a block are those of a least-squares fit that has not seen it nor its neighbours."""
    fit = fit_shapes(weighted, [ElementShape(), ElementShape()])
    residual, tangent = weighted.linearised(fit)
    time = TimeBlocks.of(weighted.problem, residual)
    left = left_out(residual, tangent, time.folds)
    friction = np.zeros((len(weighted.weight), 4))
    for e, rows in enumerate(weighted.elements):
        friction[rows.rows, 2 * e : 2 * e + 2] = rows.columns(ElementShape())[:, :2]
    columns = np.hstack([weighted.problem.regressor, friction]) * weighted.weight[:, None]
    target = weighted.problem.torque * weighted.weight
    assert 8 <= time.count <= 60
    when, apart = weighted.problem.time, time.correlation_time
    for rows, near in time.folds[::3]:
        within = (when > when[rows].min() - apart) & (when < when[rows].max() + apart)
        assert np.array_equal(near, np.flatnonzero(within))
        assert len(near) > len(rows)
        seen = np.setdiff1d(np.arange(len(target)), near)
        value = np.linalg.lstsq(columns[seen], target[seen])[0]
        assert left[rows] == pytest.approx(target[rows] - columns[rows] @ value, abs=1e-6)


def test_blocks_are_long_against_the_correlation_and_hold_all_repetitions(arm: RigidArm) -> None:
    """The time in which residuals fade is that of their autoregression, (1 + r) / (1 - r) rows."""
    whole = record(LAWS, 8)
    late = {name: getattr(whole, name)[400:] for name in ("time", "position", "velocity", "torque")}
    problem = problem_of(arm, whole, replace(whole, **late), record(LAWS, 9))
    rng, r = np.random.default_rng(0), 0.5
    residual = 0.1 * rng.normal(size=len(problem))
    for run in range(3):
        rows = (problem.run == run) & (problem.joint == 0)
        residual[rows] = lfilter([1.0], [1.0, -r], rng.normal(size=rows.sum()))
    time = TimeBlocks.of(problem, residual)
    row = problem.runs[0].down / problem.runs[0].rate
    assert time.correlation_time == pytest.approx(row * (1.0 + r) / (1.0 - r), rel=0.4)
    assert time.length == pytest.approx(2.0 * SECONDS / 60.0, rel=0.1)
    first, again, other = (problem.run == run for run in range(3))
    shared = first & (problem.time > problem.time[again].min() - 1e-9)
    assert np.mean(time.block[shared] == time.block[again]) > 0.99  # at a border rounding decides
    assert not set(time.block[first]) & set(time.block[other])
    for rows, near in time.folds:
        assert len({*problem.run[rows], *problem.run[near]} & {0, 2}) == 1


def test_elements_are_one_group_by_way_of_others() -> None:
    """Of a chain of elements that share a joint each with the next, and one alone, two groups come out."""
    acts = np.array([[1.0, 1, 0, 0, 0], [0, 1, 1, 0, 0], [0, 0, 1, 1, 0], [0, 0, 0, 0, 1]])
    groups = joint_groups(SimpleNamespace(element_matrix=acts))
    assert [group.elements for group in groups] == [(0, 1, 2), (3,)]


def test_a_gain_is_judged_by_paired_blocks(weighted: WeightedProblem) -> None:
    """By blocks a gain beyond its standard error is better, by runs no loss beyond it; no model is than itself."""
    plain = fit_shapes(weighted, [ElementShape(), ElementShape()])
    free = fit_shapes(weighted, [ElementShape(frozenset({Part.EXPONENT})), ElementShape()])
    time = TimeBlocks.of(weighted.problem, weighted.linearised(plain)[0])
    small, large = (Scored.of(weighted, fit, time) for fit in (plain, free))
    assert large.better_than(small)
    assert not small.better_than(large)
    assert not small.better_than(small)
    assert "the error falls by" in large.verdict(small)
    assert "the error rises by" in small.verdict(large)
    assert list(large.validations(small)) == ["blocks"]
    rows = np.bincount(time.block)
    uneven = np.where(np.arange(len(rows)) % 2, 0.9, 1.1) * rows  # a standard error of some percent
    even, at = uneven * rows.sum() / uneven.sum(), large.held_out["blocks"]
    for loss, accepted in ((0.0, True), (0.002, True), (0.2, False)):
        worse = replace(large, held_out={"blocks": at, "runs": (rows * (1.0 + loss), 0.0)})
        assert worse.better_than(replace(small, held_out={**small.held_out, "runs": (even, 0.0)})) is accepted
    for gain, better in ((0.002, False), (0.2, True)):  # by blocks, with the same standard error
        other = replace(large, held_out={"blocks": (rows * (1.0 - gain), 0.0)})
        assert other.better_than(replace(small, held_out={"blocks": (even, 0.0)})) is better


RISING = (stribeck(2.0, 3.0, 0.1, 1.5), LAWS[1])


@pytest.mark.parametrize(("laws", "noise", "open_ones"), [(RISING, 1.5, {0}), (LAWS, 0.0, set())])
def test_a_rise_that_may_be_there_widens_the_deviations(
    arm: RigidArm, laws: tuple[Law, Law], noise: float, open_ones: set[int]
) -> None:
    """In noise a rise of a half, left out, is free in the covariance; on clean data none is, and nothing widens."""
    one = record(laws, 10)
    noisy = replace(one, torque=one.torque + noise * np.random.default_rng(3).normal(size=one.torque.shape))
    weighted = weighted_of(problem_of(arm, noisy), 1.0 / np.hypot(NOISE, noise))
    exponent = ElementShape(frozenset({Part.EXPONENT}), alpha=0.8)
    fit = fit_shapes(weighted, [exponent, ElementShape()])
    tried = selected(weighted, fit, (0, Part.STRIBECK))
    parts, coulomb = (Part.EXPONENT, Part.STRIBECK), len(weighted.problem.names)
    final, without = FinalFit(tried, parts), FinalFit(selected(weighted, fit), parts)
    assert set(final.rises) == open_ones
    factor = final.fit.deviation[coulomb] / without.fit.deviation[coulomb]
    assert (factor > 1.1) if open_ones else (factor == 1.0)
    for value, deviation in final.rises.values():
        assert abs(value - 0.5) < 3.0 * deviation


def test_an_exponent_left_at_1_has_the_deviation_of_what_it_hides(weighted: WeightedProblem) -> None:
    """Where an exponent of 0.7 is left out, the intervals of alpha and tau_c reach the true values."""
    fit = fit_shapes(weighted, [ElementShape(), ElementShape()])
    final = FinalFit(selected(weighted, fit), (Part.EXPONENT,))
    for key, true in {(0, "alpha"): 0.7, (0, "tau_c"): 3.0}.items():
        place = len(weighted.problem.names) + final.inner.index(key)
        found = 1.0 if key[1] == "alpha" else final.fit.value[place]
        assert abs(found - true) < 1.96 * final.fit.deviation[place]


def test_a_column_of_mere_rounding_gets_no_share() -> None:
    """A column that the regressor explains, whose square rounding makes negative, is 0 beside one that is fitted."""
    gram = np.array([[4.0, 1e-16], [1e-16, -1e-15]])
    assert nonnegative(gram, np.array([2.0, 1e-9])) == pytest.approx([0.5, 0.0])
    tangent = np.column_stack([np.full(4, 0.5), np.zeros(4)])
    left = left_out(np.arange(4.0), tangent, [(np.array([3]), np.array([3]))])
    assert left[3] == pytest.approx(2.0)  # 3 less the mean of 0, 1 and 2
    assert nonnegative(-1e-9 * np.eye(2), np.ones(2)) == pytest.approx([0.0, 0.0])


def test_friction_that_falls_with_speed_is_said(arm: RigidArm) -> None:
    """Where c2 ends at 0 because friction falls, slope and tau_c without that bound are said; tau_c reaches it."""
    falling: Law = lambda v: np.sign(v) * (3.0 - 0.6 * np.abs(v))  # noqa: E731
    found = identify_friction_parts(problem_of(arm, record((falling, LAWS[1]), 1)), (), fixed=True)
    (text,) = found.warnings
    value, deviation, tau_c, written = map(
        float, re.findall(r"c2 would be (\S+) \+- (\S+) Nm s/rad and tau_c (\S+) in place of (\S+) Nm", text)[0]
    )
    assert text.startswith("the friction of one falls with speed")
    assert abs(value + 0.6) < 3.0 * deviation < 0.3
    assert tau_c == pytest.approx(3.0, abs=0.15)
    estimates = found.elements[0].parameters
    assert written == pytest.approx(estimates["tau_c_positive"].value, abs=0.01)
    assert abs(3.0 - estimates["tau_c_positive"].value) < 1.96 * estimates["tau_c_positive"].deviation
    assert "without its bound 0 it would be -0." in estimates["c2"].reason


def test_a_bristle_needs_coulomb_torque(arm: RigidArm) -> None:
    """An element without Coulomb torque gets no bristle, even asked for, nor a c0 of 0; the reasons say so."""
    laws = (power_law(-0.2, 2.0, 1.0), LAWS[1])  # 0 is the best value
    found = identify_friction_parts(problem_of(arm, record(laws, 1)), (Part.BRISTLE,), fixed=True)
    values = found.elements[0].parameters
    assert found.parts[0] == frozenset()
    assert not values["c0"].identifiable
    assert "beside it no Coulomb torque of one shows" in values["c0"].reason
    (free,) = re.findall(r"without its bound 0 it would be (\S+)", values["tau_c_positive"].reason)
    assert float(free) == pytest.approx(-0.2, abs=0.02)
    (element, _) = simulated_elements(found.elements, None)
    assert element.element.c0 > 0.0
    assert element.element.c2 == pytest.approx(1.8, abs=0.2)


@pytest.mark.parametrize("fixed", [False, True])
def test_an_exponent_that_is_nearly_coulomb_torque_is_not_kept(arm: RigidArm, fixed: bool) -> None:
    """In noise |v|^0.3 is not told from Coulomb torque: the exponent goes, with that reason, unless a person asked."""
    one = record((power_law(0.3, 2.0, 0.3), LAWS[1]), 3)
    noisy = replace(one, torque=one.torque + np.random.default_rng(2).normal(size=one.torque.shape))
    search = Selection(problem_of(arm, noisy), (Part.EXPONENT,), fixed=fixed)
    near = ElementShape(frozenset({Part.EXPONENT}), alpha=0.3)
    fit = fit_shapes(search.weighted, [near, ElementShape()], ())
    assert fit.at_bound == (frozenset(), frozenset())
    model = search.within_bounds(Scored.of(search.weighted, fit, search.blocks), Part.EXPONENT)
    assert (Part.EXPONENT in model.fit.shapes[0].parts) is fixed
    if not fixed:
        assert "is within 2 deviations of the bound of its range" in search.refused[0, Part.EXPONENT]


@pytest.mark.parametrize(
    "told", [{}, {"c0": 2e5}, {"c0": 2e4, "c1": 30.0}, {"c1": 5e3}], ids=lambda told: " ".join(told) or "none"
)
def test_an_assumed_fading_keeps_elements_passive(told: dict[str, float]) -> None:
    """Whether c0 and c1 are identified or assumed, omega_d, which nothing tells, leaves no speed that gives energy."""
    reason = ParameterEstimate.unknown("not told")
    values = {"tau_c_positive": 1.2, "tau_c_negative": 0.9, "c2": 0.1, **told}
    known = dict.fromkeys(PARAMETERS, reason) | {name: ParameterEstimate(one, 0.0) for name, one in values.items()}
    (one,) = simulated_elements([ElementEstimate("hinge", known, np.eye(len(known)), ())], None)
    assert {name: one.element.parameters[name] for name in told} == told
    assert one.element.passivity_limit(1e3) == np.inf
    assert one.element.omega_d <= 1.0
    other = one.element.replaced(c1=4.0, omega_d=2.0)  # of a fallback, whose own c1 fades as it does there
    (beside,) = simulated_elements([ElementEstimate("hinge", known, np.eye(len(known)), ())], [other])
    if "c1" in told:
        assert beside.element.passivity_limit(1e3) == np.inf
    else:
        assert (beside.element.c1, beside.element.omega_d) == (4.0, 2.0)
