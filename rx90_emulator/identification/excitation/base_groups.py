"""Base parameters: the combinations of standard parameters that the torque of an arm depends on.

Gautier 1991, "Numerical calculation of the base inertial parameters of robots": the columns of the torque at random
motions are orthogonalised one after the other. A column that lies in the space of those before it carries nothing
new; its parameter joins the groups of those whose columns make it up.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from rx90_common.base.arrays import Array
from rx90_emulator.identification.excitation.columns import StandardColumns

_SAMPLES = 60  # random motions; each gives as many equations as there are joints
_SEED = 20100
_DEPENDENT = 1e-5  # share of a column outside the space of others, below which it is dependent: more than what a
# description leaves that has 1.5708 for a right angle
_ZERO = 1e-5  # coefficient in a group, for the same reason
_LATE = ("m_", "mz_", "Iyy_")  # kinds that join other groups by Khalil's convention: they come last


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
        motion = (rng.uniform(-width, width, (_SAMPLES, len(columns.arm.names))) for width in (np.pi, 2.0, 5.0))
        torque = columns.torque(*motion)
        return cls.from_matrix(columns.names, torque.reshape(-1, len(columns.names)))

    @classmethod
    def from_matrix(cls, standard: tuple[str, ...], matrix: Array) -> BaseGroups:
        """Find the groups of any columns, shape (r, P)."""
        late = [name.startswith(_LATE) for name in standard]
        order = sorted(range(len(standard)), key=lambda k: (late[k], k))
        leading = sorted(_independent(matrix, order))
        kept = matrix[:, leading]
        combination = np.asarray(np.linalg.lstsq(kept, matrix, rcond=None)[0], dtype=np.float64)
        combination[np.abs(combination) < _ZERO] = 0.0
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
        if size > _DEPENDENT * largest and left > _DEPENDENT * size:
            basis = np.column_stack([basis, rest / left])
            chosen.append(k)
    return chosen
