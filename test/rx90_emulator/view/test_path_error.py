"""The path error of the live page: the same that a run without ROS has, whenever and however seldom it is looked at."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from rx90_common.description.kinematics import tip_position
from rx90_controller.lines.plan import Approach, approached
from rx90_controller.lines.task import load_task
from rx90_emulator.loop.closed_loop import simulate
from rx90_emulator.loop.line import path_accuracy, plan_line
from rx90_emulator.loop.setup import Setup
from rx90_emulator.view.scene import PathErrorMeter

START, END = np.array([0.5, 0.0, 0.2]), np.array([0.9, 0.0, 0.2])
REST = np.array([True, True])
LATE = 90  # samples before the trajectory is known


def test_the_largest_is_that_of_the_run(shipped: Setup) -> None:
    """Of an approach, a rest and a line what counts on the page is what `path_accuracy` counts, sample by sample.

    The word of the trajectory may come later than the line's first samples.
    """
    task = replace(load_task(), rest_before=0.05)
    plan = plan_line(shipped, task)
    limits = shipped.controller.limits(shipped.robot)
    here = plan.start_pose + 0.05
    line = approached(plan, here, limits, shipped.rates.position_period, Approach())
    run = simulate(shipped, line.points, here)
    times, position = run.times[::10], run.slow.joint_states[::10, 0]
    expected = path_accuracy(shipped.robot, task, times, position, line.approach)
    chain = shipped.robot.chain
    meter = PathErrorMeter(np.array(task.start), np.array(task.end))
    tips = tip_position(chain, position)
    seen = np.concatenate([meter.add(times[k : k + 3], tips[k : k + 3]) for k in range(0, LATE, 3)])
    assert np.isnan(seen).all()
    assert times[LATE - 1] > line.approach + task.rest_before + 0.3
    assert meter.words() == "not on the line"
    points = line.points
    meter.follow(points.times, tip_position(chain, points.position), np.equal(points.velocity, 0.0).all(axis=1))
    seen = np.concatenate([meter.add(times[k : k + 3], tips[k : k + 3]) for k in range(LATE, len(times), 3)])
    found = meter.run
    assert found is not None
    count = len(expected.times)
    assert len(found.times) - count <= 1  # the trajectory's last knot is half a set-point behind the line's end
    np.testing.assert_allclose(found.times[:count], expected.times)
    np.testing.assert_allclose(found.perpendicular[:count], expected.perpendicular, atol=1e-15)
    assert np.isfinite(seen).sum() == (found.times >= times[LATE]).sum()
    assert found.worst == pytest.approx(expected.worst)
    at = expected.along[np.argmax(expected.perpendicular)]
    beyond = expected.perpendicular[expected.along > 0.01].max()
    largest = f"{1e3 * expected.worst:.3f} mm, {1e3 * at:.0f} mm from the start"
    assert meter.words() == f"not on the line; last run {largest} (beyond 10 mm: {1e3 * beyond:.3f} mm)"


def spot(times: np.ndarray, begin: float, error: float) -> np.ndarray:
    """Return a spot that goes along the line in 4 s, and is so far from it, m."""
    share = np.clip((times - begin) / 4.0, 0.0, 1.0)[:, None]
    return np.asarray(START + share * (END - START) + [0.0, 0.0, error])


def test_a_run_stays_until_the_next_one_begins() -> None:
    """Neither the end of a run nor a new beginning of time takes it away; no sample of it counts for the next one."""
    meter = PathErrorMeter(START, END)
    times = np.arange(0.0, 8.0, 0.01)
    ends = np.stack([START, END])
    for error in (3e-5, 1e-5):
        meter.follow(np.array([2.0, 6.0]), ends, REST)
        meter.add(times, spot(times, 2.0, error))
        run = meter.run
        assert run is not None
        assert (run.worst, run.rms, run.times[0], run.times[-1]) == pytest.approx((error, error, 2.0, 6.0))
        meter.begin_again()
        meter.add(times, spot(times, 2.0, 1.0))
        assert meter.run is not None
        assert meter.run.worst == pytest.approx(error)
    meter.follow(np.array([2.0, 6.0]), ends[::-1], REST)  # back
    assert np.isnan(meter.add(times + 8.0, spot(times, 2.0, 1.0))).all()
    assert meter.run is not None
    assert meter.run.worst == pytest.approx(1e-5)


def test_a_long_run_keeps_its_largest() -> None:
    """Of an hour at 100 Hz the memory is that of a minute, and the largest error is still known."""
    meter = PathErrorMeter(START, END)
    meter.follow(np.array([0.0, 3600.0]), np.stack([START, END]), REST)
    times = np.arange(0.0, 3600.0, 0.01)
    tips = START + times[:, None] / 3600.0 * (END - START) + [0.0, 0.0, 1e-5]
    tips[7, 2] += 1e-4
    for k in range(0, len(times), 1000):
        meter.add(times[k : k + 1000], tips[k : k + 1000])
    run = meter.run
    assert run is not None
    assert run.worst == pytest.approx(1.1e-4)
    assert len(run.times) < 10_000
    assert run.along[[0, -1]] == pytest.approx([0.0, 0.4], abs=1e-3)
