"""Known friction in, known friction out; no number where the data carry none; and the comparison with the models."""

import itertools
import math
from collections import defaultdict
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from rig_bench import greeted
from scipy.integrate import solve_ivp
from scipy.linalg import solve_triangular

from benchmarks.friction_ramp import QuickRig, random_rig, truth_of
from friction_bench.experiment.identification import evaluate, identify_ramps, joint_friction, source_formulas
from friction_bench.experiment.job import plan_from, run_ramp
from friction_bench.experiment.ramp_rows import Errors, whiten
from friction_bench.experiment.record import (
    RampModel,
    RampRecord,
    RecordError,
    SlidingWindow,
    read_csv,
    read_text,
    sliding_window,
    write_csv,
)
from friction_bench.experiment.sliding_fit import find_bends, fit_sliding
from friction_bench.rig.plant import shaft_of
from friction_bench.rig.rig_file import Rig, load_rig
from rx90_common.base.arrays import Array
from rx90_common.base.errors import IdentificationError
from rx90_common.base.share import SOURCE_RIG, config_path

TICK = 0.02
STEP = math.tau / 504
MODEL = RampModel(coulomb=0.05, viscous=0.02, inertia=3e-3, slope=0.05)


def ideal_record(model: RampModel, duration: float, **changes: Any) -> RampRecord:
    time = np.arange(0.0, duration, TICK)
    angle = np.floor(model.angle(time) / STEP + 0.5) * STEP
    return RampRecord(**{"time": time, "angle": angle, "slope": model.slope, "angle_step": STEP, **changes})


def bent(record: RampRecord, left: float, **changes: Any) -> RampRecord:
    """Return a ramp whose velocity rises half-way on by a part of what it did."""
    speed = np.diff(record.angle, prepend=0.0)
    half = record.time.size // 2
    speed[half:] = speed[half] + left * (speed[half:] - speed[half])
    return replace(record, angle=np.cumsum(speed), **changes)


def own(rig: Rig, coulomb: float, viscous: float, inertia: float) -> Rig:
    """Return the rig with this friction and inertia at the motor, without a load."""
    load = (inertia - rig.emulation.motor.rotor_inertia) * rig.gear.ratio**2 * rig.gear.efficiency
    return rig.replaced(emulation={"motor_friction": {"coulomb": coulomb, "viscous": viscous}, "load_inertia": load})


def quiet(rig: Rig) -> Rig:
    return rig.replaced(emulation={"amplifier": {"gain_error": 0.0, "torque_noise": 0.0, "adc_noise": 0.0}})


def measure(rig: Rig, seed: int, repeats: int, slopes: tuple[float, ...], end: float = 0.15, loaded: bool = False):
    client = greeted(rig, seed, loaded)
    return [run_ramp(client, slope, end, loaded, f"{slope} {k}") for k in range(repeats) for slope in slopes]


def test_source_figures_come_out() -> None:
    """The source's asymptotes give its f_c and f_v, and 0.231 - 0.147 = 0.084 Nm, where 0.147 is f_c + f_v."""
    fc, fv = source_formulas(949.5407, 227.8898, 0.61)
    loaded, viscous = source_formulas(981.3603, 412.1713, 0.55)
    assert fc == pytest.approx(0.1464, abs=5e-5)
    assert (fv, viscous) == pytest.approx((6.4e-4, 5.6e-4), abs=5e-6)
    assert (round(loaded, 3), round(fc + fv, 3), round(loaded - fc - fv, 3)) == (0.231, 0.147, 0.084)


def test_release_is_the_solution_of_equation_3() -> None:
    """With static friction above f_c the closed form is what a solver makes of a shaft that starts at break-away."""
    model = RampModel(coulomb=0.05, viscous=8e-4, inertia=6e-5, slope=0.03, release=0.01)
    time = model.break_away_time + np.linspace(0.0, 1.0, 20)

    def derivative(t: float, y: Array) -> list[float]:
        return [y[1], (0.03 * t - 0.05 - 8e-4 * y[1]) / 6e-5]

    exact = solve_ivp(derivative, (time[0], time[-1]), [0.0, 0.0], "LSODA", time, rtol=1e-10, atol=1e-12).y
    assert model.break_away_time == pytest.approx(2.0)
    assert model.angle(time) == pytest.approx(exact[0], rel=1e-6, abs=1e-8)
    assert model.velocity(time) == pytest.approx(exact[1], rel=1e-6, abs=1e-8)


def integrated_ou_covariance(time: Array, T: float) -> Array:
    """Return the covariance of an integrated Ornstein-Uhlenbeck process of unit intensity from rest at 0, (n, n)."""
    s, gap = np.minimum.outer(time, time), np.abs(np.subtract.outer(time, time))
    far = np.exp(-gap / T)
    return s + T * np.expm1(-s / T) - T * (far - np.exp(-(s + gap) / T)) + T / 2 * (far - np.exp(-(2 * s + gap) / T))


def slow_start(time: Array, T: float) -> Array:
    """Return the angle of a shaft from rest whose velocity goes to 1, each shape (n,)."""
    after = np.maximum(time, 0.0)
    return after + T * np.expm1(-after / T)


def test_rows_and_estimates_of_a_ramp_are_those_of_generalised_least_squares() -> None:
    """By dense algebra at uneven times, V = r I + q K, K of an inertia that white noise drives, under a step."""
    rng = np.random.default_rng(1)
    time = np.cumsum(rng.uniform(0.01, 0.05, 60))
    T, q, r, spread = 0.08, 3e-3, 1.3e-5, np.array([0.4, 0.7])
    torque = np.where(np.arange(60) < 20, 1.0, 1.5)
    run = time - time[0]
    V = r * np.eye(60) + q * integrated_ou_covariance(run, T)
    columns = rng.standard_normal((3, 60))
    white, determinant = whiten(time, columns, T, q, r)
    L = np.linalg.cholesky(V)
    assert white == pytest.approx(solve_triangular(L, columns.T, lower=True).T, rel=1e-6, abs=1e-6)
    assert determinant == pytest.approx(np.linalg.slogdet(V)[1], rel=1e-9)
    by_alpha = slow_start(run, T) + 0.5 * slow_start(run - run[20], T)
    start = np.column_stack((np.ones(60), run - slow_start(run, T)))
    own = np.column_stack((by_alpha, -slow_start(run, T)))
    errors = Errors(T, q, r, spread)
    rows = errors.rows(SlidingWindow(None, time, np.zeros(60), torque), columns)
    loose = np.linalg.inv(V + own @ np.diag(spread**2) @ own.T)
    information = loose - loose @ start @ np.linalg.solve(start.T @ loose @ start, start.T @ loose)
    assert rows @ rows.T == pytest.approx(columns @ information @ columns.T, rel=1e-6)
    alone = errors.alone(time, torque, columns[0])
    X = np.column_stack((own, start))
    covariance = np.linalg.inv(X.T @ np.linalg.solve(V, X))
    change = covariance @ X.T @ np.linalg.solve(V, columns[0])
    left = columns[0] - X @ change
    misfit = np.linalg.slogdet(V)[1] - np.linalg.slogdet(covariance)[1] + left @ np.linalg.solve(V, left)
    assert alone.covariance == pytest.approx(covariance, rel=1e-6)
    assert alone.change == pytest.approx(change, rel=1e-6)
    assert alone.misfit == pytest.approx(misfit, rel=1e-9)


GRID = [
    # f_c, f_v, J, slopes, end torque
    (0.070, 8.0e-4, 6.3e-5, (0.02, 0.05), 0.16),
    (0.020, 6.0e-4, 4.0e-5, (0.03, 0.06), 0.14),
    (0.100, 5.0e-4, 3.0e-5, (0.015, 0.03), 0.17),
]
SEEDS = 8


def test_estimates_and_their_intervals_are_right_and_the_source_s_is_high_by_inertia(rig: Rig) -> None:
    """In each cell f_c and f_v are within 1 % in the mean, the source's f_c but for J a; 90 % of intervals hold."""
    hits, scores = defaultdict(list), defaultdict(list)
    for cell, (fc, fv, inertia, slopes, end) in enumerate(GRID):
        results = []
        for seed in range(SEEDS):
            quick = QuickRig(own(rig, fc, fv, inertia), 1000 * cell + seed)
            records = [quick.ramp(slope, end, False, f"{slope} {k}") for k in range(3) for slope in slopes]
            results.append(identify_ramps(records, rig.torque.scale_uncertainty))
        excess = np.mean([found.source.coulomb.value - fc for found in results])
        expected = np.mean([inertia * ramp.slope / fv for ramp in results[0].ramps])
        assert excess == pytest.approx(expected, abs=0.01 * fc)
        for name, truth, estimates in (
            ("f_c", fc, [found.exact.coulomb for found in results]),
            ("f_v", fv, [found.exact.viscous for found in results]),
            ("source's f_v", fv, [found.source.viscous for found in results]),
        ):
            hits[name] += [one.low <= truth <= one.high for one in estimates]
            scores[name] += [(one.value - truth) / one.error for one in estimates]
            if name != "source's f_v":
                assert abs(np.mean([one.value / truth - 1 for one in estimates])) < 0.01, (name, truth)
    assert min(map(np.mean, hits.values())) >= 0.9
    spreads = {name: np.sqrt(np.mean(np.square(values))) for name, values in scores.items()}
    assert min(spreads.values()) > 0.6
    assert max(spreads["f_c"], spreads["f_v"]) < 1.3


@pytest.mark.parametrize("kind", ["Coulomb-viscous", "LuGre"])
def test_intervals_hold_whatever_the_release(kind: str) -> None:
    """On random rigs the true f_c, f_v and J lie in most 95 % intervals and within 4.5 standard uncertainties."""
    deviations = []
    for number in range(6):
        rig = random_rig(1, number, kind)
        quick = QuickRig(rig, number)
        records = [quick.ramp(slope, 0.16, True, f"{slope} {k}") for k in range(3) for slope in (0.02, 0.05)]
        best = identify_ramps(records, rig.torque.scale_uncertainty).best
        for estimate, truth in zip((best.coulomb, best.viscous, best.inertia), truth_of(rig, True), strict=True):
            deviations.append((estimate.value - truth) / estimate.error)
            assert estimate.error < 0.15 * truth
    assert np.abs(deviations).max() < 4.5
    assert np.mean(np.abs(deviations) < 1.96) >= 14 / 18


@pytest.mark.parametrize("kind", ["Coulomb-viscous", "LuGre"])
def test_quick_ramps_are_those_of_the_rig_with_its_firmware(kind: str) -> None:
    """Without noise the compiled ramp gives the readings of the real firmware on the emulated rig, to one count."""
    rig = quiet(random_rig(1, 2, kind))
    (record,) = measure(rig, 0, 1, (0.05,), loaded=True)
    fast = QuickRig(rig, 0).ramp(0.05, 0.15, True, "quick")
    assert fast.torque == pytest.approx(record.torque)
    assert np.abs(fast.angle - record.angle).max() <= 1.01 * record.angle_step


def test_joint_friction_is_the_difference_and_carries_its_scale(rig: Rig) -> None:
    """f_joint is right within 3 standard uncertainties; a common scale error does not widen it twice."""
    records = [record for loaded in (False, True) for record in measure(rig, 5, 3, (0.02, 0.05), 0.155, loaded)]
    result = evaluate(records, rig.replaced(gear={"efficiency_uncertainty": 0.0}))
    (_, unloaded), (_, loaded) = result.parts
    joint, friction = result.joint, rig.emulation.joint
    assert joint == joint_friction(unloaded, loaded, rig.replaced(gear={"efficiency_uncertainty": 0.0}))
    for estimate, truth in zip(joint[2:], (friction.coulomb, friction.viscous), strict=True):
        assert estimate.value == pytest.approx(truth, abs=3 * estimate.error)
        assert estimate.error < 0.01 * truth
    assert joint.coulomb.error < math.hypot(unloaded.best.coulomb.error, loaded.best.coulomb.error)


def test_intervals_contain_what_differs_from_ramp_to_ramp() -> None:
    """On the source's rig most 95 % intervals hold f_c, f_v and J; without what differs by ramps half would."""
    rig = load_rig(config_path(SOURCE_RIG))
    truth, hits, spreads = truth_of(rig, True), [], []
    for seed in range(5):
        quick = QuickRig(rig, seed)
        records = [quick.ramp(slope, 1.65, True, f"{slope} {k}") for k in range(4) for slope in (0.25, 0.61)]
        fit = fit_sliding([sliding_window(record) for record in records])
        deviations = np.hypot(np.sqrt(np.diag(fit.covariance)), rig.torque.scale_uncertainty * fit.values)
        hits += (np.abs(fit.values - truth) < 1.96 * deviations).tolist()
        spreads.append(fit.spread)
    assert np.mean(hits) >= 13 / 15
    assert np.median(spreads, axis=0) == pytest.approx((0.02, 0.05 * (truth[0] - 0.1462) / truth[0]), rel=0.35)


@pytest.mark.parametrize("velocity", [4.0, 4.7, 5.5, 16.0])
def test_stribeck_velocity_of_any_size_is_held(velocity: float) -> None:
    """A solver's ramps, any w_s, e = 1.25: f_c, f_v within 3 deviations, and 0.1 %; the effect is no bend."""
    coulomb, viscous, inertia, left = 0.05, 1e-3, 6e-5, 0.02
    windows = []
    for slope in (0.02, 0.05):
        time = np.arange(0.0, 0.1 / slope, TICK)  # from where the torque is f_c and delta_s
        torque = coulomb + left + slope * (time + TICK)
        angle, state = [0.0], np.zeros(2)
        for held in torque[:-1]:

            def motion(_: float, y: Array, held: float = held) -> list[float]:
                rise = left * math.exp(-((max(y[1], 0.0) / velocity) ** 1.25))
                return [y[1], (held - coulomb - rise - viscous * y[1]) / inertia]

            state = solve_ivp(motion, (0.0, TICK), state, rtol=1e-9, atol=1e-10).y[:, -1]
            angle.append(state[0])
        step = math.tau / 10000
        record = RampRecord(time, np.round(np.array(angle) / step) * step, slope, step, torque)
        window = np.flatnonzero(record.angle > 0.1)
        windows.append(SlidingWindow(record, time[window], record.angle[window], torque[window]))
    assert find_bends(windows) == [None, None]
    fit = fit_sliding(windows)
    errors = np.sqrt(np.diag(fit.covariance))
    assert np.abs((fit.values - [coulomb, viscous, inertia]) / errors)[:2].max() < 3.0
    assert fit.values[:2] == pytest.approx((coulomb, viscous), rel=1e-3)
    assert fit.effect.kept


def test_the_commands_staircase_does_not_bend_the_asymptote(rig: Rig) -> None:
    """Without noise the asymptote is m / f_v to 0.005 %; the command's steps alone would change it by 0.02 %."""
    record = QuickRig(quiet(own(rig, 0.05, 1e-3, 1e-4)), 1).ramp(0.02, 0.16, False, "x")
    assert identify_ramps([record], 0.0).ramps[0].asymptote[0] == pytest.approx(record.slope / 1e-3, rel=5e-5)


@pytest.mark.parametrize("loaded", [False, True])
def test_one_ramp_gives_viscous_friction_within_two_per_cent(rig: Rig, loaded: bool) -> None:
    """One ramp's m / a is f_v, without and with load: the source's fall by 13 % is no matter of single ramps."""
    truth = shaft_of(rig, loaded).viscous
    for seed, slope in itertools.product(range(3), (0.02, 0.05)):
        found = identify_ramps(measure(rig, seed, 1, (slope,), 0.155, loaded), 0.0)
        assert found.best.viscous.value == pytest.approx(truth, rel=0.02)
        assert (found.exact, found.source.inertia) == (None, None)
        assert found.best is found.source


def test_break_away_torque_is_found(rig: Rig) -> None:
    """Torque m t_b of each ramp is the Coulomb friction within 3 %, where friction does not fall at break-away."""
    records = measure(own(rig, 0.05, 8e-4, 6e-5), 3, 2, (0.02, 0.05))
    for ramp in identify_ramps(records, rig.torque.scale_uncertainty).ramps:
        assert ramp.break_away * ramp.slope == pytest.approx(0.05, rel=0.03)


def test_a_bent_ramp_is_left_out_as_if_it_had_not_been_run() -> None:
    """One ramp of five whose velocity bends is named; the others give what they give without it."""
    slopes = (0.03, 0.05, 0.03, 0.05)
    straight = [ideal_record(MODEL._replace(slope=m), 20.0, label=f"ramp {k}") for k, m in enumerate(slopes)]
    found = identify_ramps([bent(straight[1], 0.9, label="bent"), *straight], 0.0)
    assert [reason.partition(":")[0] for reason in found.unused] == ["bent"]
    assert [ramp.record.label for ramp in found.ramps] == [record.label for record in straight]
    assert found.best.coulomb == identify_ramps(straight, 0.0).best.coulomb


@pytest.mark.parametrize(
    ("friction", "kept"), [((0.03, 6.4e-4, 1.3e-5), True), ((0.10, 6e-4, 1.5e-4), False), ((0.11, 1e-3, 2e-5), False)]
)
def test_plan_gives_each_ramp_time_enough_to_slide(friction: tuple[float, float, float], kept: bool, rig: Rig) -> None:
    """Slopes that suit the rig are kept; else planned ramps slide for 8 time constants and 1.4 s, within the travel."""
    coulomb, viscous, inertia = friction
    changed = own(rig, *friction)
    first = QuickRig(changed, 1).ramp(min(rig.ramps.slopes), rig.ramps.end_torque, False, "first")
    plan = plan_from(first, changed.ramps, changed)
    assert (plan.slopes == rig.ramps.slopes) is kept
    rise = plan.end_torque - coulomb
    assert rise / max(plan.slopes) >= max(1.4, 8 * inertia / viscous)
    assert rise**2 / (2 * viscous * min(plan.slopes)) < math.tau * rig.limits.load_travel * rig.gear.ratio
    assert max(plan.slopes) >= 1.8 * min(plan.slopes)
    assert plan.repeats * rise / max(plan.slopes) / rig.tick >= 280
    assert plan.end_torque == rig.ramps.end_torque


def test_ramp_ends_before_the_firmware_trips(rig: Rig) -> None:
    """Where the end torque would mean twice the speed limit, a ramp ends short of that limit, without a fault."""
    (record,) = measure(own(rig, 0.01, 3e-4, 2e-5), 2, 1, (0.05,))
    assert 0.85 * rig.limits.speed < np.ptp(record.angle[-6:]) / np.ptp(record.time[-6:]) < rig.limits.speed


def with_torques(command: Callable[[Any], Any], measured: Callable[[Any], Any]) -> RampRecord:
    record = ideal_record(MODEL, 10.0)
    torque = command(MODEL.slope * (record.time + TICK / 2))
    return replace(record, torque=torque, measured_torque=measured(np.roll(torque, 1)))


REFUSALS = {
    "no break-away": lambda: ideal_record(MODEL, 0.9),
    "too short": lambda: ideal_record(MODEL, 2.2),
    "too short|no straight asymptote": lambda: ideal_record(MODEL._replace(viscous=0.002), 6.0),
    "no straight asymptote|does not accelerate": lambda: bent(ideal_record(MODEL, 10.0), 0.0),
    "leaves the ramp": lambda: with_torques(lambda t: np.minimum(t, 0.3), lambda t: t),
    "measured torque falls": lambda: with_torques(lambda t: t, lambda t: np.minimum(t, 0.35)),
    "starts from rest|does not accelerate|no straight asymptote": lambda: replace(
        ideal_record(MODEL, 10.0), angle=np.linspace(0, 50, 500)
    ),
    "accepted: a number > 0": lambda: ideal_record(MODEL, 10.0, slope=0.0),
    "time does not increase at reading 2": lambda: ideal_record(MODEL, 10.0, time=np.r_[0, np.arange(499)] * TICK),
    "not finite": lambda: ideal_record(MODEL, 10.0, angle=np.full(500, np.nan)),
}


@pytest.mark.parametrize("message", REFUSALS)
def test_data_without_an_estimate_are_refused(message: str) -> None:
    """What a ramp cannot carry is refused in one line that says what is wrong, never answered by a number."""
    with pytest.raises((IdentificationError, RecordError), match=message) as caught:
        identify_ramps([REFUSALS[message]()], 0.0)
    assert "\n" not in str(caught.value)


def test_emulated_rig_beyond_its_supply_is_refused(rig: Rig) -> None:
    """A ramp in which the amplifier runs out of voltage is recognised by its measured current."""
    records = measure(rig.replaced(emulation={"motor": {"supply": 9.0}}), 1, 1, (0.02, 0.05))
    with pytest.raises(IdentificationError, match=r"amplifier saturates|straight asymptote"):
        identify_ramps(records, rig.torque.scale_uncertainty)


def test_csv_gives_the_record_back(tmp_path: Path, rig: Rig) -> None:
    """Writing and reading a record changes no bit; a file that Excel saved, with a byte order mark, is read, too."""
    path = tmp_path / "x.csv"
    (record,) = measure(rig, 4, 1, (0.05,))
    write_csv(record, path)
    again = read_csv(path, record.slope, record.angle_step)
    for name in ("time", "angle", "torque", "measured_torque"):
        assert np.array_equal(getattr(again, name), getattr(record, name)), name
    path.write_bytes(b"\xef\xbb\xbftime,counts\r\n0,0\r\n0.02,3\r\n,\r\n")
    assert read_csv(path, 0.1, STEP).angle == pytest.approx([0.0, 3 * STEP])


@pytest.mark.parametrize("kind", ["increments", "counts", "velocity"])
@pytest.mark.parametrize("with_time", [True, False])
def test_plain_text_of_every_kind_gives_the_same_fit(kind: str, with_time: bool, tmp_path: Path) -> None:
    """Increments, counts and velocities of one ramp, with and without a time column, agree to 0.5 %."""
    record = ideal_record(MODEL, 12.0)
    counts = np.rint(record.angle / STEP)
    steps = np.diff(counts, prepend=0.0)
    values = {"counts": counts, "increments": steps, "velocity": steps * STEP / TICK}[kind]
    lines = [f"{t + TICK:.4f}\t{v:.9g}" if with_time else f"{v:.9g}" for t, v in zip(record.time, values, strict=True)]
    path = tmp_path / "old.txt"
    path.write_text("% saved by a Turbo C program\n" + "\r\n".join(lines) + "\n")
    found = identify_ramps([read_text(path, kind, MODEL.slope, STEP, TICK)], 0.0)
    assert found.ramps[0].asymptote == pytest.approx((2.5, 2.875 + 2.5 * TICK), rel=5e-3)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("1\n2\nthree\n", "line 3 holds 'three'"),
        ("1\n1 2\n", "line 2 holds 2 numbers"),
        ("0,5\n1,7\n2,9\n3,1\n", "advances by 1 a line; accepted: s, about 0.02 a line, and a point"),
        ("time,counts\n0,1\n0.02,x\n", "line 3, column counts holds 'x'"),
    ],
)
def test_unreadable_files_are_refused_by_line(text: str, message: str, tmp_path: Path) -> None:
    """A damaged file, plain text or CSV, is refused with line, column and what stands there."""
    path = tmp_path / "bad.txt"
    path.write_text(text)
    read = partial(read_csv, path, 0.1, STEP) if "time" in text else partial(read_text, path, "counts", 0.1, STEP, TICK)
    with pytest.raises(RecordError, match=message):
        read()
