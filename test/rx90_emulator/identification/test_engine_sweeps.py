"""The sliding fit on runs of the closed loop, through a bag of motor states as the drives see them."""

from __future__ import annotations

from collections import defaultdict
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from rx90_common.bags.writing import write_joint_states
from rx90_controller.trajectory import TrajectoryPoints
from rx90_emulator.identification.arm import RigidArm
from rx90_emulator.identification.experiments.plan import PlanOptions, make_plan
from rx90_emulator.identification.records import JointRecord, read_record
from rx90_emulator.identification.robot import arm_layout
from rx90_emulator.identification.sliding.fit import identify_sliding
from rx90_emulator.loop.closed_loop import simulate
from rx90_emulator.loop.setup import Setup

Array = NDArray[np.float64]

HOME = np.array([0.2, 0.3, 0.9, -0.2, 0.4, 0.1])
DIRECTIONS = ((0, 0, 0, 0, 1, 0), (0, 0, 0, 0, 0, 1), (0, 0, 0, 0, 1, 1), (0, 0, 0, 0, 1, -1))


def sweep_program(direction: Array, speeds: Array) -> tuple[list[float], list[Array], list[Array]]:
    """Return times, positions and velocities of stretches at constant velocity, there and back."""
    times, positions, velocities = [0.0], [HOME], [np.zeros(6)]

    def go(duration: float, position: Array, velocity: Array) -> None:
        times.append(times[-1] + duration)
        positions.append(position)
        velocities.append(velocity)

    for speed in speeds:
        ramp, moving = 0.05 + 0.1 * speed, min(1.2, 0.7 / speed)
        for sign in (1.0, -1.0):
            velocity = sign * speed * direction
            start = positions[-1] + velocity * ramp / 2.0
            go(ramp, start, velocity)
            go(moving, start + velocity * moving, velocity)
            go(ramp, start + velocity * (moving + ramp / 2.0), np.zeros(6))
            go(0.1, positions[-1], np.zeros(6))
    return times, positions, velocities


@pytest.fixture(scope="module")
def bags(shipped: Setup, tmp_path_factory: pytest.TempPathFactory) -> list[Path]:
    """Return a bag of the motor states for each direction."""
    folder = tmp_path_factory.mktemp("sweeps")
    paths = []
    names = shipped.robot.joint_names
    for k, direction in enumerate(np.array(DIRECTIONS, dtype=np.float64)):
        times, positions, velocities = sweep_program(direction, np.geomspace(0.012, 1.2, 9))
        points = TrajectoryPoints.create(
            names, names, times[1:], positions[1:], velocities[1:], [np.zeros(6)] * (len(times) - 1)
        )
        result = simulate(shipped, points, HOME, times[-1] + 0.2, 0.1, record_fast=True)
        paths.append(folder / f"bag_{k}")
        write_joint_states(paths[-1], [result.series["motor_states"]])
    return paths


def test_the_engines_friction_comes_back_from_its_bags(shipped: Setup, arm: RigidArm, bags: list[Path]) -> None:
    """Motor-side bags of the closed loop give the friction file's sliding parameters of the wrist."""
    layout = arm_layout("motor_states", shipped.robot.joint_names, own_drives=lambda: shipped.drives)
    records = [read_record(bag, layout, rate=1000.0) for bag in bags]
    fit = identify_sliding(records, arm)
    for e in (4, 5, 6):
        element = shipped.friction.elements[e]
        for name, found in fit.estimates[e].parameters.items():
            assert found.identifiable, (e, name, found.reason)
            assert found.value == pytest.approx(getattr(element, name), rel=0.02), (e, name)
    assert not fit.estimates[0].parameters["c2"].identifiable
    assert fit.estimates[4].sources[0].path == bags[0]


@pytest.fixture(scope="module")
def swept(shipped: Setup) -> JointRecord:
    """Return the record of the shipped plan's sweeps of joint 3."""
    sweep = make_plan(shipped.robot, shipped.drives, PlanOptions(groups=("joint_3",)))[0]
    states = simulate(shipped, sweep.points, sweep.points.position[0], sweep.duration).slow.joint_states
    position, velocity, torque = states[: len(states) // 4 * 4].reshape(-1, 4, 3, 6).mean(axis=1).transpose(1, 0, 2)
    time = 4e-3 * np.arange(len(position))
    return JointRecord(shipped.robot.joint_names, time, position, velocity, torque, Path(sweep.name), "0")


def test_the_shipped_plan_separates_gravity_from_coulomb_friction(
    shipped: Setup, arm: RigidArm, swept: JointRecord
) -> None:
    """The plan's sweeps of joint 3 give its sliding parameters within 2 % and within 4 deviations, both directions."""
    for name, found in identify_sliding([swept], arm).estimates[2].parameters.items():
        truth = getattr(shipped.friction.elements[2], name)
        assert found.value == pytest.approx(truth, rel=0.02), name
        assert abs(found.value - truth) < 4.0 * found.deviation, name


def test_a_record_in_pieces_is_no_surer_than_it_is_right(shipped: Setup, arm: RigidArm, swept: JointRecord) -> None:
    """With gaps that leave most plateaus one block of samples, identifiable values are within 3 deviations.

    Where the gaps lie decides on each value by chance, so that is asked of the median of three ways to lay them.
    """
    deviations: dict[str, list[float]] = defaultdict(list)
    for phase in (0.0, 0.23, 0.47):
        kept = (swept.time + phase) % 0.7 > 0.21
        fields = {name: getattr(swept, name)[kept] for name in ("time", "position", "velocity", "torque")}
        for name, found in identify_sliding([replace(swept, **fields)], arm).estimates[2].parameters.items():
            if found.identifiable:
                error = abs(found.value - getattr(shipped.friction.elements[2], name))
                deviations[name].append(error / found.deviation)
    assert {"tau_c_positive", "tau_c_negative", "c2"} <= set(deviations)
    for name, found_off in deviations.items():
        assert np.median(found_off) < 3.0, (name, found_off)
