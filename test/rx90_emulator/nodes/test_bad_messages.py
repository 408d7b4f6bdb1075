"""What somebody else sends on the tick topics, and nodes that do not fit each other."""

from __future__ import annotations

import re
import signal
import struct
from itertools import cycle

import pytest
from processes import Processes
from ros_client import Client, seconds
from sensor_msgs.msg import JointState

from rx90_common.base.rates import NANOSECONDS
from rx90_common.exchange.cdr import JointStateCodec
from rx90_common.exchange.endpoints import TICK_QOS
from rx90_common.exchange.topics import MOTOR_NAMES
from rx90_common.process.children import ChildProcess

MODES = ("real_time_factor:=1.0", "time_mode:=free_running")
GARBAGE = (
    b"\x00\x01\x00\x00" + struct.pack("<iI", 1, 0) + b"\xff" * 40,
    b"\x00\x01\x00\x00",
    b"\x00",
    JointStateCodec(["elbow"]).encode(250_000),
    JointStateCodec(MOTOR_NAMES).encode(500_000),
    JointStateCodec(MOTOR_NAMES[:5]).encode(750_000),
)


def moving_through_garbage(processes: Processes, client: Client, mode: str) -> tuple[ChildProcess, ChildProcess]:
    """Start a pair and send garbage on its states during a motion; return both processes once that is at its end."""
    simulation = processes.start("rx90_sim", "--ros-args", "-p", mode)
    controller = processes.start("rx90_controller")
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
    raw = JointStateCodec(MOTOR_NAMES).encode(0)
    client.spin_until(lambda: publisher.publish(raw) or "two controllers" in simulation.output, "the report")
    assert simulation.output.count("two controllers") == 1


@pytest.mark.ros
def test_other_rates_in_the_controller_end_it(processes: Processes) -> None:
    """A controller whose rates are not the simulation's ends with one line that names both values."""
    processes.start("rx90_sim", "--ros-args", "-p", MODES[1])
    for rate, other, ours in (("position_rate", 500, 1000), ("base_rate", 2000, 4000)):
        controller = processes.start("rx90_controller", "--ros-args", "-p", f"{rate}:={other}")
        controller.wait_for(f"rx90_controller: {rate} is {other} Hz here and {ours} Hz in the simulation")
        assert controller.wait() == 3
        assert "Traceback" not in controller.output
