"""Send trajectories to the controller node, and wait until they have arrived."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Sequence
from functools import partial

import numpy as np
from builtin_interfaces.msg import Duration
from rclpy.duration import Duration as RclpyDuration
from rclpy.publisher import Publisher
from rclpy.qos import QoSProfile, ReliabilityPolicy
from sensor_msgs.msg import JointState
from std_srvs.srv import SetBool
from trajectory_msgs.msg import JointTrajectory, JointTrajectoryPoint

from rx90_common.base.arrays import Array
from rx90_common.base.errors import ExchangeError
from rx90_common.base.quoting import counted
from rx90_common.base.rates import NANOSECONDS, message_time_ns
from rx90_common.exchange.client_node import (
    POLL,
    ClientNode,
    ServiceRequest,
    spoken,
    subscribe_log,
)
from rx90_common.exchange.endpoints import ros_time
from rx90_common.exchange.ros_start import controller_topic
from rx90_common.exchange.topics import (
    COMMANDED_CORRECTION,
    COMMANDED_TRAJECTORY,
    CORRECTED,
    REFERENCE,
    TRAJECTORY_ACCEPTED,
)
from rx90_controller.lines.plan import LinePlan, approached
from rx90_controller.node.sent_trajectory import SentTrajectory
from rx90_controller.trajectory import JointLimits, TrajectoryPoints
from rx90_controller.trajectory.correction import Correction
from rx90_controller.trajectory.points import (
    correction_points,
    message_content,
    trajectory_identity,
)

_SETTLED = 1.2  # s without a change among those that listen; each participant announces itself every second, config/dds
_NEXT_SAMPLE = 1.5  # s; at the slowest real_time_factor the samples of a simulation that runs come every second

Show = Callable[[float, float], object]
"""Called with the part of a trajectory's duration that has passed, and its duration, s."""


class NewestPositions:
    """The newest positions of some joints on a JointState topic, updated by `ClientNode.spin`.

    Messages in which a joint is missing are left out.

    Attributes:
        position: rad, in the order of the names; no numbers before the first message.
        time: its stamp, s.
        count: number of messages.
        standing: whether the newest message has the stamp of the one before: time stands still.
    """

    def __init__(self, client: ClientNode, topic: str, names: Sequence[str]) -> None:
        self._names = names
        self.position: Array = np.full(len(names), np.nan)
        self.time = -1.0
        self.count = 0
        self.standing = False
        # One message in the queue: only the newest is looked at.
        newest = QoSProfile(depth=1, reliability=ReliabilityPolicy.BEST_EFFORT)
        client.node.create_subscription(JointState, topic, self._take, newest)

    def _take(self, message: JointState) -> None:
        position = dict(zip(message.name, message.position, strict=False))
        if set(self._names) <= position.keys():
            self.position = np.array([position[name] for name in self._names])
            time = self.time
            self.time = message_time_ns(message.header.stamp) / NANOSECONDS
            self.count += 1
            self.standing = self.time == time


class TrajectoryClient:
    """Sends trajectories to one controller node, and receives its set-points and the arm's states.

    Args:
        client: the node to do it with.
        controller: name of the controller node, relative or absolute.
    """

    def __init__(self, client: ClientNode, controller: str) -> None:
        self.topic = controller_topic(client.node, controller)
        self._client = client
        self._controller = controller
        self._publisher = client.node.create_publisher(JointTrajectory, self.topic, 1)
        private = self.topic.removesuffix(COMMANDED_TRAJECTORY)
        self._corrections = client.node.create_publisher(
            JointTrajectory, private + COMMANDED_CORRECTION, 1
        )
        self._arm: NewestPositions | None = None
        self._sent: SentTrajectory | None = None
        client.node.create_subscription(
            JointTrajectory, private + TRAJECTORY_ACCEPTED, self._take_acceptance, 1
        )
        subscribe_log(client, [controller], self._take_line)

    def _take_acceptance(self, accepted: JointTrajectory) -> None:
        if self._sent is not None:
            self._sent.take_acceptance(accepted)

    def _take_line(self, _node: str, line: str, _wrong: bool) -> None:
        if self._sent is not None:
            self._sent.take_line(line)

    def wait_for_controller(self, starting: float = 0.0) -> None:
        """Wait until the controller will receive messages.

        Args:
            starting: additional time to wait, s, for a node that exists and still lacks its topics.

        Raises:
            ExchangeError: if there is no controller within the client's timeout.
        """
        name = self._controller.split("/")[-1]

        def matched() -> bool:
            subscribers = self._client.node.get_subscriptions_info_by_topic(self.topic)
            there = any(info.node_name == name for info in subscribers)
            return there and self._publisher.get_subscription_count() > 0

        def more() -> float:
            if not starting or name not in self._client.node.get_node_names():
                return 0.0
            self._client.say(
                f"{name} is there, without its topics: the first start with an arm of another size compiles code; "
                f"waiting {starting:g} s more"
            )
            return starting

        self._client.wait(matched, f"a controller on {self.topic}", more)

    def _settle(self) -> None:
        """Wait until all subscribers that the graph shows, a recorder for example, are matched, and no more appear.

        The graph discovers its members one by one. Subscribers that cannot be matched are waited for no longer than the
        client's timeout.
        """
        publisher = self._publisher
        before = -1
        since = time.monotonic()
        deadline = since + self._client.timeout
        while time.monotonic() < since + _SETTLED:
            known = self._client.node.count_subscribers(self.topic)
            have = publisher.get_subscription_count()
            if have != before or have < known:
                before = have
                since = time.monotonic()
            if have < known and since > deadline:
                self._client.say(
                    f"{known - have} of {known} that listen to {self.topic} cannot be reached"
                )
                return
            self._client.spin()

    def arm(self, names: Sequence[str]) -> NewestPositions:
        """Return the subscription to the states of the controller's arm, after the first of them.

        Raises:
            ExchangeError: if no joint states come within the client's timeout.
        """
        # The arm is in the controller's namespace, which need not be ours.
        self._arm = self._newest(
            self.topic.rsplit("/", 2)[0] + "/joint_states", names, "position of the joints"
        )
        return self._arm

    def standing_time(self) -> float | None:
        """Return the time at which the simulation stands still, s; None if it runs, or before `arm`.

        While time stands still the simulation repeats its newest sample a few times a second.
        """
        arm = self._arm
        if arm is None:
            return None
        count = arm.count
        deadline = time.monotonic() + _NEXT_SAMPLE
        while arm.count == count and time.monotonic() < deadline:
            self._client.spin()
        return arm.time if arm.standing else None

    def set_points(self, names: Sequence[str]) -> NewestPositions:
        """Return the subscription to the controller's set-points, after the first of them.

        Raises:
            ExchangeError: if there are none within the client's timeout.
        """
        return self._newest(f"{self.topic.rsplit('/', 1)[0]}/{REFERENCE}", names, "set-point")

    def _newest(self, topic: str, names: Sequence[str], what: str) -> NewestPositions:
        newest = NewestPositions(self._client, topic, names)
        self._client.wait(lambda: newest.count > 0, f"a {what} on {topic}")
        return newest

    def send(
        self,
        names: Sequence[str],
        points: TrajectoryPoints,
        start_time: float = 0.0,
        correction: Correction | None = None,
        tolerance: float = 0.0,
    ) -> None:
        """Publish a trajectory to all that listen and wait until it has arrived.

        Args:
            names: joints in the order of the points' columns.
            points: the trajectory.
            start_time: when it starts, s; 0 means now.
            correction: of the trajectory; None for none.
            tolerance: how far from its last point the samples of `wait_for_end` may be when it has ended, rad.

        Raises:
            ExchangeError: if that is not confirmed within the client's timeout.
        """
        self._settle()
        message = trajectory_message(names, points, start_time)
        self._sent = SentTrajectory(message, points, tolerance)
        if correction is not None:
            message.header.frame_id = CORRECTED
            there = self._corrections.get_subscription_count
            self._client.wait(
                lambda: there() > 0, f"a controller on {self._corrections.topic_name}"
            )
            offsets = trajectory_message(names, correction_points(correction))
            offsets.header.frame_id = trajectory_identity(points)
            self._corrections.publish(offsets)
            self._confirm(self._corrections, "correction")
        self._publisher.publish(message)
        self._confirm(self._publisher, "trajectory")

    def wait_for_end(self, samples: NewestPositions, show: Show) -> float:
        """Wait until the trajectory that was sent last, to start now, has ended, and return when, s.

        That is when it was due, unless the arm came later, because it was slowed down.

        Args:
            samples: of the arm or of its set-points.
            show: called again and again.

        Raises:
            ExchangeError: if the controller refuses it or does not run it to its end, or time stands still.
        """
        sent = self._sent
        assert sent is not None
        newest = samples.time
        came = time.monotonic()
        while sent.end == math.inf:
            self._client.spin()
            clock = time.monotonic()
            if samples.time > newest:
                newest = samples.time
                came = clock
            elif clock > came + self._client.timeout:
                sent.fault = f"time stood still at {newest:.3f} s for {self._client.timeout:g} s"
            sent.see(samples.time, samples.position, clock)
            if sent.fault:
                raise ExchangeError(f"{self._controller}: {sent.fault}")
            show(min(max(0.0, newest - sent.begin), sent.duration), sent.duration)
            # the newest message suffices; in between the processor is left to the nodes
            time.sleep(POLL / 2.0)
        return sent.end

    def _confirm(self, publisher: Publisher, what: str) -> None:
        deadline = time.monotonic() + self._client.timeout
        while not publisher.wait_for_all_acked(
            RclpyDuration(nanoseconds=round(POLL * NANOSECONDS))
        ):
            self._client.check_interrupt()
            if time.monotonic() >= deadline:
                raise ExchangeError(
                    f"the controller on {publisher.topic_name} did not confirm the {what} in {self._client.timeout:g} s"
                )

    def offer(self, names: Sequence[str], points: TrajectoryPoints | None) -> None:
        """Publish a trajectory that starts now, or None to stop the arm, and do not wait; the controller's log answers.

        Raises:
            ExchangeError: if no controller listens.
        """
        if not self._publisher.get_subscription_count():
            raise ExchangeError(f"there is no controller on {self.topic}; accepted: while one runs")
        stop = JointTrajectory(joint_names=list(names))
        self._publisher.publish(stop if points is None else trajectory_message(names, points))


def enable_request(node: str, on: bool) -> ServiceRequest:
    """Return the request to a controller to give the motors torque, or to take it and close the brakes."""
    service = f"{node}/enable"
    return ServiceRequest(SetBool, service, SetBool.Request(data=on), spoken(service))


def trajectory_message(
    names: Sequence[str], points: TrajectoryPoints, start_time: float = 0.0
) -> JointTrajectory:
    """Return the points as a message that starts at `start_time`, s; 0 means when it arrives."""
    message = JointTrajectory(joint_names=list(names))
    message.header.stamp = ros_time(round(start_time * NANOSECONDS))
    message.points = [
        JointTrajectoryPoint(**(point | {"time_from_start": Duration(**point["time_from_start"])}))
        for point in message_content(names, points)["points"]
    ]
    return message


def deliver(
    client: ClientNode,
    plan: LinePlan,
    controller: str,
    limits: JointLimits,
    set_point_period: float,
    approach: bool,
    *,
    start_time: float = 0.0,
    correction: Correction | None = None,
    starting: float = 0.0,
) -> Callable[[Show], float] | None:
    """Wait for the controller, send it the line, print what was sent, and return what waits for its end.

    That is None where the end is not known: for a later start, or while time stands still.

    Args:
        client: the node to do it with.
        plan: the line.
        controller: name of the controller node.
        limits: the controller's.
        set_point_period: the controller's, s.
        approach: whether the arm moves to the start of the line; else it must be there already.
        start_time: time at which the trajectory starts, s; 0 means now.
        correction: of the line, None for none.
        starting: time beyond the timeout that a starting controller is waited for, s.

    Raises:
        ExchangeError: if the controller or the joint states do not appear within the timeout.
        LineError: if the arm is elsewhere and there is no approach, or if the controller would refuse the approach.
    """
    trajectory = TrajectoryClient(client, controller)
    trajectory.wait_for_controller(starting)
    here = plan.start_pose
    arm: NewestPositions | None = None
    if approach or start_time <= 0.0:
        arm = trajectory.arm(plan.joint_names)
        here = arm.position
    # else: where the arm will be by then is not known here; the controller checks it
    line = approached(plan, here, limits, set_point_period, approach)
    if line.approach > 0.0:
        client.say(
            f"approach: {np.degrees(line.way):.1f} deg in {line.farthest}, {line.approach:.3f} s"
        )
    later = None if correction is None else correction.later(line.approach)
    trajectory.send(plan.joint_names, line.points, start_time, later, limits.start_tolerance)
    start = f"at {start_time:g} s" if start_time else "now"
    client.say(
        f"sent {counted(len(line.points.times), 'point')} to {trajectory.topic}: start {start}, {line.duration:.3f} s"
    )
    standing = trajectory.standing_time()
    if standing is not None:
        client.say(
            f"the simulation's time stands still at {standing:.6g} s: the arm moves when it runs on"
        )
    if arm is None or start_time > 0.0 or standing is not None:
        return None
    return partial(trajectory.wait_for_end, arm)
