"""The joint-space image of a straight line, with exact derivatives, examined against the arm's limits."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from rx90_common.base.arrays import Array, Mask
from rx90_common.base.errors import LineError
from rx90_common.description.inverse import (
    SphericalWristArm,
    nearest_turn,
    singularity_margins,
    solve_anywhere,
    solve_near,
)
from rx90_common.description.kinematics import Pose, bias_acceleration, jacobian
from rx90_common.description.robot import RobotModel
from rx90_common.description.rotations import axis_rotation, length, product, rpy_rotation, solved, turn_between
from rx90_controller.lines.task import LineTask

# The line is examined at points at most this far apart, m, and at this many at least.
_EXAMINED_STEP = 1e-3
_MIN_EXAMINED = 200
# Between two examined points a joint may differ from its own slope by so much, rad; a change of branch is larger.
_MAX_JUMP = 0.05
# A joint that turns less than this over the whole line, rad, is held still: the rounding of the inverse kinematics
# would otherwise reach the friction compensation as a velocity of changing sign.
_STILL = 1e-10


@dataclass(frozen=True, eq=False)
class JointPath:
    """Joint angles as functions of the distance along the line.

    Attributes:
        robot: the arm.
        task: the line.
        distance: (n,) examined distances, m.
        position: (n, 6) joint angles there, rad.
        slope: (n, 6) their derivative by the distance, rad/m.
        margins: smallest distance from each kind of singularity, and where on the line in m.
    """

    robot: RobotModel
    task: LineTask
    distance: Array
    position: Array
    slope: Array
    margins: dict[str, tuple[float, float]]

    def at(self, distance: Array) -> tuple[Array, Array, Array]:
        """Return joint angles (n, 6) in rad, and their first and second derivative in rad/m and rad/m²."""
        chain, poses = self.robot.chain, line_poses(self.task, distance)
        near = self.position[np.clip(np.searchsorted(self.distance, distance), 0, len(self.distance) - 1)]
        arm = SphericalWristArm.from_chain(chain)
        if arm is not None:
            q = nearest_turn(arm.solve(chain, poses, self.task.branch), near)
        else:
            found = [solve_near(chain, Pose(*pose), guess) for *pose, guess in zip(*poses, near, strict=True)]
            q = np.array([np.full(6, np.nan) if row is None else row for row in found])
        slope = _slope(self.robot, self.task, q)
        # The line's own second derivative by the distance is zero, in position and in orientation.
        bend = -solved(jacobian(chain, q), bias_acceleration(chain, q, slope))
        still = np.ptp(self.position, axis=0) == 0.0
        return np.where(still, self.position[0], q), np.where(still, 0.0, slope), np.where(still, 0.0, bend)


def line_poses(task: LineTask, distance: Array) -> Pose:
    """Return the poses of the tool centre point at `distance` (n,) m from the start."""
    start = np.array(task.start)
    position = start + (np.array(task.end) - start) * (distance / task.length)[:, None]
    turn = turn_between(task.start_rpy, task.end_rpy)
    angle = length(turn)
    axis = turn / angle if angle > 0.0 else turn
    turned = axis_rotation(axis, angle * (distance / task.length))
    return Pose(position, product(turned, rpy_rotation(task.start_rpy)))


def _slope(robot: RobotModel, task: LineTask, q: Array) -> Array:
    """Return the derivative of joint angles by the distance, rad/m, shape (n, 6)."""
    turn = turn_between(task.start_rpy, task.end_rpy)
    twist = np.concatenate([np.subtract(task.end, task.start), turn]) / task.length
    return solved(jacobian(robot.chain, q), np.broadcast_to(twist, q.shape))


def _follow(robot: RobotModel, task: LineTask, distance: Array) -> Array:
    """Return continuous joint angles (n, 6); NaN rows from where the line leaves the arm's reach."""
    poses = line_poses(task, distance)
    arm = SphericalWristArm.from_chain(robot.chain)
    if arm is not None:
        q = arm.solve(robot.chain, poses, task.branch)
    else:
        q = np.full((len(distance), 6), np.nan)
        guess = solve_anywhere(robot, Pose(*(part[0] for part in poses)))
        for k, pose in enumerate(zip(*poses, strict=True)):
            guess = None if guess is None else solve_near(robot.chain, Pose(*pose), guess)
            if guess is None:
                break
            q[k] = guess
    lost = _first(np.asarray(np.isnan(q).any(axis=1)))
    q[lost:] = np.nan
    q[:lost] = np.unwrap(q[:lost], axis=0)
    return q


def plan_path(robot: RobotModel, task: LineTask) -> JointPath:
    """Find the joint path of a line and examine it from start to end.

    Raises:
        LineError: saying where on the line the arm cannot go, the joint or singularity, and what is accepted.
    """
    distance = np.linspace(0.0, task.length, max(_MIN_EXAMINED, int(np.ceil(task.length / _EXAMINED_STEP))) + 1)
    q, faults = _follow(robot, task, distance), dict[int, str]()  # the first reason, by the place
    reached = _first(np.asarray(np.isnan(q).any(axis=1)))
    if reached < len(q):
        faults[reached] = "out of reach; accepted: a pose that the arm can take"
    q = _center_turns(robot, q[:reached])
    for j, name in enumerate(robot.joint_names):
        at = _first((q[:, j] < robot.lower[j]) | (q[:, j] > robot.upper[j]))
        if at < len(q):
            accepted = f"[{robot.lower[j]:.4f}, {robot.upper[j]:.4f}]"
            faults.setdefault(at, f"{name} at {q[at, j]:.4f} rad; accepted: {accepted}")
    margins = singularity_margins(robot.chain, q)
    for kind, values in margins.items():
        at = _first(values < task.singularity_margin)
        if at < len(values):
            accepted = f">= {task.singularity_margin:g}"
            faults.setdefault(at, f"{kind} singularity, margin {values[at]:.4f}; accepted: {accepted}")
    q = q[: min(faults, default=len(q))]
    slope = _slope(robot, task, q)
    gap = np.abs(np.diff(q, axis=0) - 0.5 * (slope[1:] + slope[:-1]) * np.diff(distance[: len(q)])[:, None])
    jumps = np.argwhere(gap > _MAX_JUMP)
    if jumps.size:
        k, j = jumps[0].tolist()
        jump = q[k + 1, j] - q[k, j]
        faults[k + 1] = f"{robot.joint_names[j]} jumps by {jump:.3f} rad to another branch; accepted: no jump"
    # What no speed can mend comes first: near a singularity the joint speeds grow, whatever the line's speed.
    faults = faults or _speed_faults(robot, task, distance, slope)
    if faults:
        first = min(faults)
        at_m = float(distance[first])
        raise LineError(
            f"the line cannot be travelled at {at_m:.3f} m from its start ({at_m / task.length:.0%}): {faults[first]}"
        )
    q = np.where(np.ptp(q, axis=0) < _STILL, np.round(q[0], 12), q)
    worst = {kind: int(np.argmin(values)) for kind, values in margins.items()}
    where = {kind: (float(margins[kind][k]), float(distance[k])) for kind, k in worst.items()}
    return JointPath(robot, task, distance, q, slope, where)


def _first(rows: Mask) -> int:
    """Return the number of the first row that is true; how many rows there are if none is."""
    return int(np.argmax(rows)) if rows.any() else len(rows)


def _center_turns(robot: RobotModel, q: Array) -> Array:
    """Shift whole joints by whole turns, so that each path lies in the middle of its limits."""
    if not len(q):
        return q
    path_middle = (q.min(axis=0) + q.max(axis=0)) / 2.0
    shift = nearest_turn(path_middle, (robot.lower + robot.upper) / 2.0) - path_middle
    return np.asarray(q + shift)


def _speed_faults(robot: RobotModel, task: LineTask, distance: Array, slope: Array) -> dict[int, str]:
    """Return where joints would be too fast, with what is accepted."""
    faults: dict[int, str] = {}
    rate = np.abs(slope) * task.profile().speed_at(distance)[:, None]
    for j, name in enumerate(robot.joint_names):
        at = _first(rate[:, j] > robot.max_velocity[j])
        if at < len(rate):
            most = task.speed * robot.max_velocity[j] / rate[:, j].max()
            text = (
                f"{name} would turn at {rate[at, j]:.3f} rad/s; accepted: <= {robot.max_velocity[j]:.3f} rad/s (a line "
                f"speed of about {most:.3g} m/s)"
            )
            faults.setdefault(at, text)
    return faults
