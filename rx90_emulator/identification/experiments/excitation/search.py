"""The search for the motion of one run: random Fourier series, the best of them improved step by step (L-BFGS).

What exceeds a limit costs its square; the motion that comes out is then shrunk until it keeps all of them. Derivatives
by the coefficients go through those by position, velocity and acceleration at the samples, so that a step costs the
same for any number of harmonics.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial

import numpy as np
from scipy.optimize import minimize

from rx90_common.base.arrays import Array
from rx90_common.base.errors import IdentificationError
from rx90_emulator.identification.experiments.excitation.information import (
    ROWS,
    ExcitationColumns,
    InformationSlope,
    criterion,
)
from rx90_emulator.identification.experiments.excitation.limits import MotionLimits
from rx90_emulator.identification.experiments.excitation.options import Criterion
from rx90_emulator.identification.experiments.excitation.series import FourierSeries, SeriesBasis

_STARTS = 12  # random motions, the best of which is improved
_PER_HARMONIC = 16  # samples in a period of the fastest sine: a peak between two is missed by 2 %
_COSTS = (1.0, 50.0)  # of exceeding a limit by its whole size at one sample: at first walls are soft
_LINE = 50  # evaluations of a step at most: a step into a wall costs thousands
_SPREAD = 0.3  # of a joint's range, in which the middles of random motions lie around home
_FINE = 0.01  # s between samples at which a motion is held against the limits
_RAMP = np.linspace(0.0, 1.0, 12)  # of the way from home to the begin of the series, in the search
_FINE_RAMP = np.linspace(0.0, 1.0, 201)
_SHRINK, _HALVINGS, _SMALLEST = 0.85, 5, 0.02


@dataclass(frozen=True, eq=False)
class RunSearch:
    """The search for a run.

    Attributes:
        columns: whose parameters the run is to tell.
        limits: that it keeps.
        home: where the arm comes from, on a straight line of the joints, rad, shape (n,).
        kind: what is optimised.
        basis: of the motions, at the samples of the search.
        duration: of the run, s.
        before: information of the runs before it, shape (p, p).
    """

    columns: ExcitationColumns
    limits: MotionLimits
    home: Array
    kind: Criterion
    basis: SeriesBasis
    duration: float
    before: Array

    @staticmethod
    def samples(harmonics: int, period: float) -> SeriesBasis:
        """Return the motions at the samples of a search."""
        count = _PER_HARMONIC * harmonics
        return SeriesBasis(harmonics, period, np.linspace(0.0, period, count, endpoint=False))

    def best(self, rng: np.random.Generator, steps: int, step: Callable[[], None]) -> FourierSeries:
        """Return the best motion that was found.

        Args:
            rng: of the random motions.
            steps: of the search, at most.
            step: called after each.

        Raises:
            IdentificationError: if it cannot be made small enough for the limits.
        """
        first = min(random_starts(self, rng), key=lambda x: self.cost(x)[0])

        def progress(xk: Array) -> None:  # noqa: ARG001 - SciPy's name for it
            step()

        for cost in _COSTS:
            found = minimize(
                partial(self.cost, limit=cost),
                first,
                jac=True,
                method="L-BFGS-B",
                callback=progress,
                options={"maxiter": max(1, steps // len(_COSTS)), "maxls": _LINE},
            )
            first = found.x
        return self.within(self._series(first))

    def random(self, rng: np.random.Generator) -> FourierSeries:
        """Return a random motion that keeps ranges, speeds and accelerations, but for those of coupled motors."""
        n, limits = len(self.home), self.limits
        coefficients = rng.normal(size=(n, self.basis.count))
        coefficients[:, 0] = 0.0
        motion = self.basis.motion(coefficients)
        shares = limits.shares(motion, np.zeros_like(motion[0]))
        low, high = limits.middle - limits.reach, limits.middle + limits.reach
        middle = self.home + rng.uniform(-_SPREAD, _SPREAD, n) * limits.reach
        middle = np.clip(middle, low + 0.2 * limits.reach, high - 0.2 * limits.reach)
        room = np.minimum(middle - low, high - middle)
        size = np.stack([
            room / np.abs(motion[0]).max(axis=0),
            *(1.0 / np.abs(shares[name]).max(axis=0) for name in ("speed", "acceleration")),
        ]).min(axis=0)  # fmt: skip
        coefficients *= size[:, None]
        coefficients[:, 0] = middle
        return self._series(coefficients)

    def cost(self, x: Array, limit: float = _COSTS[-1]) -> tuple[float, Array]:
        """Return what is minimised and its derivative by the coefficients, shape (n c,).

        Args:
            x: coefficients, shape (n c,).
            limit: cost of exceeding a limit by its whole size at one sample.
        """
        coefficients = x.reshape(len(self.home), self.basis.count)
        motion = self.basis.motion(coefficients)
        slope = InformationSlope.of(self.columns, motion)
        rows, factor = slope.rows, ROWS * self.duration / len(motion[0])
        flat = rows.reshape(-1, rows.shape[2])
        value, by_information = criterion(self.kind, self.before + factor * (flat.T @ flat))
        parameters = self.columns.standard.values()
        penalty, over = self.limits.penalty(motion, slope.standard @ parameters)
        by_motion = slope.by_motion(2.0 * factor * rows @ by_information, limit * over.torque, parameters)
        gradient = self.basis.gradient(
            by_motion[0] + limit * over.position,
            by_motion[1] + limit * over.velocity,
            by_motion[2] + limit * over.acceleration,
        )
        near, by_start = self._ramp(coefficients)
        gradient += limit * by_start
        return value + limit * (penalty + near), gradient.ravel()

    def within(self, series: FourierSeries) -> FourierSeries:
        """Return the motion, shrunk until it keeps all limits between the samples, too.

        Raises:
            IdentificationError: if it does not even where it is small.
        """
        fine = self.basis.at(np.arange(0.0, series.period, _FINE))
        return self.shrunk(series, fine, _FINE_RAMP)

    def shrunk(self, series: FourierSeries, basis: SeriesBasis, way: Array) -> FourierSeries:
        """Return the motion, shrunk until it keeps the limits at a basis' samples and on parts of the way to it."""
        if self._keeps(series, basis, way):
            return series
        low, high = 1.0, 1.0
        while not self._keeps(series.shrunk(low), basis, way):
            low, high = _SHRINK * low, low
            if low < _SMALLEST:
                motion = basis.motion(series.shrunk(low).coefficients)
                worst = self.limits.worst(motion, self.columns.arm.torque(*motion))
                raise IdentificationError(
                    f"no motion was found that keeps the limits; even of a small one {worst}; accepted: walls farther "
                    "away, less --clearance, more --share, another --seed"
                )
        for _ in range(_HALVINGS):
            middle = 0.5 * (low + high)
            low, high = (middle, high) if self._keeps(series.shrunk(middle), basis, way) else (low, middle)
        return series.shrunk(low)

    def _keeps(self, series: FourierSeries, basis: SeriesBasis, way: Array) -> bool:
        motion = basis.motion(series.coefficients)
        start = series.at(np.zeros(1))[0][0]
        ramp = self.home + way[:, None] * (start - self.home)
        return self.limits.clear(ramp) and self.limits.kept(motion, self.columns.arm.torque(*motion))

    def _series(self, x: Array) -> FourierSeries:
        shape = len(self.home), self.basis.count
        return FourierSeries(self.basis.harmonics, self.basis.period, np.array(x).reshape(shape))

    def _ramp(self, coefficients: Array) -> tuple[float, Array]:
        """Return what the way from home to the begin costs, and its derivative by the coefficients, shape (n, c)."""
        begin = self.basis.at(np.zeros(1)).matrices[0][0]
        way = self.home + _RAMP[:, None] * (coefficients @ begin - self.home)
        value, slope = self.limits.nearness(way)
        return value, np.outer(_RAMP @ slope, begin)


def random_starts(search: RunSearch, rng: np.random.Generator) -> list[Array]:
    """Return the coefficients, shape (n c,), of the random motions that can be made small enough, one or more.

    Raises:
        IdentificationError: if none can.
    """
    starts, refusal = [], None
    for _ in range(_STARTS):
        try:
            starts.append(search.shrunk(search.random(rng), search.basis, _RAMP).coefficients.ravel())
        except IdentificationError as error:
            refusal = error
    if refusal is not None and not starts:
        raise refusal
    return starts
