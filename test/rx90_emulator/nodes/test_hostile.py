"""Whatever others send to the nodes or ask of them: they answer, say so in short lines, and go on."""

from __future__ import annotations

import random
import re
import struct
from collections.abc import Iterator
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
from ros_client import JOINTS, Client
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import JointState
from std_msgs.msg import Header, String
from trajectory_msgs.msg import JointTrajectory, JointTrajectoryPoint
from type_description_interfaces.srv import GetTypeDescription

from rx90_common.base.quoting import LINE_LIMIT
from rx90_common.exchange.cdr import JointStateCodec
from rx90_common.exchange.endpoints import TICK_QOS
from rx90_common.exchange.topics import motor_names

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


GARBAGE = (
    b"\x00\x01\x00\x00" + struct.pack("<iI", 1, 0) + b"\xff" * 40,
    b"\x00\x01\x00\x00",
    b"\x00",
    JointStateCodec(["elbow"]).encode(250_000),
    JointStateCodec(motor_names(6)).encode(500_000),
    JointStateCodec(motor_names(6)[:5]).encode(750_000),
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
        topic: client.node.create_publisher(kind, topic, qos)
        for kind, topic, qos in (
            (JointTrajectory, "rx90_controller/joint_trajectory", 1000),
            (String, "time_mode", latched),
            (JointState, "motor_commands", 1000),
            (JointState, "motor_states", TICK_QOS),
        )
    }
    nodes[1].wait_for("ready: rx90b, .* trajectories on /rx90_controller/joint_trajectory")
    client.spin_until(lambda: all(p.get_subscription_count() for p in publishers.values()), "the nodes' ears")
    # Commands of another tick than the one that waits for its own: those would be a second controller's.
    command = JointState(header=Header(stamp=Time(sec=50)), name=JOINTS, effort=[0.0] * 6)
    modes = [serialize_message(String(data=name)) for name in NAMES]
    messages = {
        "rx90_controller/joint_trajectory": [*refused_trajectories(), *broken(serialize_message(trajectory()), 60)],
        "motor_commands": broken(serialize_message(command), 20),
        "motor_states": GARBAGE * 5,
        "time_mode": [*modes, *broken(modes[1], 20)],
    }
    for topic, raws in messages.items():
        for raw in raws:
            publishers[topic].publish(raw)
    callers: dict[str, Any] = {}
    for name in NODES:
        for kind, service, request in requests(KNOWN[name]):
            if (service := f"{name}/{service}") not in callers:
                callers[service] = client.node.create_client(kind, service)
                client.spin_until(callers[service].service_is_ready, service)
            client.spin_until(callers[service].call_async(request).done, f"an answer of {service}")
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
    for topic in ("rx90_controller/joint_trajectory", "motor_states"):
        assert re.search(rf"/{topic}: .*; the message is ignored", nodes[1].output), topic
