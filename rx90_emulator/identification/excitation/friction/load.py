"""Friction that grows with the load, which the friction elements do not have: how much of it shows, and what it shifts.

Gears press harder on their bearings and teeth the more torque they carry. A model without that gives Coulomb torques at
the usual load of the runs; how far they are from those without load belongs into their deviations. One coefficient
for all elements, relative to their Coulomb torques, is tested: the runs tell it far better than one for each.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from rx90_common.base.arrays import Array
from rx90_emulator.identification.excitation.friction.law import COULOMB
from rx90_emulator.identification.excitation.friction.separable import SeparableFit
from rx90_emulator.identification.excitation.friction.weighted import WeightedProblem
from rx90_emulator.identification.excitation.least_squares import LinearFit, solve
from rx90_emulator.identification.excitation.prior import Prior

_LEAST = 1e-6  # Nm, of a load that elements' friction is compared with
_SIGNIFICANT = 2.0  # deviations of the coefficient from 0


class LoadDependence(NamedTuple):
    """How Coulomb friction grows with the load.

    Attributes:
        value: relative growth at a joint's RMS torque without friction.
        deviation: its standard deviation.
        shift: of all parameters when it is admitted; 0 where it is not significant, shape (q,).
    """

    value: float
    deviation: float
    shift: Array

    @property
    def significant(self) -> bool:
        """Return whether the runs show it."""
        return abs(self.value) > _SIGNIFICANT * self.deviation


def load_dependence(
    weighted: WeightedProblem, fit: SeparableFit, columns: Array, without: LinearFit, prior: Prior | None = None
) -> LoadDependence:
    """Test whether friction grows with the load.

    Args:
        weighted: the rows.
        fit: of the friction.
        columns: of the whole model around the fit, shape (r, q).
        without: fit of these columns.
        prior: of the first parameters, in that fit.
    """
    problem = weighted.problem
    bare = np.abs(problem.regressor @ without.value[: len(problem.names)])
    wide = solve(problem, np.column_stack([columns, _load_column(weighted, fit, bare)]), prior=prior)
    value, deviation = float(wide.value[-1]), float(wide.deviation[-1])
    found = LoadDependence(value, deviation, wide.value[:-1] - without.value)
    return found if found.significant else found._replace(shift=np.zeros_like(found.shift))


def _load_column(weighted: WeightedProblem, fit: SeparableFit, bare: Array) -> Array:
    """Return Coulomb torques times the load over its RMS, Nm, shape (r,).

    Args:
        weighted: the rows.
        fit: of the friction.
        bare: size of each row's torque without friction, Nm, shape (r,).
    """
    problem, column = weighted.problem, np.zeros(len(bare))
    samples = max(len(run.rows) for run in problem.runs)
    for e, (rows, shape) in enumerate(zip(weighted.elements, fit.shapes, strict=True)):
        joint = int(np.flatnonzero(problem.arm.element_matrix[e])[-1])
        own = problem.joint == joint
        if not own.any():
            continue
        # A coupled element carries the torque of the last joint that it acts on, on the rows of all of them.
        table = np.full(len(problem.runs) * samples, float(np.mean(bare[own])))
        table[problem.run[own] * samples + problem.place[own]] = bare[own]
        load = table[problem.run[rows.rows] * samples + problem.place[rows.rows]]
        size = max(float(np.sqrt(np.mean(bare[own] ** 2))), _LEAST)
        column[rows.rows] += rows.columns(shape)[0][:, COULOMB] * fit.linear[e, COULOMB] * load / size
    return column
