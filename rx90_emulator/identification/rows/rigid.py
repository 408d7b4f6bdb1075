"""The torque of an arm without friction: the standard parameters it is linear in, and the base parameters of these.

Base parameters are the combinations of standard parameters that the torque depends on (Gautier 1991, "Numerical
calculation of the base inertial parameters of robots"): the columns of the torque at random motions are orthogonalised
one after the other. A column in the space of the previous ones contains nothing new; its parameter joins the groups of
the columns that it is a combination of. Joints that rest do not move in these motions either, and have no equations.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from rx90_common.base.arrays import Array
from rx90_emulator.identification.arm import RigidArm

_LINK = ("m", "mx", "my", "mz", "Ixx", "Ixy", "Iyy", "Ixz", "Iyz", "Izz")


class StandardColumns:
    """The torque of an arm per unit of each standard parameter.

    Args:
        arm: kinematics and couplings, and which joints have a spring of the torque -k sin(q); its inertias and the
            sizes of the springs are not used.
        rotors: whether the torque contains that of the rotors. Sensors between gear and link do not measure it, and its
            columns are 0.
    """

    def __init__(self, arm: RigidArm, *, rotors: bool = True) -> None:
        self.arm = arm
        self.rotors = rotors
        self.springs = np.flatnonzero(arm.spring).tolist()

    @property
    def names(self) -> tuple[str, ...]:
        """Return the names of P parameters, with the numbers of the joints, from 1 at the base.

        m kg, mx .. mz kg m and Ixx .. Izz kg m^2 for links, about the origins of their joints and in their frames; Ia
        kg m^2, for motors seen through their gears; k Nm, for springs; offset Nm.
        """
        joints = range(1, len(self.arm.names) + 1)
        links = [f"{kind}_{joint}" for joint in joints for kind in _LINK]
        rotors = [f"Ia_{joint}" for joint in joints]
        offsets = [f"offset_{joint}" for joint in joints]
        return (*links, *rotors, *(f"k_{joint + 1}" for joint in self.springs), *offsets)

    def torque(self, position: Array, velocity: Array, acceleration: Array) -> Array:
        """Return the columns along a motion, whose arrays have shape (m, n): shape (m, n, P)."""
        n = len(self.arm.names)
        turns = self.arm.coupling
        links = self.arm.regressor(position, velocity, acceleration)
        # Motor j turns with row j of the coupling; its inertia acts back on every joint of that row.
        rotors = (acceleration @ turns.T)[:, None, :] * turns.T * self.rotors
        springs = np.sin(position)[:, :, None] * np.eye(n)[:, self.springs]
        offsets = np.broadcast_to(np.eye(n), (len(position), n, n))
        return np.concatenate([links, rotors, springs, offsets], axis=2)

    def values(self) -> Array:
        """Return the parameters of the arm's description, shape (P,), for a prior. Offsets are 0."""
        inverse = np.linalg.inv(self.arm.coupling)
        rotors = np.diag(inverse.T @ self.arm.rotor @ inverse) * self.rotors
        parts = (
            self.arm.inertial,
            rotors,
            self.arm.spring[self.springs],
            np.zeros(len(self.arm.names)),
        )
        return np.concatenate(parts)


_RANDOM_MOTIONS = 60  # each gives as many equations as there are joints
_SEED = 20100
_INDEPENDENT_SHARE = 1e-5  # least part of an independent column outside the others' space; 1.5708 for pi/2 leaves less
_MIN_COEFFICIENT = 1e-5  # in a group, for the same reason
# kinds that join other groups by Khalil's convention: they come last
_REGROUPED_KINDS = ("m_", "mz_", "Iyy_")


@dataclass(frozen=True, eq=False)
class BaseGroups:
    """Groups of standard parameters.

    Attributes:
        standard: names of the P standard parameters.
        leading: index of the parameter that each of b groups is named after, shape (b,): the columns to use.
        combination: G, base parameters = G @ standard parameters, shape (b, P); 1 at the leading ones.
    """

    standard: tuple[str, ...]
    leading: tuple[int, ...]
    combination: Array

    @classmethod
    def of(cls, columns: StandardColumns, rest: Array | None = None) -> BaseGroups:
        """Find the groups of an arm, from random positions, velocities and accelerations (always the same ones).

        Args:
            columns: of n joints.
            rest: angle of each joint that rests, rad, NaN for those that move, shape (n,); by default all move.
        """
        rng = np.random.default_rng(_SEED)
        names = columns.names
        count = len(columns.arm.names)
        moves = np.full(count, fill_value=True) if rest is None else np.isnan(rest)
        position = rng.uniform(-np.pi, np.pi, (_RANDOM_MOTIONS, count))
        if rest is not None:
            position = np.where(moves, position, rest)
        velocity = rng.uniform(-2.0, 2.0, (_RANDOM_MOTIONS, count)) * moves
        acceleration = rng.uniform(-5.0, 5.0, (_RANDOM_MOTIONS, count)) * moves
        used = columns.arm.identified & moves
        matrix = columns.torque(position, velocity, acceleration)[:, used].reshape(-1, len(names))
        size = np.linalg.norm(matrix, axis=0)
        basis = np.zeros((len(matrix), 0))
        chosen = []
        for k in sorted(
            range(len(names)), key=lambda k: (names[k].startswith(_REGROUPED_KINDS), k)
        ):
            remainder = matrix[:, k] - basis @ (basis.T @ matrix[:, k])
            # once more: rounding of the first pass
            remainder = remainder - basis @ (basis.T @ remainder)
            norm = float(np.linalg.norm(remainder))
            if size[k] > _INDEPENDENT_SHARE * size.max() and norm > _INDEPENDENT_SHARE * size[k]:
                basis = np.column_stack([basis, remainder / norm])
                chosen.append(k)
        leading = sorted(chosen)
        combination = np.asarray(
            np.linalg.lstsq(matrix[:, leading], matrix, rcond=None)[0], dtype=np.float64
        )
        combination[np.abs(combination) < _MIN_COEFFICIENT] = 0.0
        combination[:, leading] = np.eye(len(leading))
        return cls(names, tuple(leading), combination)

    @property
    def names(self) -> tuple[str, ...]:
        """Return short names, shape (b,): the leading parameter, with an R if others belong to its group (Khalil)."""
        alone = (np.count_nonzero(self.combination, axis=1) == 1).tolist()
        leading = [self.standard[k] for k in self.leading]
        return tuple(
            n if one else n.replace("_", "R_", 1) for n, one in zip(leading, alone, strict=True)
        )

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
