"""A straight line as it is typed: planned and checked as rx90_line and the controller do, before it is sent."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial

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
from rx90_emulator.view.page import NewestOnly, Page, from_user, on_change, sentence
from rx90_emulator.view.scene import PLANNED

_CHECKS = 0.1  # s from one check to the next while somebody types
_STANDS, _ELSEWHERE = 1e-4, 1e-2  # rad, from one look to the next; from where it was checked

_DRAWN = 60  # points of the approach
_LARGEST = 1e6  # of what is typed, in its unit; far beyond any arm, and far from what overflows


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


Typed = tuple[str, str, str, str, str]
"""What stands in the form: start and end (three numbers each, m), speed (m/s), acceleration (m/s²), tool (deg)."""


def typed_line(task: LineTask) -> Typed:
    """Return a line as one would type it."""
    turn = [math.degrees(angle) for angle in task.start_rpy]
    start, end, speed, acceleration, tool = (
        " ".join(f"{value:.6g}" for value in values)
        for values in (task.start, task.end, [task.speed], [task.acceleration], turn)
    )
    return start, end, speed, acceleration, tool


def preview_line(
    robot: RobotModel, limits: JointLimits, period: float, branch: Branch, typed: Typed, here: Array | None
) -> LinePreview:
    """Plan and check a typed line.

    Args:
        robot: the arm with its tool.
        limits: the controller's.
        period: of its set-points, s.
        branch: the solution of the inverse kinematics that is taken.
        typed: the line.
        here: where the arm stands, rad, shape (6,); None: nobody knows, it is at the line's start.

    Raises:
        LineError: naming a value and what is accepted, or where on the line the arm cannot go and why.
    """
    start, end, speed, acceleration, tool = typed
    turn = tuple(math.radians(angle) for angle in _numbers("tool", tool, 3, "deg"))
    task = LineTask(
        start=_numbers("start", start, 3, "m"),
        end=_numbers("end", end, 3, "m"),
        speed=_numbers("speed", speed, 1, "m/s")[0],
        acceleration=_numbers("acceleration", acceleration, 1, "m/s^2")[0],
        start_rpy=turn,
        end_rpy=turn,
        branch=branch,
    )
    plan = plan_line(robot, task, period)
    check_plan(plan, limits, period, plan.start_pose)
    line = approached(plan, plan.start_pose if here is None else here, limits, period, Approach())
    way = np.empty((0, 3))
    if here is not None and line.approach > 0.0:
        times, rest = np.array([0.0, line.approach]), np.zeros((2, 6))
        motion = interpolate(times, np.stack([here, plan.start_pose]), rest, rest)
        sampled = motion.sample(np.linspace(0.0, line.approach, _DRAWN))
        way = forward(robot.chain, sampled[:, 0]).position
    return LinePreview(plan, line, way)


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
        check: Callable[[Typed, Array | None], LinePreview],
        task: LineTask,
        send: Callable[[LinePreview], None],
    ) -> None:
        self._preview_of, self._send = check, send
        self._here: Array | None = None
        self._checked_from: Array | None = None
        self._missing = ""
        self._wanted = False
        self.preview: LinePreview | None = None
        labels = "start, m", "end, m", "speed, m/s", "acceleration, m/s²", "tool rpy, deg"
        self._fields = [page.gui.add_text(*given) for given in zip(labels, typed_line(task), strict=True)]
        self._verdict = page.gui.add_html("")
        self._button = page.gui.add_button("Send the line", disabled=True)
        self._reason = page.gui.add_html("")
        self._drawn = [
            page.add_lines(f"/panel/{name}", np.zeros((1, 2, 3)), PLANNED, thickness, visible=False)
            for name, thickness in (("line", 3.0), ("approach", 1.5))
        ]
        self._checking: NewestOnly[tuple[Typed, Array | None]] = NewestOnly(page, self._check, _CHECKS)
        for field in self._fields:
            on_change(field, self._typed, page)
        self._button.on_click(from_user(self._pressed, page))
        self._typed()

    def close(self) -> None:
        """End the thread that checks."""
        self._checking.close()

    def follow(self, here: Array | None, missing: str) -> None:
        """Take where the arm is, rad, shape (6,), None for unknown, and what is missing to send a line, if anything.

        Where the arm has come to rest elsewhere, the approach is another one.
        """
        stands = here is not None and self._here is not None and np.abs(here - self._here).max() < _STANDS
        self._here, self._missing = here, missing
        before = self._checked_from
        if stands and here is not None and (before is None or np.abs(here - before).max() > _ELSEWHERE):
            self._give()
        self._enable()

    def _typed(self) -> None:
        self._wanted = False
        self._give()

    def _pressed(self) -> None:
        # The arm may have moved since the line was checked.
        self._wanted = True
        self._give()

    def _give(self) -> None:
        self.preview = None
        self._verdict.content = sentence("checking ...")
        self._enable()
        self._checked_from = self._here
        start, end, speed, acceleration, tool = (field.value for field in self._fields)
        self._checking.give(((start, end, speed, acceleration, tool), self._here))

    def _check(self, item: tuple[Typed, Array | None]) -> Callable[[], None]:
        try:
            return partial(self._accept, self._preview_of(*item))
        except LineError as error:
            return partial(self._refuse, str(error))

    def _refuse(self, text: str) -> None:
        self._wanted = False
        self._verdict.content = sentence(text, wrong=True)
        for drawn in self._drawn:
            drawn.visible = False

    def _accept(self, found: LinePreview) -> None:
        wanted, self._wanted = self._wanted, False
        line, approach = self._drawn
        self.preview = found
        self._verdict.content = sentence(found.text())
        task = found.plan.task
        line.points = np.array([[task.start, task.end]], dtype=np.float32)
        line.visible, approach.visible = True, len(found.approach) > 0
        if len(found.approach):
            way = found.approach.astype(np.float32)
            approach.points = np.stack([way[:-1], way[1:]], axis=1)
        if wanted and not self._missing:
            self._send(found)
        self._enable()

    def _enable(self) -> None:
        disabled = self.preview is None or bool(self._missing)
        if self._button.disabled != disabled:
            self._button.disabled = disabled
        reason = sentence(f"cannot be sent: {self._missing}") if self._missing else ""
        if self._reason.content != reason:
            self._reason.content = reason
