"""Whatever others send to the nodes or ask of them: they answer or refuse, in short lines, and go on."""

import os
import random
import re
import struct
from collections.abc import Iterator
from pathlib import Path
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
from rclpy.serialization import serialize_message
from ros_client import JOINTS, Client
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import JointState
from std_msgs.msg import Header, String
from trajectory_msgs.msg import JointTrajectory, JointTrajectoryPoint
from type_description_interfaces.srv import GetTypeDescription

from rx90_common.base.quoting import LINE_LIMIT
from rx90_common.base.rates import Rates
from rx90_common.exchange.cdr import JointStateCodec
from rx90_common.exchange.channel import lock_publisher
from rx90_common.exchange.endpoints import LATCHED_QOS, TICK_QOS
from rx90_common.exchange.topics import FREE_RUNNING, TimeMode, motor_names

pytestmark = pytest.mark.ros

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


def requests(known: str) -> Iterator[tuple[Any, dict[str, Any]]]:
    """Return requests, by their fields, to the services of a node that has the parameter `known`."""
    for value in VALUES:
        parameters = [Parameter(name=name, value=value) for name in (known, *NAMES[:2])]
        yield SetParameters, {"parameters": parameters}
        yield SetParametersAtomically, {"parameters": parameters[:1]}
    yield SetParametersAtomically, {"parameters": [Parameter(name=known, value=VALUES[0])] * 1000}
    for kind in (GetParameters, DescribeParameters, GetParameterTypes):
        for asked in ([], [known] * 1000, *([name] for name in NAMES)):
            yield kind, {"names": asked}
    yield ListParameters, {"prefixes": [*NAMES], "depth": 2**64 - 1}
    for name in NAMES:
        yield GetTypeDescription, {"type_name": name, "type_hash": "RIHS01_" + 64 * "0"}
        yield GetTypeDescription, {"type_name": "x", "type_hash": name}


def trajectory() -> JointTrajectory:
    point = JointTrajectoryPoint(positions=[0.01] * 6, velocities=[0.0] * 6, time_from_start=Duration(sec=1))
    return JointTrajectory(joint_names=JOINTS, points=[point])


def refused_trajectories() -> Iterator[bytes]:
    for names in ([], NAMES, ["x"] * 10_000, [NAMES[2]] * 6):
        yield serialize_message(JointTrajectory(joint_names=list(names), points=trajectory().points))
    for stamp in (Time(sec=-1), Time(sec=2**31 - 1, nanosec=2**32 - 1), Time(nanosec=2**32 - 1)):
        yield serialize_message(JointTrajectory(header=Header(stamp=stamp), joint_names=JOINTS))
    for bad in (float("nan"), float("inf"), 1e308, -5e-324):
        for time in (Duration(sec=-1), Duration(sec=2**31 - 1, nanosec=2**32 - 1), Duration()):
            point = JointTrajectoryPoint(positions=[bad] * 6, velocities=[bad] * 6, time_from_start=time)
            yield serialize_message(JointTrajectory(joint_names=JOINTS, points=[point, point]))


def broken(raw: bytes, count: int) -> Iterator[bytes]:
    """Return a message cut off, with wrong lengths, and as noise: four bytes or more, or DDS asks for it for ever."""
    chance = random.Random(1)
    for _ in range(count):
        yield raw[: chance.randrange(4, len(raw))]
        flipped = bytearray(raw)
        for _ in range(8):
            flipped[chance.randrange(4, len(raw) - 3) // 4 * 4 + 3] = 0xFF  # of a length: far more than there is
        yield bytes(flipped)
        yield chance.randbytes(chance.randrange(4, 200))


def test_nodes_outlive_every_message_and_every_request(processes: Processes, client: Client) -> None:
    """After hundreds of hostile messages and requests, each answered, all nodes serve; no line is long or forged."""
    nodes = [processes.start("rx90_sim", "--ros-args", "-p", "real_time_factor:=0.05")]
    nodes += [processes.start(name) for name in NODES[1:]]
    publishers = {
        topic: client.node.create_publisher(kind, topic, qos)
        for kind, topic, qos in (
            (JointTrajectory, "rx90_controller/joint_trajectory", 1000),
            (String, "time_mode", LATCHED_QOS),
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
        for kind, fields in requests(KNOWN[name]):
            service = f"{name}/{re.sub('(?<!^)(?=[A-Z])', '_', kind.__name__).lower()}"
            if service not in callers:
                callers[service] = client.node.create_client(kind, service)
                client.spin_until(callers[service].service_is_ready, service)
            client.spin_until(callers[service].call_async(kind.Request(**fields)).done, f"an answer of {service}")
    # A clock of negative times raises in rclpy's own callback.
    simulated = Parameter(name="use_sim_time", value=ParameterValue(type=1, bool_value=True))
    client.asking.call(SetParameters, "rx90_controller/set_parameters", SetParameters.Request(parameters=[simulated]))
    clock = client.node.create_publisher(Clock, "/clock", 10)
    past = Clock(clock=Time(sec=-5))
    client.spin_until(lambda: clock.publish(past) or "not served: " in nodes[1].output, "the complaint")
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
            assert re.match(r"\[(INFO|WARN|ERROR)\] |\w+: compiling|sequence size exceeds", line), line[:200]
            assert len(line) <= LINE_LIMIT + 100
            assert line.isprintable()
            assert "FATAL" not in line or "\\n" in line
    for topic in ("rx90_controller/joint_trajectory", "motor_states"):
        assert re.search(rf"/{topic}: .*; the message is ignored", nodes[1].output), topic


def refused(processes: Processes, code: int, name: str, *words: str) -> str:
    """Run a command to its end; return the only line of its refusal, beside those of a run that had begun."""
    done = processes.run(name, *words, timeout=300.0)
    assert done.returncode == code, done.stderr
    others = ("compiling the numerical kernels", "[INFO] ")
    (line,) = (line for line in done.stderr.splitlines() if not any(other in line for other in others))
    assert line.startswith(f"{name}: ")
    return line


@pytest.mark.parametrize(
    ("name", "argument", "accepted"),
    [
        ("rx90_sim", "initial_position:=[0, 9, 0, 0, 0, 0]", ["joint_2", "9"]),
        ("rx90_sim", "real_time_facto:=1.0", ["real_time_facto is unknown", "real_time_factor", "step_ticks"]),
        ("rx90_cell", "paused:=true", ["paused is unknown to rx90_controller"]),
    ],
)
def test_a_bad_parameter_is_one_line(processes: Processes, name: str, argument: str, accepted: list[str]) -> None:
    """The line names the program, the offending value and what is accepted; the exit code is 2."""
    line = refused(processes, 2, name, "--ros-args", "-p", argument)
    assert all(word in line for word in accepted), line


@pytest.mark.parametrize(("name", "topic"), [("rx90_sim", "/motor_states"), ("rx90_controller", "/motor_commands")])
def test_a_second_node_of_a_kind_is_refused(processes: Processes, ros_domain: int, name: str, topic: str) -> None:
    """Its topic has a publisher already: exit code 3 and one line that names topic and process."""
    with lock_publisher(ros_domain, topic):
        line = refused(processes, 3, name)
    held = f"{topic} in ROS_DOMAIN_ID {ros_domain} is already published by process {os.getpid()}; accepted: one"
    assert line.startswith(f"{name}: {held}")


def test_another_robot_or_rate_than_the_simulations_ends_a_controller(processes: Processes, client: Client) -> None:
    """In one process or from another one: exit code 3 and one line with both values."""
    line = refused(processes, 3, "rx90_cell", "--ros-args", "-p", "rx90_controller:robot:=tx40")
    assert line.startswith("rx90_cell: the robot is 'tx40' here and 'rx90b' in the simulation")
    states = client.node.create_publisher(JointState, "motor_states", TICK_QOS)
    mode = client.node.create_publisher(String, "time_mode", LATCHED_QOS)
    mode.publish(String(data=TimeMode(FREE_RUNNING, Rates()).text))
    controller = processes.start("rx90_controller", "--ros-args", "-p", "position_rate:=500")

    def ended() -> bool:
        states.publish(JointState())  # so that it is taken for a simulation
        return controller.returncode is not None

    client.spin_until(ended, "the end of the controller")
    assert controller.returncode == 3, controller.output
    assert "position_rate is 500 Hz here and 1000 Hz in the simulation" in controller.output


def test_the_time_mode_counts_from_the_sender_of_the_motor_states_alone(processes: Processes, client: Client) -> None:
    """Another process's, before and while the nodes run, ends no control, also with a publisher that sends nothing."""
    mode = client.node.create_publisher(String, "time_mode", LATCHED_QOS)
    strange = TimeMode(FREE_RUNNING, Rates(2000, 500), "other")
    mode.publish(String(data=strange.text))
    controller = processes.start("rx90_controller")
    controller.wait_for("'free_running base_rate=2000 position_rate=500 robot=other' of a process whose")
    states = client.node.create_publisher(JointState, "motor_states", TICK_QOS)
    processes.start("rx90_sim", "--ros-args", "-p", "real_time_factor:=0.0")
    controller.wait_for("the simulation is there|ready: ")
    client.spin_until(lambda: states.get_subscription_count() > 0, "the controller's ear")
    for text in ("sometimes", strange.text, TimeMode(FREE_RUNNING, Rates()).text):
        mode.publish(String(data=text))
    client.send([(1.0, [0.01] * 6), (2.0, [0.0] * 6)])
    controller.wait_for("trajectory accepted: 2 points")
    controller.wait_for("trajectory ended")
    assert controller.returncode is None
    assert controller.output.count("of a process whose /motor_states are not followed") == 1


def test_a_diverging_arm_ends_the_run_with_joint_and_tick(
    processes: Processes, edited_yaml: Any, shipped_files: Any
) -> None:
    """A gain far too large for an amplifier without limits ends the run with one line, not with NaN."""
    drives: Path = edited_yaml(shipped_files.drives, ("motor", "peak_current"), [1e7] * 6)
    law: Path = edited_yaml(shipped_files.controller, ("servo", "kv"), [400.0] * 3 + [1.2e4] + [400.0] * 2)
    law = edited_yaml(law, ("supervision", "following_error"), [1.0] * 6)
    law = edited_yaml(law, ("supervision", "over_speed"), 10.0)
    parameters = (f"drives:={drives}", f"rx90_controller:controller:={law}", "rx90_sim:real_time_factor:=0.0")
    words = [word for given in parameters for word in ("-p", given)]
    line = refused(processes, 3, "rx90_cell", "--ros-args", *words)
    assert re.match(r"rx90_cell: the state of joint_\d diverged in tick \d+", line)


def test_the_simulation_takes_the_steps_that_the_arm_needs_or_says_so(
    processes: Processes, edited_yaml: Any, shipped_files: Any
) -> None:
    """Stiff bristles: the log tells how many plant steps the node takes by itself; fewer asked for are one line."""
    file: Path = edited_yaml(shipped_files.friction, ("elements", "joint_6", "c0"), 5.0e5)
    told = ["--ros-args", "-p", f"friction:={file}"]
    processes.start("rx90_sim", *told).wait_for(r"ready: .*, [2-9] plant steps in a tick")
    line = refused(processes, 2, "rx90_sim", *told, "-p", "substeps:=2")
    assert re.search(r"friction\.joint_6\.c0 is 500000 Nm/rad, .*2 plant steps.*substeps [3-9]", line), line
