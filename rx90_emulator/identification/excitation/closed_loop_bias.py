"""Whether noise in the closed loop biases the fit: the selected model once more, by instrumental variables."""

from __future__ import annotations

import numpy as np

from rx90_common.base.arrays import Array
from rx90_emulator.identification.excitation.auxiliary import Friction
from rx90_emulator.identification.excitation.friction.columns import element_rows
from rx90_emulator.identification.excitation.friction.law import LINEAR, steady_columns
from rx90_emulator.identification.excitation.friction.models import FrictionSelection
from rx90_emulator.identification.excitation.instruments import InstrumentalComparison, with_instruments
from rx90_emulator.identification.excitation.problem import ExcitationProblem


def compare_with_instruments(problem: ExcitationProblem, friction: FrictionSelection) -> InstrumentalComparison:
    """Fit the selected model by least squares and by instrumental variables, linear around its non-linear parameters.

    Args:
        problem: the equations.
        friction: the model; the compared values have the problem's
            names first, then the friction's in its order; those of non-linear parameters are changes.
    """
    count = len(problem.names)
    elements = problem.arm.element_names
    free = {one.element: (*LINEAR, *one.shape.free) for one in friction.fitted}
    pairs = [(name[: name.rindex(".")], name[name.rindex(".") + 1 :]) for name in friction.names[count:]]
    # Exponents that were not kept are in the covariance alone.
    places = [(element, name) for element, name in pairs if name in free[element]]
    names = (*problem.names, *(f"{element}.{name}" for element, name in places))

    def columns_of(other: ExcitationProblem) -> tuple[tuple[str, ...], Array]:
        found = {}
        for one, rows in zip(friction.fitted, element_rows(other), strict=True):
            columns, derivatives = rows.columns(one.shape)
            parts = {name: columns[:, k] for k, name in enumerate(LINEAR)}
            parts |= {name: values @ one.linear for name, values in derivatives.items()}
            for name, values in parts.items():
                found[one.element, name] = np.zeros(len(other))
                found[one.element, name][rows.rows] = values
        return names, np.column_stack([other.regressor, *(found[place] for place in places)])

    def friction_of(values: Array) -> Friction:
        linear = np.array([one.linear for one in friction.fitted])
        for (element, name), value in zip(places, values[count:].tolist(), strict=True):
            if name in LINEAR:
                linear[elements.index(element), LINEAR.index(name)] = value
        shapes = [one.shape for one in friction.fitted]

        def torque(velocity: Array) -> Array:
            steady = [steady_columns(shape, velocity[k : k + 1])[0][0] for k, shape in enumerate(shapes)]
            return np.asarray(np.einsum("ek,ek->e", np.array(steady), linear))

        return torque

    return with_instruments(problem, columns_of, friction_of)
