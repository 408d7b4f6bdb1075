"""The simplest friction: Coulomb and viscous torque of each element."""

from __future__ import annotations

import numpy as np

from rx90_common.base.arrays import Array
from rx90_emulator.identification.excitation.problem import ExcitationProblem


def coulomb_viscous(problem: ExcitationProblem) -> tuple[tuple[str, ...], Array]:
    """Return names and columns, two for each element: sign(v) and v, the torques per tau_c and c2; shape (r, 2 n_el).

    The sign is of the filtered velocity at the full rate, and is filtered with the torque.
    """
    elements = problem.arm.element_matrix.T
    along = []
    for run in problem.runs:
        velocity = run.velocity @ elements
        along.append(np.stack([np.sign(velocity), velocity], axis=2))
    names = tuple(f"{name}.{part}" for name in problem.arm.element_names for part in ("tau_c", "c2"))
    return names, problem.element_rows(along)
