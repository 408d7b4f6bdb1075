"""Ends before the last point: tolerances, a cancel, another goal, a trajectory on the topic, a reset."""

import re
from typing import Any

import numpy as np
import pytest
from action_bench import ABORTED, CANCELED, STEP, SUCCEEDED, Bench

pytestmark = pytest.mark.ros


def test_tolerances_along_the_path_and_at_the_goal(bench: Bench) -> None:
    """Beyond a tolerance on the path -4, beyond one at the goal -5 after its time: joint, amount, limit and time."""
    from action_client import Duration, move, stamp
    from control_msgs.msg import JointTolerance

    bench.home()
    ended = bench.follow(move(0.05, 0.4, path_tolerance=[JointTolerance(name="joint_3", position=1e-9)]))
    assert (ended.status, ended.result.error_code) == (ABORTED, -4)
    pattern = r"joint_3: position error \S+ rad, accepted up to 1e-09 rad along the path, at (\S+) s, (\S+) s on the .*"
    found = re.fullmatch(pattern, ended.result.error_string)
    assert found is not None, ended.result.error_string
    assert 0.0 <= float(found[2]) < 0.05

    late = {"goal_tolerance": [JointTolerance(name="joint_2", position=1e-12)]}
    ended = bench.follow(move(0.02, 0.3, **late, goal_time_tolerance=stamp(Duration, 0.1)))
    assert (ended.status, ended.result.error_code) == (ABORTED, -5)
    assert re.match(
        r"joint_2: position error \S+ rad, accepted up to 1e-12 rad at the goal, 0.101 s after the last",
        ended.result.error_string,
    )
    result = bench.goals.result_of(bench.goals.send(move(0.0, 0.3, **late)))
    bench.time.run(0.6)
    assert not result.done()  # the default of goal_time is 0, for ever
    free = [JointTolerance(name="joint_2", position=-1.0, velocity=-1.0)]
    assert bench.follow(move(0.01, 0.2, goal_tolerance=free)).status == SUCCEEDED
    assert bench.goals.wait(result).result.error_code == -1


def test_what_ends_a_goal_is_told_to_who_sent_it(bench: Bench) -> None:
    """A cancel, another goal, a trajectory or a stop on the topic, a reset: status, code, reason and a line."""
    from action_client import move
    from trajectory_msgs.msg import JointTrajectory

    def ends(result: Any, status: int, code: int, words: str) -> None:
        ended = bench.goals.wait(result)
        assert (ended.status, ended.result.error_code) == (status, code)
        assert ended.result.error_string.startswith(words)
        bench.said(f"goal {'canceled' if status == CANCELED else 'aborted'}: {ended.result.error_string}")

    bench.home()
    handle, result = bench.begin(move(0.1, 0.5))
    bench.time.run(0.1)
    assert len(bench.goals.cancel(handle).goals_canceling) == 1
    ends(result, CANCELED, 0, "cancelled; stopping from ")
    assert not bench.goals.cancel(handle).goals_canceling
    handle, result = bench.begin(move(0.1, 0.5, start=bench.now + 0.2))
    bench.goals.cancel(handle)
    ends(result, CANCELED, 0, "cancelled; stopping from ")
    bench.time.run(0.3)
    assert not bench.velocities()[-50:].any()

    _, first = bench.begin(move(0.1, 0.5))
    bench.time.run(0.1)
    second = bench.others.result_of(bench.others.send(move(0.0, 0.5)))
    ends(first, ABORTED, -1, "pre-empted by a new goal, at ")
    bench.time.run(0.1)
    bench.client.send([(0.5, [0.02] * 6)])
    ends(second, ABORTED, -1, "replaced by a trajectory on the topic, at ")
    _, third = bench.begin(move(0.1, 0.5))
    bench.time.run(0.1)
    stop = bench.client.node.create_publisher(JointTrajectory, "rx90_controller/joint_trajectory", 1)
    bench.client.spin_until(lambda: stop.get_subscription_count() > 0, "the controller")
    stop.publish(JointTrajectory())
    ends(third, ABORTED, -1, "replaced by a trajectory on the topic, at ")
    bench.time.run(0.2)
    assert not bench.velocities()[-50:].any()
    assert not re.search(r"\[ERROR\].* (pre-empted|replaced|cancelled)", bench.cell.output)

    _, fourth = bench.begin(move(0.0, 0.5))
    bench.time.run(0.1)
    bench.time.reset()
    bench.time.run(STEP)
    ends(fourth, ABORTED, -1, "the states go on from 0 s; holding, at ")
    bench.begin_anew()
    bench.home()


def test_cancelling_while_time_runs_gives_one_of_two_ends(bench: Bench) -> None:
    """Cancel and end may cross: the client gets CANCELED or SUCCEEDED, the next goal is followed all the same."""
    from action_client import move

    bench.home()
    bench.time.pause(False)
    for k, set_points in enumerate(np.random.default_rng(1).integers(0, 300, 6)):
        handle = bench.goals.send(move(0.02 * (k % 2), 0.25))
        result = bench.goals.result_of(handle)
        last = len(bench.set_points) + int(set_points)
        bench.client.spin_until(lambda last=last: len(bench.set_points) > last, "set-points")
        bench.goals.cancel(handle)
        assert bench.goals.wait(result).status in {SUCCEEDED, CANCELED}
    bench.time.pause(True)
    bench.begin_anew()
