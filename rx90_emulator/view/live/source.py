"""Running nodes as snapshots of their arm."""

from __future__ import annotations

from rx90_common.description.robot import RobotModel
from rx90_common.exchange.arm_watch import DiagnosticsTopic, JointSample, SampleTopic
from rx90_common.exchange.client_node import ClientNode
from rx90_common.friction.friction_set import element_names
from rx90_emulator.view.state import ArmState, ElementState

_STALE = 1.5  # s; while time stands still, the simulation repeats its samples four times a second


class LiveSource:
    """The newest state of an arm, by the topics `joint_states`, `friction_states` and `/diagnostics`.

    Args:
        client: whose node listens; nothing waits for it.
        robot: the arm that is expected.

    Attributes:
        diagnostics: what each node says of itself.
    """

    def __init__(self, client: ClientNode, robot: RobotModel) -> None:
        names = robot.joint_names
        self._joints = SampleTopic(client.node, "joint_states", names)
        self._friction = SampleTopic(client.node, "friction_states", element_names(names))
        self.diagnostics = DiagnosticsTopic(client.node)
        self._elements: ElementState | None = None
        self._heard: float | None = None

    def take(self, now: float) -> ArmState | None:
        """Return the state that came since the last call, None if none did; `now` is the steady clock's time, s."""
        self.diagnostics.take()
        friction, joints = self._friction.take(), self._joints.take()
        if friction is not None:
            self._elements = ElementState(friction.position, friction.velocity, friction.effort)
        if joints is None:
            return None
        self._heard = now
        return _state(joints, self._elements)

    def problem(self, now: float) -> str:
        """Return why there is nothing to be seen, as a sentence for the user; empty if there is."""
        if self._joints.problem:
            return f"Another robot: {self._joints.problem}"
        if self._heard is None:
            return "Waiting for a simulation: nobody publishes joint_states yet"
        if now - self._heard > _STALE:
            return "The simulation has gone: no joint_states any more; waiting for the next one"
        return ""


def _state(joints: JointSample, elements: ElementState | None) -> ArmState:
    return ArmState(joints.time, joints.position, joints.velocity, joints.effort, elements)
