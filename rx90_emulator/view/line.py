"""A straight line in the scene, the laser spot, and its trace coloured by the path error."""

from __future__ import annotations

import numpy as np

from rx90_common.base.arrays import Array
from rx90_common.description.kinematics import path_error
from rx90_emulator.view.page import Page

FULL_SCALE = 1e-4
"""Path error of the last colour, m: what laser welding asks for."""
_STOPS = np.array([(0, 114, 178), (0, 158, 115), (240, 228, 66), (230, 159, 0), (213, 60, 0)], dtype=np.float64)
_AWAY = np.array([150.0, 150.0, 150.0])
_NEAR = 2e-3  # m; what is farther from the line is on its way to it
_LENGTH = 600  # samples in the trace
_STEP = 5e-4  # m between two of them
_SPOT = (255, 40, 40)


def error_colors(error: Array) -> Array:
    """Return colours (n, 3), 0 to 255, of path errors (n,) in m; grey far away from the line."""
    share = np.clip(error / FULL_SCALE, 0.0, 1.0) * (len(_STOPS) - 1)
    places = np.arange(len(_STOPS))
    colors = np.stack([np.interp(share, places, channel) for channel in _STOPS.T], axis=-1)
    return np.where((error < _NEAR)[:, None], colors, _AWAY).astype(np.uint8)


def legend_html() -> str:
    """Return the colours with their path errors, as HTML."""
    stops = ", ".join(f"rgb({red:.0f},{green:.0f},{blue:.0f})" for red, green, blue in _STOPS)
    grey = ",".join(f"{part:.0f}" for part in _AWAY)
    limit = FULL_SCALE * 1e3
    return (
        '<div style="padding:0 0.6em;font-size:0.8em"><div>path error of the laser spot, mm</div>'
        f'<div style="height:0.7em;border-radius:2px;background:linear-gradient(to right, {stops})"></div>'
        '<div style="display:flex;justify-content:space-between">'
        f"<span>0</span><span>{limit / 2:g}</span><span>&ge; {limit:g}</span></div>"
        f'<div><span style="color:rgb({grey})">&#9632;</span> not on the line</div></div>'
    )


class LineScene:
    """A line from start to end, m, the spot on or near it, and where the spot has been.

    Args:
        page: to draw in.
        name: of its nodes in the scene.
        start: (3,) m.
        end: (3,) m.
    """

    def __init__(self, page: Page, name: str, start: Array, end: Array) -> None:
        self._start, self._end = np.asarray(start, dtype=np.float64), np.asarray(end, dtype=np.float64)
        points = np.stack([self._start, self._end])[None]
        page.scene.add_line_segments(f"{name}/line", points, (30, 30, 30), thickness=2.0, thickness_units="screen")
        self._spot = page.scene.add_icosphere(f"{name}/spot", 0.008, _SPOT, subdivisions=2, cast_shadow=False)
        self._trace = page.scene.add_line_segments(
            f"{name}/trace", points, (150, 150, 150), thickness=5.0, thickness_units="screen", visible=False
        )
        self._tips: list[Array] = []
        self._changed = False

    def add(self, tip: Array) -> float:
        """Move the spot to `tip`, (3,) m, and lengthen the trace; return its distance from the line, m."""
        self._spot.position = tip
        if not self._tips or float(np.linalg.norm(tip - self._tips[-1])) >= _STEP:
            self._tips = [*self._tips[-_LENGTH + 1 :], np.array(tip)]
            self._changed = True
        return float(self._distance(np.array(tip)[None])[0])

    def draw(self) -> None:
        """Draw the trace, if it is longer than before; less often than `add`, because all of it is sent."""
        if not self._changed or len(self._tips) < 2:
            return
        self._changed = False
        tips = np.array(self._tips)
        colors = error_colors(self._distance(tips))
        self._trace.points = np.stack([tips[:-1], tips[1:]], axis=1).astype(np.float32)
        self._trace.colors = np.stack([colors[:-1], colors[1:]], axis=1)
        self._trace.visible = True

    def clear(self) -> None:
        """Forget the trace."""
        self._tips, self._changed = [], False
        self._trace.visible = False

    def _distance(self, tips: Array) -> Array:
        """Return the distances (n,) of points (n, 3) from the line between its ends, m."""
        error = path_error(tips, self._start, self._end)
        return np.asarray(np.hypot(error.perpendicular, error.beyond))
