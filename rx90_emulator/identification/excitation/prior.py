"""What is known of the base parameters before a run: the inertials of the robot's description."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from rx90_common.base.arrays import Array
from rx90_common.base.errors import IdentificationError
from rx90_emulator.identification.excitation.base_groups import BaseGroups
from rx90_emulator.identification.excitation.columns import StandardColumns

_UNKNOWN = 1e4  # deviations of a parameter that is not given, in units of the arm's largest of its kind


@dataclass(frozen=True, eq=False)
class Prior:
    """A normal distribution of q parameters.

    Attributes:
        value: its mean, shape (q,).
        precision: inverse of its covariance, shape (q, q); 0 for what is unknown.
    """

    value: Array
    precision: Array

    def padded(self, count: int) -> Prior:
        """Return the prior of these and, behind them, unknown parameters: `count` in all."""
        q = len(self.value)
        precision = np.zeros((count, count))
        precision[:q, :q] = self.precision
        return Prior(np.append(self.value, np.zeros(count - q)), precision)


def described_inertials(columns: StandardColumns, base: BaseGroups, relative: float) -> Prior:
    """Return the prior of the base parameters from the inertials of the arm's description.

    Args:
        columns: with the arm.
        base: its groups.
        relative: standard deviation of a link's mass over the mass; that of its first moment is this share of mass
            times radius, that of its inertia of mass times radius squared. The radius is that of gyration about the
            joint, at least 1 cm. Rotors and springs vary by the same share where they are given; offsets, and rotors
            that are not given, are unknown.

    Raises:
        IdentificationError: for a deviation that is not positive, and for a description without inertials.
    """
    if not 0.0 < relative < math.inf:
        raise IdentificationError(f"relative deviation of the prior: {relative}; accepted: above 0")
    value = columns.values()
    if not value[: 10 * len(columns.arm.names)].any():
        raise IdentificationError("a prior from a description without <inertial>; accepted: no --prior, or inertials")
    n = len(columns.arm.names)
    links = value[: 10 * n].reshape(n, 10)
    mass = np.maximum(links[:, 0], 1e-6)
    radius = np.sqrt(np.maximum(links[:, [4, 6, 9]].sum(axis=1) / 2.0 / mass, 1e-4))
    powers = np.array([0, 1, 1, 1, 2, 2, 2, 2, 2, 2])
    deviation = relative * np.concatenate(
        [(mass[:, None] * radius[:, None] ** powers).ravel(), np.abs(value[10 * n :])]
    )
    deviation[deviation == 0.0] = _UNKNOWN * float(deviation.max())
    covariance = (base.combination * deviation**2) @ base.combination.T
    size = np.sqrt(np.diag(covariance))
    precision = np.linalg.inv(covariance / np.outer(size, size)) / np.outer(size, size)
    return Prior(base.combination @ value, precision)
