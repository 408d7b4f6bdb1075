"""The planned motions: within the arm's limits, separating the elements, run into bags of the right topics."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from rx90_common.bags.reading import BagReader, read_joint_states
from rx90_common.base.errors import ConfigError, IdentificationError
from rx90_common.description.robot_files import RobotFiles
from rx90_controller.trajectory.motion import Motion
from rx90_emulator.identification.experiments.arms import PlannedArm
from rx90_emulator.identification.experiments.plan import (
    Experiment,
    Kind,
    PlanOptions,
    directions,
    make_plan,
    plan_experiments,
    poses_of,
    read_index,
    sweep_speeds,
)
from rx90_emulator.loop.setup import Setup

pytestmark = pytest.mark.slow

HOME = (0.0,) * 6


def test_the_plan_keeps_every_limit(shipped: Setup) -> None:
    """Each experiment of the default plan stays within ranges, speeds and torques, by the controller's own check."""
    for experiment in make_plan(shipped.robot, shipped.drives):
        assert np.allclose(experiment.points.position[[0, -1]], poses_of(shipped).home.position, atol=1e-12)
        used = PlannedArm.from_setup(shipped).check(experiment)
        assert all(share <= 1.0 for share, _ in used.values())


def test_a_robot_brings_its_own_poses_and_its_ranges_bound_the_sweeps(tx40: Setup) -> None:
    """The TX40's joint 6, whose fastest sweep would take more room than it has, is swept more slowly and within it."""
    sweep = plan_experiments(tx40, ["joint_6"], quick=True)[0]
    assert 0.3 < PlannedArm.from_setup(tx40).check(sweep)["speed"][0] < 0.4
    with pytest.raises(ConfigError, match=r"no poses.yaml; accepted: a poses file"):
        plan_experiments(replace(tx40, files=replace(tx40.files or RobotFiles(), poses=None)))


def test_sweeps_hold_a_logarithmic_range_in_both_directions(shipped: Setup) -> None:
    """Joint 1 is held at 28 speeds in each direction, all different, evenly spaced in their logarithms."""
    points = make_plan(shipped.robot, shipped.drives, PlanOptions(groups=("joint_1",)))[0].points
    assert points.velocity is not None
    same = (points.velocity[:-1, 0] == points.velocity[1:, 0]) & (points.velocity[:-1, 0] != 0.0)
    held, lasting = points.velocity[:-1, 0][same], np.diff(points.times)[same]
    assert lasting == pytest.approx(np.clip(0.6 / np.abs(held), 0.7, 4.0), abs=1.001e-3)
    nominal = np.log(np.geomspace(0.004, 0.4 * shipped.robot.max_velocity[0], 56))
    for sign, first in ((1.0, 0), (-1.0, 1)):
        speeds = np.unique(np.round(held[sign * held > 0.0] * sign, 9))
        assert len(speeds) == PlanOptions().speeds
        # A speed lies below its nominal place by less than the next one's distance, away from a beat with the sampling.
        below = nominal[first::2] - np.log(speeds)
        assert below.min() > -1e-6
        assert below.max() < nominal[1] - nominal[0]


def test_no_sweep_beats_with_the_sampling(shipped: Setup) -> None:
    """No motor passes nearly a whole, half, third or quarter number of encoder steps in a millisecond of a sweep."""
    drives = shipped.drives
    for name, direction in directions(shipped.robot.joint_names, drives.turning).items():
        speeds = sweep_speeds(direction, 0.004, 1.4, 56, drives)
        motors = drives.gear * direction
        motors[5] = drives.gear[5] * (direction[4] + direction[5])
        steps = np.outer(speeds, np.abs(motors[motors != 0.0])) * drives.encoder_counts / (2.0 * np.pi) * 1e-3
        parts = steps[..., None] * np.array([1.0, 2.0, 3.0, 4.0])
        assert np.abs(parts - np.round(parts)).min() > 0.05, name


def test_oscillations_are_what_they_say() -> None:
    """In the middle of an oscillation the knots' position, velocity and acceleration are those of the sine."""
    motion = Motion(np.zeros(6))
    motion.oscillate(np.eye(6)[2], [1e-4], [8.0], 4.0)
    points = motion.points([f"joint_{i}" for i in range(1, 7)])
    assert points.velocity is not None
    assert points.acceleration is not None
    middle = (points.times > 1.1) & (points.times < 2.9)
    omega, time = 16.0 * np.pi, points.times[middle]
    assert np.allclose(points.position[middle, 2], 1e-4 * np.sin(omega * time), atol=1e-12)
    assert np.allclose(points.velocity[middle, 2], 1e-4 * omega * np.cos(omega * time), atol=1e-10)
    assert np.allclose(points.acceleration[middle, 2], -1e-4 * omega**2 * np.sin(omega * time), atol=1e-8)


def test_a_plan_beyond_what_joints_or_motors_may_do_is_refused(shipped: Setup) -> None:
    """More torque than the URDF allows, or acceleration than the controller, is refused with joint, value and limit."""
    robot, drives = shipped.robot, shipped.drives
    sweep_2, sweep_5 = (make_plan(robot, drives, PlanOptions(groups=(f"joint_{k}",)))[0] for k in (2, 5))
    way = 1.5 * robot.max_velocity / robot.max_velocity[4] * (0.0, 0.0, 0.0, 0.0, 1.0, 1.0)
    motion = Motion(-way)
    motion.move(way, 0.9 * robot.max_velocity, 100.0)
    fast = Experiment("fast", Kind.VALIDATION, motion.points(robot.joint_names), 1)
    both = 0.9 * (1.0 + robot.max_velocity[4] / robot.max_velocity[5])
    weak = drives.replaced(motor={"peak_current": drives.peak_current * (1.0, 1.0, 1.0, 1.0, 0.1, 1.0)})
    slow = shipped.controller.replaced(trajectory={"max_acceleration": np.full(6, 4.9)})
    for experiment, setup, said in (
        (sweep_2, replace(shipped, robot=replace(robot, max_effort=0.4 * robot.max_effort)),
         r"joint_2 would need 2\d\d% of its torque; accepted: up to"),
        (sweep_2, replace(shipped, controller=slow),
         r"joint_\d gets a set-point acceleration .* accepted: \[-4.9, 4.9\]"),
        (fast, shipped, rf"fast: motor_6 would need {both:.0%} of its motor speed"),
        (sweep_5, replace(shipped, drives=weak),
         r"motor_5 would need .* of its motor torque"),
    ):  # fmt: skip
        with pytest.raises(IdentificationError, match=said):
            PlannedArm.from_setup(setup).check(experiment)


def test_the_engine_writes_the_bags_that_the_recorder_would(series: Path) -> None:
    """A series on the engine has an index and bags with joint states, motor states and set-points."""
    bags = read_index(series)
    assert [bag.name for bag in (*bags.sliding, *bags.presliding, *bags.validation)] == [
        "sliding_joint_3",
        "presliding_joint_3",
        "validation",
    ]
    wanted = [{"joint_states"}, {"motor_states"}, {"motor_states", "rx90_controller/reference"}]
    for bag, topics in zip((*bags.sliding, *bags.presliding, *bags.validation), wanted, strict=True):
        with BagReader(bag) as reader:
            assert {there.name for there in reader.topics} == {f"/{topic}" for topic in (*topics, "robot_description")}
    for bag in (*bags.presliding, *bags.validation):
        assert np.median(np.diff(read_joint_states(bag, "motor_states").stamp_ns)) == 250_000
