"""Wrong zeros of the encoders, noticed by what gravity asks: in sweeps, and where a friction file is checked."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest
from foreign_arms import write_urdf
from numpy.typing import NDArray

from benchmarks.excitation_runs import MISFIT
from benchmarks.random_arms import random_arm
from benchmarks.wrong_zeros import described, sweeps, with_payload
from rx90_emulator.identification.arm import RigidArm
from rx90_emulator.identification.records import JointRecord
from rx90_emulator.identification.zeros import Instants, ZeroCheck, check_of, check_zeros, record_instants

Array = NDArray[np.float64]
STRETCHES, EACH = 24, 4


@pytest.fixture(scope="module")
def arm(tmp_path_factory: pytest.TempPathFactory) -> RigidArm:
    """Return three joints: one along gravity, two across it."""
    names, axes = ["base", "shoulder", "elbow"], ["0 0 1", "0 1 0", "0 1 0"]
    return RigidArm.from_urdf(write_urdf(tmp_path_factory.mktemp("arm"), names, axes, [4.0, 3.0, 2.0]))


def recorded(arm: RigidArm, error: Array, seed: int, spread: float = 0.1) -> Instants:
    """Return sweeps at several poses: Pinocchio's torques of links that differ from the URDF's, friction, noise."""
    rng = np.random.default_rng(seed)
    model = arm.model.copy()
    for k in range(1, model.njoints):
        body = model.inertias[k]
        off = body.lever + spread * np.linalg.norm(body.lever) * rng.normal(size=3)
        model.inertias[k] = pin.Inertia(body.mass * (1.0 + spread * rng.normal()), off, body.inertia)
    start = rng.uniform(-1.5, 1.5, (STRETCHES, 3))
    velocity = rng.choice([-1.0, 1.0], (STRETCHES, 3)) * 10.0 ** rng.uniform(-2.0, 0.0, (STRETCHES, 3))
    time = np.linspace(0.0, 0.3, EACH)
    position = (start[:, None] + velocity[:, None] * time[:, None]).reshape(-1, 3)
    speed, data = np.repeat(velocity, EACH, axis=0), model.createData()
    torque = np.array([pin.rnea(model, data, q, v, np.zeros(3)) for q, v in zip(position, speed, strict=True)])
    torque += np.sign(speed) * (3.0 + np.exp(-np.abs(speed) / 0.05)) + 2.0 * speed
    torque += 0.05 * rng.normal(size=torque.shape) + np.repeat(0.05 * rng.normal(size=(STRETCHES, 3)), EACH, axis=0)
    return Instants(position + error, speed, 0.0 * speed, torque, speed != 0.0, np.repeat(np.arange(STRETCHES), EACH))


@pytest.mark.parametrize(
    "error",
    [(0.0, 0.5 * math.pi, 0.0), (0.0, 0.0, math.pi), (0.0, 0.5 * math.pi, -0.5 * math.pi), (0.0, 0.0, -0.5 * math.pi)],
)
def test_a_turned_joint_is_told_with_the_zero_to_try(arm: RigidArm, error: tuple[float, ...]) -> None:
    """Quarter and half turns of a joint, and opposite ones of neighbours, come out with the option that mends them."""
    found = check_zeros(recorded(arm, np.array(error), 3), arm)
    away = np.remainder(found.error - error + math.pi, 2.0 * math.pi) - math.pi
    assert (np.abs(away) < 0.35).all(), found
    assert (found.error != 0.0).tolist() == [value != 0.0 for value in error]
    assert "try --zero 0 " in found.text
    assert "the torques do not determine the zero of base" in found.text


def test_right_zeros_give_no_line(arm: RigidArm) -> None:
    """With links 10 % off and right zeros no alarm is raised in 6 series, nor for an axis along gravity."""
    checks = [check_zeros(recorded(arm, np.array([1.0, 0.0, 0.0]), seed), arm) for seed in range(6)]
    assert [check.text for check in checks] == [""] * 6
    assert not any(check.identifiable[0] for check in checks)


@pytest.mark.parametrize("seed", [1, 5, 9])
def test_a_heavy_payload_is_not_blamed_on_zeros(seed: int) -> None:
    """Ten times the last link's mass raises no alarm by zeros that would only spare the URDF's inertials an error."""
    bare = random_arm(seed, 2)
    share = 10.0 * bare.links[-1].mass / sum(link.mass for link in bare.links)
    found = check_zeros(sweeps(seed, with_payload(bare, share), MISFIT), described(bare, seed))
    assert found.text == ""
    assert found.before == found.after


def test_what_is_little_beside_the_arms_torque_is_no_alarm(arm: RigidArm) -> None:
    """A turned elbow is told, but not beside friction of the base ten thousand times its weight, although that fits."""
    turned = recorded(arm, np.array([0.0, 0.0, math.pi]), 3)
    rubbing = replace(turned, torque=turned.torque + 3e4 * np.sign(turned.velocity) * [1.0, 0.0, 0.0])
    assert check_zeros(turned, arm).error[2] != 0.0
    assert check_zeros(rubbing, arm).text == ""


def test_a_zero_is_doubted_only_where_the_fit_is_better() -> None:
    """Of two errors that lower what is left by 1 and by 30 % the second is said; what the first lowers alone is none.

    What is little of the arm's torque is said of the joint whose it is: before and after are never the same number.
    """
    names, torque = ("a", "b"), np.array([100.0, 1.0])
    nothing = ZeroCheck(names, np.zeros(2), np.zeros(2), np.full(2, 1e-3), np.full(2, True), 0.0, 0.0)

    def left(shift: Array) -> dict[str, Array]:
        return {"": np.array([1.0, 1e-3]) * np.where(shift != 0.0, [0.99**2, 0.7**2], 1.0)}

    both = check_of(nothing, np.array([0.05, -0.03]), left, torque)
    assert both.error.tolist() == [0.0, 0.03]
    assert "unexplained torque of b 3.2% -> 2.2%" in both.text
    alone = check_of(nothing, np.array([0.05, 0.0]), left, torque)
    assert alone.text == ""
    assert alone.before == alone.after


def test_a_run_of_any_motion_tells_as_well(arm: RigidArm) -> None:
    """A run of sines, averaged over short times, tells a shoulder off by a quarter or 0.1 rad; a right one is right."""
    time = np.arange(0.0, 12.0, 0.005)
    wave, phase = np.array([1.3, 0.9, 2.1]), np.array([0.0, 1.0, 2.0])
    angle = time[:, None] * wave + phase
    position, velocity, acceleration = np.sin(angle), wave * np.cos(angle), -(wave**2) * np.sin(angle)
    data, model = arm.model.createData(), arm.model
    torque = np.array([pin.rnea(model, data, *row) for row in zip(position, velocity, acceleration, strict=True)])
    torque += 3.0 * np.sign(velocity) + 2.0 * velocity + 0.2 * np.random.default_rng(1).normal(size=torque.shape)
    for error, within in ((0.0, 1e-9), (0.1, 0.02), (0.5 * math.pi, 0.2)):
        shifted = position + np.array([0.0, error, 0.0])
        run = JointRecord(arm.names, time, shifted, velocity, torque, Path("run"), "")
        found = check_zeros(record_instants(run, arm), arm)
        assert found.error[[0, 2]].tolist() == [0.0, 0.0]
        assert found.error[1] == pytest.approx(error, abs=within)
