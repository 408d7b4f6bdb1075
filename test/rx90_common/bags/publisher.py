"""Publish all topics of the suite as its nodes do, with numbers of the tick: `publisher.py DEPTH LISTENERS`.

Every line on standard input, `TICKS RATE`, makes it publish ticks at a rate in Hz (0: as fast as it goes)
once it has so many subscriptions on its topics together: who listens may know that before. It prints where it is and,
once all has arrived, `done` behind each, and ends with its input.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Callable

import numpy as np
import rclpy
from rcl_interfaces.msg import ParameterEvent
from rclpy.duration import Duration
from rclpy.parameter import Parameter
from rclpy.qos import DurabilityPolicy, QoSProfile
from sensor_msgs.msg import JointState, Temperature
from std_msgs.msg import String
from trajectory_msgs.msg import JointTrajectory

from rx90_common.exchange.cdr import JointStateCodec
from rx90_common.exchange.ros_start import prepare

FAST = ("motor_states", "motor_commands")
SLOW = (
    "joint_states",
    "friction_states",
    "rx90_controller/reference",
    "rx90_controller/tracking_error",
    "rx90_controller/reference_acceleration",
    "rx90_controller/commanded_current",
    "rx90_controller/motor_current",
)
TICK_NS = 250_000
NAMES = tuple(f"joint_{i}" for i in range(1, 7))


def main() -> None:
    """Publish on demand."""
    prepare()
    rclpy.init()
    node = rclpy.create_node("publisher")
    qos = QoSProfile(depth=int(sys.argv[1]))
    publishers = {topic: node.create_publisher(JointState, topic, qos) for topic in (*FAST, *SLOW)}
    latched = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
    described = node.create_publisher(String, "robot_description", latched)
    described.publish(String(data="<robot/>"))
    event = ParameterEvent(
        node="/rx90_sim", changed_parameters=[Parameter("pace", value=[2.0, 0.5]).to_parameter_msg()]
    )
    event.stamp.nanosec = 200_000_000
    for topic in ("rx90_sim/parameters", "rx90_controller/parameters"):
        told = publishers[topic] = node.create_publisher(ParameterEvent, topic, latched)
        told.publish(event)
    accepted = node.create_publisher(JointTrajectory, "rx90_controller/trajectory_accepted", latched)
    temperatures = node.create_publisher(Temperature, "temperatures", qos)
    trajectory = node.create_publisher(JointTrajectory, "rx90_controller/joint_trajectory", qos)
    fast = [publishers[topic].publish for topic in FAST]
    slow = [publishers[topic].publish for topic in SLOW]
    each = (*publishers.values(), described, accepted, temperatures, trajectory)
    listeners = int(sys.argv[2])
    print("there", flush=True)
    tick = 0
    for line in sys.stdin:
        ticks, rate = map(int, line.split())
        while sum(publisher.get_subscription_count() for publisher in each) < listeners:
            time.sleep(0.01)
        message = JointTrajectory(joint_names=list(NAMES))
        message.header.stamp.nanosec = 100_000_000
        trajectory.publish(message)
        accepted.publish(message)
        warm = Temperature(header=message.header, temperature=31.5)
        temperatures.publish(warm)
        publish(range(tick, tick + ticks), rate, fast, slow)
        tick += ticks
        for publisher in each:
            publisher.wait_for_all_acked(Duration(seconds=60.0))
        print("done", flush=True)


def publish(ticks: range, rate: int, fast: list[Callable[[bytes], None]], slow: list[Callable[[bytes], None]]) -> None:
    """Publish these ticks."""
    codec = JointStateCodec(NAMES)
    start = time.monotonic()
    for tick in ticks:
        if rate:
            time.sleep(max(0.0, start + (tick - ticks.start) / rate - time.monotonic()))
        values = np.sin(np.arange(6) + 0.001 * tick)
        raw = codec.encode(tick * TICK_NS, values, -values, 2 * values)
        for send in fast if tick % 4 else fast + slow:
            send(raw)
        if tick % 500 == 0:
            for send in slow:  # the same sample once more, as from a simulation in which time stands still
                send(raw)
            print(f"at {tick}", flush=True)


main()
