"""Set-points that are streamed to the running controller by topic, in lock-step."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import pytest
from action_bench import STEP, Bench
from numpy.typing import NDArray
from processes import TIMEOUT
from rclpy.duration import Duration
from ros_client import JOINTS
from sensor_msgs.msg import JointState

from rx90_common.exchange.endpoints import ros_time

pytestmark = pytest.mark.ros
DELAY = 0.03  # s


def wave(time: float) -> list[float]:
    """Return positions at a time, from rest, rad."""
    return [0.02 * (1.0 - float(np.cos(4.0 * np.pi * max(time, 0.0))))] * 6


def set_points(bench: Bench, messages: Sequence[Any], topic: str, seconds: float) -> NDArray[np.float64]:
    """Send messages while time stands still, then let it run; return the set-points that came of them."""
    begin, node = bench.now, bench.client.node
    publisher = node.create_publisher(type(messages[0]), f"rx90_controller/{topic}", len(messages))
    bench.client.spin_until(lambda: publisher.get_subscription_count() > 0, "the controller")
    for message in messages:
        publisher.publish(message)
    assert publisher.wait_for_all_acked(Duration(seconds=TIMEOUT))
    for _ in messages:  # in the round in which it answers a request, its executor takes one waiting set-point
        bench.client.known_to("rx90_controller")
    bench.time.run(seconds)
    followed = bench.set_points_from(begin, round(seconds * 1e3) - 1)
    node.destroy_publisher(publisher)
    return followed


def test_stamped_set_points_are_passed_through_after_the_delay_bit_by_bit(bench: Bench) -> None:
    """In lock-step each is met `stream.delay` after its stamp, and the same ones give the same bits again."""
    found = []
    for _ in range(2):
        bench.begin_anew()
        begin, messages = bench.now, []
        for k in range(1, 40):
            messages.append(JointState(name=JOINTS, position=wave(k * STEP)))
            messages[-1].header.stamp = ros_time(round((begin + k * STEP) * 1e9))
        found.append(set_points(bench, messages, "joint_setpoints", 0.6))
    due = np.array([round((k * STEP + DELAY) * 1e3) for k in range(3, 39)])
    assert np.abs(found[0][due - 1] - np.array([wave(k * STEP) for k in range(3, 39)])).max() < 1e-5
    assert (found[0] == found[1]).all()
    assert "came" not in bench.cell.output.rpartition("stream begins")[2]
