"""Managed nodes: their states, what may be set in which, and what a running pair does meanwhile."""

from __future__ import annotations

from typing import Any

import pytest
from lifecycle_msgs.srv import GetAvailableTransitions
from processes import Processes
from rcl_interfaces.msg import ParameterEvent
from rclpy.qos import DurabilityPolicy, QoSProfile
from ros_client import Client, seconds
from std_msgs.msg import String
from std_srvs.srv import SetBool, Trigger

SIMULATION, CONTROLLER = NODES = ("rx90_sim", "rx90_controller")
UNMANAGED = ("--ros-args", "-p", "autostart:=false")
LATCHED = QoSProfile(depth=100, durability=DurabilityPolicy.TRANSIENT_LOCAL)


def latched(client: Client, topic: str, kind: type) -> list[Any]:
    """Return a list that grows with the messages of a latched topic."""
    heard: list[Any] = []
    client.node.create_subscription(kind, topic, heard.append, LATCHED)
    return heard


@pytest.mark.ros
def test_a_pair_goes_through_its_states(processes: Processes, client: Client) -> None:
    """Two processes that others manage: each state is what docs/lifecycle.md says, also with another robot after it."""
    started = [
        processes.start(SIMULATION, *UNMANAGED, "-p", "real_time_factor:=0.0"),
        processes.start(CONTROLLER, *UNMANAGED),
    ]
    simulation, controller = started
    for node in NODES:
        assert client.state(node) == "unconfigured"
        graph = client.asking.call(
            GetAvailableTransitions, f"{node}/get_transition_graph", GetAvailableTransitions.Request()
        )
        assert len(graph.available_transitions) > 20
    assert client.node.count_publishers("joint_states") == 0
    assert not client.transition(SIMULATION, "activate")
    simulation.wait_for("activate is not possible in state unconfigured; accepted: configure, shutdown")

    # A configuration that is refused leaves the node as it was.
    assert client.set_parameters(CONTROLLER, controller="robots/tx40/drives.yaml") == [""]
    assert not client.transition(CONTROLLER, "configure")
    controller.wait_for("cannot configure: .*drives.yaml: servo is missing")
    assert client.state(CONTROLLER) == "unconfigured"
    (reason,) = client.set_parameters(CONTROLLER, robot="nowhere")
    assert reason.startswith("robot 'nowhere': no such folder; accepted: rx90b, tx40")
    assert client.set_parameters(CONTROLLER, controller="robots/rx90b/controller.yaml") == [""]

    # Configured: time stands still, and no service but the lifecycle's lets it run.
    joints, commands = client.listen("joint_states", depth=1), client.listen("motor_commands", depth=1)
    for node in NODES:
        assert client.transition(node, "configure")
        assert client.state(node) == "inactive"
    client.simulation.pause(False)
    step = client.asking.call(Trigger, f"{SIMULATION}/step", Trigger.Request())
    assert (step.success, step.message) == (False, "the node is inactive; accepted: in state active")
    enable = client.asking.call(SetBool, f"{CONTROLLER}/enable", SetBool.Request(data=True))
    assert (enable.success, enable.message) == (False, step.message)
    client.spin_until(lambda: len(joints) > 2, "the heartbeat")
    assert {seconds(message) for message in joints} == {0.0}

    # An active simulation runs with closed brakes until the controller is active, too, and when it no longer is.
    assert client.transition(SIMULATION, "activate")
    client.spin_until(lambda: bool(commands) and not commands[-1].effort, "a command without torque")
    assert client.transition(CONTROLLER, "activate")
    client.spin_until(lambda: len(commands[-1].effort) == 6, "torque")
    assert client.transition(CONTROLLER, "deactivate")
    client.spin_until(lambda: not commands[-1].effort, "the torque to be taken away")
    rested = seconds(commands[-1])
    client.spin_until(lambda: seconds(commands[-1]) > rested + 0.1, "time to go on")

    # A controller that is cleaned up is as one that has gone: time stands still until another one comes.
    assert client.transition(CONTROLLER, "cleanup")
    simulation.wait_for("no controller on /motor_commands: time stands still")
    for label in ("deactivate", "cleanup"):
        assert client.transition(SIMULATION, label)
    assert client.node.count_publishers("joint_states") == 0
    described = latched(client, "robot_description", String)
    for node in NODES:
        assert client.set_parameters(node, robot="tx40") == [""]
        assert client.transition(node, "configure")
    client.spin_until(lambda: bool(described), "the description")
    assert 'name="tx40"' in described[-1].data
    for node in reversed(NODES):
        assert client.transition(node, "activate")
    client.spin_until(lambda: len(commands[-1].effort) == 6, "torque for the other robot")
    for node, process in zip(NODES, started, strict=True):
        assert client.transition(node, "shutdown")
        assert process.wait() == 0
        assert "Traceback" not in process.output


@pytest.mark.ros
def test_gains_change_in_a_motion_and_the_rest_says_why_not(processes: Processes, client: Client) -> None:
    """What is safe changes at a position tick that a topic names, from which on the torque is another; nothing else does."""
    initial = [0.0, 0.8, 0.8, 0.0, 0.5, 0.0]
    cell = processes.start(
        "rx90_cell",
        *("--ros-args", "-p", "rx90_sim:paused:=true", "-p", "rx90_sim:real_time_factor:=0.0"),
        *("-p", "rx90_sim:step_ticks:=42", "-p", f"rx90_sim:initial_position:={initial}"),
        *("-p", "rx90_controller:servo.over_speed:=1.3"),
    )
    assert cell.wait() == 2
    assert "parameter servo.over_speed is unknown to rx90_controller; accepted: autostart, base_rate" in cell.output
