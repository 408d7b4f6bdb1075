"""The sliding equations, reduced to the friction torques of the plateaus.

An element has one velocity in a plateau, hence one torque. The equations are linear in these torques f and in the
nuisance parameters p, the errors of the arm's inertial parameters. Eliminating p leaves a quadratic form in f, the
normal equations, which is sufficient for the friction. It is small, so the non-linear fit of the curves costs nothing.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array

from rx90_common.base.arrays import Array
from rx90_emulator.identification.sliding.rows import SlidingRows, back_substituted
from rx90_emulator.identification.sliding.weights import Weights

_RANK = 1e-13  # of the largest eigenvalue: smaller ones count as 0


@dataclass(frozen=True, eq=False)
class PlateauTorques:
    """Which friction torques there are, one for each plateau and element that slides in it.

    Attributes:
        element: shape (c,).
        velocity: rad/s, shape (c,).
        column: number of the torque by which each element enters a row, or -1, shape (r, n_el).
    """

    element: NDArray[np.int64]
    velocity: Array
    column: NDArray[np.int64]

    @classmethod
    def of(cls, rows: SlidingRows) -> PlateauTorques:
        """Number the torques of the rows."""
        count = rows.gain.shape[1]
        at, element = np.nonzero(rows.gain)
        keys, number = np.unique(rows.plateau[at] * count + element, return_inverse=True)
        column = np.full(rows.gain.shape, -1)
        column[at, element] = number
        velocity = np.bincount(number, rows.velocity[at, element]) / np.bincount(number)
        return cls(keys % count, velocity, column)

    def design(self, rows: SlidingRows) -> csr_array:
        """Return the rows' coefficients of the torques, shape (r, c)."""
        at, element = np.nonzero(rows.gain)
        place = at, self.column[at, element]
        return csr_array((rows.gain[at, element], place), shape=(len(rows), len(self.element)))


@dataclass(frozen=True, eq=False)
class NormalForm:
    """Equations of unit noise in the friction torques alone: root @ f = target.

    Attributes:
        root: shape (k, c).
        target: shape (k,).
        back: the nuisance parameters are back[:, 0] - back[:, 1:] @ f, shape (p, 1 + c).
        spread: root of their covariance at given torques, spread @ spread^T, shape (p, p).
    """

    root: Array
    target: Array
    back: Array
    spread: Array

    @classmethod
    def of(cls, rows: SlidingRows, design: csr_array, weights: Weights) -> NormalForm:
        """Eliminate the nuisance parameters, whose prior is 0 with a standard deviation of 1."""
        operator = weights.operator()
        value = operator @ rows.value[:, None]
        friction = operator @ design
        nuisance = operator @ rows.nuisance
        # By an orthogonal basis (QR): normal equations in nuisance parameters as badly scaled as these would lose all
        # digits.
        basis, upper = np.linalg.qr(np.vstack([nuisance, np.eye(nuisance.shape[1])]))
        basis = basis[: len(value)]
        along = np.hstack([basis.T @ value, basis.T @ friction])
        back = back_substituted(upper, along)
        form = (friction.T @ friction).toarray() - along[:, 1:].T @ along[:, 1:]
        pull = (friction.T @ value)[:, 0] - along[:, 1:].T @ along[:, 0]
        values, vectors = np.linalg.eigh((form + form.T) / 2.0)
        good = values > _RANK * values[-1]
        scale = np.sqrt(values[good])
        root = scale[:, None] * vectors[:, good].T
        spread = back_substituted(upper, np.eye(len(upper)))
        return cls(root, (vectors[:, good].T @ pull) / scale, back, spread)

    def nuisance(self, torques: Array) -> Array:
        """Return the nuisance parameters that go with friction torques, shape (p,)."""
        return np.asarray(self.back[:, 0] - self.back[:, 1:] @ torques)

    def nuisance_covariance(self, slope: Array, covariance: Array) -> Array:
        """Return the covariance of the nuisance parameters, shape (p, p).

        Args:
            slope: derivatives of the friction torques by k parameters, shape (c, k).
            covariance: of these parameters, shape (k, k).
        """
        follows = self.back[:, 1:] @ slope
        return np.asarray(self.spread @ self.spread.T + follows @ covariance @ follows.T)
