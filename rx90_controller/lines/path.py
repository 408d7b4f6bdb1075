"""The joint-space image of a straight line, with exact derivatives, examined against the arm's limits."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple, NoReturn

import numpy as np

from rx90_common.base.arrays import Array
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

# The line is examined at points at most this far apart, and at this many at least.
_STEP = 1e-3
_FEWEST = 200
# Between two examined points a joint may differ from its own slope by so much; a change of branch is larger.
_JUMP = 0.05
# A joint that turns less than this over the whole line is held still: the rounding of the inverse kinematics
# would otherwise reach the friction compensation as a velocity of changing sign.
_STILL = 1e-10


class _Fault(NamedTuple):
    at: int
    text: str


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
        chain = self.robot.chain
        near = np.clip(np.searchsorted(self.distance, distance), 0, len(self.distance) - 1)
        q = _solve(self.robot, self.task, distance, self.position[near])
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
    turn = turn_between(task.start_rpy, task.end_rpy)
    twist = np.concatenate([np.subtract(task.end, task.start), turn]) / task.length
    return solved(jacobian(robot.chain, q), np.broadcast_to(twist, q.shape))


def _solve(robot: RobotModel, task: LineTask, distance: Array, guess: Array) -> Array:
    """Return the joint angles (n, 6) near `guess` (n, 6); NaN rows where there are none."""
    poses = line_poses(task, distance)
    arm = SphericalWristArm.from_chain(robot.chain)
    if arm is not None:
        return nearest_turn(arm.solve(robot.chain, poses, task.branch), guess)
    rows = [solve_near(robot.chain, Pose(*pose), g) for *pose, g in zip(*poses, guess, strict=True)]
    return np.array([np.full(6, np.nan) if row is None else row for row in rows])


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
    lost = np.flatnonzero(np.isnan(q).any(axis=1))
    end = lost[0] if lost.size else len(q)
    q[end:] = np.nan
    q[:end] = np.unwrap(q[:end], axis=0)
    return q


def _center_turns(robot: RobotModel, q: Array) -> Array:
    """Shift whole joints by whole turns, so that each path lies in the middle of its limits."""
    if not len(q):
        return q
    path_middle = (q.min(axis=0) + q.max(axis=0)) / 2.0
    shift = nearest_turn(path_middle, (robot.lower + robot.upper) / 2.0) - path_middle
    return np.asarray(q + shift)


def plan_path(robot: RobotModel, task: LineTask) -> JointPath:
    """Find the joint path of a line and examine it from start to end.

    Raises:
        LineError: saying where on the line the arm cannot go, the joint or singularity, and what is accepted.
    """
    distance = np.linspace(0.0, task.length, max(_FEWEST, int(np.ceil(task.length / _STEP))) + 1)
    q = _follow(robot, task, distance)
    faults = _reach_faults(q)
    q = _center_turns(robot, q[: _first(faults, len(q))])
    faults += _limit_faults(robot, q)
    margins = singularity_margins(robot.chain, q)
    faults += _singularity_faults(task, margins)
    q = q[: _first(faults, len(q))]
    slope = _slope(robot, task, q)
    faults += _jump_faults(robot, distance, q, slope)
    # What no speed can mend comes first: near a singularity the joint speeds grow, whatever the line's speed.
    faults = faults or _speed_faults(robot, task, distance, slope)
    if faults:
        _refuse(task, distance, min(faults, key=lambda fault: fault.at))
    q = np.where(np.ptp(q, axis=0) < _STILL, np.round(q[0], 12), q)
    worst = {kind: int(np.argmin(values)) for kind, values in margins.items()}
    where = {kind: (float(margins[kind][k]), float(distance[k])) for kind, k in worst.items()}
    return JointPath(robot, task, distance, q, slope, where)


def _first(faults: list[_Fault], count: int) -> int:
    return min((fault.at for fault in faults), default=count)


def _refuse(task: LineTask, distance: Array, fault: _Fault) -> NoReturn:
    at = float(distance[fault.at])
    raise LineError(f"the line cannot be travelled at {at:.3f} m from its start ({at / task.length:.0%}): {fault.text}")


def _reach_faults(q: Array) -> list[_Fault]:
    lost = np.flatnonzero(np.isnan(q).any(axis=1))
    return [_Fault(int(lost[0]), "out of reach; accepted: a pose that the arm can take")] if lost.size else []


def _limit_faults(robot: RobotModel, q: Array) -> list[_Fault]:
    faults = []
    for j, name in enumerate(robot.joint_names):
        bad = np.flatnonzero((q[:, j] < robot.lower[j]) | (q[:, j] > robot.upper[j]))
        if bad.size:
            value = q[bad[0], j]
            text = f"{name} at {value:.4f} rad; accepted: [{robot.lower[j]:.4f}, {robot.upper[j]:.4f}]"
            faults.append(_Fault(int(bad[0]), text))
    return faults


def _singularity_faults(task: LineTask, margins: dict[str, Array]) -> list[_Fault]:
    faults = []
    for kind, values in margins.items():
        bad = np.flatnonzero(values < task.singularity_margin)
        if bad.size:
            text = f"{kind} singularity, margin {values[bad[0]]:.4f}; accepted: >= {task.singularity_margin:g}"
            faults.append(_Fault(int(bad[0]), text))
    return faults


def _speed_faults(robot: RobotModel, task: LineTask, distance: Array, slope: Array) -> list[_Fault]:
    faults = []
    rate = np.abs(slope) * task.profile().speed_at(distance)[:, None]
    for j, name in enumerate(robot.joint_names):
        bad = np.flatnonzero(rate[:, j] > robot.max_velocity[j])
        if bad.size:
            at_most = task.speed * robot.max_velocity[j] / rate[:, j].max()
            text = (
                f"{name} would turn at {rate[bad[0], j]:.3f} rad/s; accepted: <= {robot.max_velocity[j]:.3f} "
                f"rad/s (a line speed of about {at_most:.3g} m/s)"
            )
            faults.append(_Fault(int(bad[0]), text))
    return faults


def _jump_faults(robot: RobotModel, distance: Array, q: Array, slope: Array) -> list[_Fault]:
    step = np.diff(distance[: len(q)])[:, None]
    gap = np.abs(np.diff(q, axis=0) - 0.5 * (slope[1:] + slope[:-1]) * step)
    bad = np.argwhere(gap > _JUMP)
    if not bad.size:
        return []
    k, j = bad[0]
    jump = q[k + 1, j] - q[k, j]
    text = f"{robot.joint_names[j]} jumps by {jump:.3f} rad to another branch; accepted: no jump"
    return [_Fault(int(k + 1), text)]
