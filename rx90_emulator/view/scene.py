"""What stands in the scene: an arm, a straight line, the laser spot, and its trace coloured by the path error."""

from __future__ import annotations

from itertools import pairwise
from typing import Any, TypeAlias

import numpy as np
import pinocchio as pin
import viser
from numpy.typing import NDArray
from viser import transforms

from rx90_common.base.arrays import Array
from rx90_common.description.kinematics import decompose, path_error
from rx90_common.description.robot import RobotModel
from rx90_common.description.shapes import VisualShape, drawn_shapes
from rx90_controller.lines.task import SETTLING
from rx90_emulator.loop.line import PathAccuracy
from rx90_emulator.view.page import Page

# Of round shapes; a wire frame of few lines lets the arm behind it be seen.
_SEGMENTS, _GHOST_SEGMENTS = 32, 12
_SUBDIVISIONS, _GHOST_SUBDIVISIONS = 3, 1

Color: TypeAlias = tuple[int, int, int]


class ArmScene:
    """An arm, each joint's frame a node below that of the joint before it; `tip` is the name of the last node.

    Args:
        page: to draw in.
        name: of its node in the scene, such as "/arm".
        robot: the arm with its tool.
        ghost: colour of a wire frame, red, green and blue, 0 to 255, for a second arm beside or in the first, whose
            colours it leaves as they are; None: solid, in the shapes' own colours.
    """

    def __init__(self, page: Page, name: str, robot: RobotModel, *, ghost: Color | None = None) -> None:
        self._model, self._data = robot.model, robot.model.createData()
        shapes = drawn_shapes(robot)
        self._root = page.scene.add_frame(name, show_axes=False)
        self._joints: list[viser.FrameHandle] = []
        path = name
        self._draw(page.scene, path, [shape for shape in shapes if shape.joint < 0], ghost)
        for index, joint in enumerate(robot.joint_names):
            path = f"{path}/{joint}"
            self._joints.append(page.scene.add_frame(path, show_axes=False))
            self._draw(page.scene, path, [shape for shape in shapes if shape.joint == index], ghost)
        self._tcp = robot.model.getFrameId(robot.tcp_frame)
        frame = robot.model.frames[self._tcp].placement
        self.tip = f"{path}/tip"
        page.scene.add_frame(
            self.tip, show_axes=False, position=frame.translation, wxyz=_quaternion(frame.rotation)
        )  # fmt: skip
        self.show(np.zeros(len(robot.joint_names)))

    def show(self, position: Array) -> Array:
        """Show the arm with its joints at `position`, (6,) rad; return where its tip is, (3,) m, in the arm's base."""
        pin.forwardKinematics(self._model, self._data, np.asarray(position, dtype=np.float64))
        for handle, place in zip(self._joints, list(self._data.liMi)[1:], strict=True):
            handle.wxyz = _quaternion(place.rotation)
            if not np.array_equal(handle.position, place.translation):
                handle.position = place.translation
        return np.array(pin.updateFramePlacement(self._model, self._data, self._tcp).translation)

    @property
    def visible(self) -> bool:
        """Whether it is drawn."""
        return bool(self._root.visible)

    @visible.setter
    def visible(self, shown: bool) -> None:
        self._root.visible = shown

    @staticmethod
    def _draw(scene: viser.SceneApi, path: str, shapes: list[VisualShape], ghost: Color | None) -> None:
        for number, shape in enumerate(shapes):
            red, green, blue = ghost or (round(255 * part) for part in shape.color.tolist())
            name, color, size = f"{path}/shape_{number}", (red, green, blue), 2.0 * shape.half
            look: dict[str, Any] = {"wireframe": ghost is not None, "cast_shadow": ghost is None}
            place: dict[str, Any] = {"position": shape.position, "wxyz": _quaternion(shape.rotation)}
            if shape.kind == "Box":
                scene.add_box(name, color, size, **look, **place)
            elif shape.kind == "Cylinder":
                segments = _SEGMENTS if ghost is None else _GHOST_SEGMENTS
                scene.add_cylinder(name, size[0] / 2.0, size[2], color, radial_segments=segments, **look, **place)
            else:
                subdivisions = _SUBDIVISIONS if ghost is None else _GHOST_SUBDIVISIONS
                scene.add_icosphere(name, size[0] / 2.0, color, subdivisions=subdivisions, **look, **place)


def _quaternion(rotation: Array) -> Array:
    """Return the quaternion (4,), scalar first, of a rotation (3, 3)."""
    return np.asarray(transforms.SO3.from_matrix(np.asarray(rotation)).wxyz)


FULL_SCALE = 1e-4
"""Path error of the last colour, m: what laser welding asks for."""
_STOPS = np.array([(0, 114, 178), (0, 158, 115), (240, 228, 66), (230, 159, 0), (213, 60, 0)], dtype=np.float64)
_AWAY = np.array([150.0, 150.0, 150.0])
PLANNED = 140, 60, 190
"""Of what is planned and not measured, a colour that no path error has."""
HELD = 120, 120, 120
"""Of the trace that is held."""
_LENGTH = 600  # samples in the trace
_STEP = 5e-4  # m between two of them
_SPOT = (255, 40, 40)
# The page takes the colours of a line's points as brightness of light, and the screen's are not in proportion to it.
_LINEAR = np.round(255.0 * (np.arange(256) / 255.0) ** 2.2).astype(np.uint8)
_AT_END = 1e-4  # m; a motion that begins and ends so near the line's ends is one along the line
_START = 0.01  # m; in these a motion that follows another one bends the bristles back
_MOST = 4000  # samples of a run; of a longer one the larger of each two is kept
_KEPT = 100  # samples from before it is known that they are of a run
_NEVER = np.inf, -np.inf
_ROW = 3  # time, distance along the line, path error


class PathErrorMeter:
    """Measures the runs of a spot along a straight line, which is looked at now and then.

    Args:
        start: (3,) m.
        end: (3,) m.
    """

    def __init__(self, start: Array, end: Array) -> None:
        self._start, self._end = np.asarray(start, dtype=np.float64), np.asarray(end, dtype=np.float64)
        self._span = _NEVER
        self._before = np.empty((0, _ROW))
        self._run = np.empty((0, _ROW))
        self._is_new = False  # what is accepted now: its first sample begins a run
        self._now: float | None = None

    def follow(self, times: Array, tips: Array, at_rest: NDArray[np.bool_]) -> None:
        """Take the trajectory that was accepted last.

        Args:
            times: of its points, s, shape (n,); none for no trajectory.
            tips: where it has the spot at these, m, shape (n, 3).
            at_rest: at which of them it rests, shape (n,).
        """
        self._span, self._is_new = _NEVER, True
        for first, last in pairwise(np.flatnonzero(at_rest)):
            apart = np.linalg.norm([tips[first] - self._start, tips[last] - self._end], axis=1)
            if apart.max() < _AT_END:
                self._span = float(times[first]), float(times[last] + min(SETTLING, times[-1] - times[last]))

    def add(self, times: Array, tips: Array) -> Array:
        """Take where the spot was, (n, 3) m, at times (n,) s; return its path errors, m, NaN where none counts."""
        error = path_error(tips, self._start, self._end)
        rows = np.stack([times, error.along, error.perpendicular], axis=1)
        known = np.concatenate([self._before, rows])
        self._before = known[-_KEPT:]
        counts = self._counts(times)
        self._now = float(error.perpendicular[-1]) if counts[-1] else None
        new = known[self._counts(known[:, 0])]
        if len(new) and self._is_new:
            self._run, self._is_new = self._run[:0], False
        if len(new):
            newer = new[:, 0] > (self._run[-1, 0] if len(self._run) else -np.inf)
            self._run = _thinned(np.concatenate([self._run, new[newer]]))
        return np.where(counts, error.perpendicular, np.nan)

    def begin_again(self) -> None:
        """Forget the times that were seen: time has begun again. The newest run stays."""
        self._span, self._before, self._now = _NEVER, self._before[:0], None

    @property
    def run(self) -> PathAccuracy | None:
        """Return the newest run, as far as it has come; None before the first one."""
        return PathAccuracy(*self._run.T) if len(self._run) else None

    def words(self) -> str:
        """Return the path error in words: now, and the largest of the newest run, with its place."""
        run = self.run
        words = ["not on the line" if self._now is None else f"{self._now * 1e3:.3f} mm now"]
        if run is not None:
            words.append(f"largest of this run {largest(run)}" if self._now is not None else f"last run {largest(run)}")
        return "; ".join(words)

    def _counts(self, times: Array) -> NDArray[np.bool_]:
        return np.asarray((times >= self._span[0]) & (times <= self._span[1]))


def largest(run: PathAccuracy) -> str:
    """Return the largest path error of a run and its place, and what it is beyond the start where it is there."""
    at = float(run.along[np.argmax(run.perpendicular)])
    words = f"{run.worst * 1e3:.3f} mm, {at * 1e3:.0f} mm from the start"
    beyond = run.perpendicular[run.along > _START]
    if at > _START or not len(beyond):
        return words
    return f"{words} (beyond {_START * 1e3:.0f} mm: {beyond.max() * 1e3:.3f} mm)"


def _thinned(rows: Array) -> Array:
    """Return the rows of a run, half of them where there are too many."""
    if len(rows) <= _MOST:
        return rows
    pairs = rows[: len(rows) // 2 * 2].reshape(-1, 2, _ROW)
    return np.asarray(pairs[np.arange(len(pairs)), np.argmax(pairs[:, :, 2], axis=1)])


def error_colors(error: Array) -> Array:
    """Return colours (n, 3), 0 to 255, of path errors (n,) in m; grey for nan, off the line."""
    share = np.clip(np.nan_to_num(error) / FULL_SCALE, 0.0, 1.0) * (len(_STOPS) - 1)
    places = np.arange(len(_STOPS))
    colors = np.stack([np.interp(share, places, channel) for channel in _STOPS.T], axis=-1)
    return np.where(np.isnan(error)[:, None], _AWAY, colors).astype(np.uint8)


def line_colors(error: Array) -> Array:
    """Return what shows as the colours of path errors (n,), m, on the points of a line in the scene, (n, 3)."""
    return np.asarray(_LINEAR[error_colors(error)])


def legend_html(planned: str = "") -> str:
    """Return the colours with their path errors, and what it is that has the colour of the planned, as HTML."""
    stops = ", ".join(f"rgb({red:.0f},{green:.0f},{blue:.0f})" for red, green, blue in _STOPS)
    grey = ",".join(f"{part:.0f}" for part in _AWAY)
    limit = FULL_SCALE * 1e3
    also = f' &ensp;<span style="color:rgb{PLANNED}">&#9632;</span> {planned}' if planned else ""
    return (
        '<div style="padding:0 0.6em;font-size:0.8em"><div>path error of the laser spot, mm</div>'
        f'<div style="height:0.7em;border-radius:2px;background:linear-gradient(to right, {stops})"></div>'
        '<div style="display:flex;justify-content:space-between">'
        f"<span>0</span><span>{limit / 2:g}</span><span>&ge; {limit:g}</span></div>"
        f'<div><span style="color:rgb({grey})">&#9632;</span> not on the line{also}</div></div>'
    )


class LineScene:
    """A line from start to end, m, the spot on or near it, and where the spot has been.

    Attributes:
        meter: of the spot's path error along this line.

    Args:
        page: to draw in.
        name: of its nodes in the scene.
        start: (3,) m.
        end: (3,) m.
    """

    def __init__(self, page: Page, name: str, start: Array, end: Array) -> None:
        ends = np.stack([start, end])[None]
        self._line = page.add_lines(f"{name}/line", ends, (30, 30, 30), 2.0)
        self._spot = page.scene.add_icosphere(f"{name}/spot", 0.007, _SPOT, subdivisions=2, cast_shadow=False)
        # A colour for each end: a page that has seen one for all draws no others until it is loaded again.
        grey = np.full((1, 2, 3), 150, dtype=np.uint8)
        self._trace = page.add_lines(f"{name}/trace", ends, grey, 5.0, visible=False)
        self._held_trace = page.add_lines(f"{name}/held", ends, grey, 3.0, visible=False)
        self._factor = 1.0
        self._held = np.empty((0, 3))
        self._start = self._end = np.full(3, np.nan)
        self.place(start, end)

    def place(self, start: Array, end: Array) -> None:
        """Compare with the line from start to end, (3,) m, from now on, with an empty trace and no run."""
        before = np.concatenate([self._start, self._end])
        self._start, self._end = np.asarray(start, dtype=np.float64), np.asarray(end, dtype=np.float64)
        if not np.array_equal(before, np.concatenate([self._start, self._end])):
            self.release()
        self.meter = PathErrorMeter(self._start, self._end)
        self._line.points = np.stack([self._start, self._end])[None].astype(np.float32)
        self.clear()

    def clear(self) -> None:
        """Forget the trace."""
        self._tips: list[Array] = []
        self._errors: list[float] = []  # of the trace, nan where they do not count
        self._changed = False
        self._trace.visible = False

    @property
    def holds(self) -> bool:
        """Return whether a trace of this line is held."""
        return len(self._held) > 0

    def hold(self) -> None:
        """Keep the trace along the line in one colour, beside the next one, until another line is placed."""
        on_line = np.isfinite(self._errors)
        self._held = np.array(self._tips).reshape(-1, 3)[on_line]
        self._draw_held()

    def release(self) -> None:
        """Forget the trace that is held."""
        self._held = np.empty((0, 3))
        self._draw_held()

    def magnify(self, factor: float) -> None:
        """Draw the trace, but not the spot, this many times as far from the line as it is."""
        self._factor, self._changed = factor, True
        self._draw_held()

    def add(self, times: Array, tips: Array) -> float:
        """Lengthen the trace by where the spot was, (n, 3) m, at times (n,) s; return its path error now, m, or NaN."""
        tips = np.asarray(tips, dtype=np.float64)
        self._spot.position = tips[-1]
        errors = self.meter.add(times, tips)
        for tip, error in zip(tips, errors, strict=True):
            if not self._tips or float(np.linalg.norm(tip - self._tips[-1])) >= _STEP:
                self._tips = [*self._tips[-_LENGTH + 1 :], tip]
                self._errors = [*self._errors[-_LENGTH + 1 :], error]
                self._changed = True
        return float(errors[-1])

    def draw(self) -> None:
        """Draw the trace, if it has changed; less often than `add`, because all of it is sent."""
        if not self._changed or len(self._tips) < 2:
            return
        self._changed = False
        tips, error = np.array(self._tips), np.array(self._errors)
        colors = line_colors(error)
        drawn = np.where(np.isnan(error)[:, None], tips, self._magnified(tips)).astype(np.float32)
        self._trace.points = np.stack([drawn[:-1], drawn[1:]], axis=1)
        self._trace.colors = np.stack([colors[:-1], colors[1:]], axis=1)
        self._trace.visible = True

    def _draw_held(self) -> None:
        self._held_trace.visible = len(self._held) > 1
        if self._held_trace.visible:
            drawn = self._magnified(self._held).astype(np.float32)
            self._held_trace.points = np.stack([drawn[:-1], drawn[1:]], axis=1)
            self._held_trace.colors = np.full((len(drawn) - 1, 2, 3), _LINEAR[list(HELD)], dtype=np.uint8)

    def _magnified(self, tips: Array) -> Array:
        _, across = decompose(tips - self._start, self._end - self._start)
        return np.asarray(tips + (self._factor - 1.0) * across)
