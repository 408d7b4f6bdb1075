"""Weights of the equations of the sliding fit: noise, random effects of plateaus, outliers (Huber)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array

from rx90_common.base.arrays import Array
from rx90_emulator.identification.sliding.rows import SlidingRows

_HUBER = 3.0  # standard deviations from which a residual counts linearly
_SAME_SPEED = 0.1  # width of the classes of ln |speed| that count as one speed
_LEAST_REST = 0.05  # lower bound of 1 - leverage of a plateau's mean


@dataclass(frozen=True, eq=False)
class Weights:
    """A transformation of the equations to unit noise (random effects, quasi-demeaning).

    Besides noise from block to block, all blocks of a plateau share an error (ripple, temperature, an arm that is not
    quite rigid). With variances s^2 of a block and t^2 of a plateau of m blocks, the equations less the share
    1 - s / sqrt(s^2 + m t^2) of their plateau's mean, over s, have unit noise. As the equations are scaled, t^2 grows
    with the samples in a block.

    Attributes:
        cluster: number of plateau and group of each row, shape (r,); c clusters.
        share: of its mean that is subtracted from each cluster, shape (c,).
        factor: of each row, 1 / s and Huber's weight, shape (r,).
    """

    cluster: NDArray[np.int64]
    share: Array
    factor: Array

    @classmethod
    def equal(cls, rows: SlidingRows) -> Weights:
        """Return the weights of rows that have unit noise."""
        cluster = rows.clusters()
        return cls(cluster, np.zeros(cluster.max() + 1), np.ones(len(rows)))

    @classmethod
    def of(cls, rows: SlidingRows, residual: Array, leverage: Array) -> Weights:
        """Return the weights by the variance components of a fit's residuals.

        Args:
            rows: the equations.
            residual: shape (r,).
            leverage: of each cluster's mean, shape (c,).
        """
        cluster = rows.clusters()
        count = np.bincount(cluster)
        mean = np.bincount(cluster, residual) / count
        # The shared error of a plateau is a torque, and the equations of long blocks are scaled up.
        power = np.bincount(cluster, rows.scale**2)
        inner = residual - mean[cluster]
        # Bessel's correction; a plateau of one block has no distance from its mean, and is left out.
        several = count[cluster] > 1
        apart = inner / np.sqrt(1.0 - 1.0 / np.where(several, count[cluster], np.inf))
        group = rows.group[np.unique(cluster, return_index=True)[1]]
        share, factor = np.zeros(len(count)), np.ones(len(rows))
        for g in np.unique(group):
            inside, mine = rows.group == g, group == g
            known = apart[inside & several]
            # Without such plateaus the noise is that of the samples, by which the equations are scaled.
            noise = max(_spread(known), 1e-9) if len(known) else 1.0
            # The mean square of the residuals' means is (1 - leverage) (s^2 / m + t^2).
            left = np.maximum(_LEAST_REST, 1.0 - leverage[mine])
            excess = np.sum(count[mine] * mean[mine] ** 2) - noise**2 * np.sum(left)
            common = max(0.0, float(excess / np.sum(power[mine] * left)))
            share[mine] = 1.0 - noise / np.sqrt(noise**2 + power[mine] * common)
            size = np.abs(inner[inside]) / noise
            factor[inside] = np.sqrt(np.minimum(1.0, _HUBER / np.maximum(size, 1e-12))) / noise
        return cls(cluster, share, factor)

    def means(self, values: Array | csr_array) -> Array:
        """Return the clusters' means of columns, shape (r, k), scaled to unit noise, shape (c, k)."""
        rows = len(self.cluster)
        count = np.bincount(self.cluster)
        members = csr_array((self.factor, (self.cluster, np.arange(rows))), shape=(len(count), rows))
        return np.asarray(((1.0 - self.share) / np.sqrt(count))[:, None] * (members @ values))

    def operator(self) -> csr_array:
        """Return the matrix of the transformation, shape (r, r)."""
        rows = len(self.cluster)
        count = np.bincount(self.cluster)
        members = csr_array((np.ones(rows), (self.cluster, np.arange(rows))), shape=(len(count), rows))
        less = _diagonal(np.ones(rows)) - members.T @ _diagonal(self.share / count) @ members
        return csr_array(_diagonal(self.factor) @ less)


def speed_design_effect(rows: SlidingRows, weights: Weights, residual: Array) -> Array:
    """Return Kish's design effect of plateaus at one speed, whatever their pose and direction.

    Ripple depends on the speed and changes its sign with it, so the errors of plateaus at one speed are correlated. The
    variance of an estimate is that with independent plateaus, times the sum of S^2 over the speeds over the sum of s^2
    over the plateaus, with the residual s of a plateau along its motion, and the sum S of s at one speed.

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


def _diagonal(values: Array) -> csr_array:
    """Return a diagonal matrix; scipy.sparse.diags_array and eye_array are younger than SciPy 1.11."""
    place = np.arange(len(values))
    return csr_array((values, (place, place)), shape=(len(values), len(values)))


def _spread(values: Array) -> float:
    """Return the standard deviation about 0 without outliers, which are found by the median absolute deviation."""
    robust = 1.4826 * float(np.median(np.abs(values)))
    good = np.abs(values) <= _HUBER * robust
    # A normal distribution truncated at 3 standard deviations keeps 0.9867 of its standard deviation.
    return float(np.sqrt(np.mean(values[good] ** 2))) / 0.9867 if robust > 0.0 else 0.0
