"""What becomes of a goal that is followed, and what is beside the action: over DDS, time that runs by steps."""

import re
import signal
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from action_bench import ABORTED, STEP, SUCCEEDED, Bench
from numpy.typing import NDArray
from ros_client import JOINTS, seconds

from rx90_common.exchange.endpoints import LATCHED_QOS
from rx90_common.process.children import ChildProcess

pytestmark = pytest.mark.ros
PAGE = Path(__file__).parents[4] / "docs/howto/action.md"


def test_its_parameter_file_serves(bench: Bench) -> None:
    """What is in a file for joint_trajectory_controller and has no counterpart is one line; the rest holds."""
    (line,) = [line for line in bench.cell.output.splitlines() if "joint_trajectory_controller" in line]
    names = "cmd_timeout, gains.joint_1.d, gains.joint_1.ff_velocity_scale, gains.joint_1.i, "
    names += "gains.joint_1.i_clamp, gains.joint_1.p, interpolation_method; "
    assert "[WARN]" in line
    assert f"not used, parameters of joint_trajectory_controller: {names}" in line


def test_a_goal_is_followed_and_told_of(bench: Bench) -> None:
    """A goal succeeds at its last point, which stays; every 50 ms of simulated time its client hears how it goes."""
    from action_client import move

    bench.home()
    begin = bench.now + STEP
    ended = bench.follow(move(0.05, 0.4, start=begin))
    assert (ended.status, ended.result.error_code) == (SUCCEEDED, 0)
    assert re.fullmatch(r"goal reached at [\d.]+ s, [\d.e-]+ s after the last point", ended.result.error_string)
    bench.client.spin_until(lambda: len(bench.goals.feedback) >= 8, "what was told of it")
    times = [f.header.stamp.sec + f.header.stamp.nanosec * 1e-9 for f in bench.goals.feedback]
    assert np.diff(times) == pytest.approx(0.05)
    for feedback in bench.goals.feedback:
        assert list(feedback.joint_names) == JOINTS
        desired, actual, error = (
            np.array(getattr(feedback, name).positions) for name in ("desired", "actual", "error")
        )
        assert error == pytest.approx(desired - actual, abs=1e-15)
        since = feedback.desired.time_from_start
        assert since.sec + since.nanosec * 1e-9 == pytest.approx(
            feedback.header.stamp.sec + feedback.header.stamp.nanosec * 1e-9 - begin, abs=1e-9
        )
    bench.time.run(0.2)
    assert list(bench.heard()[-1].position) == pytest.approx([0.05] * 6, abs=1e-12)


def test_ten_thousand_points(bench: Bench) -> None:
    """A goal of 10,000 points is followed through all of them; so is a trajectory on the topic, in the same bits."""
    from action_client import goal, point
    from trajectory_msgs.msg import JointTrajectory

    times = np.arange(1, 10_001) * 1e-4
    shape = 0.05 * (10 * times**3 - 15 * times**4 + 6 * times**5)  # at rest at both ends
    speed = 0.05 * (30 * times**2 - 60 * times**3 + 30 * times**4)
    speed[-1] = 0.0
    points = [point(t, [q] * 6, [v] * 6) for t, q, v in zip(times, shape, speed, strict=True)]
    topic = bench.client.node.create_publisher(JointTrajectory, "rx90_controller/joint_trajectory", 1)
    passed = []
    for by_topic in (False, True):
        bench.home()
        begin = bench.now + 0.1  # the client may not have heard of the last ticks
        if by_topic:
            bench.client.spin_until(lambda: topic.get_subscription_count() > 0, "the controller")
            topic.publish(goal(*points, start=begin).trajectory)
            bench.said("trajectory accepted: 10000 points")
            bench.time.run(1.1 + 2 * STEP)
        else:
            assert bench.follow(goal(*points, start=begin)).status == SUCCEEDED
        passed.append(bench.set_points_from(begin, 1000))
    assert np.abs(passed[0] - shape[9::10][:, None]).max() < 1e-9
    assert np.array_equal(*passed)


def test_options_of_goals_are_parameters(bench: Bench) -> None:
    """With its option a part of the joints, a last point that moves, or a first one elsewhere is a goal."""
    from action_client import goal, point

    for option, message in (
        ("allow_partial_joints_goal", goal(point(0.3, [0.02] * 5), names=JOINTS[1:])),
        ("allow_nonzero_velocity_at_trajectory_end", goal(point(0.3, [0.02] * 6, [0.1] * 6))),
        ("allow_trajectory_replacement", goal(point(0.0, [9.0] * 6), point(0.3, [0.02] * 6))),
    ):
        bench.home()
        assert bench.client.set_parameters("rx90_controller", **{option: True}) == [""]
        assert bench.follow(message).status == SUCCEEDED
        assert bench.client.set_parameters("rx90_controller", **{option: False}) == [""]
        handle = bench.goals.send(message)
        assert not handle.accepted or bench.time.until(bench.goals.result_of(handle)).status == ABORTED


def test_speed_scaling_along_the_path(bench: Bench, acceleration: NDArray[np.float64]) -> None:
    """At a factor f a goal takes 1/f of its time, changed on the way without a jump; at 0 it waits, and goes on."""
    from action_client import move
    from control_msgs.msg import JointTrajectoryControllerState, SpeedScalingFactor

    bench.home()
    states = bench.listen("controller_state", JointTrajectoryControllerState)
    factor = bench.client.node.create_publisher(SpeedScalingFactor, "rx90_controller/speed_scaling_input", LATCHED_QOS)
    bench.client.spin_until(lambda: factor.get_subscription_count() > 0, "the controller")

    def scale(value: float, said: str) -> None:
        before = bench.cell.output.count(said)
        factor.publish(SpeedScalingFactor(factor=value))
        bench.client.spin_until(lambda: bench.cell.output.count(said) > before, said)

    try:
        begin = bench.now
        _, result = bench.begin(move(0.05, 0.4))
        bench.time.run(0.1)
        scale(0.5, "speed scaling 0.5")
        factor.publish(SpeedScalingFactor(factor=0.5))
        scale(1.5, "speed scaling 1.5; accepted: a number in [0, 1]; ignored")
        for wrong in (float("nan"), *[-0.5] * 20):
            factor.publish(SpeedScalingFactor(factor=wrong))
        bench.time.run(0.2)
        assert bench.state(states).speed_scaling_factor == 0.5
        scale(0.0, "speed scaling 0")
        bench.time.run(0.3)
        assert not result.done()
        assert bench.state(states).speed_scaling_factor == 0.0
        assert not bench.velocities()[-50:].any()
        scale(1.0, "speed scaling 1")
        ended = bench.time.until(result)
        assert ended.status == SUCCEEDED
        assert bench.cell.output.count("speed scaling 0.5") == 1
        assert bench.cell.output.count("accepted: a number in [0, 1]; ignored") == 1
    finally:
        factor.publish(SpeedScalingFactor(factor=1.0))
    # 0.1 s at full speed, some 0.2 s at half of it, 0.3 s at none: the path's 0.4 s take 0.8 s, but for the ramps.
    # By what the result says: time runs on until it has come.
    end = re.match(r"goal reached at (\S+) s", ended.result.error_string)
    assert end is not None, ended.result.error_string
    assert float(end[1]) - begin == pytest.approx(0.8, abs=0.06)
    assert (bench.fastest_change() <= acceleration).all()


def test_query_state_tells_the_set_point_of_any_time_of_the_trajectory(bench: Bench) -> None:
    """Past and future set-points are those that are commanded then; before the motion and behind it there are none."""
    from action_client import Time, move, stamp
    from control_msgs.srv import QueryTrajectoryState

    bench.home()
    begin = bench.now + STEP
    _, result = bench.begin(move(0.05, 0.4, start=begin))
    bench.time.run(0.2)
    asking = bench.client.node.create_client(QueryTrajectoryState, "rx90_controller/query_state")
    bench.client.spin_until(asking.service_is_ready, "the service")

    def ask(seconds: float) -> Any:
        return bench.goals.wait(asking.call_async(QueryTrajectoryState.Request(time=stamp(Time, seconds))))

    answers = {offset: ask(begin + offset) for offset in (0.05, 0.2, 0.333, 0.4)}
    assert [(answer.success, answer.message, answer.name) for answer in answers.values()] == [(True, "", JOINTS)] * 4
    early, late = ask(begin - 0.01), ask(begin + 0.41)
    assert (early.success, late.success) == (False, False)
    assert "accepted: from" in early.message
    assert late.message == f"time {begin + 0.41:g} s; accepted: up to the end of the motion"
    assert list(late.position) == pytest.approx([0.05] * 6)
    assert bench.time.until(result).status == SUCCEEDED
    commanded = {round(seconds(message), 3): message for message in bench.heard()}
    for offset, answer in answers.items():
        message = commanded[round(begin + offset, 3)]
        assert list(answer.position) == pytest.approx(list(message.position), abs=1e-12)
        assert list(answer.velocity) == pytest.approx(list(message.velocity), abs=1e-12)
    bench.client.enable(False)
    assert ask(bench.now).message.startswith("the controller is disabled")
    bench.client.enable(True)
    bench.time.run(STEP)


def test_controller_state_has_what_the_other_topics_have(bench: Bench) -> None:
    """50 times a second: the set-point of ~/reference, what is measured, and their difference."""
    from action_client import move
    from control_msgs.msg import JointTrajectoryControllerState

    states = bench.listen("controller_state", JointTrajectoryControllerState)
    bench.home()
    begin = bench.now + STEP
    assert bench.follow(move(0.05, 0.4, start=begin)).status == SUCCEEDED
    references = {seconds(message): message for message in bench.heard()}
    bench.state(states)
    states = [state for state in states if seconds(state) >= begin - 1e-9]
    assert len(states) >= 20
    assert np.diff([seconds(message) for message in states]) == pytest.approx(0.02)
    for state in states:
        reference = references[seconds(state)]
        assert state.joint_names == JOINTS
        assert state.reference.positions == reference.position
        assert state.reference.velocities == reference.velocity
        for field in ("positions", "velocities"):
            wanted, measured, error = (
                np.array(getattr(getattr(state, name), field)) for name in ("reference", "feedback", "error")
            )
            assert error == pytest.approx(wanted - measured, abs=1e-15)
        assert np.abs(state.error.positions).max() < 0.01
        assert len(state.output.effort) == 6
        since = state.reference.time_from_start
        assert since.sec + since.nanosec * 1e-9 == pytest.approx(min(seconds(state) - begin, 0.4), abs=1e-9)


def test_the_pages_program_sends_a_goal_and_one_that_is_killed_leaves_it_to_the_controller(
    bench: Bench, tmp_path: Path
) -> None:
    """The program on the page prints feedback and result. After kill -9 in mid-goal the goal is followed to its end."""
    (text,) = re.findall(r"```python\n(.*?)```", PAGE.read_text(encoding="utf-8"), flags=re.DOTALL)
    assert 15 <= text.count("\n") <= 30
    file = tmp_path / "send_goal.py"
    file.write_text(text, encoding="utf-8")

    def count(words: str) -> int:
        return bench.cell.output.count(words)

    def accepted() -> ChildProcess:
        before = count("goal accepted")
        sender = bench.processes.start(sys.executable, file)
        bench.client.spin_until(lambda: count("goal accepted") > before, "the goal")
        return sender

    bench.home()
    sender = accepted()
    while "error_code=0" not in sender.output:
        bench.time.run(STEP)
    assert sender.wait() == 0
    assert "goal reached" in sender.output
    sender = accepted()
    bench.time.run(0.3)
    sender.signal(signal.SIGKILL)
    sender.wait()
    before = count("goal succeeded")
    while count("goal succeeded") == before:
        bench.time.run(STEP)
