"""The path error of a moving spot: now, and the largest on its way along a line."""

from __future__ import annotations

import numpy as np

from rx90_common.base.arrays import Array
from rx90_common.description.kinematics import decompose, path_error

_NEAR = 2e-3  # m; what is farther from the line is on its way to it
_STANDS = 1e-4  # m from one look to the next; what moves less stands
_ALONG = 0.9  # least share of a step that leads along the line, towards its end


class PathErrorMeter:
    """Measures the distance from a straight line, of a spot that is looked at now and then.

    Args:
        start: (3,) m.
        end: (3,) m.

    Attributes:
        error: m; None where the spot is not on the line: far from it, or on its way to it.
    """

    def __init__(self, start: Array, end: Array) -> None:
        self._start, self._end = start, end
        self._tip: Array | None = None
        self.error: float | None = None
        self._worst = self._worst_at = 0.0  # m, of the distance from the line and from its start

    def move(self, tip: Array) -> None:
        """Take where the spot is now, (3,) m."""
        step = np.zeros(3) if self._tip is None else tip - self._tip
        self._tip = tip
        distance = path_error(tip[None], self._start, self._end)
        perpendicular, beyond = float(distance.perpendicular[0]), float(distance.beyond[0])
        along, _ = decompose(step[None], self._end - self._start)
        way = float(np.linalg.norm(step))
        moves = way > _STANDS
        if max(perpendicular, beyond) >= _NEAR or (moves and float(along[0]) < _ALONG * way):
            self.error, self._worst = None, 0.0
            return
        self.error = perpendicular
        if moves and perpendicular > self._worst:
            self._worst, self._worst_at = perpendicular, float(np.linalg.norm(tip - self._start))

    def words(self) -> str:
        """Return the path error in words: now, the largest that was seen on the way along the line, and where."""
        if self.error is None:
            return "not on the line"
        now = f"{self.error * 1e3:.3f} mm now"
        if not self._worst:
            return now
        return f"{now}; largest on this way {self._worst * 1e3:.3f} mm, {self._worst_at * 1e3:.0f} mm from the start"
