"""The simplest friction: Coulomb and viscous torque of each element."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from rx90_common.base.arrays import Array
from rx90_emulator.identification.excitation.problem import ExcitationProblem


def coulomb_viscous(problem: ExcitationProblem) -> tuple[tuple[str, ...], Array]:
    """Return names and columns, two for each element: sign(v) and v, the torques per tau_c and c2; shape (r, 2 n_el).

    The sign is of the filtered velocity at the full rate, where the torque was recorded, and is filtered with it.
    """
    elements = problem.arm.element_matrix.T
    along = []
    for run in problem.runs:
        velocity = run.torque_velocity @ elements
        along.append(run.evened(np.stack([np.sign(velocity), velocity], axis=2)))
    names = tuple(f"{name}.{part}" for name in problem.arm.element_names for part in ("tau_c", "c2"))
    return names, problem.element_rows(along)


def coulomb_viscous_law(parameters: Array) -> Callable[[Array], Array]:
    """Return the elements' torques as a function of their velocities, both of shape (n_el,).

    Args:
        parameters: tau_c and c2 of each element, as the columns are sorted, shape (2 n_el,).
    """
    coulomb, viscous = parameters.reshape(-1, 2).T
    return lambda velocity: np.asarray(np.sign(velocity) * coulomb + viscous * velocity)
