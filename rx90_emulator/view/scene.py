"""The objects in the scene: an arm, a line or path, the laser spot, and its trace coloured by the path error."""

from __future__ import annotations

from collections import deque
from itertools import product
from typing import Any

import numpy as np
import pinocchio as pin
import viser
from viser import transforms

from rx90_common.base.arrays import Array, Mask, interpolated
from rx90_common.description.robot import RobotModel
from rx90_common.description.rotations import length
from rx90_common.description.shapes import VisualShape, drawn_shapes
from rx90_controller.lines.task import SETTLING, TipTask
from rx90_emulator.view.page import Page


class ArmScene:
    """An arm, each joint's frame a node below that of the joint before it.

    Args:
        page: to draw in.
        name: of its node in the scene, such as "/arm".
        robot: the arm with its tool.

    Attributes:
        tip: the name of its last node.
    """

    def __init__(self, page: Page, name: str, robot: RobotModel) -> None:
        self._page = page
        self._model = robot.model
        self._data = robot.model.createData()
        shapes = drawn_shapes(robot)
        page.scene.add_frame(name, show_axes=False)
        self._joints: list[viser.FrameHandle] = []
        path = name
        for index, joint in enumerate(("", *robot.joint_names), -1):
            if joint:
                path = f"{path}/{joint}"
                self._joints.append(page.scene.add_frame(path, show_axes=False))
            for number, shape in enumerate(shape for shape in shapes if shape.joint == index):
                self._draw(f"{path}/shape_{number}", shape)
        placement = robot.model.frames[robot.model.getFrameId(robot.tcp_frame)].placement
        self.tip = f"{path}/tip"
        turn = _quaternion(placement.rotation)
        page.scene.add_frame(self.tip, show_axes=False, position=placement.translation, wxyz=turn)
        self.show(np.zeros(len(robot.joint_names)))

    def show(self, position: Array) -> None:
        """Show the arm with its joints at `position`, (6,) rad."""
        pin.forwardKinematics(self._model, self._data, np.asarray(position, dtype=np.float64))
        for handle, place in zip(self._joints, list(self._data.liMi)[1:], strict=True):
            handle.wxyz = _quaternion(place.rotation)
            if not np.array_equal(handle.position, place.translation):
                handle.position = place.translation

    def _draw(self, name: str, shape: VisualShape) -> None:
        red, green, blue = (round(255 * part) for part in shape.color.tolist())
        color = (red, green, blue)
        size = 2.0 * shape.half
        scene = self._page.scene
        place: dict[str, Any] = {"position": shape.position, "wxyz": _quaternion(shape.rotation)}
        if shape.kind == "Box":
            scene.add_box(name, color, size, **place)
        elif shape.kind == "Cylinder":
            scene.add_cylinder(name, size[0] / 2.0, size[2], color, **place)
        else:
            scene.add_icosphere(name, size[0] / 2.0, color, **place)


def _quaternion(rotation: Array) -> Array:
    """Return the quaternion (4,), scalar first, of a rotation (3, 3)."""
    return np.asarray(transforms.SO3.from_matrix(np.asarray(rotation)).wxyz)


FULL_SCALE = 1e-4
"""Path error of the last colour, m: what laser welding asks for."""
_ERROR_COLORS = np.array(
    [(0, 114, 178), (0, 158, 115), (240, 228, 66), (230, 159, 0), (213, 60, 0)], dtype=np.float64
)
_OFF_LINE = np.array([150.0, 150.0, 150.0])
_SPOT = (255, 40, 40)
_GAMMA = 2.2  # the page takes the colours of a line's points as brightness of light


def line_colors(error: Array) -> Array:
    """Return what shows as the colours of path errors (n,), m, on the points of a line in the scene, (n, 3).

    Grey for NaN, off the line.
    """
    places = np.arange(len(_ERROR_COLORS), dtype=np.float64)
    share = np.clip(np.nan_to_num(error) / FULL_SCALE, 0.0, 1.0) * places[-1]
    colors = interpolated(share, places, _ERROR_COLORS)
    colors[np.isnan(error)] = _OFF_LINE
    return np.round(255.0 * (colors / 255.0) ** _GAMMA).astype(np.uint8)


def connect(lines: viser.LineSegmentsHandle, points: Array, colors: Array | None = None) -> None:
    """Lead lines through points, (n, 3) m, with their colours (n, 3) where these are given."""
    points = points.astype(np.float32)
    lines.points = np.stack([points[:-1], points[1:]], axis=1)
    if colors is not None:
        lines.colors = np.stack([colors[:-1], colors[1:]], axis=1)


def legend_html() -> str:
    """Return the colours with their path errors as HTML."""
    stops = ", ".join(
        f"rgb({red:.0f},{green:.0f},{blue:.0f})" for red, green, blue in _ERROR_COLORS
    )
    grey = ",".join(f"{part:.0f}" for part in _OFF_LINE)
    limit = FULL_SCALE * 1e3
    return (
        '<div style="padding:0 0.6em;font-size:0.8em"><div>path error of the laser spot, mm</div>'
        f'<div style="height:0.7em;border-radius:2px;background:linear-gradient(to right, {stops})"></div>'
        '<div style="display:flex;justify-content:space-between">'
        f"<span>0</span><span>&ge; {limit:g}</span></div>"
        f'<div><span style="color:rgb({grey})">&#9632;</span> not on the line</div></div>'
    )


_END_TOLERANCE = 1e-4  # m; a motion that begins and ends so near the line's ends, and keeps so near, is one along it
# of its length; between the points of its trajectory it is longer than the straight way
_CHORD_TOLERANCE = 0.05
_PATH_STEP = 5e-3  # m between points of a path that is drawn
_KEPT_BEFORE = 100  # samples from before it is known that they are of a run
_TRACE_SAMPLES = 600  # samples in the trace
_TRACE_STEP = 5e-4  # m between two of them
_NO_SPAN = np.inf, -np.inf  # s, when no sample counts


class LineScene:
    """A line, or another path, the spot on or near it, where the spot has been, and its newest run along the line.

    Args:
        page: to draw in.
        name: of its nodes in the scene.
        task: the line or path.

    Attributes:
        largest: path error of the newest run along the line, as far as it has come, and its distance from the line's
            start, m; None before the first run.
    """

    def __init__(self, page: Page, name: str, task: TipTask) -> None:
        ends = np.zeros((1, 2, 3), dtype=np.float32)
        line = page.add_lines(f"{name}/line", ends, (30, 30, 30), thickness=2.0)
        self._spot = page.scene.add_icosphere(
            f"{name}/spot", 0.007, _SPOT, subdivisions=2, cast_shadow=False
        )
        # A colour for each end: a page that has seen one for all draws no others until it is loaded again.
        grey = np.full((1, 2, 3), 150, dtype=np.uint8)
        self._trace = page.add_lines(f"{name}/trace", ends, grey, thickness=5.0, visible=False)
        self._points: deque[tuple[Array, float]] = deque(maxlen=_TRACE_SAMPLES)
        self._recent: deque[tuple[float, Array]] = deque(maxlen=_KEPT_BEFORE)
        self._task = task
        connect(line, task.poses(task.places(_PATH_STEP, 1)).position)
        self.largest: tuple[float, float] | None = None
        self._error = np.nan  # of the newest sample, m
        self.begin_again()

    def begin_again(self) -> None:
        """Forget the trace and all times, because simulated time has begun again. The newest run stays."""
        self._span = _NO_SPAN
        self._begun = False
        self._asked = np.zeros((2, 1))
        self._recent.clear()
        self._points.clear()
        self._trace.visible = False
        self._changed = False

    def follow(self, times: Array, tips: Array, at_rest: Mask) -> None:
        """Take the trajectory that was accepted last.

        Args:
            times: of its points, s, shape (n,); none for no trajectory.
            tips: positions of the spot at these times, m, shape (n, 3).
            at_rest: whether the arm rests at each of them, shape (n,).
        """
        self._span = _NO_SPAN
        self._begun = False
        ends = self._task.poses(np.array([0.0, self._task.length])).position
        whole = self._task.length
        way = np.concatenate(
            [np.zeros(min(1, len(tips))), np.cumsum(length(np.diff(tips, axis=0)))]
        )
        moves = np.diff(way) > 0.0
        begins = np.flatnonzero(at_rest[:-1] & moves)
        finishes = np.flatnonzero(at_rest[1:] & moves) + 1
        for first, last in product(begins, finishes):
            travelled = way[last] - way[first]
            if last <= first or abs(travelled - whole) > _CHORD_TOLERANCE * whole:
                continue
            if length(tips[[first, last]] - ends).max() >= _END_TOLERANCE:
                continue
            asked = (way[first : last + 1] - way[first]) * (whole / travelled)
            error = self._task.error(tips[first : last + 1], asked)
            if error.perpendicular.max() < _END_TOLERANCE:
                self._asked = np.stack([times[first : last + 1], error.along])
                end = times[last] + min(SETTLING, times[-1] - times[last])
                self._span = float(times[first]), float(end)
        if self._recent:
            recent_times, recent_tips = zip(*self._recent, strict=True)
            self._measure(np.array(recent_times), np.array(recent_tips))

    def add(self, times: Array, tips: Array) -> Array:
        """Add positions of the spot; return its path errors, m, NaN where it is on no run along the line.

        Args:
            times: s, shape (n,).
            tips: m, shape (n, 3).
        """
        self._spot.position = tips[-1]
        self._recent.extend(zip(times.tolist(), tips, strict=True))
        errors = self._measure(times, tips)
        for tip, error in zip(tips, errors.tolist(), strict=True):
            if not self._points or float(np.linalg.norm(tip - self._points[-1][0])) >= _TRACE_STEP:
                self._points.append((tip, error))
                self._changed = True
        self._error = float(errors[-1])
        return errors

    def _measure(self, times: Array, tips: Array) -> Array:
        """Return path errors, m, NaN off the run along the line, and keep the largest."""
        error = self._task.error(tips, np.interp(times, *self._asked))
        counts = (times >= self._span[0]) & (times <= self._span[1])
        if counts.any():
            if not self._begun or self.largest is None:
                self.largest = 0.0, 0.0
                self._begun = True
            row = np.argmax(np.where(counts, error.perpendicular, -1.0))
            found = float(error.perpendicular[row]), float(error.along[row])
            self.largest = max(self.largest, found)
        return np.where(counts, error.perpendicular, np.nan)

    def words(self) -> str:
        """Return the path error in words: now, and the largest of the newest run, with its place."""
        known = bool(np.isfinite(self._error))
        words = f"{self._error * 1e3:.3f} mm now" if known else "not on the line"
        if self.largest is None:
            return words
        run = "largest of this run" if known else "last run"
        error, place = self.largest
        return f"{words}; {run} {error * 1e3:.3f} mm, {place * 1e3:.0f} mm from the start"

    def draw(self) -> None:
        """Draw the trace, if it has changed; less often than `add`, because all of it is sent."""
        if self._changed and len(self._points) > 1:
            self._changed = False
            tips, errors = zip(*self._points, strict=True)
            connect(self._trace, np.array(tips), line_colors(np.array(errors)))
            self._trace.visible = True
