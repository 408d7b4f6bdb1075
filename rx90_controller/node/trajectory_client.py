"""Hand a planned line to the controller: a JointTrajectory over DDS, delivered before the program ends."""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import rclpy
from builtin_interfaces.msg import Duration, Time
from numpy.typing import NDArray
from rclpy.duration import Duration as RclpyDuration
from rclpy.node import Node
from rclpy.publisher import Publisher
from sensor_msgs.msg import JointState
from trajectory_msgs.msg import JointTrajectory, JointTrajectoryPoint

from rx90_common.base.errors import ExchangeError, LineError
from rx90_common.base.rates import NANOSECONDS
from rx90_common.exchange.ros_start import reason
from rx90_controller.lines.plan import LinePlan, approach_time, stamped_points

Array = NDArray[np.float64]

# The controller takes a first point at time 0 only this close to the position it holds.
START_TOLERANCE = 1e-3
_POLL = 0.05


@dataclass(frozen=True)
class Approach:
    """A joint-space move to the start of the line.

    Attributes:
        speed: share of the joints' speed limits, in (0, 1].
        acceleration: of each joint, rad/s².
    """

    speed: float
    acceleration: float


@dataclass(frozen=True)
class Delivery:
    """How a plan is handed over.

    Attributes:
        controller: name of the controller node.
        start_time: time at which the trajectory starts, s; 0 means now.
        timeout: longest wait for the controller, and again for the joint states, s.
        approach: the move to the start of the line, None where the arm already stands there.
    """

    controller: str
    start_time: float
    timeout: float
    approach: Approach | None

    def __post_init__(self) -> None:
        if not (math.isfinite(self.start_time) and 0.0 <= self.start_time < 2.0**31):
            raise LineError(f"the start time is {self.start_time:g} s; accepted: a number >= 0, 0 for now")
        if not (math.isfinite(self.timeout) and self.timeout > 0.0):
            raise LineError(f"the timeout is {self.timeout:g} s; accepted: a number > 0")


def trajectory_message(plan: LinePlan, start_time: float, delay: float) -> JointTrajectory:
    """Return the plan as a message whose points come `delay` s later than in the plan."""
    message = JointTrajectory(joint_names=list(plan.joint_names))
    sec, nanosec = divmod(round(start_time * NANOSECONDS), NANOSECONDS)
    message.header.stamp = Time(sec=sec, nanosec=nanosec)
    message.points = [
        JointTrajectoryPoint(
            positions=point.position,
            velocities=point.velocity,
            accelerations=point.acceleration,
            time_from_start=Duration(sec=point.sec, nanosec=point.nanosec),
        )
        for point in stamped_points(plan, delay)
    ]
    return message


def deliver(
    plan: LinePlan, delivery: Delivery, say: Callable[[str], None], check_interrupt: Callable[[], None]
) -> None:
    """Wait for the controller, publish the trajectory and wait until it has been received.

    Needs an initialised rclpy. `say` gets one line for each thing that happens; `check_interrupt` is called between two
    slices of a wait and may raise.

    Raises:
        ExchangeError: if the controller or the joint states do not show up within the timeout.
        LineError: if the arm stands elsewhere and no approach was asked for.
    """
    node = rclpy.create_node("rx90_line")
    try:
        topic = _topic(node, delivery.controller)
        publisher = node.create_publisher(JointTrajectory, topic, 1)

        def matched() -> bool:
            # The controller must be among them, and a recorder that is in the graph gets the trajectory too.
            subscribers = node.get_subscriptions_info_by_topic(topic)
            there = any(info.node_name == delivery.controller.split("/")[-1] for info in subscribers)
            return there and len(subscribers) <= publisher.get_subscription_count()

        def wait(ready: Callable[[], bool], what: str) -> None:
            _wait(node, ready, what, delivery.timeout, say, check_interrupt)

        wait(matched, f"a controller on {topic}")
        delay = _delay(node, plan, delivery, topic, say, wait)
        message = trajectory_message(plan, delivery.start_time, delay)
        publisher.publish(message)
        _confirm(publisher, topic, delivery.timeout, check_interrupt)
        start = f"at {delivery.start_time:g} s" if delivery.start_time else "now"
        say(f"sent {len(message.points)} points to {topic}: start {start}, {plan.duration + delay:.3f} s")
    finally:
        node.destroy_node()


def _confirm(publisher: Publisher, topic: str, timeout: float, check_interrupt: Callable[[], None]) -> None:
    deadline = time.monotonic() + timeout
    while not publisher.wait_for_all_acked(RclpyDuration(nanoseconds=round(_POLL * NANOSECONDS))):
        check_interrupt()
        if time.monotonic() >= deadline:
            raise ExchangeError(f"the controller on {topic} did not confirm the trajectory in {timeout:g} s")


def _wait(
    node: Node,
    ready: Callable[[], bool],
    what: str,
    timeout: float,
    say: Callable[[str], None],
    check_interrupt: Callable[[], None],
) -> None:
    """Spin until `ready`; say once what is waited for."""
    deadline = time.monotonic() + timeout
    announced = False
    while not ready():
        if time.monotonic() >= deadline:
            raise ExchangeError(f"found no {what.removeprefix('a ')} within {timeout:g} s")
        if not announced:
            say(f"waiting for {what}")
            announced = True
        rclpy.spin_once(node, timeout_sec=_POLL)
        check_interrupt()


def _delay(
    node: Node,
    plan: LinePlan,
    delivery: Delivery,
    topic: str,
    say: Callable[[str], None],
    wait: Callable[[Callable[[], bool], str], None],
) -> float:
    """Return how much later than planned the line begins: the time of the approach, s."""
    if delivery.approach is None and delivery.start_time > 0.0:
        return 0.0  # where the arm will be by then is not known here; the controller checks it
    here = _joint_positions(node, topic, plan.joint_names, wait)
    gap = np.abs(here - plan.start_pose)
    joint = int(np.argmax(gap))
    if gap[joint] <= START_TOLERANCE:
        return 0.0
    if delivery.approach is None:
        raise LineError(
            f"{plan.joint_names[joint]} is at {here[joint]:.4f} rad, the line starts at "
            f"{plan.start_pose[joint]:.4f} rad; accepted: within {START_TOLERANCE:g} rad, or --approach"
        )
    approach = delivery.approach
    robot = plan.path.robot
    duration = approach_time(robot, here, plan.start_pose, approach.speed, approach.acceleration)
    duration = math.ceil(duration * 1e3) / 1e3
    say(f"approach: {np.degrees(gap[joint]):.1f} deg in {plan.joint_names[joint]}, {duration:.3f} s")
    return duration


def _topic(node: Node, controller: str) -> str:
    try:
        return str(node.resolve_topic_name(f"{controller}/joint_trajectory"))
    except RuntimeError as error:
        raise LineError(
            f"--controller is '{controller}' ({reason(error)}); accepted: the name of a node, such as rx90_controller "
            "or /cell/rx90_controller"
        ) from error


def _joint_positions(
    node: Node, controller_topic: str, names: tuple[str, ...], wait: Callable[[Callable[[], bool], str], None]
) -> Array:
    found: list[Array] = []

    def take(message: JointState) -> None:
        position = dict(zip(message.name, message.position, strict=False))
        if set(names) <= position.keys():
            found.append(np.array([position[name] for name in names]))

    # The arm that this controller moves is in the controller's namespace, which need not be ours.
    topic = node.resolve_topic_name(controller_topic.rsplit("/", 2)[0] + "/joint_states")
    subscription = node.create_subscription(JointState, topic, take, 10)
    wait(lambda: bool(found), f"a position of the six joints on {topic}")
    node.destroy_subscription(subscription)
    return found[-1]
