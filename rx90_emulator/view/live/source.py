"""Running nodes as snapshots of their arm, and what there is to say of them."""

from __future__ import annotations

from collections import deque

from rx90_common.base.quoting import plain
from rx90_common.description.robot import RobotModel
from rx90_common.exchange.arm_watch import ArmWatch, JointSample, NodeStatus
from rx90_common.exchange.client_node import ClientNode
from rx90_common.friction.friction_set import element_names
from rx90_emulator.view.state import ArmState, ElementState

_STALE = 2.5  # s; the samples of a simulation come again four times a second while time stands still
_PACE_WINDOW = 2.0  # s


class LiveSource:
    """The newest state of the arm of running nodes, which may come and go.

    Args:
        client: whose node listens; nothing waits for it.
        robot: the arm that is expected.
        controller: name of the controller node, relative or absolute; the arm is in its namespace.

    Attributes:
        watch: what the nodes publish beside the arm's state.
        friction: samples of the friction elements that came with the newest states; at ticks, if it listens there.

    Raises:
        ConfigError: if that cannot be a node's name.
    """

    def __init__(self, client: ClientNode, robot: RobotModel, controller: str) -> None:
        self._robot = str(robot.model.name)
        self.watch = ArmWatch(client.node, controller, robot.joint_names, element_names(robot.joint_names))
        self.friction: list[JointSample] = []
        self._elements: ElementState | None = None
        self._heard: float | None = None
        self._time = 0.0  # simulated, of the newest state
        self._times: deque[tuple[float, float]] = deque()  # steady clock, simulated

    def take(self, now: float) -> list[ArmState]:
        """Return the states that came since the last call, each with the newest of friction.

        Of several runs they are those of the last one alone; `now` is the steady clock's time, s.
        """
        friction, joints = self.watch.elements(), self.watch.joints()
        self.friction = self.watch.elements_at_ticks() if self.watch.listens_at_ticks else friction
        if friction:
            self._elements = ElementState(friction[-1].position, friction[-1].velocity, friction[-1].effort)
        if not joints:
            return []
        if self._heard is not None and now - self._heard > _STALE:
            self._elements = None  # of a simulation that has gone
        self._heard = now
        times = [self._time, *(sample.time for sample in joints)]
        back = max((k for k in range(len(joints)) if times[k + 1] < times[k]), default=None)
        if back is not None:  # another simulation, or reset: nothing that was accepted before is followed
            joints = joints[back:]
            self._times.clear()
            self.watch.trajectory = None
        self._time = joints[-1].time
        self._times.append((now, self._time))
        return [ArmState(one.time, one.position, one.velocity, one.effort, self._elements) for one in joints]

    def problem(self, now: float) -> str:
        """Return why there is nothing to be seen, as a sentence for the user; empty if there is."""
        theirs = self.watch.robot
        if self.watch.publishers and theirs not in {None, self._robot}:
            return f"The simulation's robot is {plain(theirs)}, this page shows {self._robot}: start it with --robot"
        if self._heard is not None and now - self._heard <= _STALE:
            return ""
        if self.watch.problem:
            return f"Another robot? {self.watch.problem}"
        if self._heard is None:
            return f"Waiting for a simulation: nothing on {self.watch.topic} yet"
        return f"The simulation has gone: nothing on {self.watch.topic} any more; waiting for the next one"

    def pace(self, now: float) -> float:
        """Return simulated time per time of the wall clock over the last seconds."""
        while self._times and self._times[0][0] < now - _PACE_WINDOW:
            self._times.popleft()
        if len(self._times) < 2:
            return 0.0
        (began, first), (ended, last) = self._times[0], self._times[-1]
        return (last - first) / (ended - began)

    def node(self, key: str) -> NodeStatus | None:
        """Return what the node says of itself whose values have `key`; None if there is no such node."""
        return next((status for status in self.watch.diagnostics.values() if key in status.values), None)
