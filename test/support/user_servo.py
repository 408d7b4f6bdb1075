"""A controller of a user: P-D with rclpy, set-points by stamp from a JointState topic; argument: motor or joint."""

import contextlib
import sys
from typing import Any

import rclpy
from rclpy.node import Node
from sensor_msgs.msg import JointState

GEAR = (85.0, 85.0, 85.0, 60.0, 45.0, 25.0)
INERTIA = (12.0, 15.0, 3.5, 0.35, 0.29, 0.04)  # joint side, kg m^2
# By the side that is commanded: topics of states and commands, and gains that its rate allows.
SIDES = {
    "motor": ("motor_states", "motor_commands", 28000.0, 400.0),
    "joint": ("measured_joint_states", "joint_commands", 10000.0, 200.0),
}


class UserServo(Node):
    """Answers each state; without a set-point for its time it holds where the arm was first."""

    def __init__(self, side: str) -> None:
        super().__init__("user_servo")
        states, commands, self.kp, self.kd = SIDES[side]
        self.at_motors = side == "motor"
        self.hold: Any = None
        self.references: dict[int, Any] = {}
        self.publisher = self.create_publisher(JointState, commands, 10)
        self.create_subscription(JointState, "set_points", self.note, 1000)
        self.create_subscription(JointState, states, self.answer, 10)

    def note(self, message: JointState) -> None:
        point = [list(message.position), list(message.velocity)]
        if self.at_motors:
            coupled = [[*values[:5], values[4] + values[5]] for values in point]
            point = [[gear * x for gear, x in zip(GEAR, values, strict=True)] for values in coupled]
        self.references[self.nanoseconds(message)] = point

    def answer(self, states: JointState) -> None:
        now = self.nanoseconds(states) // 1_000_000 * 1_000_000
        for stamp in [stamp for stamp in self.references if stamp < now]:
            del self.references[stamp]
        self.hold = self.references.get(now, self.hold or [list(states.position), [0.0] * 6])
        command = JointState(name=states.name)
        command.header.stamp = states.header.stamp
        command.effort = [
            inertia / (gear**2 if self.at_motors else 1.0) * (self.kp * (q_ref - q) + self.kd * (v_ref - v))
            for inertia, gear, q_ref, v_ref, q, v in zip(
                INERTIA, GEAR, *self.hold, states.position, states.velocity, strict=True
            )
        ]
        self.publisher.publish(command)

    @staticmethod
    def nanoseconds(message: JointState) -> int:
        return int(message.header.stamp.sec * 1_000_000_000 + message.header.stamp.nanosec)


if __name__ == "__main__":
    rclpy.init()
    with contextlib.suppress(KeyboardInterrupt):
        rclpy.spin(UserServo(sys.argv[1]))
