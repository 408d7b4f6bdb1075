"""What an arm's torque is linear in, friction apart: standard and base parameters, and a prior of them.

Everything in an arm's torque that is linear in its parameters, friction apart: links, rotors, springs, offsets.

Base parameters: the combinations of standard parameters that the torque of an arm depends on.

Gautier 1991, "Numerical calculation of the base inertial parameters of robots": the columns of the torque at random
motions are orthogonalised one after the other. A column that lies in the space of those before it carries nothing
new; its parameter joins the groups of those whose columns make it up.

What is known of the base parameters before a run: the inertials of the robot's description.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from rx90_common.base.arrays import Array
from rx90_common.base.errors import IdentificationError
from rx90_common.base.quoting import listed, quoted
from rx90_emulator.identification.arm import RigidArm

_LINK = ("m", "mx", "my", "mz", "Ixx", "Ixy", "Iyy", "Ixz", "Iyz", "Izz")


@dataclass(frozen=True, eq=False)
class StandardColumns:
    """The torque of an arm per unit of each standard parameter.

    Attributes:
        arm: kinematics and couplings; of its inertias nothing is used.
        springs: joints with a spring of the torque -k sin(q), numbers from 0.

    Raises:
        IdentificationError: for a spring on a joint that is not there.
    """

    arm: RigidArm
    springs: tuple[int, ...] = ()

    def __post_init__(self) -> None:
        for joint in self.springs:
            if not 0 <= joint < len(self.arm.names):
                raise IdentificationError(f"spring on joint {joint}; accepted: 0 to {len(self.arm.names) - 1}")

    @classmethod
    def with_springs_on(cls, arm: RigidArm, joints: Sequence[str]) -> StandardColumns:
        """Return the columns of an arm with springs on the named joints.

        Raises:
            IdentificationError: for a joint that is not there.
        """
        for name in joints:
            if name not in arm.names:
                raise IdentificationError(f"spring on joint {quoted(name)}; accepted: {listed(arm.names)}")
        return cls(arm, tuple(arm.names.index(name) for name in joints))

    @property
    def names(self) -> tuple[str, ...]:
        """Return the names of P parameters; numbers are those of the joints, from 1 at the base.

        m kg, mx .. mz kg m and Ixx .. Izz kg m^2 of the links, about the origins of their joints and in their frames;
        Ia kg m^2, of the motors through their gears; k Nm, of the springs; offset Nm.
        """
        n = len(self.arm.names)
        links = [f"{kind}_{joint}" for joint in range(1, n + 1) for kind in _LINK]
        rotors = [f"Ia_{joint}" for joint in range(1, n + 1)]
        springs = [f"k_{joint + 1}" for joint in self.springs]
        return (*links, *rotors, *springs, *(f"offset_{joint}" for joint in range(1, n + 1)))

    def torque(self, position: Array, velocity: Array, acceleration: Array) -> Array:
        """Return the columns along a motion, whose arrays have shape (m, n): shape (m, n, P)."""
        n, turns = len(self.arm.names), self.arm.coupling
        links = self.arm.regressor(position, velocity, acceleration)
        # Motor j turns with row j of the coupling; its inertia acts back on every joint of that row.
        rotors = (acceleration @ turns.T)[:, None, :] * turns.T
        springs = np.zeros((len(position), n, len(self.springs)))
        for k, joint in enumerate(self.springs):
            springs[:, joint, k] = np.sin(position[:, joint])
        offsets = np.broadcast_to(np.eye(n), (len(position), n, n))
        return np.concatenate([links, rotors, springs, offsets], axis=2)

    def values(self) -> Array:
        """Return the parameters as the arm's description has them, shape (P,): a prior. Offsets are 0."""
        inverse = np.linalg.inv(self.arm.coupling)
        rotors = np.diag(inverse.T @ self.arm.rotor @ inverse)
        springs = self.arm.spring[list(self.springs)]
        return np.concatenate([self.arm.inertial, rotors, springs, np.zeros(len(self.arm.names))])


_RANDOM_MOTIONS = 60  # random motions; each gives as many equations as there are joints
_SEED = 20100
_INDEPENDENT_SHARE = (
    1e-5  # share of a column outside the space of others, below which it is dependent: more than what a
)
# description leaves that has 1.5708 for a right angle
_MIN_COEFFICIENT = 1e-5  # coefficient in a group, for the same reason
_REGROUPED_KINDS = ("m_", "mz_", "Iyy_")  # kinds that join other groups by Khalil's convention: they come last


@dataclass(frozen=True, eq=False)
class BaseGroups:
    """Groups of standard parameters.

    Attributes:
        standard: names of the P standard parameters.
        leading: the parameter that each of b groups is named after, shape (b,): the columns to take.
        combination: G, base parameters = G @ standard parameters, shape (b, P); 1 at the leading ones.
    """

    standard: tuple[str, ...]
    leading: tuple[int, ...]
    combination: Array

    @classmethod
    def of(cls, columns: StandardColumns) -> BaseGroups:
        """Find the groups of an arm, from random positions, velocities and accelerations (always the same ones)."""
        rng = np.random.default_rng(_SEED)
        motion = (rng.uniform(-width, width, (_RANDOM_MOTIONS, len(columns.arm.names))) for width in (np.pi, 2.0, 5.0))
        torque = columns.torque(*motion)
        return cls.from_matrix(columns.names, torque.reshape(-1, len(columns.names)))

    @classmethod
    def from_matrix(cls, standard: tuple[str, ...], matrix: Array) -> BaseGroups:
        """Find the groups of any columns, shape (r, P)."""
        late = [name.startswith(_REGROUPED_KINDS) for name in standard]
        order = sorted(range(len(standard)), key=lambda k: (late[k], k))
        leading = sorted(_independent(matrix, order))
        kept = matrix[:, leading]
        combination = np.asarray(np.linalg.lstsq(kept, matrix, rcond=None)[0], dtype=np.float64)
        combination[np.abs(combination) < _MIN_COEFFICIENT] = 0.0
        combination[:, leading] = np.eye(len(leading))
        return cls(standard, tuple(leading), combination)

    @property
    def names(self) -> tuple[str, ...]:
        """Return short names, shape (b,): of the leading parameter, with an R if others have joined it (Khalil)."""
        alone = np.count_nonzero(self.combination, axis=1) == 1
        leading = [self.standard[k] for k in self.leading]
        return tuple(
            name if one else name.replace("_", "R_", 1) for name, one in zip(leading, alone.tolist(), strict=True)
        )

    @property
    def groups(self) -> tuple[str, ...]:
        """Return each group in words, shape (b,), such as "mx_2 + 0.45 m_3"; SI units."""
        return tuple(self._words(lead, row) for lead, row in zip(self.leading, self.combination, strict=True))

    def _words(self, lead: int, row: Array) -> str:
        text = self.standard[lead]
        for k in np.flatnonzero(row).tolist():
            if k != lead:
                size = "" if abs(abs(row[k]) - 1.0) < 1e-6 else f"{abs(row[k]):.4g} "
                text += f" {'-' if row[k] < 0.0 else '+'} {size}{self.standard[k]}"
        return text


def _independent(matrix: Array, order: list[int]) -> list[int]:
    """Return the columns that are independent of those before them in the given order."""
    basis = np.zeros((len(matrix), 0))
    largest = float(np.linalg.norm(matrix, axis=0).max())
    chosen = []
    for k in order:
        column = matrix[:, k]
        size = float(np.linalg.norm(column))
        rest = column - basis @ (basis.T @ column)
        rest = rest - basis @ (basis.T @ rest)  # once more: rounding of the first pass
        left = float(np.linalg.norm(rest))
        if size > _INDEPENDENT_SHARE * largest and left > _INDEPENDENT_SHARE * size:
            basis = np.column_stack([basis, rest / left])
            chosen.append(k)
    return chosen


_UNINFORMATIVE = 1e4  # deviations of a parameter that is not given, in units of the arm's largest of its kind


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
    deviation[deviation == 0.0] = _UNINFORMATIVE * float(deviation.max())
    covariance = (base.combination * deviation**2) @ base.combination.T
    size = np.sqrt(np.diag(covariance))
    precision = np.linalg.inv(covariance / np.outer(size, size)) / np.outer(size, size)
    return Prior(base.combination @ value, precision)
