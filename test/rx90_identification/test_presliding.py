"""c0 and c1: known in, known out, and what the data do not tell is said."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from benchmarks.presliding_runs import outcomes, random_bristles, recorded, run_presliding, sliding_covariance
from benchmarks.synthetic_sweeps import Noise
from rx90_identification.errors import IdentificationError
from rx90_identification.experiments.plan import PlanOptions
from rx90_identification.presliding import PreslidingFit, identify_presliding, joint_groups
from rx90_identification.record import JointRecord
from rx90_identification.rigid_arm import RigidArm
from rx90_loop.setup import Setup

Array = NDArray[np.float64]


def micro_records(setup: Setup, groups: Sequence[str], noise: float, *seeds: int) -> list[list[JointRecord]]:
    """Run presliding experiments once and return records for each seed; noise in parts of the rig's."""
    options = PlanOptions(groups=tuple(groups), burst=4.0)  # half of the plan's
    runs = run_presliding(setup, options)
    level = Noise(noise * Noise.torque)
    return [[recorded(setup, run, np.random.default_rng((seed, 1)), level) for run in runs] for seed in seeds]


def random_set(setup: Setup, seed: int) -> Setup:
    """Return the setup with every parameter of every element changed by up to a half."""
    return replace(setup, friction=random_bristles(setup.friction, np.random.default_rng(seed)))


def fitted(
    setup: Setup, records: Sequence[JointRecord], sliding_covariances: Sequence[Array] | None = None
) -> PreslidingFit:
    """Identify records of this project's engine with the true sliding regime."""
    arm, elements = RigidArm.from_setup(setup), setup.friction.elements
    return identify_presliding(records, arm, elements, 0.0, sliding_covariances, setup.rates.period)


@pytest.mark.parametrize(("noise", "seed"), [(0.0, 1), (0.5, 3)])
def test_known_bristles_come_out(shipped: Setup, noise: float, seed: int) -> None:
    """From quantised encoders and noisy torques c0 comes back within 5 % and c1 within 15 %, joints 2 to 4."""
    setup = random_set(shipped, seed)
    (records,) = micro_records(setup, ["joint_2", "joint_3", "joint_4"], noise, seed)
    fit = fitted(setup, records)
    for outcome in outcomes(fit.estimates[1:4], setup.friction.elements[1:4]):
        assert abs(outcome.error) < {"c0": 0.05, "c1": 0.15}[outcome.parameter], outcome


def test_bristles_of_the_wrist_separate(shipped: Setup) -> None:
    """The elements of joints 5, 6 and 5+6 come back apart from each other, c0 within 5 % and c1 within 15 %."""
    setup = random_set(shipped, 4)
    (records,) = micro_records(setup, ["joint_5", "joint_6", "joints_5_6_against"], 0.5, 4)
    fit = fitted(setup, records)
    for outcome in outcomes(fit.estimates[4:], setup.friction.elements[4:]):
        assert abs(outcome.error) < {"c0": 0.05, "c1": 0.15}[outcome.parameter], outcome


def test_intervals_hold_the_truth(shipped: Setup) -> None:
    """Of 20 intervals from ten draws of the rig's noise, 16 or more hold the truth, and errors share no sign."""
    setup = random_set(shipped, 2)
    found = []
    for records in micro_records(setup, ["joint_4"], 1.0, *range(10)):
        fit = fitted(setup, records)
        found += outcomes(fit.estimates[3:4], setup.friction.elements[3:4])
    scores = np.array([outcome.score for outcome in found])
    assert np.sum(np.abs(scores) < 1.96) >= 16, scores
    for name in ("c0", "c1"):
        own = [outcome.score for outcome in found if outcome.parameter == name]
        assert abs(np.mean(own)) < 1.2, own  # nearly four deviations of such a mean
        assert np.std(own) > 0.3, own  # deviations are not too large either


def test_too_much_noise_gives_no_wrong_number(shipped: Setup) -> None:
    """Twenty times the rig's noise leaves every parameter of the wrist untold or within four deviations."""
    setup = random_set(shipped, 6)
    (records,) = micro_records(setup, ["joint_5", "joint_6", "joints_5_6_against"], 20.0, 6)
    fit = fitted(setup, records)
    found = outcomes(fit.estimates[4:], setup.friction.elements[4:])
    assert any(not outcome.told for outcome in found)
    assert all(abs(outcome.score) < 4.0 for outcome in found if outcome.told), found


def test_errors_of_the_sliding_regime_widen_the_deviations(shipped: Setup) -> None:
    """A sliding regime with deviations leaves c0 and c1 as they are and makes them less certain."""
    (records,) = micro_records(shipped, ["joint_4"], 0.0, 0)
    spreads = [sliding_covariance(element) for element in shipped.friction.elements]
    known = fitted(shipped, records).estimates[3].parameters
    assumed = fitted(shipped, records, spreads).estimates[3].parameters
    for name in ("c0", "c1"):
        assert assumed[name].value == known[name].value
        assert assumed[name].deviation > 1.05 * known[name].deviation


def test_loops_of_measurement_and_simulation_agree(shipped: Setup) -> None:
    """Without torque noise the simulated friction torque follows the measured one within a tenth of its size."""
    (records,) = micro_records(shipped, ["joint_1"], 0.0, 0)
    fit = fitted(shipped, records)
    (loop,) = (loop for loop in fit.loops if loop.joint == "joint_1")
    assert np.std(loop.torque - loop.simulated_torque) < 0.1 * np.std(loop.torque)


def test_an_element_without_micro_motion_is_not_told(shipped: Setup) -> None:
    """Joints that did not oscillate get no number but a reason."""
    (records,) = micro_records(shipped, ["joint_4"], 0.0, 0)
    fit = fitted(shipped, records)
    first, fourth = fit.estimates[0].parameters["c0"], fit.estimates[3].parameters["c0"]
    assert fourth.identifiable
    assert not first.identifiable
    assert np.isnan(first.value)
    assert "micro-oscillation" in first.reason


def test_no_reversal_is_refused(shipped: Setup) -> None:
    """A record without small reversals is refused with its name and what is accepted."""
    time = np.arange(4000) / 1000.0
    still = np.zeros((4000, 6))
    record = JointRecord(shipped.robot.joint_names, time, still, still, still, Path("still"), "0")
    with pytest.raises(IdentificationError, match=r"still: no velocity reversals small enough"):
        identify_presliding([record], RigidArm.from_setup(shipped), shipped.friction.elements)


def test_a_slow_record_is_refused(shipped: Setup) -> None:
    """A record of 100 samples per second is refused with its rate."""
    time = np.arange(400) / 100.0
    still = np.zeros((400, 6))
    record = JointRecord(shipped.robot.joint_names, time, still, still, still, Path("slow"), "0")
    with pytest.raises(IdentificationError, match=r"slow: 100 samples per second; accepted: 500"):
        identify_presliding([record], RigidArm.from_setup(shipped), shipped.friction.elements)


def test_joints_that_share_an_element_are_fitted_together(shipped: Setup) -> None:
    """Joints 5 and 6 form one group, every other joint its own."""
    assert joint_groups(RigidArm.from_setup(shipped)) == [(0,), (1,), (2,), (3,), (4, 5)]
