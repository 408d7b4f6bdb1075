"""Signs and quarter turns of zeros: what is wrong is named, with what to write instead, and nothing else is."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from excitation_arms import plain_arm, rigid_arm, runs_of
from foreign_arms import some_rows

from benchmarks.excitation_runs import NOISE, FourierMotion, measured
from rx90_common.base.arrays import Array
from rx90_common.base.errors import IdentificationError
from rx90_emulator.identification.arm import RigidArm
from rx90_emulator.identification.checks import Recorded, suspicion
from rx90_emulator.identification.excitation import log_warnings
from rx90_emulator.identification.options import SHIPPED_ROBOT, RobotOptions
from rx90_emulator.identification.rows.excitation import ExcitationProblem
from rx90_emulator.identification.rows.filtering import Bandwidths, FilteredRun, filter_record

GEAR, CONSTANT = [100.0, -80.0, 60.0], [0.2, 0.1, 0.1]


@pytest.fixture(scope="module")
def recorded(tmp_path_factory: pytest.TempPathFactory) -> tuple[RigidArm, tuple[FilteredRun, ...]]:
    """Return a random arm of three joints, whose masses nobody knows, and a run of it with noise."""
    true = plain_arm(3, 3, coupled=False)
    runs = runs_of(true, 100.0, NOISE, Bandwidths(20.0, 8.0), periods=1)
    return rigid_arm(true, tmp_path_factory.mktemp("arm")), runs


def doubt(problem: ExcitationProblem, options: RobotOptions = SHIPPED_ROBOT, zero: Array | None = None) -> str:
    """Return what is said of the equations."""
    return suspicion(problem.arm, Recorded.of(problem), options, zero)[1]


def turned_round(
    recorded: tuple[RigidArm, tuple[FilteredRun, ...]], motion: tuple[int, ...], torque: tuple[int, ...]
) -> ExcitationProblem:
    """Return the equations with the positions and the torques of some joints turned round."""
    arm, runs = recorded
    signs = np.ones((2, len(arm.names)))
    signs[0, list(motion)] = signs[1, list(torque)] = -1.0
    moved = ("position", "velocity", "acceleration")
    turned = [{name: getattr(run, name) * signs[0] for name in moved} for run in runs]
    turned_runs = [replace(run, torque=run.torque * signs[1], **own) for run, own in zip(runs, turned, strict=True)]
    return ExcitationProblem.of(arm, turned_runs)


@pytest.mark.parametrize(
    ("motion", "torque", "said"),
    [
        ((), (0,), r"effort of joint_1: .*--torque-constant -0.2 0.1 0.1,"),
        ((), (1,), r"effort of joint_2: .*--torque-constant 0.2 -0.1 0.1,"),
        ((), (0, 2), r"effort of joint_\d and sign of the effort of joint_\d: .*--torque-constant -0.2 0.1 -0.1,"),
        ((1,), (1,), r"gear of joint_2: .*accepted: --gear 100 80 60,"),
        ((1,), (), r"position of joint_2: .*accepted: --gear 100 80 60 --torque-constant 0.2 -0.1 0.1,"),
    ],
)
def test_a_wrong_sign_is_named_with_what_to_write(
    recorded: tuple[RigidArm, tuple[FilteredRun, ...]], motion: tuple[int, ...], torque: tuple[int, ...], said: str
) -> None:
    """A torque, a gear or a position that is turned round is found on its joint, and the right options are said."""
    problem = turned_round(recorded, motion, torque)
    assert re.search(f"^wrong sign of the {said}", doubt(problem, RobotOptions(gear=GEAR, torque_constant=CONSTANT)))


def test_of_gears_whose_mirror_images_fit_one_is_named(tmp_path: Path) -> None:
    """Of an arm whose axes are upright and level in turn, a wrong gear of joint 4 is one of those of joints 2 and 4."""
    quarter, true = 0.5 * np.pi, plain_arm(3, 4, coupled=False)
    places = (
        ([0.0, 0.0, 0.0], 0.0),
        ([0.0, 0.0, 0.3], quarter),
        ([0.0, 0.0, 0.0], -quarter),
        ([0.0, -0.3, 0.0], quarter),
    )
    links = zip(true.links, places, strict=True)
    true = replace(
        true, links=tuple(replace(link, xyz=np.array(xyz), rpy=np.array([r, 0.0, 0.0])) for link, (xyz, r) in links)
    )
    recorded = rigid_arm(true, tmp_path), runs_of(true, 100.0, NOISE, Bandwidths(20.0, 8.0), periods=1)
    assert re.search("^wrong sign of the gear of joint_[24]: ", doubt(turned_round(recorded, (3,), (3,))))


def test_right_signs_raise_no_alarm(recorded: tuple[RigidArm, tuple[FilteredRun, ...]]) -> None:
    """Nothing is said of a run with right signs, nor of one in which a joint's effort is noise alone."""
    assert doubt(turned_round(recorded, (), ())) == ""
    arm, runs = recorded
    for size in (0.0, 1.0):
        noise = [size * np.random.default_rng(5).normal(size=len(run.torque)) for run in runs]
        torque = [np.column_stack([run.torque[:, :2], own]) for run, own in zip(runs, noise, strict=True)]
        dead = [replace(run, torque=own) for run, own in zip(runs, torque, strict=True)]
        assert doubt(ExcitationProblem.of(arm, dead)) == ""


@pytest.mark.parametrize("encoder", [(0.0, 1.0, 0.0, 0.0), (0.0, 0.0, -0.5, 0.0)])
def test_quarter_turns_of_zeros_are_named(encoder: tuple[float, ...], tmp_path: Path) -> None:
    """Zeros that are quarter turns off come with the better ones, those that were given counted in."""
    true = plain_arm(3, 4, coupled=False)
    arm, runs = rigid_arm(true, tmp_path), runs_of(true, 100.0, NOISE, Bandwidths(25.0, 8.0), (1,), periods=1)
    given, error = np.array([0.0, 0.25, 0.0, 0.0]), np.pi * np.array(encoder)
    problem = ExcitationProblem.of(arm, [replace(run, position=run.position + error) for run in runs])
    text = doubt(problem, zero=given)
    wrong = text.removeprefix("wrong ").split(":")[0].split(" and ")
    assert sorted(wrong) == [f"zero of joint_{k + 1}" for k in np.flatnonzero(error)]
    better = np.array(text.split("--zero ")[1].split(",")[0].split(), dtype=float)
    assert np.angle(np.exp(1j * (better - given - error))) == pytest.approx(0.0, abs=1e-5)


def test_a_second_of_a_log_names_no_sign(tmp_path: Path) -> None:
    """With 1.4 equations for a parameter any sign fits: none is named, and the log is called short."""
    true = plain_arm(5, 5, coupled=False)
    arm, run = rigid_arm(true, tmp_path), measured(true, FourierMotion.random(true, 5, periods=1), 100.0, 5, NOISE)
    records = [some_rows(run.record(true), slice(500, last)) for last in (650, 610)]
    short, shorter = (ExcitationProblem.of(arm, filter_record(one, Bandwidths(20.0, 8.0))) for one in records)
    assert short.parameters < len(short) < 2 * short.parameters
    assert doubt(short) == ""
    assert "short log" in log_warnings(short)[0]
    with pytest.raises(IdentificationError, match=rf"^{len(shorter)} equations .* for {shorter.parameters} parameters"):
        log_warnings(shorter)


def test_a_short_log_names_no_sign_by_chance(tmp_path: Path) -> None:
    """With 4 to 5 equations for a parameter another sign may fit better by chance, of a few per cent of the torque."""
    true = plain_arm(1, 5, coupled=False)
    arm, run = rigid_arm(true, tmp_path), measured(true, FourierMotion.random(true, 1, periods=1), 100.0, 1, NOISE)
    for rows in (slice(200, 460), slice(500, 850)):
        problem = ExcitationProblem.of(arm, filter_record(some_rows(run.record(true), rows), Bandwidths(20.0, 8.0)))
        assert 4.0 < len(problem) / problem.parameters < 6.0
        assert doubt(problem) == ""
