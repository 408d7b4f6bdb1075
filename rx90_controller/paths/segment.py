"""A part of a path as it is asked for: its kind and points, and the motion along it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from rx90_common.base.errors import LineError
from rx90_controller.paths.curve import Piece, arc_about, arc_through, line, spline

_FARTHEST = 1e3  # m


@dataclass(frozen=True)
class Segment:
    """A part of a path, from the end of the one before it.

    Attributes:
        points: a line: its end; an arc through a point: that point and its end; an arc about a centre: its end; a
            spline: its points behind the start; m.
        kind: "line", "arc" or "spline".
        center: of an arc, m; None for one through a point.
        normal: of the arc's plane; the arc runs counter-clockwise seen from where it points to.
        speed: m/s; None for that of the path.
        zone: m before and behind the end that a blend to the next segment replaces; 0: the tool stops at a corner.
        end_rpy: roll, pitch and yaw of the tool at the end, rad; None: as at its start.
    """

    points: tuple[tuple[float, ...], ...]
    kind: str = "line"
    center: tuple[float, ...] | None = None
    normal: tuple[float, ...] = (0.0, 0.0, 1.0)
    speed: float | None = None
    zone: float = 0.0
    end_rpy: tuple[float, ...] | None = None

    def piece(self, start: tuple[float, ...]) -> Piece:
        """Return the curve from a place, m.

        Raises:
            LineError: if there is none.
        """
        points = np.array([start, *self.points], dtype=np.float64)
        if points.ndim != 2 or points.shape[1] != 3 or not np.abs(points).max() <= _FARTHEST:
            raise LineError(f"has the points {self.points}; accepted: three numbers for each, up to {_FARTHEST:g} m")
        if self.kind == "line" and len(points) == 2:
            return line(*points)
        if self.kind == "spline":
            return spline(points)
        if self.kind == "arc" and self.center is not None and len(points) == 2:
            return arc_about(points[0], np.array(self.center), points[1], np.array(self.normal))
        if self.kind == "arc" and self.center is None and len(points) == 3:
            return arc_through(*points)
        raise LineError(
            f"is of kind {self.kind!r} with {len(self.points)} points; accepted: a line with its end, an arc with two "
            "points or with its centre and its end, a spline with its points"
        )
