"""FollowJointTrajectory over DDS, sentence by sentence: two clients, both nodes, time that runs by steps."""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Iterator
from contextlib import ExitStack, closing
from typing import Any

import numpy as np
import pytest
from action_msgs.msg import GoalStatus
from numpy.typing import NDArray
from processes import on_own_domain, running_processes
from ros_client import JOINTS, Client, seconds
from warm_start import WarmPopen

from rx90_common.process.children import ChildProcess
from rx90_emulator.loop.setup import Setup

pytestmark = pytest.mark.ros

STEP = 0.01  # s
SUCCEEDED, CANCELED, ABORTED = GoalStatus.STATUS_SUCCEEDED, GoalStatus.STATUS_CANCELED, GoalStatus.STATUS_ABORTED
PAUSED = ("-p", "rx90_sim:paused:=true", "-p", f"rx90_sim:step_ticks:={round(STEP * 4000)}")
UNPACED = ("-p", "rx90_sim:real_time_factor:=0.0")


class Bench:
    """Both nodes and two clients of the action."""

    def __init__(self, client: Client, cell: ChildProcess) -> None:
        from action_client import GoalClient, Stepper

        self.client, self.cell = client, cell
        self.time = Stepper(client, STEP)
        self.goals, self.others = GoalClient(client), GoalClient(client)
        self.set_points = client.listen("rx90_controller/reference", depth=5000)
        self.time.run(STEP)

    @property
    def now(self) -> float:
        """Return simulated time, s."""
        return self.time.ran

    def follow(self, message: Any) -> Any:
        """Send a goal; return its result, once there is one."""
        handle = self.goals.send(message)
        return self.time.until(self.goals.result_of(handle))

    def begin_anew(self) -> None:
        """Reset the simulation."""
        self.time.reset()
        self.time.run(STEP)
        self.client.spin_until(lambda: seconds(self.set_points[-1]) < self.now, "time to begin anew")
        del self.set_points[:-1]

    def home(self) -> None:
        """Bring the arm back, at rest, and forget what was heard, but for the last."""
        from action_client import move

        newest = self.heard()[-1]
        if any(newest.position) or any(newest.velocity):
            furthest = float(np.abs(newest.position).max())
            seconds = max(0.4, 1.1 * math.sqrt(furthest))  # at 6 rad/s^2
            assert self.follow(move(0.0, seconds)).status == SUCCEEDED
            self.heard()
        del self.set_points[:-1]

    def heard(self) -> list[Any]:
        """Return the set-points, once the newest has come."""
        newest = self.now - 1e-3 - 1e-9
        self.client.spin_until(lambda: seconds(self.set_points[-1]) >= newest, f"the set-point of {newest} s", 10.0)
        return self.set_points

    def set_points_from(self, begin: float, count: int) -> NDArray[np.float64]:
        """Return the positions of the ticks after a time, rad, shape (count, 6)."""
        commanded = {round((seconds(message) - begin) * 1e3): message.position for message in self.heard()}
        return np.array([commanded[k] for k in range(1, count + 1)])

    def velocities(self) -> NDArray[np.float64]:
        """Return the velocities of the set-points, rad/s, shape (n, 6)."""
        return np.array([message.velocity for message in self.heard()])

    def fastest_change(self) -> NDArray[np.float64]:
        """Return the largest acceleration of each joint that the velocities of the set-points show, rad/s^2."""
        largest: NDArray[np.float64] = np.abs(np.diff(self.velocities(), axis=0)).max(axis=0) / 1e-3
        return largest

    def said(self, words: str) -> None:
        """Wait for a line of the nodes."""
        self.cell.wait_for(re.escape(words))


@pytest.fixture(scope="module")
def bench(needs_action: None, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Bench]:  # noqa: ARG001
    """Give both nodes, in one process, with time standing still."""
    with ExitStack() as stack:
        patch = stack.enter_context(pytest.MonkeyPatch.context())
        patch.setattr("subprocess.Popen", WarmPopen)
        stack.enter_context(on_own_domain(patch, tmp_path_factory.mktemp("action")))
        processes = stack.enter_context(running_processes())
        cell = processes.start("rx90_cell", "--ros-args", *PAUSED, *UNPACED)
        yield Bench(stack.enter_context(closing(Client())), cell)


@pytest.fixture
def acceleration(shipped: Setup) -> NDArray[np.float64]:
    """Return the limits of the joints' accelerations, rad/s^2, with what rounding adds."""
    return shipped.controller.limits(shipped.robot).acceleration * (1.0 + 1e-9) + 1e-9


def test_names_and_types_are_those_of_the_original(bench: Bench) -> None:
    """Action, topics and service are where clients of joint_trajectory_controller look for them, with their types."""
    from rclpy.action import get_action_names_and_types

    node = bench.client.node
    actions = dict(get_action_names_and_types(node))
    assert actions["/rx90_controller/follow_joint_trajectory"] == ["control_msgs/action/FollowJointTrajectory"]
    topics, services = dict(node.get_topic_names_and_types()), dict(node.get_service_names_and_types())
    assert topics["/rx90_controller/joint_trajectory"] == ["trajectory_msgs/msg/JointTrajectory"]
    assert topics["/rx90_controller/controller_state"] == ["control_msgs/msg/JointTrajectoryControllerState"]
    assert topics["/rx90_controller/speed_scaling_input"] == ["control_msgs/msg/SpeedScalingFactor"]
    assert services["/rx90_controller/query_state"] == ["control_msgs/srv/QueryTrajectoryState"]


def test_a_goal_is_followed_and_told_of(bench: Bench) -> None:
    """A goal succeeds at its last point, which stays; every 50 ms of simulated time its client hears how it goes."""
    from action_client import move

    bench.home()
    begin = bench.now + STEP
    ended = bench.follow(move(0.05, 0.4, start=begin))
    assert (ended.status, ended.result.error_code) == (SUCCEEDED, 0)
    assert re.fullmatch(r"goal reached at [\d.]+ s, [\d.e-]+ s after the last point", ended.result.error_string)
    times = [f.header.stamp.sec + f.header.stamp.nanosec * 1e-9 for f in bench.goals.feedback]
    assert len(times) >= 8
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


def refusals() -> dict[str, tuple[Callable[[float], Any], str]]:
    """Return what is rejected: a goal, made at a simulated time, and what the log says."""
    from action_client import goal, move, point
    from control_msgs.msg import JointComponentTolerance, JointTolerance

    def efforts(_: float) -> Any:
        message = move(0.0)
        message.trajectory.points[0].effort = [1.0] * 6
        return message

    def several_dof(_: float) -> Any:
        message = move(0.0)
        message.multi_dof_trajectory.joint_names = ["base"]
        return message

    def accelerations_alone(_: float) -> Any:
        message = move(0.0)
        message.trajectory.points[0].velocities, message.trajectory.points[0].accelerations = [], [0.0] * 6
        return message

    end = point(1.0, [0.0] * 6)
    return {
        "wrong joints": (lambda _: goal(end, names=["a", *JOINTS[1:]]), "unknown joint 'a'"),
        "empty joints": (lambda _: goal(end, names=[]), "joint 'joint_1' is missing"),
        "too many joints": (lambda _: goal(end, names=[*JOINTS, "joint_7"]), "unknown joint 'joint_7'"),
        "repeated joints": (lambda _: goal(end, names=[*JOINTS[:5], "joint_1"]), "'joint_1' stands 2 times"),
        "a subset": (lambda _: goal(point(1.0, [0.0] * 5), names=JOINTS[:5]), "'joint_6' is missing"),
        "no points": (lambda _: goal(), "no points; accepted: at least one"),
        "end velocity": (lambda _: goal(point(1.0, [0.0] * 6, [0.0, 0.1] * 3)), "joint_2 ends at 0.1 rad/s"),
        "the past": (lambda now: move(0.0, 0.1, start=now - 0.11), "the last point is at"),
        "equal times": (lambda _: goal(end, end), "time_from_start 1 s after 1 s"),
        "wrong size": (lambda _: goal(point(1.0, [0.0] * 5)), "5 positions; accepted: 6"),
        "effort": (efforts, "carries effort"),
        "accelerations alone": (accelerations_alone, "accelerations without velocities"),
        "a joint of several degrees of freedom": (several_dof, "multi_dof_trajectory is given"),
        "a tolerance of components": (
            lambda _: move(0.0, component_path_tolerance=[JointComponentTolerance(joint_name="base")]),
            "component_path_tolerance of 1 joints; accepted: none",
        ),
        "a tolerance of nothing": (lambda _: move(0.0, path_tolerance=[JointTolerance(name="elbow")]), "'elbow'"),
    }


def test_what_is_no_goal_is_rejected_and_logged_and_the_one_before_goes_on(bench: Bench) -> None:
    """Each kind of bad goal is rejected, with one line that says why; the goal that is followed is not touched."""
    from action_client import move

    bench.home()
    bench.time.run(0.2)
    first = bench.goals.send(move(0.05, 0.4))
    result = bench.goals.result_of(first)
    bench.time.run(0.05)
    for name, (make, words) in refusals().items():
        before = bench.cell.output.count("goal rejected")
        assert not bench.others.send(make(bench.now)).accepted, name
        bench.client.spin_until(lambda: bench.cell.output.count("goal rejected") > before, name)  # noqa: B023
        (line,) = [line for line in bench.cell.output.splitlines() if "goal rejected" in line][before:]
        assert words in line, name
    assert bench.time.until(result).status == SUCCEEDED


@pytest.mark.parametrize(
    ("make", "words"),
    [
        (lambda goal, point: goal(point(0.0, [0.1] * 6), point(1.0, [0.1] * 6)), "joint_1 starts at 0.1 rad"),
        (lambda goal, point: goal(point(0.25, [0.1] * 6)), "acceleration"),
        (lambda goal, point: goal(point(100.0, [9.0] * 6)), "accepted: ["),
        (lambda goal, point: goal(point(1.0, [0.0] * 6), start=1000.0), "start time 1000.000 s"),
    ],
)
def test_what_the_arm_cannot_do_is_aborted_with_the_reason(bench: Bench, make: Any, words: str) -> None:
    """Start and limits depend on where the arm is: the result has INVALID_GOAL and the text; nothing moves."""
    from action_client import goal, point

    bench.home()
    handle = bench.goals.send(make(goal, point))
    ended = bench.goals.wait(bench.goals.result_of(handle))
    assert (ended.status, ended.result.error_code) == (ABORTED, -1)
    assert words in ended.result.error_string
    bench.time.run(0.05)
    assert not bench.velocities().any()


def test_brakes_end_a_goal_and_refuse_the_next(bench: Bench) -> None:
    """With the torque off the goal is aborted with INVALID_GOAL, at once; goals are rejected until it is on again.

    So they are when the node is deactivated.
    """
    from action_client import move

    def deactivate() -> None:
        assert bench.client.transition("rx90_controller", "deactivate")

    def activate() -> None:
        assert bench.client.transition("rx90_controller", "activate")

    for off, on, end, reason in (
        (
            lambda: bench.client.enable(False),
            lambda: bench.client.enable(True),
            "the torque is off, at ",
            "disabled; accepted: after a call of ~/enable with true",
        ),
        (
            deactivate,
            activate,
            "the controller is deactivated, the torque is off, at ",
            "inactive; accepted: in state active",
        ),
    ):
        bench.home()
        result = bench.goals.result_of(bench.goals.send(move(0.05, 0.4)))
        bench.time.run(0.1)
        off()
        ended = bench.goals.wait(result)
        assert (ended.status, ended.result.error_code) == (ABORTED, -1)
        assert ended.result.error_string.startswith(end)
        bench.time.run(STEP)
        assert not bench.goals.send(move(0.0)).accepted
        bench.said(f"goal rejected: the controller is {reason}")
        on()
        bench.time.run(STEP)
    bench.home()
    for on in (False, True):
        bench.client.enable(on)
    assert not bench.goals.send(move(0.0)).accepted  # not before the loops hold the arm again
    bench.time.run(STEP)
    bench.home()


def test_a_fault_of_the_supervision_ends_a_goal_and_refuses_the_next(bench: Bench, shipped: Setup) -> None:
    """Beyond the following error: ABORTED, -1, with joint, value and limit; goals are rejected until `enable`."""
    from action_client import move

    bench.home()
    usual = shipped.controller.following_error.tolist()
    assert bench.client.set_parameters("rx90_controller", supervision__following_error=[1e-5] * 6) == [""]
    ended = bench.follow(move(0.05, 0.4))
    assert (ended.status, ended.result.error_code) == (ABORTED, -1)
    reason = r"joint_\d: following error \S+ rad at \S+ s; accepted: up to 1e-05 rad; torque off, brakes closed, at .*"
    assert re.fullmatch(reason, ended.result.error_string), ended.result.error_string
    assert not bench.goals.send(move(0.0)).accepted
    bench.cell.wait_for(r"goal rejected: joint_\d: following error .*; accepted: after a call of ~/enable with true")
    assert bench.client.set_parameters("rx90_controller", supervision__following_error=usual) == [""]
    bench.client.enable(True)
    bench.time.run(0.1)
    bench.home()


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

    for limit, code in ((1e-9, -4), (0.0, 0)):  # the default, changed for the next goal
        assert bench.client.set_parameters("rx90_controller", constraints__joint_3__trajectory=limit) == [""]
        assert bench.follow(move(0.01, 0.4)).result.error_code == code
        bench.time.run(0.3)


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
        before = len(bench.set_points)
        bench.client.spin_until(lambda: len(bench.set_points) > before + generator.integers(0, 300), "some ticks")  # noqa: B023
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
            bench.client.spin_until(lambda: stop.get_subscription_count() > 0, "the controller")  # noqa: B023
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
    handle = bench.goals.send(move(0.1, 0.5, start=bench.now + 0.2))
    result = bench.goals.result_of(handle)
    bench.time.run(0.05)
    bench.goals.cancel(handle)
    assert bench.goals.wait(result).status == CANCELED
    bench.time.run(0.3)
    assert not bench.velocities().any()
    assert not bench.goals.cancel(handle).goals_canceling


def test_speed_scaling_along_the_path(bench: Bench, acceleration: NDArray[np.float64]) -> None:
    """At a factor f a goal takes 1/f of its time, changed on the way without a jump; at 0 it waits, and goes on.

    A factor that is none is a line, the next ones are counted; one that is repeated is no line. controller_state has
    the speed along the path.
    """
    from action_client import move
    from control_msgs.msg import JointTrajectoryControllerState, SpeedScalingFactor
    from rclpy.qos import DurabilityPolicy, QoSProfile

    bench.home()
    states = bench.client.listen("rx90_controller/controller_state", JointTrajectoryControllerState)
    latched = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
    factor = bench.client.node.create_publisher(SpeedScalingFactor, "rx90_controller/speed_scaling_input", latched)
    bench.client.spin_until(lambda: factor.get_subscription_count() > 0, "the controller")

    def scale(value: float, said: str) -> None:
        before = bench.cell.output.count(said)
        factor.publish(SpeedScalingFactor(factor=value))
        bench.client.spin_until(lambda: bench.cell.output.count(said) > before, said)

    try:
        result = bench.goals.result_of(bench.goals.send(move(0.05, 0.4)))
        begin = bench.now
        bench.time.run(0.1)
        scale(0.5, "speed scaling 0.5")
        factor.publish(SpeedScalingFactor(factor=0.5))
        scale(1.5, "speed scaling 1.5; accepted: a number in [0, 1]; ignored")
        for wrong in (float("nan"), *[-0.5] * 20):
            factor.publish(SpeedScalingFactor(factor=wrong))
        bench.time.run(0.2)
        assert states[-1].speed_scaling_factor == 0.5
        scale(0.0, "speed scaling 0")
        bench.time.run(0.3)
        assert not result.done()
        assert states[-1].speed_scaling_factor == 0.0
        assert not bench.velocities()[-50:].any()
        scale(1.0, "speed scaling 1")
        assert bench.time.until(result).status == SUCCEEDED
        assert bench.cell.output.count("speed scaling 0.5") == 1
        assert bench.cell.output.count("accepted: a number in [0, 1]; ignored") == 1
    finally:
        factor.publish(SpeedScalingFactor(factor=1.0))
    # 0.1 s at full speed, some 0.2 s at half of it, 0.3 s at none: the path's 0.4 s take 0.8 s, but for the ramps.
    assert bench.now - begin == pytest.approx(0.8, abs=0.06)
    assert (bench.fastest_change() <= acceleration).all()


def test_query_state_tells_the_set_point_of_any_time_of_the_trajectory(bench: Bench) -> None:
    """Past and future set-points are those that are commanded then; before the motion and behind it there are none."""
    from action_client import Time, move, stamp
    from control_msgs.srv import QueryTrajectoryState

    bench.home()
    begin = bench.now + STEP
    result = bench.goals.result_of(bench.goals.send(move(0.05, 0.4, start=begin)))
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

    states = bench.client.listen("rx90_controller/controller_state", JointTrajectoryControllerState)
    bench.home()
    begin = bench.now + STEP
    assert bench.follow(move(0.05, 0.4, start=begin)).status == SUCCEEDED
    references = {seconds(message): message for message in bench.heard()}
    last = begin + 0.38
    bench.client.spin_until(lambda: seconds(states[-1]) >= last, "the last state")
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


def test_ten_thousand_points(bench: Bench) -> None:
    """A goal of 10,000 points is followed through all of them; so is a trajectory on the topic, in the same bits."""
    from action_client import goal, point
    from trajectory_msgs.msg import JointTrajectory

    bench.home()
    begin, times = bench.now + 0.1, np.arange(1, 10_001) * 1e-4
    shape = 0.05 * (10 * times**3 - 15 * times**4 + 6 * times**5)  # at rest at both ends
    speed = 0.05 * (30 * times**2 - 60 * times**3 + 30 * times**4)
    speed[-1] = 0.0
    points = [point(t, [q] * 6, [v] * 6) for t, q, v in zip(times, shape, speed, strict=True)]
    assert bench.follow(goal(*points, start=begin)).status == SUCCEEDED
    passed = bench.set_points_from(begin, 1000)
    assert np.abs(passed - shape[9::10][:, None]).max() < 1e-9

    bench.home()
    begin = bench.now + 0.1  # the client may not have heard of the last ticks
    topic = bench.client.node.create_publisher(JointTrajectory, "rx90_controller/joint_trajectory", 1)
    bench.client.spin_until(lambda: topic.get_subscription_count() > 0, "the controller")
    topic.publish(goal(*points, start=begin).trajectory)
    bench.said("trajectory accepted: 10000 points")
    bench.time.run(1.1 + 2 * STEP)
    assert np.array_equal(bench.set_points_from(begin, 1000), passed)
