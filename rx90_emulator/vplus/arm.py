"""The arm as V+ sees it: joint values in degrees from its own zero, the world where axes 1 and 2 meet."""

from __future__ import annotations

from typing import Final

import numpy as np

from rx90_common.base.arrays import Array
from rx90_common.base.errors import ConfigError
from rx90_common.description.branch import Branch
from rx90_common.description.chain import RigidChain
from rx90_common.description.inverse import SphericalWristArm, nearest_turn
from rx90_common.description.kinematics import Pose, forward
from rx90_common.description.robot import load_robot
from rx90_controller.law.full_speeds import FullSpeeds
from rx90_emulator.loop.setup import Setup
from rx90_emulator.vplus.errors import VplusError
from rx90_emulator.vplus.transformations import placed
from rx90_emulator.vplus.values import Joints

_MM: Final = 1e3
_SINGULAR = 1e-7
"""Sine of joint 5 below which joints 4 and 6 turn about one axis: joint 4 stays then."""
_SLACK = 1e-6  # rad, at the limits


class ProgrammedArm:
    """Kinematics and limits of an arm that V+ programs move.

    Attributes:
        speeds: what 100 % is.
        max_speed: of each joint, rad/s, shape (6,).
        max_acceleration: that set-points may ask of it, rad/s^2, shape (6,).
    """

    def __init__(self, setup: Setup) -> None:
        robot = setup.robot
        solver = SphericalWristArm.from_chain(robot.chain)
        speeds = setup.controller.vplus
        if solver is None or speeds is None:
            raise ConfigError(
                "no V+ on this arm; accepted: six joints with a spherical wrist, and a block vplus in controller.yaml"
            )
        self._solver = solver
        self.speeds: FullSpeeds = speeds
        self._flange = load_robot(setup.files.urdf).chain if setup.files is not None else robot.chain
        self._world = np.array([0.0, 0.0, float(robot.chain.origin[:2, 2].sum())])  # m, in the base
        self._zero = np.array(speeds.zero)
        self._lower = robot.lower
        self._upper = robot.upper
        self.max_speed = robot.max_velocity
        self.max_acceleration = setup.controller.max_acceleration
        self.ready = self.angles(Joints(speeds.ready))

    def joints(self, q: Array) -> Joints:
        """Return joint values, degrees, of joint angles, rad, shape (6,)."""
        return Joints((np.degrees(q) + self._zero).tolist())

    def angles(self, joints: Joints) -> Array:
        """Return joint angles, rad, shape (6,), of joint values."""
        return np.asarray(np.radians(np.array(joints) - self._zero))

    def flange(self, q: Array) -> Array:
        """Return the transformation of the flange in the robot's own world."""
        pose = forward(self._flange, q)
        return placed(pose.rotation, _MM * (pose.position - self._world))

    def chain_to(self, tool: Array) -> RigidChain:
        """Return the arm up to the tip of a tool, a transformation from the flange, mm."""
        chain = self._flange
        tip = chain.tcp_position + chain.tcp_rotation @ tool[:3, 3] / _MM
        return chain._replace(tcp_position=tip, tcp_rotation=np.ascontiguousarray(chain.tcp_rotation @ tool[:3, :3]))

    def posture(self, q: Array) -> Branch:
        """Return the configuration of joint angles; at a border that of RIGHTY, ABOVE and NOFLIP."""
        reach = self._solver.forward_reach(self._flange, q[None])[0]
        return Branch(
            "front" if reach > -_SLACK else "back",
            "positive" if self._solver.elbow_angle(q[None])[0] > -_SLACK else "negative",
            "positive" if q[4] > -_SLACK else "negative",
        )

    def solve(self, flanges: Array, posture: Branch, near: Array) -> Array:
        """Return joint angles, rad, shape (n, 6), of flanges, shape (n, 4, 4); rows out of reach are NaN.

        Joints turn on from `near`, shape (6,), and from one row to the next.
        """
        pose = Pose(flanges[:, :3, 3] / _MM + self._world, np.ascontiguousarray(flanges[:, :3, :3]))
        found = self._solver.solve(self._flange, pose, posture)
        last = near
        for row in found:
            if abs(np.sin(row[4])) < _SINGULAR and abs(row[4]) < 1.0:
                row[5] += row[3] - last[3]
                row[3] = last[3]
            row[:] = nearest_turn(row, np.where(np.isnan(last), 0.0, last))
            last = row
        return np.asarray(found)

    def solve_target(self, flange: Array, posture: Branch, near: Array) -> Array:
        """Return the joint angles, rad, shape (6,), of a flange within the joints' ranges.

        Raises:
            VplusError: if there are none.
        """
        q = self.solve(flange[None], posture, near)[0]
        if np.isnan(q).any():
            raise VplusError(self._too_far_or_close(flange))
        for turn in (-2.0 * np.pi, 2.0 * np.pi):
            other = q + turn
            outside = (q < self._lower - _SLACK) | (q > self._upper + _SLACK)
            fits = (other >= self._lower) & (other <= self._upper)
            q = np.where(outside & fits, other, q)
        self.check_range(q)
        return np.asarray(q)

    def _too_far_or_close(self, flange: Array) -> str:
        near = np.linalg.norm(flange[:3, 3]) < _MM * self._solver.reach / 2.0
        return "Location too close" if near else "Location out of range"

    def check_range(self, q: Array) -> None:
        """Check joint angles, rad, shape (6,).

        Raises:
            VplusError: naming the first joint outside of its range.
        """
        outside = self.outside(q)
        if outside:
            joints = self.joints(q)
            joint = outside[0]
            low = self.joints(self._lower)[joint - 1]
            high = self.joints(self._upper)[joint - 1]
            asked = f"{joints[joint - 1]:.3f} deg; accepted: {low:.1f} to {high:.1f}"
            raise VplusError(f"Position out of range* Jt {joint}", asked)

    def outside(self, q: Array) -> list[int]:
        """Return the numbers of the joints that are outside of their ranges, from 1 on."""
        beyond = ~((q >= self._lower - _SLACK) & (q <= self._upper + _SLACK))
        return [int(joint) + 1 for joint in np.flatnonzero(beyond)]
