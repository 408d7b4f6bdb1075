"""A straight line as it is typed: planned and checked as rx90_line and the controller do, before it is sent."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from rx90_common.base.arrays import Array
from rx90_common.base.errors import LineError
from rx90_common.base.quoting import quoted
from rx90_common.description.branch import Branch
from rx90_common.description.kinematics import forward
from rx90_common.description.robot import RobotModel
from rx90_controller.lines.plan import Approach, ApproachedLine, LinePlan, approached, check_plan, plan_line
from rx90_controller.lines.task import LineTask
from rx90_controller.trajectory import JointLimits
from rx90_controller.trajectory.spline import interpolate

_DRAWN = 60  # points of the approach
_LARGEST = 1e6  # of what is typed, in its unit; far beyond any arm, and far from what overflows


@dataclass(frozen=True)
class TypedLine:
    """What stands in the form: start and end (three numbers each, m), speed (m/s), acceleration (m/s²), tool (deg)."""

    start: str
    end: str
    speed: str
    acceleration: str
    tool_rpy: str

    @classmethod
    def of(cls, task: LineTask) -> TypedLine:
        """Return a line as one would type it."""
        turn = [math.degrees(angle) for angle in task.start_rpy]
        return cls(*(_typed(values) for values in (task.start, task.end, [task.speed], [task.acceleration], turn)))

    def task(self, branch: Branch) -> LineTask:
        """Return the line that it says, for one solution of the inverse kinematics.

        Raises:
            LineError: naming what is typed and what is accepted.
        """
        turn = tuple(math.radians(angle) for angle in _numbers("tool", self.tool_rpy, 3, "deg"))
        return LineTask(
            start=_numbers("start", self.start, 3, "m"),
            end=_numbers("end", self.end, 3, "m"),
            speed=_numbers("speed", self.speed, 1, "m/s")[0],
            acceleration=_numbers("acceleration", self.acceleration, 1, "m/s^2")[0],
            start_rpy=turn,
            end_rpy=turn,
            branch=branch,
        )


@dataclass(frozen=True, eq=False)
class LinePreview:
    """A line that can be sent.

    Attributes:
        plan: the line itself.
        line: with the move to its start.
        approach: the way of the tip to the start of the line, m, shape (n, 3); none where the arm stands there.
    """

    plan: LinePlan
    line: ApproachedLine
    approach: Array

    @property
    def share(self) -> Array:
        """Return the peak speeds of the joints along the line, as shares of their limits, shape (6,)."""
        return np.asarray(np.abs(self.plan.velocity).max(axis=0) / self.plan.path.robot.max_velocity)

    def text(self) -> str:
        """Return what a person wants to know before sending it."""
        task, name = self.plan.task, self.plan.joint_names
        fastest = int(np.argmax(self.share))
        shares = ", ".join(f"{joint} {share:.0%}" for joint, share in zip(name, self.share, strict=True))
        said = f"{task.length:.3f} m in {task.profile().duration:.2f} s"
        if self.line.approach > 0.0:
            way = math.degrees(self.line.way)
            said += f", after an approach of {self.line.approach:.2f} s ({self.line.farthest} by {way:.0f} deg)"
        return f"{said}. Fastest: {name[fastest]}. Peak joint speeds, as shares of their limits: {shares}."


@dataclass(frozen=True, eq=False)
class LineChecker:
    """What a line is checked against.

    Attributes:
        robot: the arm with its tool.
        limits: the controller's.
        period: of its set-points, s.
        branch: the solution of the inverse kinematics that is taken.
    """

    robot: RobotModel
    limits: JointLimits
    period: float
    branch: Branch

    def preview(self, typed: TypedLine, here: Array | None) -> LinePreview:
        """Plan a typed line, from where the arm stands, rad, shape (6,); None: nobody knows, it is at its start.

        Raises:
            LineError: naming a value and what is accepted, or where on the line the arm cannot go and why.
        """
        plan = plan_line(self.robot, typed.task(self.branch), self.period)
        check_plan(plan, self.limits, self.period, plan.start_pose)
        line = approached(plan, plan.start_pose if here is None else here, self.limits, self.period, Approach())
        return LinePreview(plan, line, self._approach(plan, line, here))

    def _approach(self, plan: LinePlan, line: ApproachedLine, here: Array | None) -> Array:
        if here is None or line.approach == 0.0:
            return np.empty((0, 3))
        times = np.array([0.0, line.approach])
        rest, ends = np.zeros((2, 6)), np.stack([here, plan.start_pose])
        way = interpolate(times, ends, rest, rest).sample(np.linspace(0.0, line.approach, _DRAWN))
        return forward(self.robot.chain, way[:, 0]).position


def _typed(values: Sequence[float]) -> str:
    return " ".join(f"{value:.6g}" for value in values)


def _numbers(what: str, text: str, count: int, unit: str) -> tuple[float, ...]:
    """Return so many numbers, apart by blanks or commas."""
    words = text.replace(",", " ").split()
    try:
        values = tuple(float(word) for word in words)
    except ValueError:
        values = ()
    accepted = "a number" if count == 1 else f"{count} numbers"
    finite = len(values) == count and all(map(math.isfinite, values))
    if finite and max(map(abs, values)) > _LARGEST:
        raise LineError(f"{what} is {quoted(text)}; accepted: {accepted} up to {_LARGEST:g}, {unit}")
    if not finite:
        raise LineError(f"{what} is {quoted(text)}; accepted: {accepted}, {unit}")
    return values
