"""The simplest friction: Coulomb and viscous torque of each element."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from rx90_common.base.arrays import Array
from rx90_common.base.errors import IdentificationError
from rx90_emulator.identification.excitation.least_squares import solve
from rx90_emulator.identification.excitation.problem import ExcitationProblem

_SURE = 6.0  # deviations


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


def check_signs(problem: ExcitationProblem) -> None:
    """Refuse torques of an element that drive the motion instead of opposing it, beyond any doubt.

    Raises:
        IdentificationError: naming the element and its Coulomb torque.
    """
    columns = coulomb_viscous(problem)[1]
    fit, first = solve(problem, np.hstack([problem.regressor, columns])), len(problem.names)
    value, deviation, told = (part[first:].tolist() for part in (fit.value, fit.deviation, fit.determined))
    for k, name in enumerate(problem.arm.element_names):
        coulomb, viscous = 2 * k, 2 * k + 1
        if told[coulomb] and told[viscous] and value[viscous] < 0.0 and value[coulomb] < -_SURE * deviation[coulomb]:
            raise IdentificationError(
                f"{name}: the torque does not oppose the motion (Coulomb torque {value[coulomb]:.3g} +- "
                f"{deviation[coulomb]:.2g} Nm); accepted: efforts of the sign with which the drive moves the joint "
                "(check the signs of gears and torque constants)"
            )


def coulomb_viscous_law(parameters: Array) -> Callable[[Array], Array]:
    """Return the elements' torques as a function of their velocities, both of shape (n_el,).

    Args:
        parameters: tau_c and c2 of each element, as the columns are sorted, shape (2 n_el,).
    """
    coulomb, viscous = parameters.reshape(-1, 2).T
    return lambda velocity: np.asarray(np.sign(velocity) * coulomb + viscous * velocity)
