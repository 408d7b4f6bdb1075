"""Known friction in, known friction out; and no number where the data carry none."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy import stats

from benchmarks.friction_ramp import QuickRig
from friction_bench.experiment.asymptote import fit_asymptote
from friction_bench.experiment.identification import RampIdentification, identify_ramps, joint_friction, source_formulas
from friction_bench.experiment.job import run_ramp
from friction_bench.experiment.record import RampModel, RampRecord, RecordError, read_csv, read_text, write_csv
from friction_bench.rig.client import RigClient
from friction_bench.rig.emulated import EmulatedRig, VirtualPort
from friction_bench.rig.rig_file import JointFriction, Rig
from rx90_common.base.errors import IdentificationError

TICK = 0.02
STEP = math.tau / 504


def ideal_record(model: RampModel, duration: float, **changes: Any) -> RampRecord:
    """Return a ramp as a perfect rig with an encoder would give it, without torques."""
    time = np.arange(0.0, duration, TICK)
    angle = np.floor(model.angle(time) / STEP + 0.5) * STEP
    return RampRecord(**{"time": time, "angle": angle, "slope": model.slope, "angle_step": STEP, **changes})


def rig_with(rig: Rig, fc: float, fv: float, inertia: float, quiet: bool = False) -> Rig:
    """Return the rig with this friction and inertia at the motor, without a load."""
    assert rig.plant is not None
    load = (inertia - rig.plant.rotor_inertia) * rig.gear_ratio**2 * rig.gear_efficiency
    plant = replace(rig.plant, coulomb=fc, viscous=fv, load_inertia=load)
    return replace(rig, plant=replace(plant, gain_error=0.0, torque_noise=0.0, adc_noise=0.0) if quiet else plant)


def measure(rig: Rig, seed: int, repeats: int, end_torque: float, slopes: tuple[float, ...]) -> RampIdentification:
    """Run the whole measurement on an emulated rig with the real firmware, in virtual time."""
    client = RigClient(VirtualPort(EmulatedRig(rig, seed)), rig)
    client.connect()
    records = [run_ramp(client, slope, end_torque, False, f"{slope}") for _ in range(repeats) for slope in slopes]
    return identify_ramps(records, rig.scale_uncertainty)


@pytest.mark.parametrize(
    ("a", "b", "m", "fc", "fv"),
    [(949.5407, 227.8898, 0.61, 0.1464, 6.4e-4), (981.3603, 412.1713, 0.55, 0.231, 5.6e-4)],
)
def test_source_figures_come_out(a: float, b: float, m: float, fc: float, fv: float) -> None:
    """The source's asymptotes give the source's f_c and f_v to its digits."""
    found_fc, found_fv = source_formulas(a, b, m)
    assert found_fc == pytest.approx(fc, abs=5e-5 if fc < 0.2 else 5e-4)
    assert found_fv == pytest.approx(fv, abs=5e-6)


def test_source_joint_friction_comes_out() -> None:
    """0.231 - 0.147 = 0.084 Nm, where 0.147 is f_c + f_v of the source's equation 5."""
    unloaded = sum(source_formulas(949.5407, 227.8898, 0.61))
    loaded = source_formulas(981.3603, 412.1713, 0.55)[0]
    assert round(unloaded, 3) == 0.147
    assert round(loaded - unloaded, 3) == 0.084


@pytest.mark.parametrize(("m", "a", "b", "by_source"), [(0.02, 1.0, 2.65, 0.053), (0.05, 2.5, 2.875, 0.0575)])
def test_closed_form_has_the_asymptote_of_the_hand_calculation(m: float, a: float, b: float, by_source: float) -> None:
    """J = 3e-3, f_v = 0.02, f_c = 0.05: a, b, the source's f_c, and m b / a - J a = 0.05 exactly."""
    model = RampModel(coulomb=0.05, viscous=0.02, inertia=3e-3, slope=m)
    assert source_formulas(a, b, m)[0] == pytest.approx(by_source, rel=1e-12)
    assert m * b / a - 3e-3 * a == pytest.approx(0.05, rel=1e-12)
    late = np.array([50.0, 60.0])
    assert model.velocity(late) == pytest.approx(a * late - b, rel=1e-9)


def test_exact_formula_recovers_noiseless_friction() -> None:
    """From rounded encoder counts alone, two slopes give f_c, f_v to 0.1 % and J to 1 %."""
    truth = {"coulomb": 0.05, "viscous": 0.02, "inertia": 3e-3}
    records = [ideal_record(RampModel(**truth, slope=m), 40.0) for m in (0.02, 0.05)]
    exact = identify_ramps(records, 0.0).exact
    assert exact is not None
    assert exact.inertia is not None
    assert exact.coulomb.value == pytest.approx(0.05, rel=1e-3)
    assert exact.viscous.value == pytest.approx(0.02, rel=1e-3)
    assert exact.inertia.value == pytest.approx(3e-3, rel=1e-2)


GRID = [
    # f_c, f_v, J, slopes, end torque
    (0.030, 6.4e-4, 1.3e-5, (0.02, 0.05), 0.15),
    (0.070, 8.0e-4, 6.3e-5, (0.02, 0.05), 0.16),
    (0.050, 1.0e-3, 1.0e-4, (0.02, 0.06), 0.17),
    (0.020, 6.0e-4, 4.0e-5, (0.03, 0.06), 0.14),
    (0.100, 5.0e-4, 3.0e-5, (0.015, 0.03), 0.17),
    (0.010, 9.0e-4, 2.0e-5, (0.025, 0.05), 0.17),
]
SEEDS = 10


@pytest.fixture(scope="module")
def grid_results(rig: Rig) -> list[tuple[tuple[float, float, float], RampIdentification]]:
    """Return truth and estimate of every cell of the grid and every seed."""
    results = []
    for cell, (fc, fv, inertia, slopes, end) in enumerate(GRID):
        changed = rig_with(rig, fc, fv, inertia)
        for seed in range(SEEDS):
            quick = QuickRig(changed, 1000 * cell + seed)
            records = [quick.ramp(slope, end, False, f"{slope} {k}") for k in range(3) for slope in slopes]
            found = identify_ramps(records, rig.scale_uncertainty)
            results.append(((fc, fv, inertia), found))
    return results


Results = list[tuple[tuple[float, float, float], RampIdentification]]


@pytest.mark.parametrize("name", ["coulomb", "viscous"])
@pytest.mark.parametrize("method", ["exact", "repeated"])
def test_bias_is_below_one_per_cent(name: str, method: str, grid_results: Results) -> None:
    """In every cell of the grid the mean exact estimate is within 1 % of the truth."""
    index = ("coulomb", "viscous").index(name)
    for cell in range(len(GRID)):
        part = grid_results[cell * SEEDS : (cell + 1) * SEEDS]
        errors = [getattr(getattr(found, method), name).value / truth[index] - 1 for truth, found in part]
        assert abs(np.mean(errors)) < 0.01, f"cell {cell}"


@pytest.mark.parametrize("name", ["coulomb", "viscous"])
@pytest.mark.parametrize("method", ["exact", "repeated"])
def test_intervals_cover_the_truth(name: str, method: str, grid_results: Results) -> None:
    """Of the 95 % intervals, 90 to 99 % hold the truth."""
    index = ("coulomb", "viscous").index(name)
    hits = 0
    for truth, found in grid_results:
        estimate = getattr(getattr(found, method), name)
        hits += estimate.low <= truth[index] <= estimate.high
    assert 0.90 <= hits / len(grid_results) <= 0.99


def test_source_formula_is_high_by_inertia_times_acceleration(grid_results: Results) -> None:
    """In every cell the source's f_c exceeds the truth by the mean J a of its ramps, within 1 % of f_c."""
    for cell in range(len(GRID)):
        part = grid_results[cell * SEEDS : (cell + 1) * SEEDS]
        fc, fv, inertia = part[0][0]
        excess = np.mean([found.source.coulomb.value - fc for _, found in part])
        expected = np.mean([inertia * ramp.slope / fv for ramp in part[0][1].ramps if ramp.asymptote])
        assert excess == pytest.approx(expected, abs=0.01 * fc)


def test_scatter_is_what_the_covariances_say(grid_results: Results) -> None:
    """The probabilities of the repeats' scatter are uniform: the noise model is the right one."""
    p = [found.consistency for _, found in grid_results]
    assert stats.kstest(p, "uniform").pvalue > 1e-3


def test_joint_friction_is_the_difference_and_carries_its_scale(rig: Rig) -> None:
    """f_joint is right within 3 standard uncertainties, and a common scale error does not widen it twice."""
    assert rig.plant is not None
    emulated = EmulatedRig(rig, 5)
    client = RigClient(VirtualPort(emulated), rig)
    client.connect()
    parts = []
    for loaded, end in ((False, 0.15), (True, 0.16)):
        emulated.plant.load(loaded)
        records = [run_ramp(client, m, end, loaded, "r") for _ in range(3) for m in (0.02, 0.05)]
        parts.append(identify_ramps(records, rig.scale_uncertainty))
    joint = joint_friction(parts[0], parts[1], replace(rig, efficiency_uncertainty=0.0))
    friction = rig.plant.joint
    assert isinstance(friction, JointFriction)
    for estimate, truth in (
        (joint.joint_side_coulomb, friction.coulomb),
        (joint.joint_side_viscous, friction.viscous),
    ):
        assert estimate.value == pytest.approx(truth, abs=3 * estimate.error)
        assert estimate.error < 0.01 * truth
    separate = math.hypot(parts[0].best.coulomb.error, parts[1].best.coulomb.error)
    assert joint.coulomb.error < separate


def test_one_slope_gives_the_source_formula_alone(rig: Rig) -> None:
    """With one slope there is no inertia, no exact value, and the best is the source's."""
    found = measure(rig, 3, 2, 0.15, (0.02,))
    assert found.exact is None
    assert found.best is found.source
    assert found.source.inertia is None


def test_break_away_torque_is_found(rig: Rig) -> None:
    """Torque m t_b of each ramp is the Coulomb friction within 3 %, where friction does not fall at break-away."""
    found = measure(rig_with(rig, 0.05, 8e-4, 6e-5), 3, 2, 0.15, (0.02, 0.05))
    for ramp in found.ramps:
        assert ramp.break_away * ramp.slope == pytest.approx(0.05, rel=0.03)


MODEL = RampModel(coulomb=0.05, viscous=0.02, inertia=3e-3, slope=0.05)
SHORT = RampModel(coulomb=0.05, viscous=0.002, inertia=3e-3, slope=0.05)


def saturating(duration: float) -> RampRecord:
    """Return a ramp whose velocity bends: the torque stops rising half-way."""
    record = ideal_record(MODEL, duration)
    half = record.time.size // 2
    speed = np.diff(record.angle, prepend=0.0)
    speed[half:] = np.minimum(speed[half:], speed[half] * 1.02)
    return replace(record, angle=np.cumsum(speed))


def test_a_bent_ramp_is_left_out_as_if_it_had_not_been_run() -> None:
    """One ramp of five whose velocity bends is named; each of the others has its own asymptote, by T without it."""
    slopes = (0.03, 0.05, 0.03, 0.05)
    straight = [ideal_record(replace(MODEL, slope=m), 20.0, label=f"ramp {k}") for k, m in enumerate(slopes)]
    speed = np.diff(straight[1].angle, prepend=0.0)
    speed[500:] -= 0.1 * (speed[500:] - speed[500])
    found = identify_ramps([replace(straight[1], angle=np.cumsum(speed), label="bent"), *straight], 0.0)
    assert [reason.partition(":")[0] for reason in found.unused] == ["bent"]
    assert [ramp.record.label for ramp in found.ramps] == [record.label for record in straight]
    assert found.exact is not None
    assert found.exact.inertia is not None
    T = found.exact.inertia.value / found.exact.viscous.value
    for ramp in found.ramps:
        own = fit_asymptote(ramp.record, T)
        assert ramp.asymptote is not None
        assert (ramp.asymptote.a, ramp.asymptote.b) == pytest.approx((own.a, own.b), rel=1e-12)


def with_torques(command: Callable[[Any], Any], measured: Callable[[Any], Any]) -> RampRecord:
    """Return an ideal ramp with these torque columns."""
    record = ideal_record(MODEL, 10.0)
    torque = command(MODEL.slope * (record.time + TICK / 2))
    return replace(record, torque=torque, measured_torque=measured(np.roll(torque, 1)))


REFUSALS = {
    "no break-away": (lambda: ideal_record(MODEL, 0.9), "no break-away"),
    "too few points": (lambda: ideal_record(MODEL, 2.2), "too short"),
    "transient not over": (lambda: ideal_record(SHORT, 6.0), "too short|no straight asymptote"),
    "velocity saturates": (lambda: saturating(10.0), "no straight asymptote|does not accelerate"),
    "command saturates": (
        lambda: with_torques(lambda t: np.minimum(t, 0.3), lambda t: t),
        "leaves the ramp",
    ),
    "current saturates": (
        lambda: with_torques(lambda t: t, lambda t: np.minimum(t, 0.35)),
        "measured torque falls",
    ),
    "already moving": (
        lambda: replace(ideal_record(MODEL, 10.0), angle=np.linspace(0, 50, 500)),
        "starts from rest|does not accelerate|no straight asymptote",
    ),
    "no slope": (lambda: ideal_record(MODEL, 10.0, slope=0.0), "accepted: a number > 0"),
    "time runs back": (
        lambda: ideal_record(MODEL, 10.0, time=np.r_[0.0, np.arange(499)] * TICK),
        "time does not increase at reading 2",
    ),
    "not a number": (lambda: ideal_record(MODEL, 10.0, angle=np.full(500, np.nan)), "not finite"),
}


@pytest.mark.parametrize("name", REFUSALS)
def test_data_without_an_estimate_are_refused(name: str) -> None:
    """What a ramp cannot carry is refused in one line that says what is wrong, never answered by a number."""
    make, message = REFUSALS[name]
    with pytest.raises((IdentificationError, RecordError), match=message) as caught:
        fit_asymptote(make())
    assert "\n" not in str(caught.value)


def test_emulated_rig_beyond_its_supply_is_refused(rig: Rig) -> None:
    """A ramp in which the amplifier runs out of voltage is recognised by its measured current."""
    assert rig.plant is not None
    weak = replace(rig, plant=replace(rig.plant, supply=9.0))
    with pytest.raises(IdentificationError, match=r"amplifier saturates|straight asymptote"):
        measure(weak, 1, 1, 0.15, (0.02, 0.05))


def test_csv_gives_the_record_back(tmp_path: Path, rig: Rig) -> None:
    """Writing and reading a record changes no bit of what the fit sees."""
    client = RigClient(VirtualPort(EmulatedRig(rig, 4)), rig)
    client.connect()
    record = run_ramp(client, 0.05, 0.15, False, "x")
    write_csv(record, tmp_path / "x.csv")
    again = read_csv(tmp_path / "x.csv", record.slope, record.angle_step)
    assert fit_asymptote(again).a == pytest.approx(fit_asymptote(record).a, rel=1e-12)
    assert fit_asymptote(again).b == pytest.approx(fit_asymptote(record).b, rel=1e-12)


def test_csv_with_a_byte_order_mark_is_read(tmp_path: Path) -> None:
    """A file that Excel saved as UTF-8 is read like any other."""
    path = tmp_path / "excel.csv"
    path.write_bytes(b"\xef\xbb\xbftime,counts\r\n0,0\r\n0.02,3\r\n,\r\n")
    assert read_csv(path, 0.1, STEP).angle == pytest.approx([0.0, 3 * STEP])


@pytest.mark.parametrize("kind", ["increments", "counts", "velocity"])
@pytest.mark.parametrize("with_time", [True, False])
def test_plain_text_of_every_kind_gives_the_same_fit(kind: str, with_time: bool, tmp_path: Path) -> None:
    """Increments, counts and velocities of one ramp, with and without a time column, agree to 0.5 %."""
    record = ideal_record(MODEL, 12.0)
    counts = np.rint(record.angle / STEP)
    values = {
        "counts": counts,
        "increments": np.diff(counts, prepend=0.0),
        "velocity": np.diff(counts, prepend=0.0) * STEP / TICK,
    }[kind]
    lines = [f"{t + TICK:.4f}\t{v:.9g}" if with_time else f"{v:.9g}" for t, v in zip(record.time, values, strict=True)]
    path = tmp_path / "old.txt"
    path.write_text("% saved by a Turbo C program\n" + "\r\n".join(lines) + "\n")
    a = MODEL.slope / MODEL.viscous
    b = a * (MODEL.coulomb / MODEL.slope + MODEL.time_constant)
    fit = fit_asymptote(read_text(path, kind, MODEL.slope, STEP, TICK))
    assert fit.a == pytest.approx(a, rel=5e-3)
    assert fit.b == pytest.approx(b + a * TICK, rel=5e-3)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("1\n2\nthree\n", "line 3 holds 'three'"),
        ("1 2 3\n1 2 3\n", "line 1 holds 3 numbers"),
        ("1\n1 2\n", "line 2 holds 2 numbers"),
        ("", "0 readings"),
        ("1\n", "1 readings"),
        ("20 1\n40 2\n60 3\n", "advances by 20 a line; accepted: s, about 0.02"),
        ("0,5\n1,7\n2,9\n3,1\n", "advances by 1 a line; accepted: s, about 0.02 a line, and a point"),
    ],
)
def test_unreadable_text_is_refused_by_line(text: str, message: str, tmp_path: Path) -> None:
    """A damaged text file is refused with the line and what stands there."""
    path = tmp_path / "bad.txt"
    path.write_text(text)
    with pytest.raises(RecordError, match=message):
        read_text(path, "counts", 0.1, STEP, TICK)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("time,counts\n0,1\n0.02,x\n", "line 3, column counts holds 'x'"),
        ("time,pulses\n0,1\n", "column 'counts' is missing"),
        ("time,counts\n0,1\n0.02\n", "line 3, column counts holds 'nothing'"),
        ("", "is empty"),
        ("# made by hand\n\ntime,counts\n0,1\n\n# pause\n0.02,x\n", "line 7, column counts holds 'x'"),
        ("time;counts\n0;1\n", "column 'time' is missing, found 'time;counts'"),
    ],
)
def test_unreadable_csv_is_refused_by_line(text: str, message: str, tmp_path: Path) -> None:
    """A damaged CSV file is refused with line, column and what stands there."""
    path = tmp_path / "bad.csv"
    path.write_text(text)
    with pytest.raises(RecordError, match=message):
        read_csv(path, 0.1, STEP)
