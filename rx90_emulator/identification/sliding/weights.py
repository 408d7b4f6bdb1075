"""How much each equation of the sliding fit counts: noise, what a plateau has in common, outliers."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array, diags_array, eye_array

from rx90_emulator.identification.sliding.rows import SlidingRows

Array = NDArray[np.float64]

_HUBER = 3.0  # deviations from which a residual counts linearly
_SAME_SPEED = 0.1  # of the logarithms of speeds that count as one
_LEAST_LEFT = 0.05  # of a plateau's variance, however much the fit follows it


@dataclass(frozen=True, eq=False)
class Weights:
    """What turns the equations into ones of unit noise.

    Besides noise from block to block, a plateau as a whole may be off (ripple, temperature, an arm that is not
    quite rigid). With variances s^2 of a block and t^2 of a plateau of m blocks, the equations less the share
    1 - s / sqrt(s^2 + m t^2) of their plateau's mean, over s, have unit noise (random effects). In the equations as
    they are scaled, t^2 grows with the samples in a block.

    Attributes:
        cluster: number of plateau and group of each row, shape (r,).
        share: of its mean that each cluster loses, shape (c,).
        factor: of each row, shape (r,).
    """

    cluster: NDArray[np.int64]
    share: Array
    factor: Array

    @classmethod
    def equal(cls, rows: SlidingRows) -> Weights:
        """Return the weights of rows that have unit noise already."""
        cluster = rows.clusters()
        return cls(cluster, np.zeros(cluster.max() + 1), np.ones(len(rows)))

    @classmethod
    def of(cls, rows: SlidingRows, residual: Array, leverage: Array) -> Weights:
        """Return the weights that the residuals of a fit call for.

        Args:
            rows: the equations.
            residual: shape (r,).
            leverage: share of each cluster's mean that the fit follows, shape (c,).
        """
        cluster = rows.clusters()
        count = np.bincount(cluster)
        mean = np.bincount(cluster, residual) / count
        # What a plateau has in common is a torque, and the equations of long blocks are scaled up.
        power = np.bincount(cluster, rows.scale**2)
        inner = residual - mean[cluster]
        # A block's distance from the mean of its plateau is a little less than from the truth; a plateau of one block
        # shows none, and says nothing of what blocks differ by.
        several = count[cluster] > 1
        apart = inner / np.sqrt(1.0 - 1.0 / np.where(several, count[cluster], np.inf))
        group = rows.group[np.unique(cluster, return_index=True)[1]]
        share, factor = np.zeros(len(count)), np.ones(len(rows))
        for g in np.unique(group):
            inside, mine = rows.group == g, group == g
            known = apart[inside & several]
            # Without such plateaus the samples alone say what noise a block has, by which the equations are scaled.
            noise = max(_spread(known), 1e-9) if len(known) else 1.0
            # The mean square of what the fit has left of the means is (1 - leverage) (s^2 / m + t^2).
            left = np.maximum(_LEAST_LEFT, 1.0 - leverage[mine])
            excess = np.sum(count[mine] * mean[mine] ** 2) - noise**2 * np.sum(left)
            common = max(0.0, float(excess / np.sum(power[mine] * left)))
            share[mine] = 1.0 - noise / np.sqrt(noise**2 + power[mine] * common)
            size = np.abs(inner[inside]) / noise
            factor[inside] = np.sqrt(np.minimum(1.0, _HUBER / np.maximum(size, 1e-12))) / noise
        return cls(cluster, share, factor)

    def means(self, values: Array | csr_array) -> Array:
        """Return the clusters' means of columns, scaled to unit noise, shape (c, k)."""
        rows = len(self.cluster)
        count = np.bincount(self.cluster)
        members = csr_array((self.factor, (self.cluster, np.arange(rows))), shape=(len(count), rows))
        return np.asarray(((1.0 - self.share) / np.sqrt(count))[:, None] * (members @ values))

    def operator(self) -> csr_array:
        """Return the matrix that turns the equations into ones of unit noise, shape (r, r)."""
        rows = len(self.cluster)
        count = np.bincount(self.cluster)
        members = csr_array((np.ones(rows), (self.cluster, np.arange(rows))), shape=(len(count), rows))
        less = eye_array(rows) - members.T @ diags_array(self.share / count) @ members
        return csr_array(diags_array(self.factor) @ less)


def speed_design_effect(rows: SlidingRows, weights: Weights, residual: Array) -> Array:
    """Return by how much the errors of plateaus at one speed, whatever pose and direction, add to the variance.

    Ripple depends on the speed and turns its sign with it, so plateaus at one speed do not err apart. The variance of
    a sum of m of them is that of independent ones times sum((sum s)^2) / sum(s^2), with the residuals s along the
    motion; the outer sums go over the speeds (Kish's design effect).

    Args:
        rows: the equations.
        weights: of the fit.
        residual: of the fit, shape (r,).

    Returns:
        The factor for each row's joint, 1 or more, shape (r,).
    """
    first = np.unique(weights.cluster, return_index=True)[1]
    group, source = rows.group[first], rows.source[first]
    velocity = rows.velocity[first, group]
    along = np.sign(velocity) * weights.means(residual[:, None])[:, 0]
    with np.errstate(divide="ignore"):
        level = np.round(np.log(np.abs(velocity)) / _SAME_SPEED)
    factor = np.ones(len(rows))
    for g in np.unique(group):
        mine = np.flatnonzero((group == g) & (velocity != 0.0))
        number = np.unique(np.column_stack([source[mine], level[mine]]), axis=0, return_inverse=True)[1].ravel()
        power = float(np.sum(along[mine] ** 2))
        if power > 0.0:
            together = float(np.sum(np.bincount(number, along[mine]) ** 2))
            factor[rows.group == g] = max(1.0, together / power)
    return factor


def _spread(values: Array) -> float:
    """Return the standard deviation about 0, blind to a few outliers."""
    robust = 1.4826 * float(np.median(np.abs(values)))
    good = np.abs(values) <= _HUBER * robust
    # Of a normal distribution cut at 3 deviations 0.9867 of the deviation is left.
    return float(np.sqrt(np.mean(values[good] ** 2))) / 0.9867 if robust > 0.0 else 0.0
