"""Whatever others send to the nodes or ask of them: they answer, say so in short lines, and go on."""

from __future__ import annotations

import random
import re
import signal
import struct
from collections.abc import Iterator
from itertools import cycle
from typing import Any

import pytest
from builtin_interfaces.msg import Duration, Time
from processes import Processes
from rcl_interfaces.msg import Parameter, ParameterValue
from rcl_interfaces.srv import (
    DescribeParameters,
    GetParameters,
    GetParameterTypes,
    ListParameters,
    SetParameters,
    SetParametersAtomically,
)
from rclpy.qos import DurabilityPolicy, QoSProfile
from rclpy.serialization import serialize_message
from ros_client import JOINTS, Client, seconds
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import JointState
from std_msgs.msg import Header, String
from trajectory_msgs.msg import JointTrajectory, JointTrajectoryPoint
from type_description_interfaces.srv import GetTypeDescription

from rx90_common.base.quoting import LINE_LIMIT
from rx90_common.base.rates import NANOSECONDS
from rx90_common.exchange.cdr import JointStateCodec
from rx90_common.exchange.endpoints import TICK_QOS
from rx90_common.exchange.topics import motor_names
from rx90_common.process.children import ChildProcess

NODES = ("rx90_sim", "rx90_controller", "friction_bench")
NAMES = ("", "a\n[FATAL] [1.0] [rx90_sim]: forged", "n" * 100_000, "qos_overrides./tf.publisher.depth", "\x1b[2J\u202e")
KNOWN = {"rx90_sim": "step_ticks", "rx90_controller": "base_rate", "friction_bench": "ramp_slope"}
VALUES = (
    ParameterValue(type=77),
    ParameterValue(type=255, string_value=NAMES[2]),
    *(ParameterValue(type=kind) for kind in range(10)),
    ParameterValue(type=3, double_value=float("nan")),
    ParameterValue(type=2, integer_value=-(2**63)),
    ParameterValue(type=8, double_array_value=[0.0] * 10_000),
    ParameterValue(type=4, string_value=NAMES[1]),
)


def requests(known: str) -> Iterator[tuple[Any, str, Any]]:
    """Return requests to the services of a node that has the parameter `known`."""
    for value in VALUES:
        parameters = [Parameter(name=name, value=value) for name in (known, *NAMES[:2])]
        yield SetParameters, "set_parameters", SetParameters.Request(parameters=parameters)
        yield (
            SetParametersAtomically,
            "set_parameters_atomically",
            SetParametersAtomically.Request(parameters=parameters[:1]),
        )
    yield (
        SetParametersAtomically,
        "set_parameters_atomically",
        SetParametersAtomically.Request(parameters=[Parameter(name=known, value=VALUES[0])] * 1000),
    )
    for kind, service in (
        (GetParameters, "get_parameters"),
        (DescribeParameters, "describe_parameters"),
        (GetParameterTypes, "get_parameter_types"),
    ):
        for asked in ([], [known] * 1000, *([name] for name in NAMES)):
            yield kind, service, kind.Request(names=asked)
    yield ListParameters, "list_parameters", ListParameters.Request(prefixes=[*NAMES], depth=2**64 - 1)
    for name in (*NAMES, "RIHS01_" + 64 * "0"):
        yield GetTypeDescription, "get_type_description", GetTypeDescription.Request(type_name=name, type_hash=name)


def trajectory() -> JointTrajectory:
    """Return a trajectory that the controller accepts."""
    point = JointTrajectoryPoint(positions=[0.01] * 6, velocities=[0.0] * 6, time_from_start=Duration(sec=1))
    return JointTrajectory(joint_names=JOINTS, points=[point])


def refused_trajectories() -> Iterator[bytes]:
    """Return trajectories that can be read and not followed."""
    for names in ([], NAMES, ["x"] * 10_000, [NAMES[2]] * 6):
        yield serialize_message(JointTrajectory(joint_names=list(names), points=trajectory().points))
    for stamp in (Time(sec=-1), Time(sec=2**31 - 1, nanosec=2**32 - 1), Time(nanosec=2**32 - 1)):
        yield serialize_message(JointTrajectory(header=Header(stamp=stamp), joint_names=JOINTS))
    for bad in (float("nan"), float("inf"), 1e308, -5e-324):
        for time in (Duration(sec=-1), Duration(sec=2**31 - 1, nanosec=2**32 - 1), Duration()):
            point = JointTrajectoryPoint(positions=[bad] * 6, velocities=[bad] * 6, time_from_start=time)
            yield serialize_message(JointTrajectory(joint_names=JOINTS, points=[point, point]))


def broken(raw: bytes, count: int) -> Iterator[bytes]:
    """Return a message cut off anywhere, with wrong lengths, and as noise.

    Each has the four bytes of an encapsulation: what is shorter the middleware itself drops, and it asks the sender for
    it again and again.
    """
    chance = random.Random(1)
    for _ in range(count):
        yield raw[: chance.randrange(4, len(raw))]
        flipped = bytearray(raw)
        for _ in range(8):
            flipped[chance.randrange(4, len(raw) - 3) // 4 * 4 + 3] = 0xFF  # of a length: far more than there is
        yield bytes(flipped)
        yield chance.randbytes(chance.randrange(4, 200))


@pytest.mark.ros
def test_nodes_outlive_every_message_and_every_request(processes: Processes, client: Client) -> None:
    """After hundreds of hostile messages and requests, each answered, all nodes serve; no line is long or forged."""
    nodes = [processes.start("rx90_sim", "--ros-args", "-p", "real_time_factor:=0.05")]
    nodes += [processes.start(name) for name in NODES[1:]]
    latched = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
    publishers = {
        kind: client.node.create_publisher(kind, topic, qos)
        for kind, topic, qos in (
            (JointTrajectory, "rx90_controller/joint_trajectory", 1000),
            (String, "time_mode", latched),
            (JointState, "motor_commands", 1000),
        )
    }
    nodes[1].wait_for("ready: rx90b, .* trajectories on /rx90_controller/joint_trajectory")
    client.spin_until(lambda: all(p.get_subscription_count() for p in publishers.values()), "the nodes' ears")
    # Commands of another tick than the one that waits for its own: those would be a second controller's.
    command = JointState(header=Header(stamp=Time(sec=50)), name=JOINTS, effort=[0.0] * 6)
    messages = {
        JointTrajectory: [*refused_trajectories(), *broken(serialize_message(trajectory()), 60)],
        JointState: [*broken(serialize_message(command), 20)],
        String: [serialize_message(String(data=name)) for name in NAMES],
    }
    messages[String] += broken(messages[String][1], 20)
    for kind, raws in messages.items():
        for raw in raws:
            publishers[kind].publish(raw)
    for name in NODES:
        for kind, service, request in requests(KNOWN[name]):
            client.asking.call(kind, f"{name}/{service}", request)
    # A clock of negative times raises in rclpy's own callback.
    simulated = Parameter(name="use_sim_time", value=ParameterValue(type=1, bool_value=True))
    client.asking.call(SetParameters, "rx90_controller/set_parameters", SetParameters.Request(parameters=[simulated]))
    clock = client.node.create_publisher(Clock, "/clock", 10)
    client.spin_until(
        lambda: clock.publish(Clock(clock=Time(sec=-5))) or "not served: " in nodes[1].output, "the complaint"
    )
    client.spin_until(lambda: nodes[1].output.count("trajectory rejected") >= 15, "the answers")
    client.send([(1.0, [0.01] * 6), (2.0, [0.02] * 6), (3.0, [0.03] * 6)])
    nodes[1].wait_for("trajectory accepted: 3 points")
    for name, value in (
        ("rx90_sim", ParameterValue(type=2, integer_value=8)),
        ("friction_bench", ParameterValue(type=3, double_value=0.01)),
    ):
        request = SetParameters.Request(parameters=[Parameter(name=KNOWN[name], value=value)])
        assert client.asking.call(SetParameters, f"{name}/set_parameters", request).results[0].successful
    for node in nodes:
        assert node.returncode is None
        for line in node.lines:
            assert re.match(r"\[(INFO|WARN|ERROR)\] |\w+: compiling", line), line[:200]
            assert len(line) <= LINE_LIMIT + 100
            assert line.isprintable()
            assert "FATAL" not in line or "\\n" in line
    assert re.search(r"/rx90_controller/joint_trajectory: .*; the message is ignored", nodes[1].output)


MODES = ("real_time_factor:=1.0", "time_mode:=free_running")
GARBAGE = (
    b"\x00\x01\x00\x00" + struct.pack("<iI", 1, 0) + b"\xff" * 40,
    b"\x00\x01\x00\x00",
    b"\x00",
    JointStateCodec(["elbow"]).encode(250_000),
    JointStateCodec(motor_names(6)).encode(500_000),
    JointStateCodec(motor_names(6)[:5]).encode(750_000),
)


def moving_through_garbage(processes: Processes, client: Client, mode: str) -> tuple[ChildProcess, ChildProcess]:
    """Start a pair and send garbage on its states during a motion; return both processes once that is at its end."""
    rates = ("-p", "base_rate:=1000", "-p", "position_rate:=1000")
    simulation = processes.start("rx90_sim", "--ros-args", "-p", mode, *rates)
    controller = processes.start("rx90_controller", "--ros-args", *rates)
    reference = client.listen("rx90_controller/reference", depth=1)
    client.spin_until(lambda: bool(reference), "the controller to hold")
    client.send([(0.4, [0.02] * 6)])
    controller.wait_for("trajectory accepted")
    publisher = client.node.create_publisher(JointState, "motor_states", TICK_QOS)
    client.spin_until(lambda: publisher.get_subscription_count() > 0, "the controller's ears")
    garbage = cycle(GARBAGE)
    # In free-running time only the newest of several messages is looked at.
    client.spin_until(lambda: publisher.publish(next(garbage)) or "ignored" in controller.output, "the complaint")
    for raw in GARBAGE:
        publisher.publish(raw)
    # A controller that falls behind on a loaded machine comes to the end later.
    end = pytest.approx([0.02] * 6, abs=1e-12)
    client.spin_until(lambda: list(reference[-1].position) == end, "the end of the motion")
    assert sum("ignored" in line for line in controller.lines) <= 3
    assert controller.returncode is None
    return simulation, controller


@pytest.mark.ros
def test_bad_messages_in_lock_step_are_a_line_each(processes: Processes, client: Client) -> None:
    """Wrong names, sizes and bytes of states leave a motion alone; a command that cannot be read closes no brakes.

    One with the stamp that is waited for is a line, and the controller's command is waited for.
    """
    simulation, controller = moving_through_garbage(processes, client, MODES[0])
    states = client.listen("motor_states", depth=1)
    publisher = client.node.create_publisher(JointState, "motor_commands", TICK_QOS)
    client.spin_until(lambda: publisher.get_subscription_count() > 0, "the simulation's ears")
    client.spin_until(lambda: bool(states), "time to run")
    controller.signal(signal.SIGSTOP)

    def stands_still() -> bool:
        """Return whether the newest states are those that wait: it may have been silent before its first command."""
        told = re.findall(r"is silent: time stands still at (\S+) s", simulation.output)
        return bool(told) and abs(float(told[-1]) - seconds(states[-1])) < 100e-6

    client.spin_until(stands_still, "time to stand still")
    stamp = states[-1].header.stamp
    publisher.publish(JointStateCodec(["elbow"]).encode(stamp.sec * NANOSECONDS + stamp.nanosec))
    simulation.wait_for("joint name 'elbow' is unknown; .*; the message is ignored")
    controller.signal(signal.SIGCONT)
    client.spin_until(lambda: states[-1].header.stamp != stamp, "time to run on")
    assert "brakes" not in simulation.output.split("is silent")[-1]


@pytest.mark.ros
def test_bad_messages_in_free_running_time_are_a_line_each(processes: Processes, client: Client) -> None:
    """Garbage leaves a motion alone, a controller that complained may fall behind, and a second one is reported once.

    Commands of somebody else between those of the controller close the brakes.
    """
    simulation, controller = moving_through_garbage(processes, client, MODES[1])
    joints = client.listen("joint_states", depth=1)
    reference = client.listen("rx90_controller/reference", depth=1)
    client.spin_until(lambda: bool(reference) and bool(joints), "the controller to hold")

    def lags() -> int:
        return len(re.findall("behind the simulation|the loops rest", controller.output))

    before = lags()
    for _ in range(10):  # on a busy machine there may have been such a line, which keeps the next one back for 5 s
        controller.signal(signal.SIGSTOP)
        later = seconds(joints[-1]) + 1.0
        client.spin_until(lambda: seconds(joints[-1]) > later, "the simulation to run ahead")  # noqa: B023 - called at once
        controller.signal(signal.SIGCONT)
        client.spin_until(lambda: seconds(reference[-1]) > later, "the controller to run on")  # noqa: B023
        if lags() > before:
            break
    assert lags() > before
    assert "Traceback" not in controller.output
    publisher = client.node.create_publisher(JointState, "motor_commands", TICK_QOS)
    raw = JointStateCodec(motor_names(6)).encode(0)
    client.spin_until(lambda: publisher.publish(raw) or "two controllers" in simulation.output, "the report")
    assert simulation.output.count("two controllers") == 1
