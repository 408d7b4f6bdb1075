"""c0 and c1: known in, known out, and what is not identifiable is reported as such."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import yaml
from numpy.typing import NDArray
from scipy.fft import next_fast_len

from benchmarks.presliding_runs import outcomes, random_bristles, recorded, run_presliding, sliding_covariance
from benchmarks.synthetic_sweeps import Noise
from rx90_common.base.errors import IdentificationError
from rx90_common.base.share import config_path
from rx90_common.description.robot_files import RobotFiles
from rx90_emulator.identification.arm import RigidArm
from rx90_emulator.identification.experiments.plan import PlanOptions
from rx90_emulator.identification.presliding.bristle_motion import joint_groups
from rx90_emulator.identification.presliding.fit import PreslidingFit, identify_presliding
from rx90_emulator.identification.presliding.micro_motion import fast_length
from rx90_emulator.identification.records import JointRecord
from rx90_emulator.loop.setup import Setup

Array = NDArray[np.float64]

WRIST = ["joint_5", "joint_6", "joints_5_6_against"]
FOURTH = 3  # joint 4: its index, and its element's


def test_the_transform_s_length_is_the_next_fast_one_below() -> None:
    """SciPy calls each length fast that is used, and none between it and the number of block means."""
    lengths = [*range(1, 200), 12345, 65537]
    for longest in lengths:
        length = fast_length(longest)
        assert next_fast_len(length, real=True) == length <= longest < next_fast_len(length + 1, real=True)


def micro_records(setup: Setup, groups: Sequence[str], noise: float, *seeds: int) -> list[list[JointRecord]]:
    """Run presliding experiments once and return records for each seed; noise in parts of the rig's."""
    heavy = not set(groups) <= set(WRIST)
    options = PlanOptions(
        groups=tuple(groups),
        burst=3.0,  # the plan's is 8
        presliding_cycles=(2e-3,) * 3,
        tone_amplitudes=(2.4e-4, 1.2e-4, 5e-5) if heavy else (5e-5, 1.6e-5, 6e-6),
    )
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


@pytest.mark.parametrize("seed", [4, 5])
def test_bristles_of_the_wrist_separate(shipped: Setup, seed: int) -> None:
    """The elements of joints 5, 6 and 5+6 come back apart, also where 6 and 5+6 are so weak that they break away."""
    setup = random_set(shipped, seed)
    (records,) = micro_records(setup, WRIST, 0.25, seed)
    fit = fitted(setup, records)
    for outcome in outcomes(fit.estimates[4:], setup.friction.elements[4:]):
        assert abs(outcome.error) < {"c0": 0.05, "c1": 0.15}[outcome.parameter], outcome
        assert abs(outcome.score) < 4.0, outcome


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
    """Twenty times the rig's noise leaves every parameter of the wrist not identifiable or within four deviations."""
    setup = random_set(shipped, 6)
    (records,) = micro_records(setup, WRIST, 20.0, 6)
    fit = fitted(setup, records)
    found = outcomes(fit.estimates[4:], setup.friction.elements[4:])
    assert any(not outcome.identifiable for outcome in found)
    assert all(abs(outcome.score) < 4.0 for outcome in found if outcome.identifiable), found


def test_errors_of_the_sliding_regime_widen_the_deviations(shipped: Setup) -> None:
    """A sliding regime with ten times the usual deviations leaves c0 and c1 as they are and makes them less certain."""
    (records,) = micro_records(shipped, ["joint_4"], 0.0, 0)
    spreads = [100.0 * sliding_covariance(element) for element in shipped.friction.elements]
    known = fitted(shipped, records).estimates[3].parameters
    assumed = fitted(shipped, records, spreads).estimates[3].parameters
    for name in ("c0", "c1"):
        assert assumed[name].value == known[name].value
        assert assumed[name].deviation > 1.2 * known[name].deviation


def test_loops_of_measurement_and_simulation_agree(shipped: Setup) -> None:
    """Without torque noise the simulated friction torque follows the measured one within 7 % of its size."""
    (records,) = micro_records(shipped, ["joint_1"], 0.0, 0)
    fit = fitted(shipped, records)
    (loop,) = (loop for loop in fit.loops if loop.joint == "joint_1")
    assert np.std(loop.torque - loop.simulated_torque) < 0.07 * np.std(loop.torque)


def test_an_element_without_micro_motion_is_not_identifiable(shipped: Setup) -> None:
    """Joints that did not oscillate get no number but a reason."""
    (records,) = micro_records(shipped, ["joint_4"], 0.0, 0)
    fit = fitted(shipped, records)
    first, fourth = fit.estimates[0].parameters["c0"], fit.estimates[3].parameters["c0"]
    assert fourth.identifiable
    assert not first.identifiable
    assert np.isnan(first.value)
    assert "micro-oscillation" in first.reason


@pytest.fixture(scope="module")
def fourth(shipped: Setup) -> tuple[Setup, JointRecord]:
    """Return a set of friction and a record of joint 4 at half the rig's noise."""
    setup = random_set(shipped, 3)
    ((record,),) = micro_records(setup, ["joint_4"], 0.5, 3)
    return setup, record


def without_rows(record: JointRecord, lost: NDArray[np.bool_]) -> JointRecord:
    """Return the record without some of its samples."""
    rows = {name: getattr(record, name)[~lost] for name in ("time", "position", "velocity", "torque")}
    return replace(record, **rows)


def few_missing(record: JointRecord) -> JointRecord:
    """Return the record with 1 % of its messages missing."""
    return without_rows(record, np.random.default_rng(1).random(len(record.time)) < 0.01)


def with_gaps(record: JointRecord) -> JointRecord:
    """Return the record with a gap of 0.2 s in every 3 s."""
    return without_rows(record, (record.time + 0.7) % 3.0 < 0.2)


def with_spikes(record: JointRecord) -> JointRecord:
    """Return the record with spikes of a single sample in effort and position, two in a second."""
    rng = np.random.default_rng(2)
    torque, position = record.torque.copy(), record.position.copy()
    for values, size in ((torque, 100.0), (position, 2e-3)):
        rows = rng.integers(0, len(values), int(record.time[-1]))
        values[rows, FOURTH] += size * rng.choice([-1.0, 1.0], len(rows))
    return replace(record, torque=torque, position=position)


@pytest.mark.parametrize("corrupt", [few_missing, with_gaps, with_spikes])
def test_corrupted_records_give_the_same_bristles(
    fourth: tuple[Setup, JointRecord], corrupt: Callable[[JointRecord], JointRecord]
) -> None:
    """Missing messages, gaps and spikes leave c0 within 5 % and c1 within 15 %."""
    setup, record = fourth
    fit = fitted(setup, [corrupt(record)])
    for outcome in outcomes(fit.estimates[FOURTH:][:1], setup.friction.elements[FOURTH:][:1]):
        assert abs(outcome.error) < {"c0": 0.05, "c1": 0.15}[outcome.parameter], outcome


def heavier(arm: RigidArm) -> RigidArm:
    """Return an arm whose inertias are twice as large."""
    model = arm.model.copy()
    for body in list(model.inertias)[1:]:
        body.mass, body.inertia = 2.0 * body.mass, 2.0 * body.inertia
    return replace(arm, model=model, rotor=2.0 * arm.rotor)


def test_a_wrong_inertia_gives_a_reason(fourth: tuple[Setup, JointRecord]) -> None:
    """Inertias wrong by a factor of 2 give no number, and the joint's name in the reason."""
    setup, record = fourth
    arm = heavier(RigidArm.from_setup(setup))
    fit = identify_presliding([record], arm, setup.friction.elements, 0.0, None, setup.rates.period)
    for estimate in fit.estimates[FOURTH].parameters.values():
        assert "the inertia at joint_4 would be" in estimate.reason


@pytest.mark.parametrize("delay", [5e-3, -5e-3])
def test_a_wrong_delay_of_the_torque_gives_a_reason(fourth: tuple[Setup, JointRecord], delay: float) -> None:
    """A torque stamped 5 ms early or late gives no number, and a reason that names the delay."""
    setup, record = fourth
    arm = RigidArm.from_setup(setup)
    fit = identify_presliding([record], arm, setup.friction.elements, delay, None, setup.rates.period)
    for estimate in fit.estimates[FOURTH].parameters.values():
        assert not estimate.identifiable
        assert "delay" in estimate.reason


def test_a_joint_that_slides_gives_a_reason(shipped: Setup) -> None:
    """Oscillations that break the bristles away throughout give no number but say so."""
    options = PlanOptions(
        groups=("joint_6",), burst=4.0, presliding_cycles=(2e-3,) * 2, tone_amplitudes=(2.4e-3, 1.5e-3)
    )
    runs = run_presliding(shipped, options)
    rng = np.random.default_rng(0)
    fit = fitted(shipped, [recorded(shipped, run, rng, Noise(0.0)) for run in runs])
    for estimate in fit.estimates[5].parameters.values():
        assert "slide in every micro-oscillation" in estimate.reason


def test_an_unknown_payload_gives_no_wrong_bristles(shipped: Setup, tmp_path: Path) -> None:
    """With 1 kg on the flange that the description lacks, the wrist's c0 and c1 are right or not identifiable."""
    file = tmp_path / "tool.yaml"
    tool = yaml.safe_load(config_path("robots/rx90b/tool.yaml").read_text(encoding="utf-8"))
    # The tool with a point mass of 1 kg at (0.03, -0.02, 0.15) m.
    tool["inertial"]["mass"] = 4.5
    tool["inertial"]["center_of_mass"] = [0.00667, -0.00444, 0.11111]
    tool["inertial"]["inertia"] = [0.01226, 0.01264, 0.00601, 0.00047, -0.00117, 0.00078]
    file.write_text(yaml.safe_dump(tool), encoding="utf-8")
    loaded = Setup.load(RobotFiles(tool=file))
    (records,) = micro_records(loaded, WRIST, 0.5, 0)
    fit = fitted(shipped, records)
    found = outcomes(fit.estimates[4:], shipped.friction.elements[4:])
    assert not all(outcome.identifiable for outcome in found)
    for outcome in found:
        if outcome.identifiable:
            assert abs(outcome.error) < {"c0": 0.05, "c1": 0.15}[outcome.parameter], outcome


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
    groups = joint_groups(RigidArm.from_setup(shipped))
    assert [group.joints for group in groups] == [(0,), (1,), (2,), (3,), (4, 5)]
