"""The time on a path, tick by tick: at full speed, or at a rate that goes to a wanted one within the accelerations.

Along a path q(s) that is travelled at the rate r = ds/dt, the velocities are q' r and the accelerations
q'' r^2 + q' dr/dt (Bobrow, Dubowsky and Gibson 1985). A path that keeps to the accelerations at full speed keeps to
them at every constant rate below; what is left of them changes the rate.
"""

from __future__ import annotations

import numpy as np

from rx90_common.base.arrays import Array
from rx90_common.kernels.compiled import inlined, kernel
from rx90_controller.trajectory.spline import Spline, sample_spline

_BLOCK = 64  # ticks that are computed at once, at least
_HALVINGS = 20
_SLACK = 1e-3  # of the limit, as accelerations between two set-points of a path have it


class PathTime:
    """Time and rate on a path from a tick on: the rate goes to a wanted one and stays there.

    Attributes:
        tick: its first position tick.
        wanted: the rate that it goes to, in [0, 1].
    """

    def __init__(
        self, spline: Spline, limit: Array, period: float, *, tick: int, time: float, rate: float, wanted: float
    ) -> None:
        """Go on from a time, s, and a rate.

        Args:
            spline: the path; its set-points at full speed keep to the accelerations.
            limit: accelerations of the joints, rad/s^2, shape (6,).
            period: of the position loop, s.
            tick: first position tick.
            time: on the path, s.
            rate: of that time.
            wanted: the rate to go to.
        """
        self.tick, self.wanted = tick, wanted
        self._spline, self._limit, self._period = spline, limit, period
        self._series = np.array([[time], [rate]])  # at its ticks
        self._settled = rate == wanted

    def at(self, ticks: Array) -> tuple[Array, Array, Array]:
        """Return times on the path, s, rates, and their changes, 1/s, at ticks, whole or not, shape (n,) each."""
        since = ticks - self.tick
        self._extend(int(since.max(initial=0.0)) + 2)
        times, rates = self._series
        last = times.size - 1
        row = np.clip(since.astype(np.int64), 0, last)
        ahead = (since - row) * self._period
        change = (rates[np.minimum(row + 1, last)] - rates[row]) / self._period
        return times[row] + ahead * (rates[row] + 0.5 * ahead * change), rates[row] + ahead * change, change

    def point(self, tick: int) -> tuple[float, float]:
        """Return time, s, and rate at a tick, as `at`, in a fraction of its time."""
        since = tick - self.tick
        self._extend(since + 1)
        row = min(since, self._series.shape[1] - 1)
        time, rate = self._series[:, row].tolist()
        return time + (since - row) * self._period * rate, rate

    def settles(self, within: int) -> int | None:
        """Return after how many ticks the wanted rate, or the end of the path, is reached; None if they are more."""
        self._extend(within + 2)
        last = self._series.shape[1] - 1
        return last if self._settled and last <= within else None

    def _extend(self, count: int) -> None:
        """Compute `count` ticks, or as many as there are until the wanted rate is reached."""
        while not self._settled and self._series.shape[1] < count:
            # As many as there are: so that what is copied does not grow with the square of a long change.
            block = max(_BLOCK, self._series.shape[1])
            series = np.empty((2, block + 1))
            series[:, 0] = self._series[:, -1]
            path = self._spline
            done = _advance(path.times, path.coefficients, path.final, self._limit, self._period, self.wanted, series)
            self._settled = done < block
            self._series = np.concatenate([self._series, series[:, 1 : done + 1]], axis=1)


@kernel
def _advance(
    knots: Array, coefficients: Array, final: Array, limit: Array, period: float, wanted: float, series: Array
) -> int:
    """Fill times and rates, shape (2, n), from their first entries on; return how many ticks the rate changes for."""
    here, there = np.empty((1, 3, 6)), np.empty((1, 3, 6))
    at = np.empty(1)
    count: int = series.shape[1] - 1
    for k in range(count):
        time, rate = series[0, k], series[1, k]
        if rate == wanted or time >= knots[-1]:
            return k
        at[0] = time
        sample_spline(knots, coefficients, final, at, here)
        bound = _bound(here[0], rate, wanted, limit, period)
        # The rate may always stay; how far it may change is searched for between that and the bound.
        kept, beyond, tried = rate, bound, bound
        for _ in range(_HALVINGS):
            at[0] = time + 0.5 * period * (rate + tried)
            sample_spline(knots, coefficients, final, at, there)
            if _follows(here[0], rate, there[0], tried, limit, period):
                kept = tried
                if tried == bound:
                    break
            else:
                beyond = tried
            tried = 0.5 * (kept + beyond)
        series[0, k + 1], series[1, k + 1] = time + 0.5 * period * (rate + kept), kept
    return count


@inlined
def _bound(here: Array, rate: float, wanted: float, limit: Array, period: float) -> float:
    """Return how far the rate may go towards the wanted one by the accelerations q'' r^2 + q' dr/dt at its begin."""
    change = (wanted - rate) / period
    for j in range(6):
        slope, bend = here[1, j], here[2, j] * rate * rate
        asked = slope * change
        room = max(limit[j] - bend if asked > 0.0 else limit[j] + bend, 0.0)
        if abs(asked) > room:
            change *= room / abs(asked)
    if change == (wanted - rate) / period:
        return wanted
    return rate + change * period


@inlined
def _follows(before: Array, rate: float, after: Array, then: float, limit: Array, period: float) -> bool:
    """Return whether velocities q' r change by no more than the limits, and the tick ends within the accelerations.

    Without the second one the path's own acceleration could grow within the tick to what the change leaves no room for.
    """
    follows, change = True, (then - rate) / period
    for j in range(6):
        step = after[1, j] * then - before[1, j] * rate
        end = after[2, j] * then * then + after[1, j] * change
        follows = follows and abs(step) <= limit[j] * period and abs(end) <= limit[j] * (1.0 + _SLACK)
    return follows
