"""What a motion tells of the parameters: the information matrix of the weighted columns, and what is optimised of it.

The columns are those that the identification fits: base parameters (links, rotors, springs, offsets), and Coulomb and
viscous torque of each friction element. Each joint is weighted by the noise of its torque.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from rx90_common.base.arrays import Array
from rx90_emulator.identification.arm import RigidArm
from rx90_emulator.identification.excitation.linear_parameters import BaseGroups, StandardColumns
from rx90_emulator.identification.experiments.excitation.options import Criterion
from rx90_emulator.loop.setup import Setup

SMOOTH = 0.1  # rad/s, over which the sign of the velocity changes for the search
_DIFFERENCE = 1e-6  # of position and velocity: the columns' derivatives are differences
_FLOOR = 1e-12  # of the squared length of a column: what is excited less counts as not excited
ROWS = 100.0  # independent samples of each joint's torque per second

Motion = tuple[Array, Array, Array]
"""Position, velocity and acceleration, each of shape (m, n)."""


@dataclass(frozen=True, eq=False)
class ExcitationColumns:
    """The columns of an arm's torque.

    Attributes:
        arm: n joints and n_el elements.
        standard: of the P standard parameters.
        base: b groups of them.
        noise: standard deviation of each joint's torque in `ROWS` samples per second, Nm, shape (n,).
    """

    arm: RigidArm
    standard: StandardColumns
    base: BaseGroups
    noise: Array

    @classmethod
    def of(cls, setup: Setup, noise: Array) -> ExcitationColumns:
        """Return the columns that `rx90_identify --excitation` fits."""
        arm = RigidArm.from_setup(setup)
        springs = [name for name, k in zip(arm.names, arm.spring.tolist(), strict=True) if k]
        standard = StandardColumns.with_springs_on(arm, springs)
        return cls(arm, standard, BaseGroups.of(standard), noise)

    @property
    def names(self) -> tuple[str, ...]:
        """Return the names of p = b + 2 n_el parameters."""
        friction = [f"{name}.{part}" for part in ("tau_c", "c2") for name in self.arm.element_names]
        return (*self.base.names, *friction)

    def rows(self, standard: Array, velocity: Array, smooth: float = 0.0) -> Array:
        """Return the columns, each joint over its noise.

        Args:
            standard: of the standard parameters, Nm per unit, shape (m, n, P).
            velocity: rad/s, shape (m, n).
            smooth: speed over which the sign changes, rad/s.

        Returns:
            Shape (m, n, p).
        """
        share, inputs = self.arm.element_matrix.T, velocity @ self.arm.element_matrix.T
        sign = np.tanh(inputs / smooth) if smooth else np.sign(inputs)
        friction = [value[:, None, :] * share for value in (sign, inputs)]
        rows = np.concatenate([standard[:, :, list(self.base.leading)], *friction], axis=2)
        return np.asarray(rows / self.noise[:, None])

    def information(self, motion: Motion, duration: float) -> Array:
        """Return the information of `duration`, s, of a motion whose samples represent it, shape (p, p)."""
        rows = self.rows(self.standard.torque(*motion), motion[1])
        flat = rows.reshape(-1, rows.shape[2])
        return np.asarray(flat.T @ flat * (ROWS * duration / len(rows)))


def criterion(kind: Criterion, information: Array) -> tuple[float, Array]:
    """Return what is to be minimised and its derivative by the information, shape (p, p).

    `condition`: the logarithm of the condition number of the columns, each of length 1. `d`: the mean logarithm of the
    parameters' deviations, -log det(information) / (2 p).
    """
    p, size = len(information), np.sqrt(np.maximum(np.diag(information), 1e-300))
    scaled = information / np.outer(size, size) + _FLOOR * np.eye(p)
    if kind is Criterion.D:
        factor = np.linalg.cholesky(scaled)
        value = -np.sum(np.log(np.diag(factor) * size)) / p
        return float(value), -np.linalg.inv(scaled) / np.outer(size, size) / (2.0 * p)
    values, vectors = np.linalg.eigh(scaled)
    ends = vectors[:, [-1, 0]] / np.sqrt(values[[-1, 0]])
    slope = 0.5 * (np.outer(ends[:, 0], ends[:, 0]) - np.outer(ends[:, 1], ends[:, 1]))
    derivative = slope / np.outer(size, size)
    derivative[np.diag_indices(p)] -= np.sum(slope * scaled, axis=1) / size**2
    return float(0.5 * np.log(values[-1] / values[0])), derivative


def condition_number(information: Array) -> float:
    """Return the condition number of the columns, each of length 1; infinite where a parameter is not excited."""
    size = np.sqrt(np.diag(information))
    if not np.all(size > 0.0):
        return float("inf")
    values = np.linalg.eigvalsh(information / np.outer(size, size))
    return float(np.sqrt(values[-1] / max(values[0], 1e-300)))


def log_determinant(information: Array) -> float:
    """Return log det of the information, natural; -inf where it is singular."""
    sign, value = np.linalg.slogdet(information)
    return float(value) if sign > 0 else -float("inf")


def deviations(information: Array) -> Array:
    """Return the standard deviations of the parameters, shape (p,)."""
    size = np.sqrt(np.diag(information))
    inverse = np.linalg.pinv(information / np.outer(size, size), hermitian=True)
    return np.asarray(np.sqrt(np.diag(inverse)) / size)


@dataclass(frozen=True, eq=False)
class InformationSlope:
    """Derivatives by a motion of anything that depends on the columns.

    Attributes:
        columns: of the arm.
        motion: m samples.
        standard: of the P parameters there, shape (m, n, P).
    """

    columns: ExcitationColumns
    motion: Motion
    standard: Array

    @classmethod
    def of(cls, columns: ExcitationColumns, motion: Motion) -> InformationSlope:
        """Evaluate the columns of a motion."""
        return cls(columns, motion, columns.standard.torque(*motion))

    @property
    def rows(self) -> Array:
        """Return the smoothed, weighted columns, shape (m, n, p)."""
        return self.columns.rows(self.standard, self.motion[1], SMOOTH)

    def by_motion(self, by_rows: Array, by_torque: Array, parameters: Array) -> Motion:
        """Return the derivatives by position, velocity and acceleration of a function of rows and rigid torque.

        Args:
            by_rows: its derivative by the rows, shape (m, n, p).
            by_torque: by the rigid torque, 1/Nm, shape (m, n).
            parameters: standard parameters that the torque is made with, shape (P,).

        Returns:
            Each of shape (m, n).
        """
        columns, base = self.columns, self.columns.base
        weighted = by_rows / columns.noise[:, None]
        count = len(base.leading)
        by_standard = by_torque[:, :, None] * parameters
        by_standard[:, :, list(base.leading)] += weighted[:, :, :count]
        now = np.einsum("mnp,mnp->m", by_standard, self.standard)
        slopes = []
        for kind in range(3):
            slope = np.empty_like(self.motion[kind])
            for joint in range(slope.shape[1]):
                moved = [one.copy() for one in self.motion]
                # The columns are linear in the acceleration.
                step = 1.0 if kind == 2 else _DIFFERENCE
                moved[kind][:, joint] += step
                other = columns.standard.torque(moved[0], moved[1], moved[2])
                slope[:, joint] = (np.einsum("mnp,mnp->m", by_standard, other) - now) / step
            slopes.append(slope)
        slopes[1] = slopes[1] + self._by_friction(weighted[:, :, count:])
        return slopes[0], slopes[1], slopes[2]

    def _by_friction(self, weighted: Array) -> Array:
        """Return the derivative by the velocity through the friction columns, shape (m, n)."""
        elements = self.columns.arm.element_matrix
        inputs = self.motion[1] @ elements.T
        n_el = len(elements)
        coulomb, viscous = (
            np.einsum("mne,en->me", part, elements) for part in (weighted[:, :, :n_el], weighted[:, :, n_el:])
        )
        slope = 1.0 / (SMOOTH * np.cosh(np.minimum(np.abs(inputs) / SMOOTH, 50.0)) ** 2)
        return np.asarray((coulomb * slope + viscous) @ elements)
