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
from rx90_emulator.identification.excitation.problem import ExcitationProblem

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


def load_dependence(weighted: WeightedProblem, fit: SeparableFit, columns: Array, without: LinearFit) -> LoadDependence:
    """Test whether friction grows with the load.

    Args:
        weighted: the rows.
        fit: of the friction.
        columns: of the whole model around the fit, shape (r, q).
        without: fit of these columns.
    """
    problem, arm = weighted.problem, weighted.problem.arm
    base = without.value[: len(problem.names)]
    # Of each element in parts of its Coulomb torque and of its load, which for a coupled one is the last joint's.
    bare = problem.regressor @ base
    last = [int(np.flatnonzero(share)[-1]) for share in arm.element_matrix]
    sizes = [max(float(np.sqrt(np.mean(bare[problem.joint == j] ** 2))), _LEAST) for j in last]
    column = load_dependent(problem, base)[1] @ (fit.linear[:, COULOMB] / sizes)
    wide = solve(problem, np.column_stack([columns, column]))
    value, deviation = float(wide.value[-1]), float(wide.deviation[-1])
    found = LoadDependence(value, deviation, wide.value[:-1] - without.value)
    return found if found.significant else found._replace(shift=np.zeros_like(found.shift))


def load_dependent(problem: ExcitationProblem, parameters: Array) -> tuple[tuple[str, ...], Array]:
    """Return names and columns, one for each element: |load| sign(v), Nm per unit of relative growth; (r, n_el).

    Where friction grows with the load and the model does not say so, Coulomb torques come out as those at the mean
    load, with deviations that know nothing of it. With these columns they are the torques of the unloaded gear.

    Args:
        problem: r rows.
        parameters: values of the problem's b base parameters, from a fit without these columns, shape (b,): they give
            the torque of the arm alone, which is the load. An element of a motor that turns with several joints
            carries the torque of that motor.
    """
    arm = problem.arm
    n = len(arm.names)
    together = [k for k in range(n) if np.count_nonzero(arm.coupling[k]) > 1]
    along = []
    for run, bare in zip(problem.runs, problem.bare_torque(parameters), strict=True):
        motors = bare @ np.linalg.inv(arm.coupling)
        load = np.abs(np.hstack([bare, motors[:, together]]))
        along.append((load * np.sign(run.velocity @ arm.element_matrix.T))[:, :, None])
    return tuple(f"{name}.load" for name in arm.element_names), problem.element_rows(along)
