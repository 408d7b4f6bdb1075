"""How well a model predicts blocks of time, or whole runs, that it was not fitted to."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.linalg.lapack import dpotrf, dpotrs

from rx90_common.base.arrays import Array
from rx90_common.friction.held_out import HeldOutErrors
from rx90_emulator.identification.excitation.friction.fit import SeparableFit, WeightedProblem
from rx90_emulator.identification.excitation.friction.law import LINEAR
from rx90_emulator.identification.excitation.problem import ExcitationProblem


@dataclass(frozen=True)
class CrossValidation:
    """How well a model predicts what it was not fitted to.

    Attributes:
        error: weighted RMS of the residuals of what was left out, in noise deviations of the joints.
        deviation: standard error of `error`, from its scatter over the blocks.
        relative: RMS of these residuals over the RMS torque, all joints together.
        gain: by how much `error` is less than that of the model it is compared with; 0 for the first model.
        gain_deviation: standard error of `gain`, from paired differences over the blocks.
    """

    error: float
    deviation: float
    relative: float
    gain: float = 0.0
    gain_deviation: float = 0.0


@dataclass(frozen=True)
class BlockDivision:
    """The blocks of time of the cross-validation.

    Attributes:
        length: of a block, s.
        count: of blocks.
        correlation_time: time in which the autocorrelation of the residuals fades, s.
        reason: how the length was chosen, in words.
    """

    length: float
    count: int
    correlation_time: float
    reason: str


_CORRELATION_TIMES = 4.0  # in a block
_MIN_BLOCKS, _MAX_BLOCKS = 8, 60  # blocks of all runs
_MAX_LAG_SHARE = 0.2  # of a run
_CUTOFF = 1e-10  # relative: directions that the remaining rows do not determine stay where they are


Rows = NDArray[np.intp]
Folds = list[tuple[Rows, Rows]]
"""Groups of rows to predict, each with the rows that the model does not see then: its own, and their neighbours."""


@dataclass(frozen=True, eq=False)
class Linearised:
    """A fitted model and its tangent.

    Attributes:
        residual: weighted, shape (r,).
        tangent: weighted derivatives of the torques by everything that is fitted and not at a bound, columns of length
            1: the basis of the regressor, then friction, shape (r, k).
    """

    residual: Array
    tangent: Array

    @classmethod
    def of(cls, weighted: WeightedProblem, fit: SeparableFit) -> Linearised:
        """Return the model around a fit."""
        columns = [weighted.column(fit.shapes, fit.linear, e, name) for e, name in fit.inner()]
        linear = [fit.linear[e, LINEAR.index(name)] if name in LINEAR else 0.0 for e, name in fit.inner()]
        friction = np.stack(columns, axis=1) if columns else np.empty((len(weighted.rest), 0))
        without = weighted.problem.torque * weighted.weight - friction @ np.array(linear)
        residual = without - weighted.basis @ (weighted.basis.T @ without)
        size = np.linalg.norm(friction, axis=0)
        return cls(residual, np.hstack([weighted.basis, friction / np.where(size > 0.0, size, 1.0)]))

    def left_out(self, folds: Folds) -> Array:
        """Return the weighted residuals of each group of rows by the model fitted without it, shape (r,).

        The model without a group is one Gauss-Newton step away from that of all rows; for a model without non-linear
        parameters that is exact.
        """
        whole = self.tangent.T @ self.tangent
        gradient = self.tangent.T @ self.residual
        result = np.empty_like(self.residual)
        for rows, near in folds:
            own, rest = self.tangent[near], self.residual[near]
            step = _solved(whole - own.T @ own, gradient - own.T @ rest)
            result[rows] = self.residual[rows] - self.tangent[rows] @ step
        return result


def _solved(gram: Array, right: Array) -> Array:
    """Return the solution of normal equations whose columns had length 1, the shortest where they do not determine it.

    A Cholesky factor takes a hundredth of the time of singular values, which are left for what it cannot tell.
    """
    factor, failed = dpotrf(gram, lower=1)
    if failed or np.diag(factor).min() ** 2 < _CUTOFF:
        return np.asarray(np.linalg.lstsq(gram, right, rcond=_CUTOFF)[0])
    return np.asarray(dpotrs(factor, right, lower=1)[0])


@dataclass(frozen=True, eq=False)
class Scored:
    """A model with its errors on what was left out.

    Attributes:
        fit: to all rows.
        residual: of all rows, Nm, shape (r,).
        error: weighted RMS of the residuals.
        by_blocks: squared weighted residuals left out by blocks, summed in each block, shape (b,).
        by_runs: those left out by runs, summed in each block; None where there is one run.
        relative: RMS of what was left out over the RMS torque, by blocks and by runs.
        rows: in each block, shape (b,).
    """

    fit: SeparableFit
    residual: Array
    error: float
    by_blocks: Array
    by_runs: Array | None
    relative: tuple[float, float]
    rows: Array

    @classmethod
    def of(cls, weighted: WeightedProblem, fit: SeparableFit, time: TimeBlocks) -> Scored:
        """Score a fit."""
        around, problem = Linearised.of(weighted, fit), weighted.problem

        def scored(folds: Folds) -> tuple[Array, float]:
            left = around.left_out(folds)
            sums = np.bincount(time.block, left**2).astype(np.float64)
            return sums, _relative(problem, left / weighted.weight)

        by_blocks, relative = scored(time.folds)
        by_runs, of_runs = None, relative
        if len(problem.runs) > 1:
            by_runs, of_runs = scored([(rows, rows) for rows in _members(problem.run)])
        return cls(
            fit=fit,
            residual=around.residual / weighted.weight,
            error=float(np.sqrt(np.mean(around.residual**2))),
            by_blocks=by_blocks,
            by_runs=by_runs,
            relative=(relative, of_runs),
            rows=np.bincount(time.block).astype(np.float64),
        )

    def validations(self, against: Scored | None = None) -> tuple[CrossValidation, CrossValidation | None]:
        """Return the figures by blocks and by runs, with the gain over another model."""
        other = self if against is None else against

        def figures(own: Array, its: Array, relative: float) -> CrossValidation:
            errors = HeldOutErrors({"own": own, "other": its}, self.rows)
            return CrossValidation(*errors.rms("own"), relative, *errors.gain("own", "other"))

        blocks = figures(self.by_blocks, other.by_blocks, self.relative[0])
        if self.by_runs is None or other.by_runs is None:
            return blocks, None
        return blocks, figures(self.by_runs, other.by_runs, self.relative[1])

    def better_than(self, other: Scored) -> bool:
        """Return whether this model predicts better: by blocks, and by runs where there are several.

        By blocks the gain must exceed the standard error of the paired differences. One standard error, not two: a part
        that is there and left out biases all others, a part too much widens their deviations. By runs the loss, if
        there is one, must lie within that error: few runs say less than many blocks.
        """
        blocks, runs = self.validations(other)
        return blocks.gain > blocks.gain_deviation and (runs is None or runs.gain > -runs.gain_deviation)


def _relative(problem: ExcitationProblem, residual: Array) -> float:
    return float(np.linalg.norm(residual) / np.linalg.norm(problem.torque))


@dataclass(frozen=True, eq=False)
class TimeBlocks:
    """The rows in blocks of time of about equal length; all joints of a time, and its repetitions, are in one block.

    Attributes:
        blocks: what they are.
        block: number of each row's block, shape (r,).
        folds: each block's rows, and those with its neighbours within a correlation time on both sides.
    """

    blocks: BlockDivision
    block: Rows
    folds: Folds

    @classmethod
    def of(cls, problem: ExcitationProblem, residual: Array) -> TimeBlocks:
        """Choose the blocks from the residuals of a model, shape (r,).

        A block is long against the autocorrelation of the residuals, so that the errors of blocks are independent; and
        what lies within a correlation time of it is left out with it, so that its neighbours do not tell of it (Burman,
        Chow and Nolan 1994: h-block cross-validation). A time that is repeated, in another period or run, brings back
        the same misfit: it is in the block, too.
        """
        correlation = _correlation_time(problem, residual)
        motion, time = _phase_times(problem)
        durations = np.array([time[motion == k].max() for k in range(int(motion.max()) + 1)])
        whole = float(durations.sum())
        length, reason = _block_length(correlation, whole)
        counts = np.maximum(1, np.round(durations / length)).astype(np.intp)
        place = (time / durations[motion] * counts[motion]).astype(np.intp)
        first = np.cumsum(counts) - counts
        block = np.unique(first[motion] + np.minimum(place, counts[motion] - 1), return_inverse=True)[1].ravel()
        folds = []
        for rows in _members(block):
            near = (time > time[rows].min() - correlation) & (time < time[rows].max() + correlation)
            folds.append((rows, np.flatnonzero(near & (motion == motion[rows[0]]))))
        return cls(BlockDivision(whole / float(counts.sum()), len(folds), correlation, reason), block, folds)


def _block_length(correlation: float, whole: float) -> tuple[float, str]:
    """Return how long blocks are to be, s, and why, for a correlation time and motions of so many seconds in all."""
    wanted = _CORRELATION_TIMES * correlation
    length = min(max(wanted, whole / _MAX_BLOCKS), whole / _MIN_BLOCKS)
    reason = f"{_CORRELATION_TIMES:g} correlation times of the residuals, {correlation:.3g} s"
    if length > wanted:
        return length, f"a {_MAX_BLOCKS}th of the motions, more than {reason}"
    if length < wanted:
        return length, f"an {_MIN_BLOCKS}th of the motions, less than {reason}: the motions are short"
    return length, reason


def _phase_times(problem: ExcitationProblem) -> tuple[Rows, Array]:
    """Return the motion of each row and the time in it, s: equal in repetitions, each of shape (r,)."""
    motion = np.empty(len(problem.torque), dtype=np.intp)
    time = np.empty(len(motion))
    for number, (run, (one, phase)) in enumerate(zip(problem.runs, problem.phases, strict=True)):
        rows = problem.run == number
        motion[rows], time[rows] = one, phase[problem.place[rows]] * (run.down / run.rate)
    return np.unique(motion, return_inverse=True)[1].ravel(), time


def _members(number: Rows) -> list[Rows]:
    """Return the rows of each group, by the numbers of the groups, shape (r,)."""
    return [np.flatnonzero(number == k) for k in range(int(number.max()) + 1)]


def _correlation_time(problem: ExcitationProblem, residual: Array) -> float:
    """Return the integrated autocorrelation time of the residuals, s, of the joint where it is longest.

    It is summed up to the first lag at which the autocorrelation is not positive.
    """
    times = [0.0]
    lags = max(int(_MAX_LAG_SHARE * len(run.rows)) for run in problem.runs)
    for joint in range(int(problem.joint.max()) + 1):
        products = np.zeros(lags)  # of residuals so many samples apart, summed over the runs
        period = 0.0
        for number, run in enumerate(problem.runs):
            rows = (problem.run == number) & (problem.joint == joint)
            period = run.down / run.rate
            series = np.zeros(len(run.rows))
            series[problem.place[rows]] = residual[rows]
            size = 2 * len(series)
            lagged = np.fft.irfft(np.abs(np.fft.rfft(series, size)) ** 2, size)[: int(_MAX_LAG_SHARE * len(series))]
            products[: len(lagged)] += lagged
        if lags and products[0] > 0.0:
            fading = products / products[0]
            end = int(np.argmax(fading <= 0.0)) if (fading <= 0.0).any() else len(fading)
            times.append(period * (2.0 * float(fading[:end].sum()) - 1.0))
    return max(times)
