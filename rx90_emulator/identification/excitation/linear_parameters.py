"""What an arm's torque is linear in, friction apart: standard and base parameters, and what is known of them before.

Standard parameters are those of links, rotors, springs and offsets. Base parameters are the combinations of them that
the torque depends on (Gautier 1991, "Numerical calculation of the base inertial parameters of robots"): the columns of
the torque at random motions are orthogonalised one after the other. A column that lies in the space of those before it
carries nothing new; its parameter joins the groups of those whose columns make it up.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from rx90_common.base.arrays import Array
from rx90_common.base.errors import IdentificationError
from rx90_emulator.identification.arm import RigidArm

_LINK = ("m", "mx", "my", "mz", "Ixx", "Ixy", "Iyy", "Ixz", "Iyz", "Izz")


@dataclass(frozen=True, eq=False)
class StandardColumns:
    """The torque of an arm per unit of each standard parameter.

    Attributes:
        arm: kinematics and couplings; of its inertias nothing is used.
        springs: joints with a spring of the torque -k sin(q), numbers from 0.
    """

    arm: RigidArm
    springs: tuple[int, ...] = ()

    @classmethod
    def of(cls, arm: RigidArm) -> StandardColumns:
        """Return the columns of an arm with springs on the joints on which its description has one."""
        return cls(arm, tuple(np.flatnonzero(arm.spring).tolist()))

    @property
    def names(self) -> tuple[str, ...]:
        """Return the names of P parameters; numbers are those of the joints, from 1 at the base.

        m kg, mx .. mz kg m and Ixx .. Izz kg m^2 of the links, about the origins of their joints and in their frames;
        Ia kg m^2, of the motors through their gears; k Nm, of the springs; offset Nm.
        """
        joints = range(1, len(self.arm.names) + 1)
        links = [f"{kind}_{joint}" for joint in joints for kind in _LINK]
        rotors, offsets = ([f"{kind}_{joint}" for joint in joints] for kind in ("Ia", "offset"))
        return (*links, *rotors, *(f"k_{joint + 1}" for joint in self.springs), *offsets)

    def torque(self, position: Array, velocity: Array, acceleration: Array) -> Array:
        """Return the columns along a motion, whose arrays have shape (m, n): shape (m, n, P)."""
        n, turns = len(self.arm.names), self.arm.coupling
        links = self.arm.regressor(position, velocity, acceleration)
        # Motor j turns with row j of the coupling; its inertia acts back on every joint of that row.
        rotors = (acceleration @ turns.T)[:, None, :] * turns.T
        joints = list(self.springs)
        springs = np.sin(position)[:, :, None] * np.eye(n)[:, joints]
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
_INDEPENDENT_SHARE = 1e-5  # of a column outside the space of others; a description with 1.5708 for pi/2 leaves less
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
        rng, names = np.random.default_rng(_SEED), columns.names
        motion = (rng.uniform(-width, width, (_RANDOM_MOTIONS, len(columns.arm.names))) for width in (np.pi, 2.0, 5.0))
        matrix = columns.torque(*motion).reshape(-1, len(names))
        size = np.linalg.norm(matrix, axis=0)
        basis, chosen = np.zeros((len(matrix), 0)), []
        for k in sorted(range(len(names)), key=lambda k: (names[k].startswith(_REGROUPED_KINDS), k)):
            rest = matrix[:, k] - basis @ (basis.T @ matrix[:, k])
            rest = rest - basis @ (basis.T @ rest)  # once more: rounding of the first pass
            left = float(np.linalg.norm(rest))
            if size[k] > _INDEPENDENT_SHARE * size.max() and left > _INDEPENDENT_SHARE * size[k]:
                basis = np.column_stack([basis, rest / left])
                chosen.append(k)
        leading = sorted(chosen)
        combination = np.asarray(np.linalg.lstsq(matrix[:, leading], matrix, rcond=None)[0], dtype=np.float64)
        combination[np.abs(combination) < _MIN_COEFFICIENT] = 0.0
        combination[:, leading] = np.eye(len(leading))
        return cls(names, tuple(leading), combination)

    @property
    def names(self) -> tuple[str, ...]:
        """Return short names, shape (b,): of the leading parameter, with an R if others have joined it (Khalil)."""
        alone = (np.count_nonzero(self.combination, axis=1) == 1).tolist()
        leading = [self.standard[k] for k in self.leading]
        return tuple(n if one else n.replace("_", "R_", 1) for n, one in zip(leading, alone, strict=True))

    @property
    def groups(self) -> tuple[str, ...]:
        """Return each group in words, shape (b,), such as "mx_2 + 0.45 m_3"; SI units."""
        texts = []
        for lead, row in zip(self.leading, self.combination, strict=True):
            text = self.standard[lead]
            for k in np.flatnonzero(row).tolist():
                if k != lead:
                    size = "" if abs(abs(row[k]) - 1.0) < 1e-6 else f"{abs(row[k]):.4g} "
                    text += f" {'-' if row[k] < 0.0 else '+'} {size}{self.standard[k]}"
            texts.append(text)
        return tuple(texts)


_UNINFORMATIVE = 1e4  # deviations of a parameter that is not given, in units of the arm's largest of its kind


class Prior(NamedTuple):
    """A normal distribution of q parameters: its mean, shape (q,), and the inverse of its covariance, (q, q)."""

    value: Array
    precision: Array


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
    value, count = columns.values(), 10 * len(columns.arm.names)
    if not value[:count].any():
        raise IdentificationError("a prior from a description without <inertial>; accepted: no --prior, or inertials")
    links = value[:count].reshape(-1, 10)
    mass = np.maximum(links[:, 0], 1e-6)
    radius = np.sqrt(np.maximum(links[:, [4, 6, 9]].sum(axis=1) / 2.0 / mass, 1e-4))
    sizes = mass[:, None] * radius[:, None] ** np.array([0, 1, 1, 1, 2, 2, 2, 2, 2, 2])
    deviation = relative * np.concatenate([sizes.ravel(), np.abs(value[count:])])
    deviation[deviation == 0.0] = _UNINFORMATIVE * float(deviation.max())
    covariance = (base.combination * deviation**2) @ base.combination.T
    size = np.sqrt(np.diag(covariance))
    precision = np.linalg.inv(covariance / np.outer(size, size)) / np.outer(size, size)
    return Prior(base.combination @ value, precision)
