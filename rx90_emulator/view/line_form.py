"""A straight line as it is typed: planned and checked as rx90_line and the controller do, before it is sent."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from functools import partial
from typing import NamedTuple

import numpy as np

from rx90_common.base.arrays import Array
from rx90_common.base.errors import LineError
from rx90_common.base.quoting import quoted
from rx90_common.description.branch import Branch
from rx90_common.description.kinematics import tip_position
from rx90_common.description.robot import RobotModel
from rx90_controller.lines.plan import Approach, ApproachedLine, LinePlan, approached, check_plan, plan_line
from rx90_controller.lines.task import LineTask
from rx90_controller.trajectory import JointLimits
from rx90_controller.trajectory.spline import interpolate
from rx90_emulator.view.page import Checker, Page, from_user, numbers, on_change, sentence
from rx90_emulator.view.scene import PLANNED, connect

_CHECKS = 0.1  # s from one check to the next while somebody types
_STANDS, _ELSEWHERE = 1e-4, 1e-2  # rad, from one look to the next; from where it was checked
_DRAWN = 60  # points of the approach
_LARGEST = 1e6  # of what is typed, in its unit; far beyond any arm, and far from what overflows
FIELDS = {"start": (3, "m"), "end": (3, "m"), "speed": (1, "m/s"), "acceleration": (1, "m/s²"), "tool rpy": (3, "deg")}
"""What is typed: how many numbers, and their unit."""


class LinePreview(NamedTuple):
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
        shares = ", ".join(f"{joint} {share:.0%}" for joint, share in zip(name, self.share, strict=True))
        said = f"{task.length:.3f} m in {task.profile().duration:.2f} s"
        if self.line.approach > 0.0:
            way = math.degrees(self.line.way)
            said += f", after an approach of {self.line.approach:.2f} s ({self.line.farthest} by {way:.0f} deg)"
        fastest = name[int(np.argmax(self.share))]
        return f"{said}. Fastest: {fastest}. Peak joint speeds, as shares of their limits: {shares}."


def typed_line(task: LineTask) -> list[str]:
    """Return a line as one would type it, in the order of FIELDS."""
    turn = [math.degrees(angle) for angle in task.start_rpy]
    lists = (task.start, task.end, [task.speed], [task.acceleration], turn)
    return [" ".join(f"{value:.6g}" for value in values) for values in lists]


def preview_line(
    robot: RobotModel, limits: JointLimits, period: float, branch: Branch, typed: Sequence[str], here: Array | None
) -> LinePreview:
    """Plan and check a typed line.

    Args:
        robot: the arm with its tool.
        limits: the controller's.
        period: of its set-points, s.
        branch: the solution of the inverse kinematics that is taken.
        typed: the line, in the order of FIELDS.
        here: where the arm stands, rad, shape (6,); None: nobody knows, it is at the line's start.

    Raises:
        LineError: naming a value and what is accepted, or where on the line the arm cannot go and why.
    """
    found = []
    for (what, (count, unit)), text in zip(FIELDS.items(), typed, strict=True):
        values = numbers(text)
        if len(values) != count or not all(abs(value) <= _LARGEST for value in values):
            accepted = "a number" if count == 1 else f"{count} numbers"
            raise LineError(f"{what} is {quoted(text)}; accepted: {accepted}, {unit}, up to {_LARGEST:g}")
        found.append(tuple(values))
    start, end, (speed,), (acceleration,), turn = found
    turn = tuple(map(math.radians, turn))
    plan = plan_line(robot, LineTask(start, end, speed, acceleration, turn, turn, branch=branch), period)
    check_plan(plan, limits, period, plan.start_pose)
    line = approached(plan, plan.start_pose if here is None else here, limits, period, Approach())
    way = np.empty((0, 3))
    if here is not None and line.approach > 0.0:
        rest = np.zeros((2, 6))
        motion = interpolate(np.array([0.0, line.approach]), np.stack([here, plan.start_pose]), rest, rest)
        way = tip_position(robot.chain, motion.sample(np.linspace(0.0, line.approach, _DRAWN))[:, 0])
    return LinePreview(plan, line, way)


class LineForm:
    """Fields for start, end, speed, acceleration and tool; a line that says what comes of them; a button to send it.

    Args:
        page: to build in, within a tab.
        check: plans and checks what is typed, from where the arm stands, as `preview_line`; on a thread of its own.
        task: what stands in the fields at first.
        send: takes a line that was checked, when the button is pressed.
    """

    def __init__(
        self,
        page: Page,
        check: Callable[[Sequence[str], Array | None], LinePreview],
        task: LineTask,
        send: Callable[[LinePreview], None],
    ) -> None:
        self._send = send
        self._here: Array | None = None
        self._checked_from: Array | None = None
        self._missing = ""
        self._wanted = False
        self._preview: LinePreview | None = None
        labels = (f"{what}, {unit}" for what, (_, unit) in FIELDS.items())
        self._fields = [page.gui.add_text(*given) for given in zip(labels, typed_line(task), strict=True)]
        self._checker = Checker(page, lambda given: check(*given), self._show, _CHECKS)
        self.close = self._checker.close
        self._button = page.gui.add_button("Send the line", disabled=True)
        self._reason = page.gui.add_html("")
        nowhere = np.zeros((1, 2, 3), dtype=np.float32)
        self._line, self._approach = (
            page.add_lines(f"/panel/{name}", nowhere, PLANNED, thickness=thickness, visible=False)
            for name, thickness in (("line", 3.0), ("approach", 1.5))
        )
        for field in self._fields:
            on_change(field, self._give, page)
        # Checked again before it is sent: the arm may have moved since.
        self._button.on_click(from_user(partial(self._give, wanted=True), page))
        self._give()

    def follow(self, here: Array | None, missing: str) -> None:
        """Take where the arm is, rad, shape (6,), None for unknown, and what is missing to send a line, if anything.

        Where the arm has come to rest elsewhere, the approach is another one.
        """
        stands = here is not None and self._here is not None and np.abs(here - self._here).max() < _STANDS
        self._here, self._missing = here, missing
        before = self._checked_from
        if stands and here is not None and (before is None or np.abs(here - before).max() > _ELSEWHERE):
            self._give(wanted=self._wanted)
        self._enable()

    def _give(self, *, wanted: bool = False) -> None:
        self._wanted, self._preview, self._checked_from = wanted, None, self._here
        self._enable()
        self._checker.give(([field.value for field in self._fields], self._here))

    def _show(self, found: LinePreview | None) -> str:
        wanted, self._wanted = self._wanted, False
        self._preview = found
        self._line.visible, self._approach.visible = found is not None, found is not None and len(found.approach) > 0
        self._enable()
        if found is None:
            return ""
        connect(self._line, np.array([found.plan.task.start, found.plan.task.end]))
        if len(found.approach):
            connect(self._approach, found.approach)
        if wanted and not self._missing:
            self._send(found)
        return found.text()

    def _enable(self) -> None:
        self._reason.content = sentence(f"cannot be sent: {self._missing}") if self._missing else ""
        self._button.disabled = self._preview is None or bool(self._missing)
