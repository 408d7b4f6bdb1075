"""Joint angles along a straight line or any other path, each posture from the one before.

A spherical-wrist arm of six joints has a closed form. The postures of any other arm are found by Newton steps, from a
given posture and then from place to place. An arm of five joints keeps position and direction of the tool; the rotation
about the tool's own z axis is free, as if there were a sixth joint about that axis.

An arm of seven joints has a choice of postures at each place. Its joints move with the least speed that keeps the tool
on the line, q' = J+ x' (Whitney 1969, "Resolved motion rate control of manipulators and human prostheses"): nothing
moves in the null space of the Jacobian. This differential equation is integrated with Hermite's two-point formula of
the fourth order, and each step is corrected by the shortest Newton steps back to the line.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import pinocchio as pin

from rx90_common.base.arrays import Array
from rx90_common.base.errors import LineError
from rx90_common.base.quoting import counted
from rx90_common.description.chain import RigidChain
from rx90_common.description.inverse import (
    SphericalWristArm,
    nearest_turn,
    newton_steps,
    pose_error,
    solve_anywhere,
    solve_near,
)
from rx90_common.description.kinematics import Pose, bias_acceleration, forward, jacobian
from rx90_common.description.robot import RobotModel
from rx90_common.description.rotations import length, solved
from rx90_controller.lines.task import LineTask, TipTask
from rx90_controller.trajectory.spline import interpolate

FEWEST, MOST = 5, 7
"""Joints of an arm that travels lines."""
_HALF_TURN = np.pi + 0.1  # rad, of the tool about its own axis, either way
_POSE = 6  # numbers of a pose
_STEPS = 30  # of Newton's, for a place on the line next to one that is known
_ON_LINE = 1e-12  # m and rad
_CORRECTIONS = 2  # of the two-point formula, whose slope at the far end is first a guess


class LeastSpeed:
    """The least joint speed of a redundant arm that keeps its tool on a line, by Pinocchio.

    Args:
        robot: an arm of m joints, more than six.
    """

    def __init__(self, robot: RobotModel) -> None:
        self._model = robot.model
        self._data = robot.model.createData()
        self._frame = robot.model.getFrameId(robot.tcp_frame)

    def derivatives(self, q: Array, twist: Array, bend: Array) -> tuple[Array, Array]:
        """Return first and second derivatives of angles (m,) by the distance, rad/m and rad/m².

        `twist` and `bend` are those of the tool, in base axes, shape (6,): 1 and rad/m, 1/m and rad/m².
        """
        model = self._model
        data = self._data
        frame = self._frame
        j = pin.computeFrameJacobian(model, data, q, frame, pin.LOCAL_WORLD_ALIGNED)
        try:
            weights = np.linalg.solve(j @ j.T, twist)
        except np.linalg.LinAlgError:  # at a singularity, which the margins report
            return np.full_like(q, np.nan), np.full_like(q, np.nan)
        slope = j.T @ weights
        pin.computeJointJacobiansTimeVariation(model, data, q, slope)
        rate = pin.getFrameJacobianTimeVariation(model, data, frame, pin.WORLD)
        place = pin.updateFramePlacement(model, data, frame).translation
        spin = j[3:]
        # Of the tool centre point instead of the point of the tool that is at the base's origin.
        rate[:3] -= pin.skew(place) @ rate[3:] + pin.skew(twist[:3]) @ spin
        # q' = Jᵀ w and J q' = x' by the distance: q'' = Jᵀ' w + Jᵀ w', where J q'' = x'' - J' q'.
        own = rate.T @ weights
        return slope, own + j.T @ np.linalg.solve(j @ j.T, bend - rate @ slope - j @ own)

    def put_right(self, q: Array, pose: Pose) -> Array | None:
        """Return the angles (m,) that the shortest steps from angles near a pose lead to, or None if they miss it."""
        model = self._model
        data = self._data
        frame = self._frame
        for _ in range(_STEPS):
            pin.framesForwardKinematics(model, data, q)
            here = data.oMf[frame]
            turn = here.rotation @ pin.log3(here.rotation.T @ pose.rotation)
            error = np.concatenate([pose.position - here.translation, turn])
            if np.linalg.norm(error) < _ON_LINE:
                return q
            j = pin.computeFrameJacobian(model, data, q, frame, pin.LOCAL_WORLD_ALIGNED)
            q = q + j.T @ np.linalg.solve(j @ j.T + 1e-2 * (error @ error) * np.eye(_POSE), error)
        return None

    def onwards(
        self, q: Array, step: float, pose: Pose, twists: tuple[Array, Array]
    ) -> Array | None:
        """Return the angles (m,) at a pose that is a step, m, farther on than other angles, or None.

        `twists` are those of the tool, first and second derivative, at both places, each (2, 6).
        """
        slope, bend = self.derivatives(q, twists[0][0], twists[1][0])
        after = self.put_right(q + step * (slope + 0.5 * step * bend), pose)
        for _ in range(_CORRECTIONS):
            if after is not None:
                slope_there, bend_there = self.derivatives(after, twists[0][1], twists[1][1])
                way = 0.5 * step * (slope + slope_there) + step * step / 12.0 * (bend - bend_there)
                after = self.put_right(q + way, pose)
        return after


@dataclass(frozen=True, eq=False)
class Postures:
    """How an arm follows a line, or another path.

    Attributes:
        robot: the arm; one of five joints with a sixth, the tool's turn about its own z axis. Hence m joints below.
        task: the path.
        closed_form: of a spherical-wrist arm, else None.
        least_speed: of an arm of seven joints, else None.
    """

    robot: RobotModel
    task: TipTask
    closed_form: SphericalWristArm | None
    least_speed: LeastSpeed | None

    @classmethod
    def of(cls, robot: RobotModel, task: TipTask) -> Postures:
        """Return how an arm of n joints follows a path.

        Raises:
            LineError: for another number of joints, and for a start posture that does not fit the arm.
        """
        names = robot.joint_names
        given = task.start_posture
        if not FEWEST <= len(names) <= MOST:
            raise LineError(
                f"a {task.what} of an arm of {counted(len(names), 'joint')}; accepted: of {FEWEST} to {MOST}"
            )
        arm = SphericalWristArm.from_chain(robot.chain)
        if given is not None and arm is not None:
            raise LineError(
                "start_posture of an arm with a spherical wrist; accepted: shoulder, elbow and wrist"
            )
        if given is not None and len(given) != len(names):
            raise LineError(_wrong_count(len(given), len(names)))
        least_speed = LeastSpeed(robot) if len(names) > _POSE else None
        return cls(_with_free_tool(robot) if len(names) < _POSE else robot, task, arm, least_speed)

    def from_start(self, distance: Array) -> tuple[Array, str]:
        """Return continuous angles (n, m) at distances (n,) in m as far as the arm reaches, and why no farther."""
        chain = self.robot.chain
        poses = self.task.poses(distance)
        if self.closed_form is not None:
            solved_at = self.closed_form.solve(chain, poses, self.task.branch)
            there = ~np.isnan(solved_at).any(axis=1)
            return (
                (solved_at, "")
                if there.all()
                else (solved_at[: int(np.argmin(there))], _OUT_OF_REACH)
            )
        q: Array | None
        first = Pose(poses.position[0], poses.rotation[0])
        if self.task.start_posture is None:
            q = solve_anywhere(self.robot, first)
            missed = _OUT_OF_REACH
        else:
            guess = np.append(
                self.task.start_posture,
                np.zeros(len(self.robot.lower) - len(self.task.start_posture)),
            )
            q = solve_near(chain, first, guess)
            missed = self._missed(first, guess)
        found: list[Array] = []
        while q is not None:
            found.append(q)
            if len(found) == len(distance):
                return np.array(found), ""
            pose = Pose(poses.position[len(found)], poses.rotation[len(found)])
            guess = found[-1]
            if self.least_speed is None:
                q = solve_near(chain, pose, guess)
            else:
                here = distance[len(found) - 1 : len(found) + 1]
                q = self.least_speed.onwards(
                    guess, float(here[1] - here[0]), pose, self.task.twists(here)
                )
            missed = self._missed(pose, guess) if q is None else ""
        return np.array(found).reshape(-1, len(self.robot.lower)), missed

    def _missed(self, pose: Pose, guess: Array) -> str:
        error = pose_error(self.robot.chain, newton_steps(self.robot.chain, pose, guess), pose)
        metres = float(length(error[:3]))
        turn = float(length(error[3:]))
        return (
            f"out of reach, Newton's steps end {metres:.3g} m and {turn:.3g} rad away; {_REACHABLE}"
        )

    def derivatives(self, distance: Array, q: Array) -> tuple[Array, Array]:
        """Return first and second derivatives of angles (n, m) at distances (n,) m by these, rad/m and rad/m²."""
        twist, change = self.task.twists(distance)
        if self.least_speed is not None:
            rows = [
                self.least_speed.derivatives(*row) for row in zip(q, twist, change, strict=True)
            ]
            both = np.array(rows).reshape(len(q), 2, q.shape[1])
            return both[:, 0], both[:, 1]
        chain = self.robot.chain
        j = jacobian(chain, q)
        slope = solved(j, twist)
        return slope, solved(j, change - bias_acceleration(chain, q, slope))

    def between(self, distance: Array, known: Array, angles: Array) -> Array:
        """Return angles (n, m) at distances (n,) m, from those (k, m) at the known distances (k,) that lie around."""
        chain = self.robot.chain
        poses = self.task.poses(distance)
        near = angles[np.clip(np.searchsorted(known, distance), 0, len(known) - 1)]
        if self.closed_form is not None:
            return nearest_turn(self.closed_form.solve(chain, poses, self.task.branch), near)
        if self.least_speed is not None:
            known_motion = interpolate(known, angles, *self.derivatives(known, angles))
            near = known_motion.sample(distance)[:, 0]
        found = [
            solve_near(chain, Pose(*pose), guess)
            if self.least_speed is None
            else self.least_speed.put_right(guess, Pose(*pose))
            for *pose, guess in zip(*poses, near, strict=True)
        ]
        return np.array([np.full(near.shape[1], np.nan) if row is None else row for row in found])


_REACHABLE = "accepted: a pose that the arm can take"
_OUT_OF_REACH = f"out of reach; {_REACHABLE}"


def task_from(robot: RobotModel, posture: Sequence[float], end: Sequence[float]) -> LineTask:
    """Return the line from an arm's tool position in a posture, rad, to a place, m, with constant orientation.

    Raises:
        LineError: if these do not make a line.
    """
    if len(posture) != len(robot.joint_names):
        raise LineError(_wrong_count(len(posture), len(robot.joint_names)))
    pose = forward(robot.chain, np.array(posture))
    turn = tuple(pin.rpy.matrixToRpy(pose.rotation).tolist())
    return LineTask(tuple(pose.position.tolist()), tuple(end), start_rpy=turn, end_rpy=turn)


def _wrong_count(given: int, joints: int) -> str:
    return f"start_posture has {counted(given, 'number')}; accepted: {joints}, one per joint"


def _with_free_tool(robot: RobotModel) -> RobotModel:
    """Return an arm with one more joint, about the tool's z axis."""
    chain: RigidChain = robot.chain
    moved = chain._replace(
        origin=np.vstack([chain.origin, chain.tcp_position]),
        axis=np.vstack([chain.axis, chain.tcp_rotation[:, 2]]),
        tcp_position=np.zeros(3),
    )
    lower = np.append(robot.lower, -_HALF_TURN)
    upper = np.append(robot.upper, _HALF_TURN)
    return replace(robot, chain=moved, lower=lower, upper=upper)
