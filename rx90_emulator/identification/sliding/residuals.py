"""What the sliding fit leaves of its equations, plateau by plateau, for the tests of misfit and drift."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array

from rx90_common.base.arrays import Array
from rx90_emulator.identification.sliding.rows import SlidingRows
from rx90_emulator.identification.sliding.weights import Weights


@dataclass(frozen=True, eq=False)
class Residuals:
    """Residuals of r equations of unit noise, in c plateaus.

    Attributes:
        left: residuals, shape (r,).
        slope: derivatives by the q free parameters, nuisance parameters eliminated, shape (r, q).
        gain: of the elements' torques along their motion, nuisance parameters eliminated, shape (r, n_el).
        plateau: number of each equation's plateau, 0 to c - 1, shape (r,).
        velocity: of the elements, 0 where they do not slide, rad/s, shape (c, n_el).
        along: residual torque of each element along its motion, standard deviation 1, shape (c, n_el).
        time: s, shape (c,).
    """

    left: Array
    slope: Array
    gain: Array
    plateau: NDArray[np.int64]
    velocity: Array
    along: Array
    time: Array

    @classmethod
    def of(cls, rows: SlidingRows, weights: Weights, residual: Array, slope: Array) -> Residuals:
        """Return what a fit leaves.

        Args:
            rows: the equations.
            weights: of the fit.
            residual: of the equations, shape (r,).
            slope: derivatives of the equations by the free parameters, shape (r, q).
        """
        operator = weights.operator()
        left = np.asarray(operator @ residual)
        number = np.asarray(np.unique(rows.plateau, return_inverse=True)[1], dtype=np.int64)
        count = int(number.max()) + 1
        gather = csr_array((np.ones(len(rows)), (number, np.arange(len(rows)))), shape=(count, len(rows)))
        slides = rows.gain != 0.0
        shared = np.maximum(np.asarray(gather @ slides.astype(np.float64)), 1.0)
        gain = np.asarray(operator @ (np.sign(rows.velocity) * rows.gain))
        along = np.asarray(gather @ (gain * left[:, None])) / np.sqrt(np.maximum(gather @ gain**2, 1e-300))
        nuisance = operator @ rows.nuisance
        basis = np.linalg.qr(np.vstack([nuisance, np.eye(nuisance.shape[1])]))[0][: len(left)]
        both = np.hstack([np.asarray(operator @ slope), gain])
        both = both - basis @ (basis.T @ both)
        return cls(
            left=left,
            slope=both[:, : slope.shape[1]],
            gain=both[:, slope.shape[1] :],
            plateau=number,
            velocity=np.asarray(gather @ (rows.velocity * slides)) / shared,
            along=along,
            time=np.asarray(gather @ rows.time) / np.bincount(number),
        )
