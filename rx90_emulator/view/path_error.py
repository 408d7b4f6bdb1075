"""The path error of a moving spot along a line: now, the runs along the line, and two of them compared.

What counts is what `LineTask.counted` says: from the beginning of the line's own motion until the arm has settled at
its end, by the times of the trajectory that the controller has accepted.
"""

from __future__ import annotations

from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from rx90_common.base.arrays import Array
from rx90_common.description.kinematics import path_error
from rx90_controller.lines.task import SETTLING
from rx90_emulator.loop.line import PathAccuracy

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
