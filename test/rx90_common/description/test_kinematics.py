"""Pose, Jacobian, bias acceleration, inverse kinematics, singularity margins and path error."""

import itertools
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest

from rx90_common.description.branch import SHOULDERS, SIGNS, Branch
from rx90_common.description.chain import RigidChain
from rx90_common.description.inverse import SphericalWristArm, nearest_turn, singularity_margins, solve_anywhere
from rx90_common.description.kinematics import (
    bias_acceleration,
    decompose,
    forward,
    jacobian,
    path_error,
    polyline_error,
    tip_position,
)
from rx90_common.description.robot import RobotModel, load_robot
from rx90_emulator.loop.setup import Setup


def _states(robot: RobotModel, count: int, seed: int = 3) -> np.ndarray:
    return np.random.default_rng(seed).uniform(robot.lower, robot.upper, (count, 6))


def _check_against_pinocchio(robot: RobotModel) -> None:
    data, frame = robot.model.createData(), robot.model.getFrameId(robot.tcp_frame)
    q, v = _states(robot, 10), np.random.default_rng(4).normal(size=(10, 6))
    pose, ours, bias = forward(robot.chain, q), jacobian(robot.chain, q), bias_acceleration(robot.chain, q, v)
    tips = tip_position(robot.chain, q)
    for k in range(10):
        pin.computeJointJacobians(robot.model, data, q[k])
        oracle = pin.getFrameJacobian(robot.model, data, frame, pin.LOCAL_WORLD_ALIGNED)
        np.testing.assert_allclose(ours[k], oracle, atol=1e-12)
        pin.forwardKinematics(robot.model, data, q[k], v[k], np.zeros(6))
        pin.updateFramePlacements(robot.model, data)
        for position in (pose.position[k], tips[k]):
            np.testing.assert_allclose(position, data.oMf[frame].translation, atol=1e-12)
        np.testing.assert_allclose(pose.rotation[k], data.oMf[frame].rotation, atol=1e-12)
        acceleration = pin.getFrameClassicalAcceleration(robot.model, data, frame, pin.LOCAL_WORLD_ALIGNED)
        np.testing.assert_allclose(bias[k], acceleration.vector, atol=1e-11)


def test_any_serial_arm_is_the_urdf_seen_by_pinocchio(random_arm: Callable[[int], Path], shipped: Setup) -> None:
    """The shipped arm, and arms with any frames, axes and a side branch, whose names tell no order, move as there."""
    _check_against_pinocchio(shipped.robot)
    for seed in range(4):
        robot = load_robot(random_arm(seed), shipped.files.tool)
        assert robot.joint_names == ("turn_9", "turn_8", "turn_7", "turn_6", "turn_5", "turn_4")
        np.testing.assert_array_equal(robot.max_effort, np.arange(10.0, 16.0))
        _check_against_pinocchio(robot)


def _offset_arm(chain: RigidChain) -> RigidChain:
    origin = chain.origin.copy()
    origin[0] += [0.03, -0.02, 0.0]
    origin[1] += [0.15, 0.05, 0.02]
    origin[2] += [-0.02, -0.03, 0.0]
    origin[3] += [0.08, 0.02, 0.1]
    axis = chain.axis * np.array([-1, 1, -1, 1, -1, -1])[:, None]
    return chain._replace(origin=origin, axis=axis)


@pytest.mark.parametrize("change", [lambda chain: chain, _offset_arm])
def test_one_of_eight_solutions_is_where_it_was(shipped: Setup, change: Callable[[RigidChain], RigidChain]) -> None:
    """One branch gives random angles back, up to whole turns, the others their pose; also of another arm."""
    chain = change(shipped.robot.chain)
    arm = SphericalWristArm.from_chain(chain)
    q = _states(shipped.robot, 200)
    pose = forward(chain, q)
    found = np.zeros(200)
    for branch in itertools.starmap(Branch, itertools.product(SHOULDERS, SIGNS, SIGNS)):
        solution = arm.solve(chain, pose, branch)
        there = ~np.isnan(solution).any(axis=1)
        assert np.abs(forward(chain, solution[there]).position - pose.position[there]).max() < 1e-12
        found += np.abs(nearest_turn(solution, q) - q).max(axis=1) < 1e-8
    np.testing.assert_array_equal(found, np.ones(200))


def test_other_arms_are_solved_by_newton_steps_alone(random_arm: Callable[[int], Path]) -> None:
    """Without a spherical wrist the search finds the pose, and the same angles at every call."""
    robot = load_robot(random_arm(7))
    assert SphericalWristArm.from_chain(robot.chain) is None
    pose = forward(robot.chain, _states(robot, 1)[0])
    first, second = (solve_anywhere(robot, pose) for _ in range(2))
    np.testing.assert_array_equal(first, second)
    np.testing.assert_allclose(forward(robot.chain, first).position, pose.position, atol=1e-11)


def test_margins_multiply_to_the_determinant(shipped: Setup) -> None:
    """|det J| is the product of the three margins, both arm lengths and the reach, at random states."""
    robot = shipped.robot
    q = _states(robot, 200)
    product = np.prod(list(singularity_margins(robot.chain, q).values()), axis=0) * 0.45 * 0.45 * 0.9
    np.testing.assert_allclose(np.abs(np.linalg.det(jacobian(robot.chain, q))), product, atol=1e-14)


@pytest.mark.parametrize(
    ("kind", "q"),
    [
        ("wrist", [0.3, 0.4, 1.0, 0.2, 0.0, 0.1]),
        ("elbow", [0.3, 0.4, 0.0, 0.2, 0.7, 0.1]),
        ("shoulder", [0.3, -0.5, 1.0, 0.2, 0.7, 0.1]),
    ],
)
def test_each_kind_of_singularity_has_its_own_margin(shipped: Setup, kind: str, q: list[float]) -> None:
    """Straight wrist, stretched arm and wrist above axis 1 bring their own margin to 0, no other."""
    margins = singularity_margins(shipped.robot.chain, np.array(q))
    assert margins.pop(kind) == pytest.approx(0.0, abs=1e-15)
    assert min(margins.values()) > 0.1


def test_path_error_of_known_points() -> None:
    """Points beside, before and past a line have the distances of elementary geometry, in any frame."""
    rng = np.random.default_rng(8)
    turn, shift = np.linalg.qr(rng.normal(size=(3, 3)))[0], rng.normal(size=3)
    points = np.array([[1.0, 3, 4], [-2, 0, 0], [5, 0, 1], [2, 0, 0]]) @ turn.T
    error = path_error(points + shift, shift, 4.0 * turn[:, 0] + shift)
    np.testing.assert_allclose(error.along, [1, -2, 5, 2])
    np.testing.assert_allclose(error.perpendicular, [5, 0, 1, 0], atol=1e-13)
    along, across = decompose(points, 4.0 * turn[:, 0])
    np.testing.assert_allclose(along, [1, -2, 5, 2])
    np.testing.assert_allclose(across @ turn, [[0, 3, 4], [0, 0, 0], [0, 0, 1], [0, 0, 0]], atol=1e-13)


def test_a_polyline_is_looked_for_from_where_the_tip_should_be() -> None:
    """Where lines cross, each is found from places ahead of and behind it; beyond the ends they go on straight."""
    corners = np.array([[x, 0.0, 0.0] for x in range(10)] + [[9.0, 5.0, 0.0], [4.5, 5.0, 0.0], [4.5, -5.0, 0.0]])
    points = np.array([[4.5, 0.1, 0.0], [4.5, 0.1, 0.0], [4.4, 0.2, 0.0], [-2.0, 0.3, 0.4], [4.5, -9.0, 1.0]])
    for near in ([1, 8, 12, 0, 12], [4, 5, 11, 6, 11]):
        error = polyline_error(points, corners, np.array(near))
        np.testing.assert_allclose(error.along, [4.5, 4.5, 9.0 + 5.0 + 4.5 + 4.8, -2.0, 9.0 + 5.0 + 4.5 + 14.0])
        np.testing.assert_allclose(error.perpendicular, [0.1, 0.1, 0.1, 0.5, 1.0])
    np.testing.assert_allclose(polyline_error(points, corners).perpendicular[[0, 3, 4]], [0.1, 0.5, 1.0])


def test_a_line_between_equal_points_is_refused() -> None:
    """Path error without a direction is an error, not NaN."""
    with pytest.raises(ValueError, match="two different points"):
        path_error(np.zeros((2, 3)), np.ones(3), np.ones(3))
