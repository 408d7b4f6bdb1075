"""Controllers of one's own against `rx90_sim` over DDS, written in plain rclpy as a user's are."""

from typing import Any

import numpy as np
import pytest
from builtin_interfaces.msg import Time
from processes import Processes
from ros_client import JOINTS, Client, seconds
from sensor_msgs.msg import JointState

import rx90_emulator as rx
from rx90_common.process.children import ChildProcess

pytestmark = pytest.mark.ros
STIFFNESS = np.array([3000.0, 3000.0, 800.0, 60.0, 40.0, 8.0])
START = [0.1, -0.3, 1.2, 0.2, -0.4, 0.1]


def start(processes: Processes, **parameters: object) -> ChildProcess:
    given = {"command_interface": "joint", "real_time_factor": 0.0, **parameters}
    words = [word for name, value in given.items() for word in ("-p", f"{name}:={value}")]
    return processes.start("rx90_sim", "--ros-args", *words)


def law(position: np.ndarray, velocity: np.ndarray, t: float) -> np.ndarray:
    wanted = np.array(START) + 0.02 * np.sin(7.0 * t)
    return STIFFNESS * (wanted - position) - 0.1 * STIFFNESS * velocity


def test_the_node_gives_the_bits_of_one_process(processes: Processes, client: Client) -> None:
    """At 500 Hz, joints named backwards: links and measured states are, to the bit, those of `rx.run_controller`."""
    publisher = client.node.create_publisher(JointState, "joint_commands", 10)

    def answer(states: Any) -> None:
        measured.append(states)
        effort = law(np.array(states.position), np.array(states.velocity), seconds(states))
        command = JointState(name=states.name[::-1], effort=effort.tolist()[::-1])
        command.header.stamp = states.header.stamp
        unreadable = JointState(header=command.header, name=command.name, effort=command.effort[1:])
        for message in (command,) if len(measured) % 20 else (unreadable, command):
            publisher.publish(message)

    measured: list[Any] = []
    client.node.create_subscription(JointState, "measured_joint_states", answer, 10)
    links = client.listen("joint_states")
    simulation = start(processes, command_rate=500, duration=0.4, initial_position=START, paused=True)
    client.known_to("rx90_sim")
    client.simulation.pause(False)
    client.spin_until(lambda: simulation.returncode is not None, "the end of the run")
    client.spin_until(lambda: len({seconds(one) for one in links}) == 400, "all states")
    assert "effort has 5 elements; accepted: 6 or none; the message is ignored" in simulation.output
    run = rx.run_controller(rx.load_setup(), law, 0.4, START, command_rate=500)
    first = {seconds(one): one for one in measured}
    for messages, rows in ((first, run.measured), ({seconds(one): one for one in links}, run.joint_states)):
        heard = np.array([[one.position, one.velocity, one.effort] for _, one in sorted(messages.items())])
        assert heard.tobytes() == rows.tobytes()
    assert np.ptp(run.joint_states[:, 0], axis=0).min() > 1e-4  # it moves


def test_a_late_listener_of_joint_states_alone_may_answer_them(processes: Processes, client: Client) -> None:
    """In lock-step the stamp counts, not the topic that was heard; one that is not set is told."""
    publisher = client.node.create_publisher(JointState, "joint_commands", 1)
    unset = True

    def answer(states: Any) -> None:
        command = JointState(name=JOINTS, effort=[0.0] * 6)
        command.header.stamp = Time() if unset else states.header.stamp
        publisher.publish(command)

    client.node.create_subscription(JointState, "joint_states", answer, 10)
    simulation = start(processes, duration=0.05)
    client.spin_until(lambda: "header.stamp is 0, not set, at 0.001 s" in simulation.output, "the line")
    unset = False
    client.spin_until(lambda: simulation.returncode == 0, "the end of the run")
