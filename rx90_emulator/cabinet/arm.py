"""The arm as V+ sees it: joint values in degrees from its own zero, and the world where axes 1 and 2 meet."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import TypeAlias

import numpy as np
from pinocchio import SE3

from rx90_common.base.arrays import Array
from rx90_common.base.errors import ConfigError
from rx90_common.description.branch import Branch
from rx90_common.description.inverse import SphericalWristArm, nearest_turn
from rx90_common.description.kinematics import Pose, forward
from rx90_common.description.robot import RobotModel, load_robot
from rx90_emulator.cabinet.errors import VplusError
from rx90_emulator.loop.setup import Setup

_MM = 1e3
_SINGULAR = 1e-7
"""Sine of joint 5 below which joints 4 and 6 turn about one axis: joint 4 stays then."""
_SLACK = 1e-6  # rad, at the limits
_TURN = 2.0 * math.pi


class Joints(tuple[float, ...]):
    """Joint values of a precision point, degrees."""

    __slots__ = ()


Configuration: TypeAlias = list[bool]
"""Whether LEFTY, BELOW and FLIP."""
CONFIGURATIONS = ("RIGHTY", "ABOVE", "NOFLIP", "LEFTY", "BELOW", "FLIP")


def words(configuration: Configuration) -> str:
    """Return a configuration as programs ask for it."""
    return " ".join(CONFIGURATIONS[part + 3 * asked] for part, asked in enumerate(configuration))


class ProgrammedArm:
    """Kinematics and limits of an arm that V+ programs move.

    Attributes:
        full: what 100 % of speeds and accelerations is.
        robot: the arm without the tool of its setup.
        max_acceleration: that set-points may ask of it, rad/s^2, shape (6,).
        ready: joint angles of READY, rad, shape (6,).
    """

    def __init__(self, setup: Setup) -> None:
        solver = SphericalWristArm.from_chain(setup.robot.chain)
        full = setup.controller.vplus
        if solver is None or full is None:
            raise ConfigError(
                "no V+ on this arm; accepted: six joints with a spherical wrist, and a block vplus in controller.yaml"
            )
        self._solver = solver
        self.full = full
        self.robot = load_robot(setup.files.urdf)
        self._world = np.array([0.0, 0.0, self.robot.chain.origin[:2, 2].sum()])  # m, in the base
        self.max_acceleration = setup.controller.max_acceleration
        self.ready = self.angles(Joints(full.ready))

    def joints(self, q: Array) -> Joints:
        """Return joint values, degrees, of joint angles, rad, shape (6,)."""
        return Joints((np.degrees(q) + self.full.zero).tolist())

    def angles(self, joints: Joints) -> Array:
        """Return joint angles, rad, shape (6,), of joint values."""
        return np.radians(np.subtract(joints, self.full.zero))

    def flange(self, q: Array) -> SE3:
        """Return the transformation of the flange in the robot's own world."""
        pose = forward(self.robot.chain, q)
        return SE3(pose.rotation, _MM * (pose.position - self._world))

    def with_tool(self, tool: SE3) -> RobotModel:
        """Return the arm up to the tip of a tool, a transformation from the flange, mm."""
        chain = self.robot.chain
        tip = chain.tcp_position + chain.tcp_rotation @ tool.translation / _MM
        turned = np.ascontiguousarray(chain.tcp_rotation @ tool.rotation)
        return replace(self.robot, chain=chain._replace(tcp_position=tip, tcp_rotation=turned))

    def configuration(self, q: Array) -> Configuration:
        """Return the configuration of joint angles, at a border RIGHTY, ABOVE and NOFLIP."""
        reach = self._solver.forward_reach(self.robot.chain, q[None])[0]
        elbow = self._solver.elbow_angle(q[None])[0]
        lefty = bool(reach <= -_SLACK)
        return [lefty, bool(elbow > -_SLACK) == lefty, bool(q[4] <= -_SLACK)]

    def solve(self, flanges: Pose, configuration: Configuration, near: Array) -> Array:
        """Return joint angles, rad, shape (n, 6), of n flanges, mm.

        Joints turn on from `near`, shape (6,), and from one row to the next.

        Raises:
            VplusError: for a place that is out of reach.
        """
        pose = Pose(flanges.position / _MM + self._world, np.ascontiguousarray(flanges.rotation))
        lefty, below, flip = configuration
        branch = Branch(
            "back" if lefty else "front",
            "positive" if below == lefty else "negative",
            "negative" if flip else "positive",
        )
        rows = self._solver.solve(self.robot.chain, pose, branch)
        missed = np.flatnonzero(np.isnan(rows).any(axis=1))
        if len(missed):
            distance = np.linalg.norm(flanges.position[missed[0]]) / _MM
            is_close = distance < self._solver.reach / 2.0
            text = "Location too close" if is_close else "Location out of range"
            raise VplusError(text, f"{distance:.3f} m from the shoulder")
        for row in rows:
            if abs(np.sin(row[4])) < _SINGULAR and abs(row[4]) < 1.0:
                row[5] += row[3] - near[3]
                row[3] = near[3]
            row[:] = nearest_turn(row, near)
            near = row
        return rows

    def solve_target(self, flange: SE3, configuration: Configuration, near: Array) -> Array:
        """Return the joint angles, rad, shape (6,), of a flange, where possible within the joints' ranges."""
        pose = Pose(flange.translation[None], flange.rotation[None])
        q = self.solve(pose, configuration, near)[0]
        for joint in self.outside(q):
            for turn in (-_TURN, _TURN):
                if self.robot.lower[joint] <= q[joint] + turn <= self.robot.upper[joint]:
                    q[joint] += turn
        return np.asarray(q)

    def outside(self, q: Array) -> list[int]:
        """Return the joints that are outside of their ranges, counted from 0."""
        inside = (q >= self.robot.lower - _SLACK) & (q <= self.robot.upper + _SLACK)
        return [int(joint) for joint in np.flatnonzero(~inside)]

    def check_range(self, q: Array) -> None:
        """Check joint angles, rad, shape (6,).

        Raises:
            VplusError: naming the first joint outside of its range.
        """
        for joint in self.outside(q):
            low = self.joints(self.robot.lower)[joint]
            high = self.joints(self.robot.upper)[joint]
            detail = f"{self.joints(q)[joint]:.3f} deg; accepted: {low:.1f} to {high:.1f}"
            raise VplusError(f"Position out of range* Jt {joint + 1}", detail)
