"""Managed nodes: their states, what may be set in which, and what a running pair does meanwhile."""

import re
import signal
from pathlib import Path
from typing import Any
from unittest.mock import ANY

import numpy as np
import pytest
from lifecycle_msgs.srv import GetAvailableTransitions
from processes import Processes
from rcl_interfaces.msg import ParameterEvent
from rclpy.parameter import parameter_value_to_python
from rclpy.qos import DurabilityPolicy, QoSProfile
from ros_client import Client, seconds
from std_msgs.msg import String
from std_srvs.srv import SetBool, Trigger

from rx90_controller.law.parameters import CS7BParameters
from rx90_emulator.loop.recorded_setup import read_values
from rx90_emulator.loop.setup import Setup

SIMULATION, CONTROLLER = NODES = ("rx90_sim", "rx90_controller")
UNMANAGED = ("--ros-args", "-p", "autostart:=false")
POSE = [0.0, 0.8, 0.8, 0.0, 0.5, 0.0]
TICKS, CHANGED_AT = 120, 42
TOLD = tuple(f"{node}/parameters" for node in NODES)
LATCHED = QoSProfile(depth=100, durability=DurabilityPolicy.TRANSIENT_LOCAL)


def latched(client: Client, topic: str, kind: type) -> list[Any]:
    heard: list[Any] = []
    client.node.create_subscription(kind, topic, heard.append, LATCHED)
    return heard


@pytest.mark.ros
def test_a_pair_goes_through_its_states(processes: Processes, client: Client) -> None:
    """Two processes that others manage: each state is what lifecycle.md says, also with another robot after it."""
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
    controller.wait_for("cannot configure: .*drives.yaml: transmission is not a known key; accepted: .*servo")
    assert client.state(CONTROLLER) == "unconfigured"
    (reason,) = client.set_parameters(CONTROLLER, robot="nowhere")
    assert reason.startswith("robot 'nowhere': no such folder; accepted: panda, rx90b, rx90b/paper, tx40")
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
    assert (enable.success, enable.message) == (False, "the controller is inactive; accepted: in state active")
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
    client.spin_until(lambda: client.node.count_publishers("motor_commands") == 0, "the commands' topic to go")
    # It is silent before its topics are gone, which may take long enough to be told.
    simulation.wait_for(r"controller on /motor_commands(?: is silent)?: time stands still at (?!0 s)")
    for label in ("deactivate", "cleanup"):
        assert client.transition(SIMULATION, label)
    client.spin_until(lambda: client.node.count_publishers("joint_states") == 0, "the topics to go")
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


def commands_of_two_laws(setup: Setup, before: CS7BParameters, after: CS7BParameters, first: int) -> list[list[float]]:
    """Return the motor torques while the arm holds `POSE`, with plant and law stepped here: `after` from a tick on."""
    plant, cs7b = setup.plant(), setup.cs7b()
    plant.reset(POSE)
    commands = []
    for tick in range(TICKS):
        position, velocity, _ = plant.motor_states()
        if tick == 0:
            cs7b.reset(position)
        cs7b.law[:] = (after if tick >= first else before).record(setup.robot, setup.drives, setup.rates)
        commands.append(cs7b.step(position, velocity).tolist())
        plant.step(np.array(commands[-1]))
    return commands


@pytest.mark.ros
def test_gains_change_between_two_ticks_and_the_rest_says_why_not(
    processes: Processes, client: Client, shipped: Setup, tmp_path: Path
) -> None:
    """What is safe changes at a position tick that topic and bag tell; from it on the torque is that of the new law."""
    viscous = [0.5 * value for value in shipped.controller.feed_forward.viscous_friction]
    cell = processes.start(
        "rx90_cell",
        *("--ros-args", "-p", "rx90_sim:paused:=true", "-p", "rx90_sim:real_time_factor:=0"),
        *("-p", f"rx90_sim:step_ticks:={TICKS - CHANGED_AT}", "-p", f"rx90_sim:initial_position:={POSE}"),
        *("-p", f"rx90_controller:feed_forward.viscous_friction:={viscous}"),
    )
    cell.wait_for("ready")
    events = latched(client, f"{CONTROLLER}/parameters", ParameterEvent)
    commands = client.listen("motor_commands")
    recorder = processes.start("rx90 bag", "record", "-o", tmp_path / "bag", "motor_states", *TOLD)
    recorder.wait_for("ready: all")
    client.spin_until(lambda: len(events) == 1, "the values at the start")
    told = {p.name: parameter_value_to_python(p.value) for p in events[0].new_parameters}
    assert list(told["servo.kp"]) == list(shipped.controller.servo.kp)
    assert list(told["feed_forward.viscous_friction"]) == viscous

    # Refused, with what is accepted, and without effect.
    refused = {
        "robot": ("tx40", "robot is read when the node is configured"),
        "autostart": (False, "read-only"),
        "servo_kp": (1.0, "servo_kp is unknown to rx90_controller .did you mean servo.kp.*; accepted: .*servo.kp"),
        "servo.kp": ([1.0] * 5, r"servo.kp is .*; accepted: 6 numbers"),
        "feed_forward.coulomb": (1.0, "Wrong parameter type"),
    }
    for name, (value, reason) in refused.items():
        assert re.search(reason, client.set_parameters(CONTROLLER, **{name: value})[0]), name
    kp, inertia = [80.0] * 6, (shipped.controller.inertia * 1.5).tolist()
    (reason,) = client.set_parameters(CONTROLLER, atomically=True, servo__kp=kp, servo__ki=[-1.0] * 6)
    assert "servo.ki[0] is -1.0" in reason

    # Changed, one by one and together, from one position tick on.
    switched = {
        f"feed_forward__{part}": part != "coulomb" for part in ("coulomb", "inverse_dynamics", "friction_model")
    }
    assert client.set_parameters(SIMULATION, step_ticks=CHANGED_AT) == [""]
    client.simulation.step()
    assert client.set_parameters(SIMULATION, step_ticks=TICKS - CHANGED_AT) == [""]
    assert client.set_parameters(CONTROLLER, servo__kp=[1.0], servo__inertia=inertia) == [ANY, ""]
    assert client.set_parameters(CONTROLLER, atomically=True, servo__kp=[80] * 6, **switched) == [""]
    client.simulation.step()
    client.spin_until(lambda: len(events) == 3, "two changes")
    effect = -(-CHANGED_AT // 4) * 4
    assert [message.stamp.nanosec for message in events[1:]] == [effect * 250_000] * 2
    assert [p.name for p in events[2].changed_parameters] == [
        "servo.kp",
        *(name.replace("__", ".") for name in switched),
    ]
    client.spin_until(lambda: len(commands) == TICKS, "all commands")
    before = shipped.controller.replaced(feed_forward={"viscous_friction": np.array(viscous)})
    forward = {"coulomb": False, "inverse_dynamics": True, "friction_model": True}
    after = before.replaced(servo={"kp": np.array(kp), "inertia": np.array(inertia)}, feed_forward=forward)
    assert [list(m.effort) for m in commands] == commands_of_two_laws(shipped, before, after, effect)
    recorder.signal(signal.SIGINT)
    assert recorder.wait() == 0
    recorded = read_values(tmp_path / "bag")
    assert recorded["feed_forward.viscous_friction"] == viscous
    assert recorded["servo.kp"] == list(shipped.controller.servo.kp)
