"""Whether the noise of a closed loop biases an identification: the identified model by instrumental variables, too."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from rx90_common.base.arrays import Array
from rx90_emulator.identification.excitation.friction.identify import linear_columns, with_linear
from rx90_emulator.identification.excitation.friction.law import LINEAR, steady_columns
from rx90_emulator.identification.excitation.friction.models import FittedElement, FrictionSelection
from rx90_emulator.identification.excitation.instruments import InstrumentalComparison, with_instruments
from rx90_emulator.identification.excitation.prior import Prior
from rx90_emulator.identification.excitation.problem import ExcitationProblem
from rx90_emulator.identification.excitation.result import NOT_DETERMINED, BaseParameter
from rx90_emulator.identification.model.estimates import ParameterEstimate

_STEP = 2e-3  # rad/s, of the table of the simulated friction
_FASTEST = 30.0  # rad/s, where it ends
_NO_FRICTION = "instrumental variables give an element friction that is not positive"


def check_closed_loop(
    problem: ExcitationProblem, friction: FrictionSelection, prior: Prior | None = None
) -> tuple[InstrumentalComparison, FrictionSelection]:
    """Compare least squares with instrumental variables, all linear parameters free and the friction's shapes kept.

    Args:
        problem: the rows.
        friction: that was selected on them.
        prior: of the base parameters.

    Returns:
        The comparison, and the friction with the values that it speaks for.
    """
    size = len(problem.names)

    def columns_of(other: ExcitationProblem) -> tuple[tuple[str, ...], Array]:
        names, columns = linear_columns(friction, other)
        return other.names + names, np.hstack([other.regressor, columns])

    def law_of(values: Array) -> Callable[[Array], Array]:
        return _steady_law(friction.fitted, linear, values[size:])

    linear = linear_columns(friction, problem)[0]
    found = with_instruments(problem, columns_of, law_of, prior=prior)
    if found.biased and (found.instrumental.value[size:] <= 0.0).any():
        found = replace(found, biased=False, reason=f"least squares are taken: {_NO_FRICTION}")
    if found.biased:
        friction = with_linear(friction, problem, problem.names + linear, found.instrumental)
    return found, friction


def remark(comparison: InstrumentalComparison) -> str:
    """Return in one sentence what the comparison says, and which values are reported."""
    which = "instrumental variables" if comparison.biased else "least squares"
    return f"{comparison.reason}; {comparison.controller}; all values written are by {which}"


def with_other(base: Sequence[BaseParameter], comparison: InstrumentalComparison) -> tuple[BaseParameter, ...]:
    """Return base parameters with their values by the other one of least squares and instrumental variables."""
    fit = comparison.least_squares if comparison.biased else comparison.instrumental
    rows = zip(base, fit.value.tolist(), fit.deviation.tolist(), strict=False)  # friction follows the base parameters
    return tuple(
        replace(one, other=ParameterEstimate(value, deviation))
        if one.estimate.identifiable and np.isfinite(deviation)
        else replace(one, other=ParameterEstimate.unknown(NOT_DETERMINED))
        for one, value, deviation in rows
    )


def _steady_law(fitted: Sequence[FittedElement], names: Sequence[str], values: Array) -> Callable[[Array], Array]:
    """Return the elements' sliding friction for values of their linear parameters; bristles are left out.

    A simulation asks for it at every step: it is read off a table of speeds.
    """
    known = dict(zip(names, values.tolist(), strict=True))
    linear = np.array([[known.get(f"{one.element}.{name}", 0.0) for name in LINEAR] for one in fitted])
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
