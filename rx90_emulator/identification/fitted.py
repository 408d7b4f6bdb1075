"""Rigid body and friction of excitation runs, fitted together: chosen laws, values with deviations, and the reasons.

A value that the runs do not determine has a reason in place of a deviation. The fitted curve stands in the files all
the same: it predicts the torque, even where its parameters could be exchanged for each other.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from rx90_common.base.arrays import Array
from rx90_common.estimation.choose import Choice, choose, without_bound_parts
from rx90_common.estimation.deviations import Deviations, law_deviations
from rx90_common.estimation.elements import fit_laws
from rx90_common.estimation.fit import Fit
from rx90_common.estimation.law import Law, Part
from rx90_common.friction import FrictionElement
from rx90_emulator.identification.arm import RigidArm
from rx90_emulator.identification.estimates import (
    PARAMETERS,
    Estimates,
    FittedLaw,
    IdentifiedElement,
    ParameterEstimate,
    fitted_laws,
    least_coulomb,
    unknown_estimates,
    with_passive_fading,
)
from rx90_emulator.identification.records import BagSource
from rx90_emulator.identification.rows.excitation import ExcitationProblem

TRIED = (Part.STRIBECK, Part.EXPONENT, Part.BRISTLE)
"""Parts of the friction that runs are asked for, with delta = 1."""
ROWS_PER_PARAMETER = 2.0
"""Of the simplest model, from which parts are chosen: fewer rows predict nothing."""
MOST_RELATIVE_DEVIATION = 0.5
"""Of omega_s, delta, alpha, c0 and c1, up to which they are identified."""
PRESLIDING_DISTANCE = 2.5e-4
"""rad, at break-away where no c0 is known: that of the shipped RX90B's large joints."""
LEAST_SHARE = 1e-3
"""tau_c over tau_s of friction that falls to none at last: an element has some."""
RELAXATION = 1e-3
"""s, c1 over c0 where no c1 is known, as there."""
ASSUMED = "no file: bristles that break away after 0.25 mrad are assumed, and the least Coulomb torque of the others"
"""Source, in words, of values that are not identified, without a fallback."""
PART_OF = {
    "tau_s_positive": Part.STRIBECK,
    "tau_s_negative": Part.STRIBECK,
    "omega_s": Part.STRIBECK,
    "delta": Part.STRIBECK_EXPONENT,
    "alpha": Part.EXPONENT,
    "c0": Part.BRISTLE,
    "c1": Part.BRISTLE,
}
"""The part that each parameter belongs to."""


@dataclass(frozen=True, eq=False)
class FittedArm(Deviations):
    """A fit of all elements' laws and the base parameters, with their deviations.

    Attributes:
        arm: whose elements these are.
        laws: of the elements.
        fit: of friction, q parameters, and of b base parameters.
        tried: parts of the friction that the runs were asked for.
        base_names: of the base parameters.
        speeds: least and greatest speed with data of each element, rad/s; 0 for one that rests.
    """

    arm: RigidArm
    laws: tuple[Law, ...]
    fit: Fit
    tried: tuple[Part, ...]
    base_names: tuple[str, ...]
    speeds: tuple[tuple[float, float], ...]

    @property
    def names(self) -> tuple[str, ...]:
        """Return the names of the values: `element.parameter`, then base parameters, shape (q + b,)."""
        elements = zip(self.arm.element_names, self.laws, strict=True)
        return (
            *(f"{name}.{parameter}" for name, law in elements for parameter in law.names),
            *self.base_names,
        )

    @property
    def values(self) -> Array:
        """Return the fitted values, shapes by their logarithms, shape (q + b,)."""
        return np.concatenate([self.fit.x, self.fit.linear])

    def predicted(self, problem: ExcitationProblem) -> Array:
        """Return the torque of the rows of runs of the same arm, Nm, shape (r,)."""
        friction = problem.friction_rows().problem(self.laws).model(self.fit.x)[0]
        return friction + problem.regressor @ self.fit.linear

    @property
    def elements(self) -> list[FittedLaw]:
        """Return the fitted law of each element."""
        return fitted_laws(self.laws, self.fit, self)

    def estimates(self, number: int) -> Estimates:
        """Return the estimates of an element by the names of FrictionElement; shared by both directions."""
        if self.speeds[number][1] == 0.0:
            return unknown_estimates(PARAMETERS, "at rest in all runs")
        estimates = self.elements[number].estimates(_doubt)
        for name in PARAMETERS:
            if name not in estimates:
                estimates[name] = ParameterEstimate.unknown(self._missing(number, PART_OF[name]))
        return {name: estimates[name] for name in PARAMETERS}

    def _missing(self, number: int, part: Part) -> str:
        """Return why an element does not have a part."""
        lone = part is Part.BRISTLE and Part.STRIBECK not in self.laws[number].parts
        return (
            f"{part.value} was not tried"
            if lone or part not in self.tried
            else f"no {part.value} shows"
        )


def _doubt(name: str, value: float, deviation: float, determined: bool) -> str:
    """Return why a parameter is not identified; "" if it is."""
    if name.startswith("tau_c") and value <= 0.0:
        return "no Coulomb friction shows"
    if name == "c2" and value <= 0.0:
        return "no viscous friction shows"
    if not determined:
        return "the runs do not determine it"
    if (
        name in PART_OF
        and not name.startswith("tau")
        and deviation > MOST_RELATIVE_DEVIATION * value
    ):
        return f"standard deviation {deviation:.3g} at a value of {value:.3g}"
    return ""


def fit_arm(
    problem: ExcitationProblem,
    parts: Sequence[Part] = TRIED,
    *,
    fixed: bool = False,
) -> FittedArm:
    """Fit rigid body and friction together.

    Args:
        problem: the rows.
        parts: to try beside Coulomb and viscous friction.
        fixed: whether all elements have the parts, without a choice.
    """
    rows = problem.friction_rows()
    if fixed:
        tried = parts
        laws = [Law(frozenset(parts))] * len(rows.elements)
        chosen = without_bound_parts(rows, Choice(tuple(laws), fit_laws(rows, laws)))
    else:
        tried = parts if len(problem) >= ROWS_PER_PARAMETER * problem.parameters else ()
        chosen = choose(rows, tried, [Law()] * len(rows.elements))
    known = law_deviations(rows, chosen.laws, chosen.fit, tried)
    return FittedArm(
        arm=problem.arm,
        laws=chosen.laws,
        fit=chosen.fit,
        **vars(known),
        tried=tuple(tried),
        base_names=problem.names,
        speeds=tuple((element.speeds.low, element.speeds.high) for element in rows.elements),
    )


def simplest_fit(problem: ExcitationProblem) -> FittedArm:
    """Return the fit with Coulomb and viscous friction alone, which any other is held against."""
    return fit_arm(problem, (), fixed=True)


def identified_elements(
    fitted: FittedArm, fallback: Sequence[FrictionElement] | None, bags: tuple[BagSource, ...]
) -> tuple[IdentifiedElement, ...]:
    """Return the elements with values for all parameters.

    Bristles, without which an arm cannot stand still, are the fallback's, or else have the presliding distance of large
    joints; both are assumptions. So is the friction of an element without a Coulomb torque: the fallback's, or else the
    least Coulomb torque of the other elements.

    Args:
        fitted: the fit.
        fallback: elements in the same order; None if there are none.
        bags: that were fitted.
    """
    estimates = [fitted.estimates(number) for number in range(len(fitted.laws))]
    least = least_coulomb(dict(zip(fitted.arm.element_names, estimates, strict=True)), fallback)
    elements = []
    for number, own in enumerate(estimates):
        other = None if fallback is None else fallback[number]
        element = _element(fitted, number, other, least)
        elements.append(IdentifiedElement(element, own, dict.fromkeys(own, bags)))
    return tuple(elements)


def _element(
    fitted: FittedArm, number: int, other: FrictionElement | None, least: float
) -> FrictionElement:
    """Return an element; `other`, or the `least` Coulomb torque and assumed bristles, replace what is missing."""
    law, x, *_ = fitted.elements[number]
    if fitted.speeds[number][1] == 0.0:
        if other is not None:
            return other
        law = Law()
        x = np.zeros(len(law.names))
    coulomb = law.names.index("tau_c")
    static = law.natural(x)[0].get("tau_s_positive", float(x[coulomb]))
    if x[coulomb] <= 0.0:
        x = x.copy()
        x[coulomb] = LEAST_SHARE * static or (least if other is None else other.tau_c.positive)
    stiffness = max(static, float(x[coulomb])) / PRESLIDING_DISTANCE
    assumed: dict[str, float] = {"c0": stiffness, "c1": stiffness * RELAXATION}
    if other is not None:
        assumed = {"c0": other.c0, "c1": other.c1, "omega_d": other.omega_d}
    element = law.element(x, assumed)
    if Part.BRISTLE in law.parts or other is None:
        return with_passive_fading(element, other)
    return element
