"""Set-points that are streamed to the running controller by topic, in lock-step."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from action_bench import STEP, Bench
from numpy.typing import NDArray
from ros_client import JOINTS
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64MultiArray

from rx90_common.exchange.endpoints import ros_time

pytestmark = pytest.mark.ros
DELAY = 0.03  # s


def wave(time: float) -> list[float]:
    """Return positions at a time, from rest, rad."""
    return [0.02 * (1.0 - float(np.cos(4.0 * np.pi * max(time, 0.0))))] * 6


def as_joint_state(position: list[float], time: float) -> JointState:
    """Return a set-point with names and stamp."""
    message = JointState(name=JOINTS, position=position)
    message.header.stamp = ros_time(round(time * 1e9))
    return message


def as_array(position: list[float], _: float) -> Float64MultiArray:
    """Return a set-point without names, as MoveIt Servo and forward_command_controller have it."""
    return Float64MultiArray(data=position)


def stream(bench: Bench, topic: str, message: Callable[[list[float], float], Any], count: int) -> NDArray[np.float64]:
    """Send a set-point in each step of 10 ms, once the one before has come; return the set-points that came of them."""
    bench.home()
    bench.heard()
    node, begin = bench.client.node, bench.now
    publisher = node.create_publisher(type(message(wave(0.0), 0.0)), f"rx90_controller/{topic}", 10)
    bench.client.spin_until(lambda: publisher.get_subscription_count() > 0, "the controller")
    for k in range(1, count):
        publisher.publish(message(wave(k * STEP), begin + k * STEP - STEP))
        publisher.wait_for_all_acked()
        bench.client.known_to("rx90_controller")  # its executor has taken what came before the request
        bench.time.run(STEP)
    bench.time.run(0.2)
    set_points = bench.set_points_from(begin, count * 10)
    node.destroy_publisher(publisher)
    bench.said("stream ended")
    return set_points


@pytest.mark.parametrize(("topic", "message"), [("joint_setpoints", as_joint_state), ("commands", as_array)])
def test_a_stream_moves_the_arm_after_the_delay(
    bench: Bench, topic: str, message: Callable[[list[float], float], Any]
) -> None:
    """In lock-step each set-point is passed through `stream.delay` after its time, by both topics; none is late."""
    set_points = stream(bench, topic, message, 40)
    due = np.array([round((k * STEP - STEP + DELAY) * 1e3) for k in range(6, 36)])
    wanted = np.array([wave(k * STEP) for k in range(6, 36)])
    assert np.abs(set_points[due - 1] - wanted).max() < 1e-5
    assert "came" not in bench.cell.output.rpartition("stream begins")[2]


def test_the_same_stream_gives_the_same_bits(bench: Bench) -> None:
    """Set-points with stamps that are there before they are used move the arm alike, to the last bit."""
    bench.begin_anew()
    first = stream(bench, "joint_setpoints", as_joint_state, 20)
    bench.begin_anew()
    assert (stream(bench, "joint_setpoints", as_joint_state, 20) == first).all()
