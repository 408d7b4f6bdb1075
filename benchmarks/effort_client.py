"""A plain rclpy effort controller, as a user writes one: what `benchmarks.nodes own_controller` drives the arm with."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

STIFFNESS = (3000.0, 3000.0, 800.0, 60.0, 40.0, 8.0)


class Hold:
    """Springs and dampers from where the arm stood when it was first asked."""

    def __init__(self) -> None:
        self._home: Sequence[float] | None = None

    def __call__(
        self, position: Sequence[float], velocity: Sequence[float], _time: float
    ) -> list[float]:
        """Return efforts, Nm."""
        if self._home is None:
            self._home = list(position)
        rows = zip(STIFFNESS, self._home, position, velocity, strict=True)
        return [k * (home - q - 0.1 * v) for k, home, q, v in rows]


def main() -> None:
    """Answer until the process is ended."""
    import rclpy
    from sensor_msgs.msg import JointState

    rclpy.init()
    node = rclpy.create_node("effort_client")
    publisher, hold = node.create_publisher(JointState, "joint_commands", 1), Hold()

    def answer(states: Any) -> None:
        stamp = states.header.stamp
        effort = hold(states.position, states.velocity, stamp.sec + stamp.nanosec * 1e-9)
        command = JointState(name=states.name, effort=effort)
        command.header.stamp = stamp
        publisher.publish(command)

    node.create_subscription(JointState, "measured_joint_states", answer, 10)
    rclpy.spin(node)


if __name__ == "__main__":
    main()
