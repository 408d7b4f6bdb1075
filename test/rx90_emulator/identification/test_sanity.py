"""What is wrong with a log is named, with what to write instead, and nothing is said of a right one."""

import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from excitation_arms import plain_arm, rigid_arm
from foreign_arms import some_rows

from benchmarks.excitation_runs import MISFIT, NOISE, Disturbances, FourierMotion, measured
from benchmarks.random_arms import SyntheticArm, random_arm
from benchmarks.wrong_zeros import sweeps
from rx90_common.base.arrays import Array
from rx90_emulator.identification.arm import RigidArm
from rx90_emulator.identification.options import RobotOptions
from rx90_emulator.identification.records import JointRecord
from rx90_emulator.identification.sanity import Recorded, alarms, body_alarms, mistake_alarms, moved_bodies

GEAR = [100.0, -80.0, 60.0, 50.0]
CONSTANT = [0.2, 0.1, 0.1, 0.3]
OPTIONS = RobotOptions(gear=GEAR, torque_constant=CONSTANT)


def recorded_run(arm: SyntheticArm, seed: int = 0, rate: float = 100.0) -> JointRecord:
    return measured(arm, FourierMotion.random(arm, seed, periods=1), rate, seed, NOISE).record(arm)


@pytest.fixture(scope="module")
def arm() -> SyntheticArm:
    return plain_arm(3, 4, coupled=False)


@pytest.fixture(scope="module")
def described(arm: SyntheticArm, tmp_path_factory: pytest.TempPathFactory) -> RigidArm:
    return rigid_arm(arm, tmp_path_factory.mktemp("arm"))


@pytest.fixture(scope="module")
def record(arm: SyntheticArm) -> JointRecord:
    return recorded_run(arm)


def said(described: RigidArm, record: JointRecord, options: RobotOptions = OPTIONS, zero: Array | None = None) -> str:
    return "; ".join(alarms(described, Recorded.of([record], described), options, zero))


def turned(record: JointRecord, motion: tuple[int, ...], torque: tuple[int, ...]) -> JointRecord:
    signs = np.ones((2, len(record.names)))
    signs[0, list(motion)] = -1.0
    signs[1, list(torque)] = -1.0
    return replace(record, position=record.position * signs[0], torque=record.torque * signs[1])


@pytest.mark.parametrize(
    ("motion", "torque", "message"),
    [
        ((), (0,), r"effort of joint_1: .*--torque-constant -0.2 0.1 0.1 0.3,"),
        ((), (1,), r"effort of joint_2: .*--torque-constant 0.2 -0.1 0.1 0.3,"),
        ((), (0, 2), r"effort of joint_\d and sign of the effort of joint_\d: .*--torque-constant -0.2 0.1 -0.1 0.3,"),
        ((1,), (1,), r"gear of joint_2: .*accepted: --gear 100 80 60 50,"),
        ((1,), (), r"position of joint_2: .*accepted: --gear 100 80 60 50, --torque-constant 0.2 -0.1 0.1 0.3,"),
    ],
)
def test_a_wrong_sign_is_named_with_what_to_write(
    described: RigidArm, record: JointRecord, motion: tuple[int, ...], torque: tuple[int, ...], message: str
) -> None:
    """A torque, a gear or a position that is turned round is found on its joint, and the right options are said."""
    assert re.search(f"^wrong sign of the {message}", said(described, turned(record, motion, torque)))


def exchanged(values: Array) -> Array:
    return values[:, [0, 2, 1, 3]]


@pytest.mark.parametrize("kind", ["columns", "efforts", "positions"])
def test_columns_in_the_wrong_order_are_named(described: RigidArm, record: JointRecord, kind: str) -> None:
    """Of joint-side values that two joints have exchanged, the two are named."""
    if kind != "efforts":
        record = replace(record, position=exchanged(record.position))
    if kind != "positions":
        record = replace(record, torque=exchanged(record.torque))
    assert re.search(f"^wrong order of the {kind} of joint_2 and joint_3: ", said(described, record, RobotOptions()))


@pytest.mark.parametrize("delay", [0.06, -0.04])
def test_a_delay_of_the_torques_is_measured(described: RigidArm, record: JointRecord, delay: float) -> None:
    """Torques that come 60 ms late, or early, are told to a sample."""
    late = np.column_stack([np.interp(record.time - delay, record.time, column) for column in record.torque.T])
    text = said(described, replace(record, torque=late))
    assert abs(float(re.findall(r"^wrong delay of the torques by (-?\d+) ms: ", text)[0]) - 1e3 * delay) <= 10.0
    assert abs(float(re.findall(r"torque_delay: (\S+) in the signal map", text)[0]) + delay) <= 0.01


def test_forgotten_gears_are_named_and_nothing_else(described: RigidArm, record: JointRecord) -> None:
    """Torques of motors beside angles of joints are far too small for the described bodies."""
    text = said(described, replace(record, torque=record.torque / [100.0, 120.0, 80.0, 60.0]))
    assert re.search(
        r"^the torque of joint_1, .* times what the described bodies need; accepted: --gear .*--torque-constant", text
    )
    assert "wrong" not in text


def test_right_logs_raise_no_alarm(described: RigidArm, record: JointRecord) -> None:
    """Nothing is said of a right run, nor of one in which a joint's effort is noise alone."""
    assert said(described, record) == ""
    for size in (0.0, 1.0):
        noise = size * np.random.default_rng(5).normal(size=len(record.time))
        assert said(described, replace(record, torque=np.column_stack([record.torque[:, :3], noise]))) == ""


@pytest.mark.parametrize("encoder", [(0.0, 1.0, 0.0, 0.0), (0.0, 0.0, -0.5, 0.0)])
def test_quarter_turns_of_zeros_are_named(encoder: tuple[float, ...], tmp_path: Path) -> None:
    """Zeros that are quarter turns off come with the better ones, those that were given counted in."""
    true = plain_arm(3, 4, coupled=False)
    given, error = np.array([0.0, 0.25, 0.0, 0.0]), np.pi * np.array(encoder)
    log = recorded_run(true, 1)
    text = said(rigid_arm(true, tmp_path), replace(log, position=log.position + error), zero=given)
    wrong = text.removeprefix("wrong ").split(":")[0].split(" and ")
    assert sorted(wrong) == [f"zero of joint_{k + 1}" for k in np.flatnonzero(error)]
    better = np.array(text.split("--zero ")[1].split(",")[0].split(), dtype=float)
    assert np.angle(np.exp(1j * (better - given - error))) == pytest.approx(0.0, abs=1e-5)


@pytest.mark.parametrize(("seed", "disturbances"), [(0, NOISE), (1, MISFIT), (3, MISFIT)])
def test_a_quarter_turn_is_told_in_sweeps(seed: int, disturbances: Disturbances, tmp_path: Path) -> None:
    """A quarter turn of the second joint in sweeps comes out with the option that mends it; right zeros say nothing."""
    true = random_arm(seed, 3)
    rigid, recorded = rigid_arm(true, tmp_path), sweeps(seed, true, disturbances)
    assert mistake_alarms(rigid, recorded) == ()
    motion = recorded.motion.copy()
    motion[0, :, 1] += 0.5 * np.pi
    (text,) = mistake_alarms(rigid, replace(recorded, motion=motion))
    assert text.startswith("wrong zero of joint_2: ")
    assert "accepted: --zero 0 1.5708 0, " in text


def test_a_short_log_names_nothing_by_chance(tmp_path: Path) -> None:
    """With few equations for a parameter any sign fits: none is named."""
    true = plain_arm(5, 5, coupled=False)
    log = recorded_run(true, 5)
    for rows in (slice(200, 460), slice(500, 650), slice(500, 510)):
        assert said(rigid_arm(true, tmp_path), some_rows(log, rows), RobotOptions()) == ""


def test_bodies_far_from_the_description_are_named(described: RigidArm) -> None:
    """Mass, first moment and inertia of what a joint moves follow from the links; ten times more or less is said."""
    light = described.with_bodies(0.1 * described.inertial, np.diag(described.rotor))
    bodies = moved_bodies(described, light)
    masses = described.inertial[::10]
    for joint, moved in enumerate(bodies):
        assert moved.mass == pytest.approx((masses[joint:].sum(), 0.1 * masses[joint:].sum()))
        assert moved.moment[1] == pytest.approx(0.1 * moved.moment[0])
    last = described.inertial[-10:]
    assert bodies[-1].moment[0] == pytest.approx(np.hypot(last[1], last[2]))  # about the z axis of its joint
    assert body_alarms(moved_bodies(described, described)) == ()
    assert "joint_1 " in body_alarms(bodies)[0]
    assert "payload" not in body_alarms(bodies)[0]
    loaded = described.with_bodies(10.0 * described.inertial, np.diag(described.rotor))
    assert body_alarms(moved_bodies(described, loaded))[0].endswith("its payload in the description")
