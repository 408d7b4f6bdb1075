"""How well a model predicts what it was not fitted to: blocks of time, and whole runs.

A block is long against the autocorrelation of the residuals, and what is near it is left out with it. The model without
a block is a Gauss-Newton step away from that of all rows, so that no fit is repeated.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from scipy.linalg.lapack import dpotrf, dpotrs

from rx90_common.base.arrays import Array, Index
from rx90_common.friction.held_out import HeldOutErrors
from rx90_emulator.identification.excitation.fit import SeparableFit, WeightedProblem
from rx90_emulator.identification.excitation.problem import ExcitationProblem

_CORRELATION_TIMES = 4.0  # in a block
_MIN_BLOCKS, _MAX_BLOCKS = 8, 60  # blocks of all runs
_MAX_LAG_SHARE = 0.2  # of a run
_CUTOFF = 1e-10  # relative: directions that the remaining rows do not determine stay where they are

Folds = list[tuple[Index, Index]]
"""Groups of rows to predict, each with the rows that the model does not see then: its own, and their neighbours."""


def left_out(residual: Array, tangent: Array, folds: Folds) -> Array:
    """Return the weighted residuals of each group of rows by the model fitted without it, shape (r,).

    The model without a group is one Gauss-Newton step away from that of all rows; for a model without non-linear
    parameters that is exact.

    Args:
        residual: of all rows, shape (r,), and
        tangent: shape (r, k), as `WeightedProblem.linearised` returns them.
        folds: the groups.
    """
    whole, gradient = tangent.T @ tangent, tangent.T @ residual
    result = np.empty_like(residual)
    for rows, near in folds:
        gram, right = whole - tangent[near].T @ tangent[near], gradient - tangent[near].T @ residual[near]
        # A Cholesky factor takes a hundredth of the time of singular values, which are left for what it cannot tell.
        factor, failed = dpotrf(gram, lower=1)
        if failed or np.diag(factor).min() ** 2 < _CUTOFF:
            step = np.linalg.lstsq(gram, right, rcond=_CUTOFF)[0]
        else:
            step = dpotrs(factor, right, lower=1)[0]
        result[rows] = residual[rows] - tangent[rows] @ step
    return result


@dataclass(frozen=True, eq=False)
class TimeBlocks:
    """The rows in blocks of time of about equal length; all joints of a time, and its repetitions, are in one block.

    Attributes:
        length: of a block, s.
        correlation_time: time in which the autocorrelation of the residuals fades, s.
        reason: how the length was chosen, in words.
        block: number of each row's block, shape (r,).
        folds: each block's rows, and those with its neighbours within a correlation time on both sides.
    """

    length: float
    correlation_time: float
    reason: str
    block: Index
    folds: Folds

    @property
    def count(self) -> int:
        """Return how many blocks there are."""
        return len(self.folds)

    @classmethod
    def of(cls, problem: ExcitationProblem, residual: Array) -> TimeBlocks:
        """Choose the blocks from the residuals of a model, shape (r,).

        A block is long against the autocorrelation of the residuals, so that the errors of blocks are independent; and
        what lies within a correlation time of it is left out with it, so that its neighbours do not tell of it (Burman,
        Chow and Nolan 1994: h-block cross-validation). A time that is repeated, in another period or run, brings back
        the same misfit: it is in the block, too.
        """
        correlation = _correlation_time(problem, residual)
        motion = np.unique(problem.motion, return_inverse=True)[1].ravel()
        time = problem.phase * np.array([run.down / run.rate for run in problem.runs])[problem.run]
        durations = np.array([max(rows.max(), 1e-9) for rows in _grouped(time, motion)])  # of one instant: 0
        whole = float(durations.sum())
        wanted = _CORRELATION_TIMES * correlation
        length = min(max(wanted, whole / _MAX_BLOCKS), whole / _MIN_BLOCKS)
        reason = f"{_CORRELATION_TIMES:g} correlation times of the residuals, {correlation:.3g} s"
        if length > wanted:
            reason = f"a {_MAX_BLOCKS}th of the motions, more than {reason}"
        elif length < wanted:
            reason = f"an {_MIN_BLOCKS}th of the motions, less than {reason}: the motions are short"
        counts = np.maximum(1, np.round(durations / length)).astype(np.intp)
        place = (time / durations[motion] * counts[motion]).astype(np.intp)
        first = np.cumsum(counts) - counts
        block = np.unique(first[motion] + np.minimum(place, counts[motion] - 1), return_inverse=True)[1].ravel()
        folds = []
        for rows in _grouped(np.arange(len(block)), block):
            near = (time > time[rows].min() - correlation) & (time < time[rows].max() + correlation)
            folds.append((rows, np.flatnonzero(near & (motion == motion[rows[0]]))))
        return cls(whole / float(counts.sum()), correlation, reason, block, folds)


def _grouped(values: Array | Index, number: Index) -> list[Index]:
    """Return the values of each group of rows, by the numbers of the groups, both of shape (r,)."""
    return [values[number == k] for k in range(int(number.max()) + 1)]


def _correlation_time(problem: ExcitationProblem, residual: Array) -> float:
    """Return the integrated autocorrelation time of the residuals, s, of the joint where it is longest.

    It is summed up to the first lag at which the autocorrelation is not positive.
    """
    times = [0.0]
    lags = max(int(_MAX_LAG_SHARE * len(run.rows)) for run in problem.runs)
    period = problem.runs[-1].down / problem.runs[-1].rate
    for joint in range(int(problem.joint.max()) + 1):
        products = np.zeros(lags)  # of residuals so many samples apart, summed over the runs
        for number, run in enumerate(problem.runs):
            rows = (problem.run == number) & (problem.joint == joint)
            series = np.zeros(len(run.rows))
            series[problem.place[rows]] = residual[rows]
            size = 2 * len(series)
            lagged = np.fft.irfft(np.abs(np.fft.rfft(series, size)) ** 2, size)[: int(_MAX_LAG_SHARE * len(series))]
            products[: len(lagged)] += lagged
        if lags and products[0] > 0.0:
            fading = products / products[0]
            end = int(np.argmax(fading <= 0.0)) if (fading <= 0.0).any() else lags
            times.append(period * (2.0 * float(fading[:end].sum()) - 1.0))
    return max(times)


class CrossValidation(NamedTuple):
    """How well a model predicts what it was not fitted to.

    Attributes:
        error: weighted RMS of the residuals of what was left out, in noise deviations of the joints.
        relative: RMS of these residuals over the RMS torque, all joints together.
        gain: by how much `error` is less than that of the model it is compared with; 0 for the first model.
        gain_deviation: standard error of `gain`, from paired differences over the blocks.
    """

    error: float
    relative: float
    gain: float
    gain_deviation: float


@dataclass(frozen=True, eq=False)
class Scored:
    """A model with its errors on what was left out.

    Attributes:
        fit: to all rows.
        residual: of all rows, Nm, shape (r,).
        left: by "blocks", and by "runs" where there are several: squared weighted residuals of what was left out,
            summed in each block, shape (b,), and their RMS over the RMS torque.
        rows: in each block, shape (b,).
    """

    fit: SeparableFit
    residual: Array
    left: dict[str, tuple[Array, float]]
    rows: Array

    @classmethod
    def of(cls, weighted: WeightedProblem, fit: SeparableFit, time: TimeBlocks) -> Scored:
        """Score a fit."""
        residual, tangent = weighted.linearised(fit)
        problem, folds = weighted.problem, {"blocks": time.folds}
        if len(problem.runs) > 1:
            folds["runs"] = [(rows, rows) for rows in _grouped(np.arange(len(problem)), problem.run)]
        left = {}
        for kind, groups in folds.items():
            errors = left_out(residual, tangent, groups)
            relative = np.linalg.norm(errors / weighted.weight) / np.linalg.norm(problem.torque)
            left[kind] = (np.bincount(time.block, errors**2).astype(np.float64), float(relative))
        return cls(fit, residual / weighted.weight, left, np.bincount(time.block).astype(np.float64))

    def validations(self, against: Scored | None = None) -> dict[str, CrossValidation]:
        """Return the figures by "blocks", and by "runs" where both have them, with the gain over another model."""
        other, found = self if against is None else against, {}
        for kind, (own, relative) in self.left.items():
            if kind in other.left:
                errors = HeldOutErrors({"own": own, "other": other.left[kind][0]}, self.rows)
                found[kind] = CrossValidation(errors.rms("own")[0], relative, *errors.gain("own", "other"))
        return found

    def better_than(self, other: Scored) -> bool:
        """Return whether this model predicts better: by blocks, and by runs where there are several.

        By blocks the gain must exceed the standard error of the paired differences. One standard error, not two: a part
        that is there and left out biases all others, a part too much widens their deviations. By runs the loss, if
        there is one, must lie within that error: few runs say less than many blocks.
        """
        figures = self.validations(other)
        blocks, runs = figures["blocks"], figures.get("runs")
        return blocks.gain > blocks.gain_deviation and (runs is None or runs.gain > -runs.gain_deviation)

    def verdict(self, against: Scored) -> str:
        """Return by how much the model predicts better than another one, in words."""
        texts = []
        for kind, one in self.validations(against).items():
            share, deviation = (100.0 * size / (one.error + one.gain) for size in (one.gain, one.gain_deviation))
            way = f"{'rises' if share < 0.0 else 'falls'} by {abs(share):.2f} %"
            texts.append(f"by {kind} the error {way} with a standard error of {deviation:.2f} %")
        return "; ".join(texts)
