"""FollowJointTrajectory with each of its processes apart: bits from run to run, options, and who dies in mid-goal."""

from __future__ import annotations

import re
import signal
import sys
import time
from collections.abc import Iterator
from contextlib import closing, contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from processes import TIMEOUT, Processes, own_processes
from ros_client import JOINTS, Client
from sensor_msgs.msg import JointState

from rx90_common.base.rates import NANOSECONDS
from rx90_common.exchange.cdr import cdr_stamp_ns, message_time_ns
from rx90_common.process.children import ChildProcess

pytestmark = pytest.mark.ros

PAGE = Path(__file__).parents[4] / "docs/howto/action.md"
STEP = 0.01
START, END = 0.1, 0.6
"""When the first goal begins, and up to when both runs are compared, s of simulated time."""
START_NS, END_NS = round(START * NANOSECONDS), round(END * NANOSECONDS)
TOLD = 8
"""How often its client hears how it goes: every 0.05 s, from its first tick to the last but one."""
SIMULATION = ("-p", "real_time_factor:=0.0", "-p", "paused:=true", "-p", f"step_ticks:={round(STEP * 4000)}")
OPTIONS = ("allow_partial_joints_goal", "allow_nonzero_velocity_at_trajectory_end", "allow_trajectory_replacement")
SUCCEEDED, CANCELED, ABORTED = 4, 5, 6  # action_msgs/GoalStatus


class Pair:
    """A simulation, a controller that accepts all there are options for, and a client."""

    def __init__(self, client: Client, processes: Processes) -> None:
        from action_client import GoalClient, Stepper

        self.client, self.processes = client, processes
        self.simulation = processes.start("rx90_sim", "--ros-args", *SIMULATION)
        options = (word for option in OPTIONS for word in ("-p", f"{option}:=true"))
        self.controller = processes.start("rx90_controller", "--ros-args", *options)
        self.time, self.goals = Stepper(client, STEP), GoalClient(client)

    def begun(self) -> list[Any]:
        """Follow a goal that is sent before the first tick and stamped; return all that is heard and told of it."""
        from action_client import move
        from control_msgs.msg import JointTrajectoryControllerState

        topics = {"joint_states": JointState, "rx90_controller/controller_state": JointTrajectoryControllerState}
        heard: dict[str, list[bytes]] = {topic: [] for topic in topics}
        for topic, kind in topics.items():
            self.client.node.create_subscription(kind, topic, heard[topic].append, 5000, raw=True)
        self.client.known_to("rx90_sim", "rx90_controller")
        handle = self.goals.send(move(0.05, 0.4, start=START))
        deadline = time.monotonic() + TIMEOUT
        while not handle.accepted and time.monotonic() < deadline:  # the controller has not found the simulation yet
            time.sleep(0.05)
            handle = self.goals.send(move(0.05, 0.4, start=START))
        result = self.goals.result_of(handle)
        self.controller.wait_for("a goal waits for the simulation's first tick")
        ended = self.time.until(result)
        self.time.run(END + STEP - self.time.ran)
        for topic, messages in heard.items():
            self.client.spin_until(lambda m=messages: bool(m) and cdr_stamp_ns(m[-1]) >= END_NS, f"the end of {topic}")  # type: ignore[misc]
        self.client.spin_until(lambda: len(self.goals.feedback) >= TOLD, "the last that was told of the goal")
        # While time stands still the newest sample comes again and again.
        once = {
            topic: [message for message in dict.fromkeys(messages) if START_NS <= cdr_stamp_ns(message) <= END_NS]
            for topic, messages in heard.items()
        }
        return [once, ended, self.goals.feedback]

    def home(self) -> None:
        """Bring the arm back."""
        from action_client import move

        assert self.time.until(self.goals.result_of(self.goals.send(move(0.0, 0.4)))).status == SUCCEEDED


@contextmanager
def started(folder: Path) -> Iterator[Pair]:
    """Give a pair on a domain of its own."""
    with own_processes(folder) as processes, closing(Client()) as client:
        yield Pair(client, processes)


@pytest.fixture(scope="module")
def first_run() -> list[Any]:
    """Return a place for what the first run has brought."""
    return []


@pytest.fixture(scope="module")
def pair(
    needs_action: None,  # noqa: ARG001
    tmp_path_factory: pytest.TempPathFactory,
    first_run: list[Any],
) -> Iterator[Pair]:
    """Give a pair that has followed a first goal."""
    with started(tmp_path_factory.mktemp("pair")) as running:
        first_run.extend(running.begun())
        yield running


def test_a_subset_of_joints_moves_while_the_others_hold(pair: Pair) -> None:
    """With allow_partial_joints_goal a goal names some joints, in any order; the others keep their set-point."""
    from action_client import goal, point

    pair.home()
    references = pair.client.listen("rx90_controller/reference", depth=1)
    pair.client.known_to("rx90_controller")
    ended = pair.time.until(
        pair.goals.result_of(pair.goals.send(goal(point(0.3, [0.03, -0.02]), names=["joint_4", "joint_2"])))
    )
    assert (ended.status, ended.result.error_code) == (SUCCEEDED, 0)
    wanted = pytest.approx([0.0, -0.02, 0.0, 0.03, 0.0, 0.0], abs=1e-12)
    pair.client.spin_until(
        lambda: bool(references) and list(references[-1].position) == wanted, "the end of the motion"
    )


def test_a_goal_may_end_with_a_velocity_and_begin_where_the_path_is(pair: Pair) -> None:
    """With its option the last point may move, behind which the arm brakes; with replacement a first point in the past.

    Set-points have no jump of position or velocity; who has sent the goal before gets -1.
    """
    from action_client import goal, point

    pair.home()
    references = pair.client.listen("rx90_controller/reference", depth=5000)
    pair.client.known_to("rx90_controller")
    first = pair.goals.result_of(pair.goals.send(goal(point(0.3, [0.03] * 6, [0.1] * 6), point(0.6, [0.05] * 6))))
    pair.time.run(0.2)
    points = [point(0.0, [9.0] * 6), point(0.3, [0.04] * 6, [0.1] * 6)]
    second = pair.goals.result_of(pair.goals.send(goal(*points, start=pair.time.ran - 0.05)))
    assert pair.goals.wait(first).result.error_string.startswith("pre-empted")
    pair.time.run(0.6)
    # It passes its last point with 0.1 rad/s, while 0.01 rad/s would be rest: the goal waits for that.
    assert pair.goals.wait(second).status == SUCCEEDED
    last_ns = round((pair.time.ran - 1e-3) * 1e9)
    pair.client.spin_until(
        lambda: bool(references) and message_time_ns(references[-1].header.stamp) >= last_ns, "the last set-point"
    )
    velocity = np.array([message.velocity for message in references])
    position = np.array([message.position for message in references])
    assert np.abs(np.diff(velocity, axis=0)).max(axis=0) == pytest.approx(np.zeros(6), abs=0.0601)
    assert np.diff(position, axis=0) == pytest.approx(0.5e-3 * (velocity[1:] + velocity[:-1]), abs=1e-5)
    assert not velocity[-1].any()


def program(tmp_path: Path) -> Path:
    """Return the file of the page's program."""
    (text,) = re.findall(r"```python\n(.*?)```", PAGE.read_text(encoding="utf-8"), flags=re.DOTALL)
    assert 15 <= text.count("\n") <= 30
    file = tmp_path / "send_goal.py"
    file.write_text(text, encoding="utf-8")
    return file


def test_the_pages_program_sends_a_goal_and_one_that_is_killed_leaves_it_to_the_controller(
    pair: Pair, tmp_path: Path
) -> None:
    """The program on the page prints feedback and result. After kill -9 in mid-goal the goal is followed to its end."""
    file = program(tmp_path)

    def accepted() -> ChildProcess:
        before = pair.controller.output.count("goal accepted")
        sender = pair.processes.start(sys.executable, file)
        pair.client.spin_until(lambda: pair.controller.output.count("goal accepted") > before, "the goal")
        return sender

    sender = accepted()
    while "error_code=0" not in sender.output:
        pair.time.run(STEP)
    assert sender.wait() == 0
    assert "goal reached" in sender.output
    sender = accepted()
    pair.time.run(0.3)
    sender.signal(signal.SIGKILL)
    sender.wait()
    before = pair.controller.output.count("goal succeeded")
    while pair.controller.output.count("goal succeeded") == before:
        pair.time.run(STEP)


def test_who_is_killed_in_mid_goal_ends_it(pair: Pair) -> None:
    """After kill -9 of the simulation the client gets -1 and why; after that of the controller it sees it is gone."""
    from action_client import move

    result = pair.goals.result_of(pair.goals.send(move(0.05, 0.4)))
    pair.time.run(0.1)
    pair.simulation.signal(signal.SIGKILL)
    pair.simulation.wait()
    ended = pair.goals.wait(result)
    assert (ended.status, ended.result.error_code) == (ABORTED, -1)
    assert ended.result.error_string.startswith("the simulation is gone, for more than 2 s, at ")
    assert not pair.goals.send(move(0.0)).accepted
    pair.controller.wait_for("goal rejected: there is no simulation; accepted: once there is one")
    pair.controller.signal(signal.SIGKILL)
    pair.controller.wait()
    pair.client.spin_until(lambda: not pair.goals.there(), "the controller to be missed")


def test_a_stamped_goal_gives_the_same_bits_in_every_run(
    pair: Pair,  # noqa: ARG001
    first_run: list[Any],
    tmp_path: Path,
) -> None:
    """In lock-step, messages, feedback and result of another run by other processes are the same to the last bit."""
    with started(tmp_path) as other:
        (messages, ended, feedback), (first_messages, first_ended, first_feedback) = other.begun(), first_run
        for topic, count in (("joint_states", 501), ("rx90_controller/controller_state", 26)):
            stamps = [cdr_stamp_ns(message) for message in messages[topic]]
            assert (len(stamps), stamps) == (count, [cdr_stamp_ns(message) for message in first_messages[topic]])
            assert [i for i in range(count) if messages[topic][i] != first_messages[topic][i]] == []
        assert (ended.status, ended) == (SUCCEEDED, first_ended)
        assert len(feedback) == TOLD
        assert feedback == first_feedback
        # Ctrl-C in mid-goal: the controller says so to the client before it ends.
        from action_client import move

        result = other.goals.result_of(other.goals.send(move(0.0, 0.5)))
        other.time.run(0.1)
        other.controller.signal(signal.SIGINT)
        ended = other.goals.wait(result)
        assert (ended.status, ended.result.error_code) == (ABORTED, -1)
        assert ended.result.error_string.startswith("the controller ends, at ")
        assert other.controller.wait() == 0


def test_a_goal_in_free_running_time(needs_action: None, processes: Processes) -> None:  # noqa: ARG001
    """Where nobody holds time back a goal is followed to its result as well."""
    from action_client import GoalClient, move

    processes.start("rx90_cell", "--ros-args", "-p", "rx90_sim:time_mode:=free_running")
    with closing(Client()) as client:
        goals = GoalClient(client)
        ended = goals.wait(goals.result_of(goals.send(move(0.02, 0.3))))
        assert (ended.status, ended.result.error_code) == (SUCCEEDED, 0)
        client.spin_until(lambda: bool(goals.feedback), "what was told of it")
        assert [feedback.joint_names for feedback in goals.feedback][:1] == [JOINTS]
