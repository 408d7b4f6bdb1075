"""The move of the joints from where the arm stands to the start of a planned line."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from rx90_common.base.arrays import Array
from rx90_common.base.errors import LineError
from rx90_controller.lines.plan import LinePlan, approach_time, check_plan
from rx90_controller.trajectory import JointLimits, TrajectoryPoints


@dataclass(frozen=True)
class Approach:
    """A joint-space move to the start of the line.

    Attributes:
        speed: share of the joints' speed limits, in (0, 1].
        acceleration: of each joint, rad/s².
    """

    speed: float = 0.25
    acceleration: float = 2.0


class ApproachedLine(NamedTuple):
    """A plan with the move to its start, as it is sent.

    Attributes:
        points: of the line; the first one comes after the time of the approach.
        approach: that time, s; 0 where the arm stands at the start.
        duration: of both, s.
        farthest: the joint that has the longest way to the start.
        way: its way, rad.
    """

    points: TrajectoryPoints
    approach: float
    duration: float
    farthest: str
    way: float


def approached(
    plan: LinePlan, here: Array, limits: JointLimits, period: float, approach: Approach | None
) -> ApproachedLine:
    """Return a line with the move to its start, checked as the controller does.

    Args:
        plan: the line.
        here: where the arm stands, rad, shape (6,).
        limits: the controller's.
        period: of its set-points, s.
        approach: the move, None where the arm has to stand there already.

    Raises:
        LineError: if the arm stands elsewhere without an approach, or the controller would refuse the approach.
    """
    gap = np.abs(here - plan.start_pose)
    joint = int(np.argmax(gap))
    name, way = plan.joint_names[joint], float(gap[joint])
    if way <= limits.start_tolerance:
        return ApproachedLine(plan.points, 0.0, plan.duration, name, way)
    if approach is None:
        raise LineError(
            f"{name} is at {here[joint]:.4f} rad, the line starts at "
            f"{plan.start_pose[joint]:.4f} rad; accepted: within {limits.start_tolerance:g} rad, or --approach"
        )
    duration = approach_time(plan.path.robot, here, plan.start_pose, approach.speed, approach.acceleration)
    duration = math.ceil(duration * 1e3) / 1e3
    check_plan(plan, limits, period, here, duration)
    points = replace(plan.points, times=plan.times + duration)
    return ApproachedLine(points, duration, plan.duration + duration, name, way)
