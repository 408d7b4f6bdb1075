"""What a run is judged by."""

from __future__ import annotations

import numpy as np

from rx90_common.description.kinematics import forward, tip_position
from rx90_controller.lines.task import LineTask
from rx90_emulator.loop.line import path_accuracy, run_line
from rx90_emulator.loop.setup import Setup
from rx90_emulator.sweep.sweep import measure, metrics_of


def test_tip_is_that_of_the_kinematics(shipped: Setup) -> None:
    """The short way to the tip gives the forward kinematics' position at random poses."""
    robot = shipped.robot
    q = np.random.default_rng(1).uniform(robot.lower, robot.upper, (500, 6))
    np.testing.assert_allclose(tip_position(robot.chain, q), forward(robot.chain, q).position, rtol=0, atol=1e-14)


def test_metrics_of_a_run(shipped: Setup, task: LineTask) -> None:
    """The metrics are those that the series of the run give, from the line's start until it has settled."""
    result = run_line(shipped, task)
    names = [metric.name for metric in metrics_of(shipped.robot.joint_names, shipped.friction.names)]
    found = dict(zip(names, measure(task, result), strict=True))
    accuracy = path_accuracy(shipped.robot, task, result.times, result.slow.joint_states[:, 0])
    # The error that remains of two ways to the same sum, against 1e-5 m.
    assert abs(found["path_error_worst"] - accuracy.worst) < 1e-13
    assert abs(found["path_error_rms"] - accuracy.rms) < 1e-13
    rows = np.isin(result.times, accuracy.times)
    error, joint = result.slow.tracking_error[rows, 0], result.slow.joint_states[rows]
    friction = result.slow.friction_states[rows]
    for i in range(6):
        assert found[f"tracking_error_worst_joint_{i + 1}"] == np.abs(error[:, i]).max()
        assert np.isclose(found[f"tracking_error_rms_joint_{i + 1}"], error[:, i].std(mean=0.0), rtol=1e-12)
        assert found[f"velocity_peak_joint_{i + 1}"] == np.abs(joint[:, 1, i]).max()
        assert found[f"drive_torque_peak_joint_{i + 1}"] == np.abs(joint[:, 2, i]).max()
        assert found[f"saturated_ticks_motor_{i + 1}"] == result.saturated[i]
    for i, name in enumerate(shipped.friction.names):
        power = friction[:, 1, i] * friction[:, 2, i]
        assert np.isclose(found[f"friction_work_{name}"], (power[1:] + power[:-1]).sum() / 2 * 1e-3)
