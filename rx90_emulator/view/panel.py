"""The tabs that move the arm and ask the nodes: a slider for each joint, and all parts put together."""

from __future__ import annotations

import html
import math
import time
from collections import deque
from collections.abc import Callable
from functools import partial

import numpy as np

from rx90_common.base.arrays import Array
from rx90_common.description.robot import RobotModel, load_robot
from rx90_common.description.robot_files import RobotFiles
from rx90_common.exchange.arm_watch import JointSample
from rx90_common.friction.friction_file import FrictionFile
from rx90_controller.law.parameters import load_controller
from rx90_controller.lines.plan import Approach
from rx90_controller.lines.task import TOOL_DOWN, USUAL_ACCELERATION, USUAL_SPEED, LineTask, load_task
from rx90_controller.trajectory import JointLimits, TrajectoryPoints
from rx90_controller.trajectory.spline import interpolate
from rx90_emulator.view.element_form import ElementForm
from rx90_emulator.view.line_form import LineForm, LinePreview, preview_line
from rx90_emulator.view.operator import NodeControls, NodeNames, Operator
from rx90_emulator.view.page import NewestOnly, Page, block, from_user, on_change, put

_STEP = 0.1  # deg
_INTERVAL = 0.2  # s from one trajectory to the next while a slider is dragged
_ON_ITS_WAY = 2.0  # s; the longest that what the page shows takes to a browser
_SETTLED = 0.5  # s after the last change by a user, who may type on before
ARRIVED = 2e-3
"""How near to where it was sent the arm counts as there, rad."""
_PATIENCE = 2.0  # s without a motion until a slider shows the arm again, instead of where it was sent
_MOVED = 1e-6  # rad
_ROUNDING = 1e-6  # steps: a limit of whole degrees is one of the ends
_SHORTEST, _LONGER = 0.02, 1.15  # s; from one try to the next
_SAMPLES = np.linspace(0.0, 1.0, 33)[:-1]  # the last one would be the rest behind the end


def jog(position: Array, velocity: Array, target: Array, limits: JointLimits, gentle: Approach) -> TrajectoryPoints:
    """Return a quintic move to rest at a target, as short as speed and acceleration allow.

    It begins with whatever set-point the controller then has, of which the arm's own state is a good guess: the room
    between `gentle` and the controller's limits is for what is left.

    Args:
        position: of the arm, rad, shape (6,).
        velocity: rad/s, shape (6,).
        target: rad, shape (6,).
        limits: the controller's.
        gentle: share of their speeds, and acceleration.
    """
    # Slower than it is, it cannot be at once.
    top = np.maximum(gentle.speed * limits.velocity, np.abs(velocity))
    most = np.minimum(gentle.acceleration, limits.acceleration)
    rest = np.zeros((1, 6))
    positions, velocities = np.stack([position, target]), np.vstack([velocity, rest])
    duration = _SHORTEST
    while _exceeds(duration, positions, velocities, top, most):
        duration *= _LONGER
    return TrajectoryPoints(np.array([round(duration, 3)]), target[None], rest, rest)


def _exceeds(duration: float, positions: Array, velocities: Array, top: Array, most: Array) -> bool:
    """Return whether a quintic between two positions and velocities, shape (2, 6) each, is too fast anywhere."""
    times = np.array([0.0, duration])
    sampled = np.abs(interpolate(times, positions, velocities, np.zeros((2, 6))).sample(_SAMPLES * duration))
    return bool((sampled[:, 1] > top * (1.0 + _ROUNDING)).any() or (sampled[:, 2] > most).any())


def _is_at(arm: Array, target: Array) -> bool:
    return bool(np.abs(arm - target).max() < ARRIVED)


def slider_range(limits: JointLimits, joint: int, step: float) -> tuple[float, float]:
    """Return the ends of a joint's slider, deg: within its limits, and on its steps."""
    low, high = np.degrees([limits.lower[joint], limits.upper[joint]])
    ends = np.ceil(low / step - _ROUNDING) * step, np.floor(high / step + _ROUNDING) * step
    return float(ends[0]), float(ends[1])


class JogSliders:
    """Six sliders in degrees, within the joint limits.

    Args:
        page: to build in, within a tab.
        limits: the controller's.
        send: has a trajectory followed from now on.
    """

    def __init__(self, page: Page, limits: JointLimits, send: Callable[[TrajectoryPoints], None]) -> None:
        self._limits, self._gentle = limits, Approach()
        self._arm: JointSample | None = None
        # Where the joints are to go, and where they have come to and rest since, rad; where the arm was last seen.
        self._target: Array | None = None
        self._reached: Array | None = None
        self._arm_was: Array | None = None
        self._moved_at = 0.0
        self._sending: NewestOnly[tuple[JointSample, Array]] = NewestOnly(
            page, lambda item: send(jog(item[0].position, item[0].velocity, item[1], limits, self._gentle)), _INTERVAL
        )
        self._sliders = []
        for joint, name in enumerate(limits.names):
            low, high = slider_range(limits, joint, _STEP)
            slider = page.gui.add_slider(f"{name}, deg", low, high, _STEP, min(max(0.0, low), high), disabled=True)
            on_change(slider, partial(self._dragged, joint), page)
            self._sliders.append(slider)
        # What each slider was last seen with: another value is one that a user has just given, and is taken first.
        self._seen = [slider.value for slider in self._sliders]
        self._put_at = [-math.inf] * len(self._sliders)  # when each was last moved by the page
        self._given_at = 0.0  # when one was last moved by a user
        self._unsure: set[int] = set()  # sliders that a user has moved while another value was on its way to the page

    def close(self) -> None:
        """End the thread that sends."""
        self._sending.close()

    def follow(self, arm: JointSample | None, *, ready: bool) -> None:
        """Show where the arm is, or where it was sent; without an arm, or a controller that is ready, nothing moves."""
        self._arm = arm
        if arm is not None:
            now = time.monotonic()
            for joint, angle in enumerate(np.degrees(self._shown(arm.position, now))):
                self._show(joint, float(angle), now)
        for slider in self._sliders:
            if slider.disabled != (arm is None or not ready):
                slider.disabled = not slider.disabled

    def forget(self) -> None:
        """Show the arm again: something else was sent, or the move was refused."""
        self._target = self._reached = None

    def _shown(self, arm: Array, now: float) -> Array:
        """Return what the sliders show, rad: where the joints are to go, while the arm is on its way, else the arm."""
        if self._arm_was is None or np.abs(arm - self._arm_was).max() > _MOVED:
            self._arm_was, self._moved_at = arm.copy(), max(now, self._moved_at)
        if self._target is not None and _is_at(arm, self._target):
            self._reached, self._target = self._target, None
        elif now - self._moved_at > _PATIENCE:
            self._target = None
        if self._reached is not None and not _is_at(arm, self._reached):
            self._reached = None  # something else has moved it
        return arm if self._target is None else self._target

    def _show(self, joint: int, angle: float, now: float) -> None:
        """Move a slider to an angle, deg, unless a user has just moved it."""
        slider = self._sliders[joint]
        wanted = min(max(round(angle, 1), slider.min), slider.max)
        if slider.value != self._seen[joint]:
            return
        if joint in self._unsure and now > self._given_at + _SETTLED:
            # Viser sends no value that it takes for shown. Of two that are put in one step the page gets the last.
            self._unsure.remove(joint)
            put(slider, slider.min if wanted != slider.min else slider.max)
        if slider.value != wanted:
            put(slider, wanted)
            self._seen[joint], self._put_at[joint] = wanted, now

    def _dragged(self, joint: int) -> None:
        self._seen[joint] = self._sliders[joint].value
        now = self._given_at = time.monotonic()
        if now < self._put_at[joint] + _ON_ITS_WAY:
            self._unsure.add(joint)
        if self._arm is not None:
            # The others go on to where they were sent. One that rests there stays sent there: friction holds it a
            # little beside, and to send it to where it is would move it a little with each jog of another joint.
            begun = self._target if self._target is not None else self._reached
            target = (self._arm.position if begun is None else begun).copy()
            target[joint] = np.radians(self._seen[joint])
            self._target, self._moved_at = target, now
            self._sending.give((self._arm, target))


_PERIOD = 0.2  # s
_SET_POINT = 1e-3  # s, from one set-point of the controller to the next
_REFUSED = "rejected"
_LINES = 6


class DoPanel:
    """Tabs "Move" and "Element": jogging, lines, services, a friction element.

    Args:
        page: to build in.
        files: of the robot that the nodes have.
        arm: returns the newest state of the arm; None before the first one, or when it comes no more.
        names: of the nodes.
        on_line: takes a line that was sent.
    """

    def __init__(
        self,
        page: Page,
        files: RobotFiles,
        arm: Callable[[], JointSample | None],
        names: NodeNames,
        on_line: Callable[[LineTask], None],
    ) -> None:
        self._page, self._arm, self._on_line, self._names = page, arm, on_line, names
        robot = load_robot(files.urdf, files.tool)
        limits = load_controller(files.controller).limits(robot)
        task = load_task(files.task) if files.task is not None else _usual_line(robot)
        self._operator = Operator(
            names, lambda *line: page.later(lambda: self._said(*line)),
            lambda *both: page.later(lambda: self._nodes.states(*both)),
        )  # fmt: skip
        self._joints = limits.names
        self._lines: deque[str] = deque(maxlen=_LINES)  # the newest of what the nodes say and of what was refused here
        gui = page.gui
        with page.tab("Move"):
            with gui.add_folder("Straight line"):
                check = partial(preview_line, robot, limits, _SET_POINT, task.branch)
                self._line = LineForm(page, check, task, self._send_line)
            with gui.add_folder("Joints"):
                self._sliders = JogSliders(page, limits, lambda points: self._operator.send(self._joints, points))
            self._stop = gui.add_button("Stop the arm", color="red")
            self._stop.on_click(from_user(lambda: self._send(None), page))
            with gui.add_folder("What the nodes say"):
                self._log = gui.add_html(block("nothing yet"))
            with gui.add_folder("Nodes"):
                self._nodes = NodeControls(page, self._operator)
        with page.tab("Element"):
            self._form = ElementForm(page, FrictionFile.read(files.friction), self._start_with)
        page.every(_PERIOD, self._follow)

    def close(self) -> None:
        """End all threads."""
        for part in (self._line, self._sliders, self._form, self._operator):
            part.close()

    def _follow(self, _now: float) -> None:
        arm = self._arm()
        missing = self._missing(self._names.controller, self._nodes.controller)
        self._stop.disabled = bool(missing)
        if arm is None and not missing:
            missing = "no joint_states come"
        self._line.follow(None if arm is None else arm.position, missing)
        self._sliders.follow(arm, ready=not missing)
        self._form.follow(self._missing(self._names.simulation, self._nodes.simulation))

    @staticmethod
    def _missing(node: str, state: str) -> str:
        if state == "active":
            return ""
        return f"{node} is {state}; accepted: in state active" if state else f"there is no {node}"

    def _send(self, points: TrajectoryPoints | None) -> None:
        self._sliders.forget()
        self._operator.send(self._joints, points)

    def _send_line(self, preview: LinePreview) -> None:
        self._on_line(preview.plan.task)
        self._send(preview.line.points)

    def _start_with(self, path: str) -> None:
        self._sliders.forget()

        def ended(text: str, wrong: bool) -> None:
            self._page.later(lambda: self._form.tell(text, wrong))

        self._operator.configure_again("friction", path, ended)

    def _said(self, node: str, line: str, wrong: bool) -> None:
        colour = "color:#c92a2a" if wrong else ""
        self._lines.appendleft(f'<div style="{colour}"><b>{html.escape(node)}</b> {html.escape(line)}</div>')
        self._log.content = block("".join(self._lines))
        if wrong and _REFUSED in line:
            self._sliders.forget()


def _usual_line(robot: RobotModel) -> LineTask:
    """Return a line for a robot that has none of its own, as far out as half its reach."""
    reach = 0.5 * float(abs(robot.chain.origin).sum(axis=0)[2])
    start, end = (reach, -0.1 * reach, 0.3 * reach), (reach, 0.1 * reach, 0.3 * reach)
    return LineTask(start, end, USUAL_SPEED, USUAL_ACCELERATION, TOOL_DOWN, TOOL_DOWN)
