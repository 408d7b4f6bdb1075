"""Ends before the last point: tolerances, a cancel, another goal, a trajectory on the topic, a reset."""

from __future__ import annotations

import re

import numpy as np
import pytest
from action_bench import ABORTED, CANCELED, STEP, SUCCEEDED, Bench
from numpy.typing import NDArray

pytestmark = pytest.mark.ros


def test_tolerances_along_the_path_and_at_the_goal(bench: Bench, acceleration: NDArray[np.float64]) -> None:
    """Beyond a tolerance on the path -4, beyond one at the goal -5 after its time: joint, amount, limit and time.

    The arm then stops within the accelerations. The next goal has the defaults again; -1 takes a tolerance away.
    """
    from action_client import Duration, move, stamp
    from control_msgs.msg import JointTolerance

    bench.home()
    path = [JointTolerance(name="joint_3", position=1e-9)]
    ended = bench.follow(move(0.05, 0.4, path_tolerance=path))
    assert (ended.status, ended.result.error_code) == (ABORTED, -4)
    pattern = r"joint_3: position error \S+ rad, accepted up to 1e-09 rad along the path, at (\S+) s, (\S+) s on the .*"
    found = re.fullmatch(pattern, ended.result.error_string)
    assert found is not None, ended.result.error_string
    assert 0.0 <= float(found[2]) < 0.05
    bench.time.run(0.3)
    assert (bench.fastest_change() <= acceleration).all()
    assert not bench.velocities()[-1].any()

    bench.home()
    late = {"goal_tolerance": [JointTolerance(name="joint_2", position=1e-12)]}
    ended = bench.follow(move(0.05, 0.4, **late, goal_time_tolerance=stamp(Duration, 0.1)))
    assert (ended.status, ended.result.error_code) == (ABORTED, -5)
    assert re.match(
        r"joint_2: position error \S+ rad, accepted up to 1e-12 rad at the goal, 0.101 s after the last",
        ended.result.error_string,
    )
    assert bench.follow(move(0.0, 0.5)).status == SUCCEEDED

    waiting = bench.goals.send(move(0.05, 0.4, **late))  # the default of goal_time is 0, for ever
    result = bench.goals.result_of(waiting)
    bench.time.run(1.5)
    assert not result.done()
    free = [JointTolerance(name="joint_2", position=-1.0, velocity=-1.0)]
    ended = bench.follow(move(0.0, 0.5, goal_tolerance=free))
    assert ended.status == SUCCEEDED
    assert bench.goals.wait(result).result.error_code == -1

    for limit, code in ((1e-9, -4), (0.0, 0)):  # the default, changed for what comes next
        assert bench.client.set_parameters("rx90_controller", constraints__joint_3__trajectory=limit) == [""]
        assert bench.follow(move(0.01, 0.4)).result.error_code == code
        bench.time.run(0.3)
        bench.client.send([(0.4, [0.0] * 6)])  # on the topic: the same
        bench.time.run(0.6)
        lines = re.findall(r"\[ERROR\].* trajectory aborted: (\S+): .*; stopping and holding", bench.cell.output)
        assert lines == ["joint_3"]


@pytest.mark.parametrize("seed", range(3))
def test_a_cancelled_goal_stops_within_the_accelerations_and_holds(
    bench: Bench, seed: int, acceleration: NDArray[np.float64]
) -> None:
    """At whatever moment a goal is cancelled: CANCELED at once, a stop within the accelerations, then rest."""
    from action_client import move

    bench.home()
    handle = bench.goals.send(move(0.1, 0.5))
    result = bench.goals.result_of(handle)
    bench.time.run(STEP * np.random.default_rng(seed).integers(0, 48))
    assert len(bench.goals.cancel(handle).goals_canceling) == 1
    ended = bench.goals.wait(result)
    assert (ended.status, ended.result.error_code) == (CANCELED, 0)
    assert ended.result.error_string.startswith("cancelled; stopping from ")
    bench.time.run(0.4)
    assert (bench.fastest_change() <= acceleration).all()
    assert not bench.velocities()[-50:].any()


def spin_for(bench: Bench, set_points: int) -> None:
    """Wait until so many set-points have come, and one."""
    last = len(bench.set_points) + set_points
    bench.client.spin_until(lambda: len(bench.set_points) > last, f"{set_points} set-points")


def test_cancelling_while_time_runs_gives_one_of_two_ends(bench: Bench) -> None:
    """Cancel and end may cross: the client gets CANCELED or SUCCEEDED, the next goal is followed all the same."""
    from action_client import move

    bench.home()
    bench.time.pause(False)
    generator = np.random.default_rng(1)
    ends = set()
    for k in range(6):
        handle = bench.goals.send(move(0.02 * (k % 2), 0.25))
        result = bench.goals.result_of(handle)
        spin_for(bench, int(generator.integers(0, 300)))
        bench.goals.cancel(handle)
        ends.add(bench.goals.wait(result).status)
    bench.time.pause(True)
    assert ends <= {SUCCEEDED, CANCELED}
    bench.begin_anew()


def test_a_new_goal_of_anybody_pre_empts_the_one_before(bench: Bench, acceleration: NDArray[np.float64]) -> None:
    """Another client's goal is followed from where the path is; the first client gets -1, "pre-empted"."""
    from action_client import move

    bench.home()
    first = bench.goals.result_of(bench.goals.send(move(0.1, 0.5)))
    bench.time.run(0.2)
    second = bench.others.result_of(bench.others.send(move(0.02, 0.6)))
    ended = bench.goals.wait(first)
    assert (ended.status, ended.result.error_code) == (ABORTED, -1)
    assert ended.result.error_string.startswith("pre-empted by a new goal, at ")
    bench.said(f"goal aborted: {ended.result.error_string}")
    assert not re.search(r"\[ERROR\].* pre-empted by a new goal", bench.cell.output)
    assert bench.time.until(second).status == SUCCEEDED
    assert (bench.fastest_change() <= acceleration).all()
    assert list(bench.heard()[-1].position) == pytest.approx([0.02] * 6, abs=1e-12)


def test_a_trajectory_on_the_topic_ends_a_goal(bench: Bench) -> None:
    """What comes on ~/joint_trajectory is followed instead: the goal's client gets -1 and why; so for a stop there."""
    for points in ([(0.5, [0.02] * 6)], None):
        from action_client import move
        from trajectory_msgs.msg import JointTrajectory

        bench.home()
        result = bench.goals.result_of(bench.goals.send(move(0.1, 0.5)))
        bench.time.run(0.2)
        if points is None:
            stop = bench.client.node.create_publisher(JointTrajectory, "rx90_controller/joint_trajectory", 1)
            bench.client.spin_until(lambda: stop.get_subscription_count() > 0, "the controller")  # noqa: B023 - called at once
            stop.publish(JointTrajectory())
        else:
            bench.client.send(points)
        ended = bench.goals.wait(result)
        assert (ended.status, ended.result.error_code) == (ABORTED, -1)
        assert ended.result.error_string.startswith("replaced by a trajectory on the topic, at ")
        bench.said(f"goal aborted: {ended.result.error_string}")
    assert not re.search(r"\[ERROR\].* replaced by a trajectory", bench.cell.output)
    bench.time.run(0.3)
    assert not bench.velocities()[-50:].any()


def test_cancelling_before_the_start_and_after_the_end(bench: Bench) -> None:
    """A goal that waits for its start can be cancelled, and nothing moves; one that has ended cannot."""
    from action_client import move

    bench.home()
    handle, result = bench.begin(move(0.1, 0.5, start=bench.now + 0.2))
    bench.time.run(0.05)
    bench.goals.cancel(handle)
    assert bench.goals.wait(result).status == CANCELED
    bench.time.run(0.3)
    assert not bench.velocities().any()
    assert not bench.goals.cancel(handle).goals_canceling


def test_a_paused_simulation_keeps_a_goal_waiting_and_a_reset_aborts_it(bench: Bench) -> None:
    """While time stands still a goal has no end, but can be cancelled or replaced; when time begins anew it is -1."""
    from action_client import move

    bench.home()
    first = bench.goals.send(move(0.1, 0.5))
    results = [bench.goals.result_of(first)]
    bench.time.run(0.2)
    results.append(bench.others.result_of(bench.others.send(move(0.0, 0.6))))
    ended = bench.goals.wait(results[0])  # without a tick
    assert ended.result.error_string.startswith("pre-empted")
    bench.time.run(0.1)
    bench.time.reset()
    bench.time.run(STEP)
    ended = bench.goals.wait(results[1])
    assert (ended.status, ended.result.error_code) == (ABORTED, -1)
    assert ended.result.error_string.startswith("the states go on from 0 s; holding, at ")
    bench.begin_anew()
    bench.home()
