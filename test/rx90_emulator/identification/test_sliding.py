"""The sliding fit finds known friction with the right deviations, and says what is not identifiable, or no sweep."""

import dataclasses
import math
import re
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from foreign_arms import some_rows, write_urdf

import rx90_emulator as rx
from benchmarks.synthetic_sweeps import Noise
from rx90_common.base.arrays import Array
from rx90_common.base.errors import IdentificationError
from rx90_common.friction import FrictionElement, FrictionSet
from rx90_emulator.identification.arm import RigidArm
from rx90_emulator.identification.estimates import SLIDING, Estimates
from rx90_emulator.identification.experiments.plan import Kind, PlanOptions, directions, make_plan, poses_of
from rx90_emulator.identification.identify import identify_records
from rx90_emulator.identification.output.friction_file import sweeps_text
from rx90_emulator.identification.records import BagSource, JointRecord
from rx90_emulator.identification.robot import RecordedRobot
from rx90_emulator.identification.rows.sweeps import find_blocks
from rx90_emulator.identification.sliding import identify_sliding
from rx90_emulator.loop.setup import Setup

pytestmark = pytest.mark.slow


def errors(estimate: Estimates, element: FrictionElement) -> dict[str, float]:
    return {name: abs(found.value / element.parameters[name] - 1.0) for name, found in estimate.items()}


def test_wrist_joints_moved_one_at_a_time_do_not_identify_element_seven(sweeps: Any, arm: RigidArm) -> None:
    """With joint 5 alone no parameter of joint 5 is given out as if element 7 were not there."""
    record, _ = sweeps([4], 1)
    fit = identify_sliding([record], arm)
    for e in (4, 6):
        coulomb = fit.estimates[e]["tau_c_positive"]
        assert math.isnan(coulomb.value)
        assert "not separable from" in coulomb.reason


def test_a_coulomb_difference_of_element_seven_moves_to_joints_five_and_six(
    sweeps: Any, arm: RigidArm, shipped: Setup
) -> None:
    """A constant torque of element 7 shows in no motion: joints 5 and 6 take it, and nothing else changes."""
    seventh = shipped.friction.elements[6].replaced(tau_c={"positive": 1.6, "negative": 1.4})
    friction = FrictionSet(shipped.friction.names, (*shipped.friction.elements[:6], seventh))
    record, _ = sweeps([4, 5], 1, Noise(0.0), friction=friction)
    found = identify_sliding([record], arm).estimates[4:]
    assert found[2]["tau_c_positive"].value == pytest.approx(1.5, rel=2e-3)
    assert found[2]["tau_c_negative"].value == pytest.approx(1.5, rel=2e-3)
    assert found[0]["tau_c_positive"].value == pytest.approx(4.1, rel=2e-3)
    assert found[1]["tau_c_negative"].value == pytest.approx(1.9, rel=2e-3)


def test_an_unknown_payload_of_one_kilogram_does_not_move_tau_c(sweeps: Any, arm: RigidArm) -> None:
    """A payload of 1 kg that the model does not have shifts tau_c by less than 2 %."""
    (without, friction), (loaded, _) = (sweeps([1, 2], 4, Noise(0.0), payload=mass) for mass in (0.0, 1.0))
    bare, full = (identify_sliding([record], arm) for record in (without, loaded))
    for joint in (1, 2):
        assert np.abs(loaded.torque - without.torque)[:, joint].max() > 5.0  # Nm: it would show
        for name in ("tau_c_positive", "tau_c_negative"):
            values = [fit.estimates[joint][name].value for fit in (full, bare)]
            assert values[0] == pytest.approx(values[1], rel=0.02)
    rows = np.flatnonzero(np.abs(loaded.velocity[:, 1]) > 0.1)[50::500]
    q, v = loaded.position[rows], loaded.velocity[rows]
    rigid = arm.torque(q, v, np.zeros_like(v)) + arm.regressor(q, v, np.zeros_like(v)) @ full.inertial
    expected = loaded.torque[rows, 1] - friction.elements[1].steady_torque(v[:, 1])
    assert np.abs(rigid[:, 1] - expected).max() < 0.2


def test_torques_that_no_weight_explains_are_an_alarm(sweeps: Any, arm: RigidArm) -> None:
    """Torques in mNm, of motors, early, or of no friction are said; where no weight moves, nothing can be told."""
    record, _ = sweeps([0, 1, 2], 4, longest=1.0)
    right = identify_sliding([record], arm)
    assert right.alarms == ()
    assert [right.scales[f"joint_{k}"] for k in (1, 2)] == pytest.approx([math.nan, 1.0], abs=0.02, nan_ok=True)
    early = np.roll(record.torque, -60, axis=0)
    rough = record.torque + 30.0 * np.sin(6.0 * record.position) * (np.arange(6) == 2)
    wrong = (
        (1e3 * record.torque, r"is 1e\+03, .* times what"),
        (0.011 * record.torque, r"is 0\.011, .* times what"),
        (early, "torques by -[67]. ms"),
        (rough, "of the friction of joint_3 unexplained"),
    )
    for torque, text in wrong:
        assert re.search(text, identify_sliding([dataclasses.replace(record, torque=torque)], arm).alarms[-1])


def test_intervals_cover_the_truth(sweeps: Any, arm: RigidArm) -> None:
    """95 % intervals hold the truth in 90 % of 80 cases or more, and errors are as large as the deviations say."""
    inside, scores = [], []
    for seed in range(3):
        record, friction = sweeps([0, 1, 2, 3], 100 + seed, Noise(common=1e-3), longest=1.2)
        estimates = identify_sliding([record], arm).estimates
        for joint in range(4):
            for name, found in estimates[joint].items():
                if not found.identifiable:
                    continue
                low, high = found.bounds
                true = friction.elements[joint].parameters[name]
                inside.append(low <= true <= high)
                scores.append((found.value - true) / found.deviation)
    assert len(inside) >= 80
    assert np.mean(inside) >= 0.9
    assert 0.7 < np.sqrt(np.mean(np.square(scores))) < 1.3


def outliers(record: JointRecord) -> JointRecord:
    torque = record.torque.copy()
    torque[np.random.default_rng(7).random(len(torque)) < 0.02, 2] += 200.0
    return dataclasses.replace(record, torque=torque)


def missing(record: JointRecord) -> JointRecord:
    kept = np.random.default_rng(8).random(len(record.time)) > 0.1
    return some_rows(record, kept)


@pytest.mark.parametrize(
    ("seed", "counts", "spoilt", "names"),
    [
        (6, 1000.0, lambda record: record, ("tau_c_positive", "tau_c_negative", "c2")),
        (7, None, outliers, SLIDING),
        (8, None, missing, SLIDING),
    ],
)
def test_a_poor_record_is_no_obstacle(
    sweeps: Any,
    arm: RigidArm,
    seed: int,
    counts: float | None,
    spoilt: Callable[[JointRecord], JointRecord],
    names: Sequence[str],
) -> None:
    """With 1000 counts per motor turn, outliers or missing samples, parameters stay within 2 %."""
    record, friction = sweeps([2], seed, None if counts is None else Noise(counts=counts), count=14, poses=2)
    found = errors(identify_sliding([spoilt(record)], arm).estimates[2], friction.elements[2])
    assert max(found[name] for name in names) < 0.02


def test_no_stribeck_effect_is_reported_as_such(sweeps: Any, arm: RigidArm, shipped: Setup) -> None:
    """Friction without a static rise leaves tau_s, omega_s and delta not identifiable, and the others identifiable."""
    plain = shipped.friction.elements[2].replaced(tau_s=18.0)
    elements = (*shipped.friction.elements[:2], plain, *shipped.friction.elements[3:])
    record, _ = sweeps([2], 9, friction=FrictionSet(shipped.friction.names, elements))
    found = identify_sliding([record], arm).estimates[2]
    for name in ("tau_s_positive", "tau_s_negative", "omega_s", "delta"):
        assert not found[name].identifiable
        assert "no Stribeck effect" in found[name].reason
    assert found["tau_c_positive"].value == pytest.approx(18.0, rel=0.02)
    assert found["c2"].value == pytest.approx(7.0, rel=0.02)


@pytest.mark.parametrize(("joint", "alpha", "rises", "longest"), [(0, 0.7, True, 4.0), (3, 0.6, False, 0.7)])
def test_a_viscous_exponent_is_found_where_there_is_one(
    sweeps: Any, arm: RigidArm, shipped: Setup, tmp_path: Path, joint: int, alpha: float, rises: bool, longest: float
) -> None:
    """The exponent is within 0.05 and three deviations of the truth, is no Stribeck effect, and stands in the file."""
    base = shipped.friction.elements[joint]
    static = base.tau_s.positive if rises else base.tau_c.positive
    bent = base.replaced(alpha=alpha, tau_s=static)
    elements = [bent if e == joint else one for e, one in enumerate(shipped.friction.elements)]
    friction = FrictionSet(shipped.friction.names, tuple(elements))
    record, _ = sweeps([joint], 32, friction=friction, count=16, longest=longest)
    record = dataclasses.replace(record, source=tmp_path)
    result = identify_records(
        [record], [], RecordedRobot(arm, shipped, fallback=shipped.friction.elements, fallback_name="shipped")
    )
    found = result.elements[joint].estimates
    assert abs(found["alpha"].value - alpha) < min(0.05, 3.0 * found["alpha"].deviation)
    assert abs(found["c2"].value / base.c2 - 1.0) < 0.05
    assert found["omega_s"].identifiable == rises
    file = tmp_path / "friction.yaml"
    file.write_text(sweeps_text(result), encoding="utf-8")
    read = rx.FrictionFile.read(file)
    assert [element.alpha != 1.0 for element in read.elements.entries.values()] == [e == joint for e in range(7)]
    assert read.elements[f"joint_{joint + 1}"].alpha == pytest.approx(found["alpha"].value, rel=1e-5)
    assert " +- ".join(found["alpha"].texts()) in rx.identification_summary(result)


@pytest.mark.parametrize(
    ("program", "lasting", "message"),
    [
        ({"count": 4, "longest": 4.0}, math.inf, r"joint_3 slides at 4 speeds in positive and 4 .*accepted: 5 or more"),
        ({"backward": False}, math.inf, r"joint_3 slides at positive velocities only; accepted: .*both"),
        ({}, 0.08, "no stretch of constant velocity"),
    ],
)
def test_what_tells_no_friction_is_refused(
    sweeps: Any, arm: RigidArm, program: dict[str, Any], lasting: float, message: str
) -> None:
    """Too few speeds, one direction and rest are refused with what is lacking and what is accepted."""
    record, _ = sweeps([2], **program)
    with pytest.raises(IdentificationError, match=message):
        identify_sliding([some_rows(record, record.time < lasting)], arm)


def on_the_engine(setup: Setup, options: PlanOptions) -> list[JointRecord]:
    """Return the records of a plan's sweeps in the closed loop, means of four samples."""
    found = []
    for sweep in make_plan(setup.robot, setup.drives, options):
        if sweep.kind is Kind.SLIDING:
            states = rx.simulate(setup, sweep.points, duration=sweep.duration).slow.joint_states
            means = states[: len(states) // 4 * 4].reshape(-1, 4, 3, 6).mean(axis=1).transpose(1, 0, 2)
            time = 4e-3 * np.arange(means.shape[1], dtype=np.float64)
            found.append(JointRecord(setup.robot.joint_names, time, *means, Path(sweep.name), "0"))
    return found


@pytest.mark.parametrize("count", [1, 2])
def test_the_wrists_friction_comes_back_from_the_engine(shipped: Setup, arm: RigidArm, count: int) -> None:
    """Sweeps of joints 5 and 6 tell their three elements apart to 2.5 %; with too few speeds by their deviations."""
    names = directions(shipped.robot.joint_names, shipped.drives.turning)
    poses = poses_of(shipped)
    few = poses.replaced(sweeps={"positions": poses.sweeps.positions[:count]})
    groups = tuple(name for name in names if {"5", "6"} & set(name))
    fit = identify_sliding(on_the_engine(shipped, PlanOptions(speeds=9, travel=0.2, poses=few, groups=groups)), arm)
    for e in (4, 5, 6):
        for name, found in fit.estimates[e].items():
            truth = shipped.friction.elements[e].parameters[name]
            if count == 1:
                assert abs(found.value / truth - 1.0) < 0.025, (e, name)
            elif found.identifiable:
                assert abs(found.value - truth) < 3.0 * found.deviation, (e, name)
    assert not fit.estimates[0]["c2"].identifiable


Friction = Callable[[Array], Array]
SPEEDS = np.geomspace(0.004, 1.2, 12)


@pytest.fixture(scope="module")
def hinge(tmp_path_factory: pytest.TempPathFactory) -> RigidArm:
    """Return an arm of one joint with a vertical axis: no weight, all torque is friction and inertia."""
    return RigidArm.from_urdf(write_urdf(tmp_path_factory.mktemp("arm"), ["hinge"], ["0 0 1"], [4.0], "continuous"))


def straight(velocity: Array) -> Array:
    return np.asarray(5.0 * np.tanh(velocity / 1e-4) + 2.0 * velocity)


def record(time: Array, velocity: Array, torque: Array, name: str = "bag") -> JointRecord:
    """Return the record of one joint; positions are the integral of the velocity that was."""
    position = np.concatenate([[0.0], np.cumsum(0.5 * (velocity[1:] + velocity[:-1]) * np.diff(time))])
    columns = (values[:, None] for values in (position, velocity, torque))
    return JointRecord(("hinge",), time, *columns, Path(name), name)


def sweep(speed: float, rng: np.random.Generator, begin: float, friction: Friction, ripple: float) -> JointRecord:
    """Return rest, a stretch at a speed that ripples where it is slow, and rest again, at 67 Hz, with noise."""
    lasting = 1.5 + max(1.5, 0.06 / abs(speed))
    time = np.arange(0.0, lasting, 1.0 / 67.0)
    moving = np.clip((time - 0.3) / 0.2, 0.0, 1.0) * np.clip((lasting - 0.3 - time) / 0.1, 0.0, 1.0)
    wave = np.sin(2.0 * np.pi * 3.0 * time + rng.uniform(0.0, 6.0))
    velocity = speed * moving * (1.0 + ripple * min(1.0, 0.01 / abs(speed)) * wave)
    torque = friction(velocity) + 0.05 * rng.normal(size=len(time))
    clean = record(begin + time, velocity, torque, f"{speed:+.4f}")
    noisy = clean.velocity + 0.003 * ripple * rng.normal(size=clean.velocity.shape)
    return JointRecord(clean.names, clean.time, clean.position, noisy, clean.torque, clean.source, clean.sha256)


def series(rng: np.random.Generator, friction: Friction = straight, ripple: float = 0.0) -> list[JointRecord]:
    speeds = [sign * speed for speed in rng.permutation(SPEEDS).tolist() for sign in (1.0, -1.0)]
    return [sweep(speed, rng, 20.0 * k, friction, ripple) for k, speed in enumerate(speeds)]


@pytest.mark.parametrize(("noise", "hertz"), [(0.0, 0.1), (0.001, 0.1), (0.004, 0.1), (0.01, 0.1), (0.004, 0.05)])
def test_the_crests_of_a_slow_sine_are_no_plateaus(noise: float, hertz: float) -> None:
    """A sine of 0.9 rad/s, whose crest keeps within 2 % for 0.6 s, is left out, and pieces that noise cuts it in."""
    time = np.arange(0.0, 4.0 / hertz, 0.004)
    velocity = 0.9 * np.sin(2.0 * np.pi * hertz * time)
    sine = record(time, velocity, straight(velocity))
    measured = sine.velocity + noise * np.random.default_rng(2).normal(size=sine.velocity.shape)
    with pytest.raises(IdentificationError, match="no stretch of constant velocity"):
        find_blocks([JointRecord(sine.names, time, sine.position, measured, sine.torque, Path("sine"), "")], np.eye(1))


def test_slow_sweeps_at_67_hz_are_used(hinge: RigidArm) -> None:
    """Sweeps from 4 mrad/s on, of which the slow ones ripple by 30 %, are all used, and friction is found from them."""
    records = series(np.random.default_rng(3), ripple=0.3)
    fit = identify_sliding(records, hinge)
    for one, use in zip(records, fit.usage, strict=True):
        assert use.stretches >= 1, (one.source, use.text(("hinge",)))
        assert use.speeds[0, 0] == pytest.approx(abs(float(str(one.source))), rel=0.25)
    found = fit.estimates[0]
    for name, truth in (("tau_c_positive", 5.0), ("tau_c_negative", 5.0), ("c2", 2.0)):
        assert abs(found[name].value - truth) < max(0.03 * truth, 3.0 * found[name].deviation), name


def humped(velocity: Array) -> Array:
    """Return friction with a hump near 50 mrad/s, as of a lubricant, which is no curve of the model, Nm."""
    speed = np.abs(velocity) + 1e-9
    return np.asarray(straight(velocity) + 3.0 * np.sign(velocity) * np.exp(-(np.log(speed / 0.05) ** 2)))


def test_a_misfit_shows(hinge: RigidArm) -> None:
    """A curve of the model's form leaves the samples' noise; one of another form leaves more."""
    straight_fit, humped_fit = (
        identify_sliding(series(np.random.default_rng(5), friction), hinge).curves[0] for friction in (straight, humped)
    )
    assert 0.3 < straight_fit.chi2 < 3.0
    assert humped_fit.chi2 > 10.0
    assert humped_fit.share > 3.0 * straight_fit.share


def test_a_bag_was_recorded_when_its_stamps_say() -> None:
    """Stamps of the wall clock are a date, whenever the file was written; those of a simulation are none."""
    assert BagSource(Path("bag"), "", 60.0, 0, 1_577_836_800.4).recorded == "2020-01-01T00:00:00+00:00"
    assert BagSource(Path("bag"), "", 60.0, 0, 2.0).recorded == "no date; stamps from 2 to 62 s"
