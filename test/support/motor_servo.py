"""A controller of a user: P-D with rclpy at the motors, set-points by stamp from a JointState topic."""

from __future__ import annotations

import contextlib
import sys
from typing import Any

import rclpy
from rclpy.node import Node
from sensor_msgs.msg import JointState

GEAR = (85.0, 85.0, 85.0, 60.0, 45.0, 25.0)
INERTIA = (12.0, 15.0, 3.5, 0.35, 0.29, 0.04)  # joint side, kg m^2
KP, KD = 28000.0, 400.0


class MotorServo(Node):  # type: ignore[misc]  # rclpy is untyped
    """Answers each motor state; without a set-point for its time it holds where the motors were first."""

    def __init__(self) -> None:
        super().__init__("motor_servo")
        self.hold: Any = None
        self.references: dict[int, Any] = {}
        self.publisher = self.create_publisher(JointState, "motor_commands", 10)
        self.create_subscription(JointState, "set_points", self.note, 1000)
        self.create_subscription(JointState, "motor_states", self.answer, 10)

    def note(self, message: JointState) -> None:
        """Keep a set-point of the joints, as one of the motors."""
        q, v = ([*values[:5], values[4] + values[5]] for values in (message.position, message.velocity))
        motor = [[gear * x for gear, x in zip(GEAR, values, strict=True)] for values in (q, v)]
        self.references[self.nanoseconds(message)] = motor

    def answer(self, states: JointState) -> None:
        """Command torques for one tick."""
        now = self.nanoseconds(states) // 1_000_000 * 1_000_000
        for stamp in [stamp for stamp in self.references if stamp < now]:
            del self.references[stamp]
        self.hold = self.references.get(now, self.hold or [list(states.position), [0.0] * 6])
        command = JointState(name=states.name)
        command.header.stamp = states.header.stamp
        command.effort = [
            inertia / gear**2 * (KP * (q_ref - q) + KD * (v_ref - v))
            for inertia, gear, q_ref, v_ref, q, v in zip(
                INERTIA, GEAR, *self.hold, states.position, states.velocity, strict=True
            )
        ]
        self.publisher.publish(command)

    @staticmethod
    def nanoseconds(message: JointState) -> int:
        """Return the stamp."""
        return int(message.header.stamp.sec * 1_000_000_000 + message.header.stamp.nanosec)


if __name__ == "__main__":
    rclpy.init(args=sys.argv)
    with contextlib.suppress(KeyboardInterrupt):
        rclpy.spin(MotorServo())
