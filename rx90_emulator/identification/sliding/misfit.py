"""How well the curves fit: residuals that hang together over the speeds show a misfit, which widens deviations.

A random effect takes what the blocks of a plateau share as accidental. Where a curve of the model's form does not go
through the data, the errors of plateaus at neighbouring speeds have one sign, and the estimates are off by more than
independent errors say. How much shows when bands of speeds are left out in turn.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from rx90_common.base.arrays import Array, Mask
from rx90_emulator.identification.sliding.residuals import Residuals

_REACH = 1.0  # of ln |speed| over which errors hang together: a factor of e
_SAME = 0.1  # of ln |speed| below which ripple of one speed may be the reason, which has a factor of its own
_BAND = 1.0  # of ln |speed|, within which errors are taken as one
_LARGEST_LEVERAGE = 0.9  # of a band: without it a parameter would not be determined
_NEIGHBOURS = 4  # residuals on either side by which the scatter is judged
_SIGNIFICANT = 3.0  # standard deviations of the sum of products of neighbouring residuals


@dataclass(frozen=True, eq=False)
class Misfit:
    """What residuals say of the curves' form.

    Attributes:
        agreement: of the residuals at neighbouring speeds of each element, in standard deviations of what independent
            ones show, shape (n_el,).
        widening: factor on the variance of each parameter because of it, 1 without a misfit, shape (n_el, p).
    """

    agreement: Array
    widening: Array

    @property
    def significant(self) -> Mask:
        """Return which elements' curves do not fit, shape (n_el,)."""
        return np.asarray(self.agreement > _SIGNIFICANT)

    @classmethod
    def of(cls, residuals: Residuals, free: Mask, covariance: Array) -> Misfit:
        """Judge the residuals of a fit.

        Args:
            residuals: of the fit.
            free: which parameters of the elements were fitted, shape (n_el, p).
            covariance: of the free parameters with independent plateaus, shape (q, q).
        """
        agreement, widening = np.zeros(len(free)), np.ones(free.shape)
        column = np.cumsum(free.ravel()).reshape(free.shape) - 1
        for e in np.flatnonzero(free.any(axis=1)).tolist():
            velocity = residuals.velocity[:, e]
            mine = np.flatnonzero(velocity)
            speed = np.log(np.abs(velocity[mine]))
            along = residuals.along[mine, e]
            scatter = _scatter(along, np.argsort(speed))
            agreement[e] = _agreement(along / scatter, np.abs(speed[:, None] - speed))
            if agreement[e] > _SIGNIFICANT:
                band = np.full(len(velocity), -1)
                band[mine] = np.floor((speed - speed.min()) / _BAND)
                variance = _jackknife(residuals.slope, residuals.left, band[residuals.plateau], covariance)
                chosen = column[e, free[e]]
                widening[e, free[e]] = np.maximum(1.0, variance[chosen] / np.diag(covariance)[chosen])
        return cls(agreement, widening)


def _jackknife(slope: Array, left: Array, band: NDArray[np.int64], covariance: Array) -> Array:
    """Return the variances of the parameters by how they change when each band of speeds is left out, shape (q,).

    That is the jackknife over groups, for a linear model the cluster-robust CR3 (Bell and McCaffrey 2002).

    Args:
        slope: derivatives of the equations of unit noise, shape (r, q).
        left: their residuals, shape (r,).
        band: number of the band of each equation, -1 for none, shape (r,).
        covariance: of the parameters with independent errors, shape (q, q).
    """
    values, vectors = np.linalg.eigh(covariance)
    root = vectors * np.sqrt(np.maximum(values, 0.0))
    scaled = slope @ root
    numbers = np.unique(band[band >= 0])
    total = np.zeros(len(covariance))
    for number in numbers.tolist():
        part = scaled[band == number]
        leverage, directions = np.linalg.eigh(part.T @ part)
        pull = directions.T @ (part.T @ left[band == number])
        change = root @ (directions @ (pull / (1.0 - np.minimum(leverage, _LARGEST_LEVERAGE))))
        with np.errstate(over="ignore"):  # what becomes infinite is not identifiable
            total += change**2
    return np.asarray(total * (len(numbers) - 1) / max(len(numbers), 1))


def _scatter(residual: Array, order: NDArray[np.intp]) -> Array:
    """Return the standard deviation of each residual by its differences from its neighbours, which share a misfit."""
    if len(residual) < 3:
        return np.ones(len(residual))
    squares = np.diff(residual[order]) ** 2 / 2.0
    window = np.ones(min(2 * _NEIGHBOURS, len(squares)))
    usual = np.convolve(squares, window, "same") / np.convolve(np.ones(len(squares)), window, "same")
    local = np.empty(len(residual))
    local[order] = np.sqrt(np.maximum(np.append(usual, usual[-1]), 1e-6 * squares.mean() + 1e-300))
    return local


def _agreement(residual: Array, distance: Array) -> float:
    """Return how many standard deviations neighbouring residuals agree more than independent ones."""
    kernel = np.triu(np.maximum(0.0, 1.0 - distance / _REACH) * (distance > _SAME), 1)
    spread = float(np.sqrt(residual**2 @ kernel**2 @ residual**2))
    return float(residual @ kernel @ residual) / spread if spread > 0.0 else 0.0
