"""The limits of an arm and of the room around it, as shares that a motion reaches and as what exceeding them costs."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from rx90_common.base.arrays import Array
from rx90_common.exchange.topics import MOTOR_NAMES
from rx90_emulator.identification.experiments.excitation.information import SMOOTH, Motion
from rx90_emulator.identification.experiments.excitation.self_collision import GAP
from rx90_emulator.identification.experiments.excitation.workspace import Workspace
from rx90_emulator.identification.experiments.load import Motors, friction_torque
from rx90_emulator.loop.setup import Setup

_SLACK = 0.02  # rad, to the joints' ranges, as the sweeps keep
_LENGTH = 0.1  # m too near to a wall that cost as much as a limit exceeded by its whole size
_MARGIN, _ROOM = 0.02, 0.01  # of a limit, and m to a wall, that a search leaves for what lies between its samples


@dataclass(frozen=True, eq=False)
class MotionSlope:
    """Derivatives by a motion and its rigid torque, each of shape (m, n)."""

    position: Array
    velocity: Array
    acceleration: Array
    torque: Array


@dataclass(frozen=True, eq=False)
class MotionLimits:
    """What a run must keep.

    Attributes:
        setup: ranges, speeds, efforts of the joints, accelerations of the controller, peak torques of the drives.
        workspace: planes.
        clearance: least distance to them, m.
        share: of accelerations and torques.
        speed: share of the speeds.
    """

    setup: Setup
    workspace: Workspace
    clearance: float
    share: float
    speed: float

    @property
    def middle(self) -> Array:
        """Return the middle of each joint's range, rad, shape (n,)."""
        return 0.5 * (self.setup.robot.lower + self.setup.robot.upper)

    @property
    def reach(self) -> Array:
        """Return how far each joint may go from there, rad, shape (n,)."""
        return 0.5 * (self.setup.robot.upper - self.setup.robot.lower) - _SLACK

    @cached_property
    def motors(self) -> Motors:
        """Return what the motors turn and carry, and their limits."""
        return Motors.of(self.setup.robot, self.setup.drives)

    def shares(self, motion: Motion, torque: Array) -> dict[str, Array]:
        """Return signed shares of what is allowed, by name, each of shape (m, n).

        Args:
            motion: m samples of n joints.
            torque: with friction, Nm, shape (m, n).
        """
        position, velocity, acceleration = motion
        robot, controller, motors = self.setup.robot, self.setup.controller, self.motors
        return {
            "position": (position - self.middle) / self.reach,
            "speed": velocity / (self.speed * robot.max_velocity),
            "motor_speed": velocity @ motors.turns.T / (self.speed * motors.speed),
            "acceleration": acceleration / (self.share * controller.max_acceleration),
            "torque": torque / (self.share * robot.max_effort),
            "motor_torque": torque @ motors.carries.T / (self.share * motors.torque),
        }

    def penalty(self, motion: Motion, rigid: Array) -> tuple[float, MotionSlope]:
        """Return the sum of squares of what comes too near to the limits, and its derivatives.

        Args:
            motion: m samples of n joints.
            rigid: torque without friction, Nm, shape (m, n); friction is smoothed.
        """
        robot, controller, motors = self.setup.robot, self.setup.controller, self.motors
        friction, by_speed = friction_torque(motion[1], controller, SMOOTH)
        over = {name: _over(share) for name, share in self.shares(motion, rigid + friction).items()}
        value = sum(float(np.sum(one**2)) for one in over.values())
        near, slope = self.nearness(motion[0])
        by_velocity = over["speed"] / robot.max_velocity + over["motor_speed"] / motors.speed @ motors.turns
        carried = over["motor_torque"] / motors.torque @ motors.carries
        by_torque = 2.0 * (over["torque"] / robot.max_effort + carried) / self.share
        by_friction = by_torque @ motors.turns.T * by_speed @ motors.turns
        return value + near, MotionSlope(
            2.0 * over["position"] / self.reach + slope,
            2.0 * by_velocity / self.speed + by_friction,
            2.0 * over["acceleration"] / (self.share * controller.max_acceleration),
            by_torque,
        )

    def nearness(self, position: Array) -> tuple[float, Array]:
        """Return what it costs to be too near to walls or itself, and its derivative by the position, shape (m, n)."""
        value, slope = 0.0, np.zeros_like(position)
        for distance, by_position in self.workspace.distances(position):
            missing = np.maximum((self.clearance + _ROOM - distance) / _LENGTH, 0.0)
            value += float(np.sum(missing**2))
            slope -= 2.0 / _LENGTH * np.einsum("ms,msn->mn", missing, by_position)
        arm, gap = self.workspace.arm, GAP + _ROOM
        near = arm.near(position, gap)
        distance = arm.distances(position[near])
        missing = np.maximum((gap - distance) / _LENGTH, 0.0)
        value += float(np.sum(missing**2))
        slope[near] -= 2.0 / _LENGTH * np.einsum("ms,msn->mn", missing, arm.slopes(position[near], distance, gap))
        return value, slope

    def kept(self, motion: Motion, rigid: Array) -> bool:
        """Return whether a motion keeps all limits at its samples."""
        torque = rigid + friction_torque(motion[1], self.setup.controller)[0]
        within = all(float(np.abs(share).max()) <= 1.0 for share in self.shares(motion, torque).values())
        return within and self.clear(motion[0])

    def clear(self, position: Array) -> bool:
        """Return whether the arm is far enough from the walls and from itself at positions, rad, shape (m, n)."""
        free = all(distance >= self.clearance for distance, _ in self.workspace.lowest(position))
        return free and not len(self.workspace.arm.near(position))

    def worst(self, motion: Motion, rigid: Array) -> str:
        """Return in words which limit a motion exceeds most at its samples."""
        torque = rigid + friction_torque(motion[1], self.setup.controller)[0]
        for wall, (distance, name) in zip(self.workspace.walls, self.workspace.lowest(motion[0]), strict=True):
            if distance < self.clearance:
                return f"{name} comes as near to {wall.name} as {distance:.3g} m"
        if len(self.workspace.arm.near(motion[0])):
            return "the arm touches itself"
        shares = {name: np.abs(share).max(axis=0) for name, share in self.shares(motion, torque).items()}
        name = max(shares, key=lambda one: float(shares[one].max()))
        joint = int(np.argmax(shares[name]))
        whose = (MOTOR_NAMES if name.startswith("motor") else self.setup.robot.joint_names)[joint]
        return f"the {name.removeprefix('motor_')} of {whose} is {shares[name][joint]:.0%} of what is allowed"


def _over(share: Array) -> Array:
    """Return by how much a signed share exceeds 1, less a margin, with its sign."""
    return np.asarray(np.sign(share) * np.maximum(np.abs(share) - 1.0 + _MARGIN, 0.0))
