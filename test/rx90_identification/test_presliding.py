"""c0 and c1: known in, known out, and what the data do not tell is said."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from rx90_identification.errors import IdentificationError
from rx90_identification.experiments.plan import PlanOptions, make_plan
from rx90_identification.presliding import identify_presliding, joint_groups
from rx90_identification.record import JointRecord
from rx90_identification.rigid_arm import RigidArm
from rx90_loop.closed_loop import simulate
from rx90_loop.setup import Setup
from rx90_sim.friction import FrictionSet

STEADY_TORQUE = np.array([318.0, 166.0, 76.0, 34.0, 29.0, 11.0])


def micro_records(setup: Setup, groups: Sequence[str], noise: float, seed: int) -> list[JointRecord]:
    """Run presliding experiments and return encoders and torques, with white noise, a share of steady torque."""
    generator = np.random.default_rng(seed)
    gear = setup.drives.gear
    records = []
    # Two of the plan's four amplitudes, those that bend light joints, for time.
    options = PlanOptions(groups=tuple(groups), presliding_cycles=(2e-3, 1e-3), tone_amplitudes=(4e-5, 1e-5))
    for experiment in make_plan(setup.robot, setup.drives, options):
        if experiment.kind != "presliding":
            continue
        run = simulate(setup, experiment.points, np.zeros(6), experiment.duration, record_fast=True)
        assert run.fast is not None
        position, velocity, torque = run.fast.motor_states.transpose(1, 0, 2)
        torque = torque * gear + noise * STEADY_TORQUE * generator.standard_normal(torque.shape)
        torque[:, 4] += torque[:, 5]
        position, velocity = position / gear, velocity / gear
        position[:, 5] -= position[:, 4]
        velocity[:, 5] -= velocity[:, 4]
        time = np.arange(len(position)) * setup.rates.period
        name = Path(experiment.name)
        records.append(JointRecord(setup.robot.joint_names, time, position, velocity, torque, name, experiment.name))
    return records


def random_set(setup: Setup, seed: int) -> Setup:
    """Return the setup with c0 and c1 of every element changed by up to a third."""
    generator = np.random.default_rng(seed)
    elements = [
        replace(e, c0=e.c0 * generator.uniform(0.75, 1.33), c1=e.c1 * generator.uniform(0.75, 1.33))
        for e in setup.friction.elements
    ]
    return replace(setup, friction=FrictionSet(setup.friction.names, tuple(elements)))


@pytest.mark.parametrize(("noise", "seed"), [(0.0, 1), (0.002, 3)])
def test_known_bristles_come_out(shipped: Setup, noise: float, seed: int) -> None:
    """From quantised encoders and noisy torques c0 comes back within 5 % and c1 within 15 %, joints 1 to 4."""
    setup = random_set(shipped, seed)
    records = micro_records(setup, [f"joint_{k}" for k in range(1, 5)], noise, seed)
    fit = identify_presliding(records, RigidArm.from_setup(setup), setup.friction.elements)
    for estimate, truth in list(zip(fit.estimates, setup.friction.elements, strict=True))[:4]:
        assert abs(estimate.parameters["c0"].value / truth.c0 - 1.0) < 0.05, estimate.element
        assert abs(estimate.parameters["c1"].value / truth.c1 - 1.0) < 0.15, estimate.element


def test_bristles_of_the_wrist_separate(shipped: Setup) -> None:
    """The elements of joints 5, 6 and 5+6 come back apart from each other, c0 within 5 % and c1 within 15 %."""
    setup = random_set(shipped, 5)
    records = micro_records(setup, ["joint_5", "joint_6", "joints_5_6_against"], 0.0005, 5)
    fit = identify_presliding(records, RigidArm.from_setup(setup), setup.friction.elements)
    for estimate, truth in list(zip(fit.estimates, setup.friction.elements, strict=True))[4:]:
        assert abs(estimate.parameters["c0"].value / truth.c0 - 1.0) < 0.05, estimate.element
        assert abs(estimate.parameters["c1"].value / truth.c1 - 1.0) < 0.15, estimate.element


def test_loops_of_measurement_and_simulation_agree(shipped: Setup) -> None:
    """The simulated micro-motion follows the measured one within the encoder's resolution."""
    records = micro_records(shipped, ["joint_1"], 0.0, 0)
    fit = identify_presliding(records, RigidArm.from_setup(shipped), shipped.friction.elements)
    (loop,) = (loop for loop in fit.loops if loop.joint == "joint_1")
    resolution = 2.0 * np.pi / 65536 / shipped.drives.gear[0]
    assert np.std(loop.position - loop.simulated_position) < resolution


def test_an_element_without_micro_motion_is_not_told(shipped: Setup) -> None:
    """Joints that did not oscillate get no number but a reason."""
    records = micro_records(shipped, ["joint_4"], 0.0, 0)
    fit = identify_presliding(records, RigidArm.from_setup(shipped), shipped.friction.elements)
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
