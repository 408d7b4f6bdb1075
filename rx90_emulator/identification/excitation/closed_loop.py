"""Whether the noise of a closed loop biases an identification: the identified model by instrumental variables, too."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from rx90_common.base.arrays import Array
from rx90_emulator.identification.excitation.friction.columns import element_rows
from rx90_emulator.identification.excitation.friction.law import DAMPING, LINEAR, Part, steady_columns
from rx90_emulator.identification.excitation.friction.models import FittedElement, FrictionSelection
from rx90_emulator.identification.excitation.instruments import InstrumentalComparison, with_instruments
from rx90_emulator.identification.excitation.problem import ExcitationProblem
from rx90_emulator.identification.excitation.result import BaseParameter
from rx90_emulator.identification.model.estimates import ParameterEstimate

_STEP = 2e-3  # rad/s, of the table of the simulated friction
_FASTEST = 30.0  # rad/s, where it ends


def check_closed_loop(problem: ExcitationProblem, friction: FrictionSelection) -> InstrumentalComparison:
    """Compare least squares with instrumental variables, all linear parameters free and the friction's shapes kept.

    Args:
        problem: the rows.
        friction: that was selected on them.
    """
    size, places = len(problem.names), [_linear(one) for one in friction.fitted]

    def columns_of(other: ExcitationProblem) -> tuple[tuple[str, ...], Array]:
        names, parts = list(other.names), [other.regressor]
        for one, rows, taken in zip(friction.fitted, element_rows(other), places, strict=True):
            part = np.zeros((len(other), len(taken)))
            part[rows.rows] = rows.columns(one.shape)[0][:, taken]
            parts.append(part)
            names += [f"{one.element}.{LINEAR[k]}" for k in taken]
        return tuple(names), np.hstack(parts)

    def law_of(values: Array) -> Callable[[Array], Array]:
        return _steady_law(friction.fitted, places, values[size:])

    return with_instruments(problem, columns_of, law_of)


def remark(comparison: InstrumentalComparison) -> str:
    """Return in one sentence what the comparison says of the values that are reported, which are least squares."""
    warning = ""
    if comparison.biased:
        warning = "; the values of this report are by least squares, those by instrumental variables stand beside them"
    return f"{comparison.reason}; {comparison.controller}{warning}"


def with_instrumental(base: Sequence[BaseParameter], comparison: InstrumentalComparison) -> tuple[BaseParameter, ...]:
    """Return base parameters with their values by instrumental variables."""
    fit = comparison.instrumental
    rows = zip(base, fit.value.tolist(), fit.deviation.tolist(), strict=False)  # friction follows the base parameters
    return tuple(
        replace(one, instrumental=ParameterEstimate(value, deviation))
        if np.isfinite(deviation)
        else replace(one, instrumental=ParameterEstimate.unknown("the instruments do not determine it"))
        for one, value, deviation in rows
    )


def _linear(one: FittedElement) -> list[int]:
    """Return the places in LINEAR of the parameters that an element has."""
    damped = Part.DAMPING in one.shape.parts
    return [k for k in range(len(LINEAR)) if k != DAMPING or damped]


def _steady_law(
    fitted: Sequence[FittedElement], places: Sequence[Sequence[int]], values: Array
) -> Callable[[Array], Array]:
    """Return the elements' sliding friction for values of their linear parameters; bristles are left out.

    A simulation asks for it at every step: it is read off a table of speeds.
    """
    linear = np.zeros((len(fitted), len(LINEAR)))
    first = 0
    for row, taken in zip(linear, places, strict=True):
        row[list(taken)] = values[first : first + len(taken)]
        first += len(taken)
    speeds = np.arange(0.0, _FASTEST, _STEP) + 1e-9  # just above rest, where the sign counts already
    pairs = zip(fitted, linear, strict=True)
    table = np.array([steady_columns(one.shape, speeds)[0] @ row for one, row in pairs])
    element = np.arange(len(fitted))

    def law(velocity: Array) -> Array:
        place = np.minimum(np.abs(velocity) / _STEP, len(speeds) - 1.001)
        low = place.astype(np.intp)
        share = place - low
        torque = (1.0 - share) * table[element, low] + share * table[element, low + 1]
        return np.asarray(np.sign(velocity) * torque)

    return law
