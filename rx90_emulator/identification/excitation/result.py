"""What an identification from excitation runs returns: parameters, torques and predictions, elements to simulate.

What the runs did not determine, the arm that the files hold, and the identified friction as elements that can be
simulated: what the runs do not tell is assumed, and marked.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np

from rx90_common.base.arrays import Array
from rx90_common.base.errors import IdentificationError
from rx90_common.friction import FrictionElement
from rx90_emulator.identification.estimates import ElementEstimate, IdentifiedElement, ParameterEstimate
from rx90_emulator.identification.excitation.bodies import Consistency
from rx90_emulator.identification.excitation.choice import ModelRow
from rx90_emulator.identification.excitation.fit import LinearFit
from rx90_emulator.identification.excitation.friction import FrictionSelection
from rx90_emulator.identification.excitation.instruments import InstrumentalComparison
from rx90_emulator.identification.excitation.known_payload import DriveGains, LoadParts
from rx90_emulator.identification.excitation.law import overall
from rx90_emulator.identification.excitation.problem import ExcitationProblem
from rx90_emulator.identification.excitation.torques import (
    RunTorques,
    SpeedResiduals,
    TorqueValidation,
    Trend,
    residuals_by_speed,
    unexplained,
)
from rx90_emulator.identification.options import RobotOptions
from rx90_emulator.identification.records import BagSource
from rx90_emulator.identification.robot import RecordedRobot
from rx90_emulator.identification.zeros import ZeroCheck

UNITS = {"m": "kg", "mx": "kg m", "my": "kg m", "mz": "kg m", "k": "Nm", "offset": "Nm"}
"""Units of base parameters by the first word of their names; of all others kg m^2."""
NOT_DETERMINED = "these runs do not determine it"


@dataclass(frozen=True)
class BaseParameter:
    """A combination of inertial parameters, or another linear one, that the torque depends on.

    Attributes:
        name: short, such as mzR_2: the R says that others have joined it.
        group: in words, such as "mz_2 + 0.45 m_3".
        unit: SI.
        estimate: together with the friction, by weighted least squares, or by instrumental variables where these are
            taken.
        consistent: its value by the physically consistent inertias.
        other: by the other one of least squares and instrumental variables.
    """

    name: str
    group: str
    unit: str
    estimate: ParameterEstimate
    consistent: float
    other: ParameterEstimate


@dataclass(frozen=True, eq=False)
class ExcitationIdentification:
    """An arm's dynamics from excitation runs.

    Attributes:
        robot: that the runs come from.
        options: that describe it.
        problem: the equations of the runs.
        friction: what was compared, and the friction that was kept.
        elements: of the friction, to simulate with, and what is known of each parameter.
        base: linear parameters but friction.
        consistency: inertias that bodies can have, near to these.
        torques: recorded against predicted, of each run that was used.
        validations: the same of runs that were not used, with a verdict.
        trends: drifts within a run.
        bags: what was read, by use: excitation, validation.
        instruments: least squares against instrumental variables.
        zeros: which encoder zeros seem wrong.
        gains: of the drives, by which the recorded torques were multiplied; None without a known payload.
        loads: the friction's load parts, whose torque the problem's is less of; None where they were not asked for.
        notes: what of the recordings was left out or bridged, and what they cannot tell.
    """

    robot: RecordedRobot
    options: RobotOptions
    problem: ExcitationProblem
    friction: FrictionSelection
    elements: tuple[IdentifiedElement, ...]
    base: tuple[BaseParameter, ...]
    consistency: Consistency
    torques: tuple[RunTorques, ...]
    validations: tuple[TorqueValidation, ...]
    trends: tuple[Trend, ...]
    bags: tuple[tuple[str, BagSource], ...]
    instruments: InstrumentalComparison
    zeros: ZeroCheck
    gains: DriveGains | None = None
    loads: LoadParts | None = None
    notes: tuple[str, ...] = ()

    @cached_property
    def speeds(self) -> tuple[SpeedResiduals, ...]:
        """Return what is left at each speed of the elements."""
        return residuals_by_speed(self.problem, self.problem.torque - self.friction.predicted)

    @property
    def speed_ranges(self) -> tuple[tuple[float, float], ...]:
        """Return the least and the greatest speed of each element at which there were data, rad/s; 0 for none."""
        return tuple(overall(one.ranges) for one in self.friction.fitted)

    @property
    def unit(self) -> str:
        """Return the unit of the torques: Nm, or A without torque constants; all values are in its scale."""
        return self.problem.runs[0].source.unit

    @property
    def base_covariance(self) -> Array:
        """Return the covariance of the base parameters in the order of `base`, SI units, shape (b, b).

        Infinite on the diagonal where these runs do not determine one.
        """
        count = len(self.base)
        return self.friction.fit.covariance[:count, :count]

    @property
    def undetermined(self) -> tuple[str, ...]:
        """Return the names of base parameters that these runs do not determine."""
        return tuple(one.name for one in self.base if not one.estimate.identifiable)

    @cached_property
    def warnings(self) -> tuple[str, ...]:
        """Return which values are not to be trusted, and why, a sentence each."""
        return (*self._assumed.values(), *unexplained(self.torques).values(), *self.friction.warnings)

    @property
    def element_notes(self) -> dict[str, str]:
        """Return the same of the friction of single elements, by their names."""
        arm, poor = self.problem.arm, unexplained(self.torques)
        last = [arm.names[np.flatnonzero(row)[-1]] for row in arm.element_matrix]
        found = {name: poor[joint] for name, joint in zip(arm.element_names, last, strict=True) if joint in poor}
        return found | {name: "; ".join(filter(None, (text, found.get(name)))) for name, text in self._assumed.items()}

    @cached_property
    def _assumed(self) -> dict[str, str]:
        named = zip(self.problem.arm.element_names, self.elements, strict=True)
        return assumed_friction(dict(named), self.robot.fallback_name)

    @property
    def confirmed(self) -> bool:
        """Return whether every validation agrees; True without any."""
        return all(check.passed for check in self.validations)

    @property
    def model(self) -> ModelRow:
        """Return the row of the model that was kept."""
        return next(row for row in reversed(self.friction.models) if row.kept)


def base_parameters(
    problem: ExcitationProblem,
    friction: FrictionSelection,
    consistency: Consistency,
    comparison: InstrumentalComparison,
) -> tuple[BaseParameter, ...]:
    """Return the linear parameters but friction with their deviations, and by the other fit of a comparison."""
    fit, other = friction.fit, comparison.least_squares if comparison.biased else comparison.instrumental
    unknown, none = undetermined(problem, fit), ParameterEstimate.unknown(NOT_DETERMINED)
    found = []
    for k, (name, group) in enumerate(zip(problem.names, problem.base.groups, strict=True)):
        estimate, second = (ParameterEstimate(float(one.value[k]), float(one.deviation[k])) for one in (fit, other))
        told = name not in unknown
        second = second if told and math.isfinite(second.deviation) else none
        unit = UNITS.get(name.split("_")[0].rstrip("R"), "kg m^2")
        near = float(consistency.inertias.base[k])
        found.append(BaseParameter(name, group, unit, estimate if told else none, near, second))
    return tuple(found)


def undetermined(problem: ExcitationProblem, fit: LinearFit) -> tuple[str, ...]:
    """Return the base parameters that these runs do not determine, by name.

    One deviation of such a parameter alone would move torques by more than the torques' own RMS: the data would bear
    any value that an arm may have.

    Args:
        problem: r rows.
        fit: of the base parameters, and of others behind them.
    """
    count, size = len(problem.names), float(np.sqrt(np.mean(problem.torque**2)))
    known = fit.determined[:count]
    effect = np.where(known, fit.deviation[:count], 0.0) * np.sqrt(np.mean(problem.regressor**2, axis=0))
    good = (known & (effect < size)).tolist()
    return tuple(name for name, one in zip(problem.names, good, strict=True) if not one)


_PRESLIDING_DISTANCE = 2.5e-4  # rad, at break-away where no c0 is known: that of the shipped RX90B's large joints
ASSUMED = "no file: bristles that break away after 0.25 mrad are assumed, and the least Coulomb torque of the others"
"""Where what is not identified comes from without a fallback, in words."""
_BRISTLE_RELAXATION = 1e-3  # s, c1 over c0 where no c1 is known, as there
_DAMPING_FADE_SPEED = 1.0  # rad/s, omega_d beside such a c1: the element is passive then at every speed
_NEUTRAL = {"omega_s": 0.1, "delta": 1.0, "c2": 0.0}  # of no effect while tau_s = tau_c


def simulated_elements(
    estimates: Sequence[ElementEstimate],
    fallback: Sequence[FrictionElement] | None,
    loads: LoadParts | None = None,
) -> tuple[IdentifiedElement, ...]:
    """Return the elements with values for all parameters.

    A part that the model does not have is switched off: tau_s = tau_c, alpha = 1. Bristles, which an arm needs to stand
    still, come from the fallback, else from the presliding distance of large joints; both are assumptions. So is the
    friction of an element without an identified Coulomb torque: that of the fallback, else the least Coulomb torque of
    the others.

    Args:
        estimates: by the names of FrictionElement.
        fallback: elements in the same order; None if there are none.
        loads: the load parts; None where they were not asked for.

    Raises:
        IdentificationError: naming the elements, if no Coulomb torque is identified and there is no fallback.
    """
    known = [one.parameters[_COULOMB[0]].value for one in estimates if _slides(one.parameters)]
    if not known and fallback is None:
        reasons = "; ".join(f"{one.element}: {one.parameters[_COULOMB[0]].reason}" for one in estimates)
        raise IdentificationError(
            f"no friction of any element is identified ({reasons}); accepted: runs that tell some, or --fallback with "
            "a friction file"
        )
    found = []
    for number, (one, other) in enumerate(zip(estimates, fallback or (None,) * len(estimates), strict=True)):
        values = dict(one.parameters)
        if not any(estimate.identifiable for estimate in values.values()) and other is not None:
            element = other
        else:
            element = _element(values, other, min(known, default=0.0))
        if loads is not None:
            element, values = replace(element, load=loads.part(number)), values | loads.estimates(number)
        found.append(IdentifiedElement.of(element, values, dict.fromkeys(values, one.sources), other))
    return tuple(found)


_COULOMB = ("tau_c_positive", "tau_c_negative")


def _slides(estimates: Mapping[str, ParameterEstimate]) -> bool:
    """Return whether an element has an identified Coulomb torque, which is the same in both directions."""
    return estimates[_COULOMB[0]].identifiable


def assumed_friction(elements: Mapping[str, IdentifiedElement], fallback_name: str | None) -> dict[str, str]:
    """Return, in words by element, whose Coulomb torque is assumed, why, and where it comes from."""
    whose = "the least of the others" if fallback_name is None else f"that of {fallback_name}"
    missing = {name: one.estimates[_COULOMB[0]] for name, one in elements.items() if not _slides(one.estimates)}
    return {
        name: f"the friction of {name} is not identified ({estimate.reason}); assumed is a Coulomb torque of "
        f"{elements[name].element.tau_c_positive:.3g} Nm, {whose}"
        for name, estimate in missing.items()
    }


def _element(known: Mapping[str, ParameterEstimate], other: FrictionElement | None, least: float) -> FrictionElement:
    """Return an element; `other` or the `least` Coulomb torque stand in for what is not known."""
    found: dict[str, Any] = {parameter: one.value for parameter, one in known.items() if one.identifiable}
    for sign in ("positive", "negative"):
        coulomb = f"tau_c_{sign}"
        found.setdefault(coulomb, least if other is None else float(getattr(other, coulomb)))
        found[f"tau_s_{sign}"] = max(found.get(f"tau_s_{sign}", 0.0), found[coulomb])
    found = _NEUTRAL | found
    mean = 0.5 * (found["tau_c_positive"] + found["tau_c_negative"])
    found.setdefault("c0", mean / _PRESLIDING_DISTANCE if other is None else other.c0)
    if "c1" not in found:
        found["c1"] = found["c0"] * _BRISTLE_RELAXATION if other is None else other.c1
        found["omega_d"] = _DAMPING_FADE_SPEED if other is None else other.omega_d
    return FrictionElement(**found)
