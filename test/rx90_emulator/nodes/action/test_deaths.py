"""FollowJointTrajectory with each of its processes apart: bits from run to run, and who dies in mid-goal."""

import signal
import time
from contextlib import closing
from pathlib import Path
from typing import Any

import pytest
from processes import TIMEOUT, Processes, own_processes
from ros_client import Client
from sensor_msgs.msg import JointState

from rx90_common.base.rates import NANOSECONDS
from rx90_common.exchange.cdr_stamps import cdr_stamp_ns

pytestmark = pytest.mark.ros

STEP = 0.01
START, END = 0.1, 0.6
"""When the first goal begins, and up to when both runs are compared, s of simulated time."""
START_NS, END_NS = round(START * NANOSECONDS), round(END * NANOSECONDS)
TOLD = 8
"""How often its client hears how it goes: every 0.05 s, from its first tick to the last but one."""
SIMULATION = ("-p", "real_time_factor:=0.0", "-p", "paused:=true", "-p", f"step_ticks:={round(STEP * 4000)}")
SUCCEEDED, ABORTED = 4, 6  # action_msgs/GoalStatus


class Pair:
    def __init__(self, client: Client, processes: Processes) -> None:
        from action_client import GoalClient, Stepper

        self.client = client
        self.simulation = processes.start("rx90_sim", "--ros-args", *SIMULATION)
        self.controller = processes.start("rx90_controller")
        self.time, self.goals = Stepper(client, STEP), GoalClient(client)

    def begun(self) -> list[Any]:
        from action_client import move
        from control_msgs.msg import JointTrajectoryControllerState

        topics = {"joint_states": JointState, "rx90_controller/controller_state": JointTrajectoryControllerState}
        heard = {topic: self.client.listen(topic, kind, 5000, raw=True) for topic, kind in topics.items()}
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


def killed(pair: Pair) -> None:
    from action_client import move

    result = pair.goals.result_of(pair.goals.send(move(0.0, 0.4)))
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


def interrupted(pair: Pair) -> None:
    from action_client import move

    result = pair.goals.result_of(pair.goals.send(move(0.0, 0.5)))
    pair.time.run(0.1)
    pair.controller.signal(signal.SIGINT)
    ended = pair.goals.wait(result)
    assert (ended.status, ended.result.error_code) == (ABORTED, -1)
    assert ended.result.error_string.startswith("the controller ends, at ")
    assert pair.controller.wait() == 0


def test_a_stamped_goal_gives_the_same_bits_in_every_run_and_who_dies_ends_one(
    needs_action: None,  # noqa: ARG001
    tmp_path: Path,
) -> None:
    """In lock-step, messages, feedback and result of another run by other processes are the same to the last bit."""
    runs = []
    for name, end in (("first", killed), ("other", interrupted)):
        (tmp_path / name).mkdir()
        with own_processes(tmp_path / name) as processes, closing(Client()) as client:
            pair = Pair(client, processes)
            runs.append(pair.begun())
            end(pair)
    (first_messages, first_ended, first_feedback), (messages, ended, feedback) = runs
    for topic, count in (("joint_states", 501), ("rx90_controller/controller_state", 26)):
        stamps = [cdr_stamp_ns(message) for message in messages[topic]]
        assert (len(stamps), stamps) == (count, [cdr_stamp_ns(message) for message in first_messages[topic]])
        assert [i for i in range(count) if messages[topic][i] != first_messages[topic][i]] == []
    assert (ended.status, ended) == (SUCCEEDED, first_ended)
    assert len(feedback) == TOLD
    assert feedback == first_feedback
