"""What an identification from excitation runs returns.

From the identified friction to elements that can be simulated: what the runs do not tell is assumed, and marked.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np

from rx90_common.base.errors import IdentificationError
from rx90_common.friction import FrictionElement
from rx90_emulator.identification.estimates import ElementEstimate, IdentifiedElement, ParameterEstimate
from rx90_emulator.identification.excitation.consistency import Consistency
from rx90_emulator.identification.excitation.friction.estimates import FrictionSelection
from rx90_emulator.identification.excitation.friction.selection import ModelRow
from rx90_emulator.identification.excitation.gains import DriveGains
from rx90_emulator.identification.excitation.instruments import InstrumentalComparison
from rx90_emulator.identification.excitation.load_parts import LoadParts
from rx90_emulator.identification.excitation.problem import ExcitationProblem
from rx90_emulator.identification.excitation.torques import (
    RunTorques,
    SpeedResiduals,
    TorqueValidation,
    Trend,
    residuals_by_speed,
    undetermined,
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
        other: by the other one of least squares and instrumental variables; None where they were not compared.
    """

    name: str
    group: str
    unit: str
    estimate: ParameterEstimate
    consistent: float
    other: ParameterEstimate | None = None


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

    @cached_property
    def speeds(self) -> tuple[SpeedResiduals, ...]:
        """Return what is left at each speed of the elements."""
        return residuals_by_speed(self.problem, self.problem.torque - self.friction.predicted)

    @property
    def undetermined(self) -> tuple[str, ...]:
        """Return the names of base parameters that these runs do not determine."""
        return tuple(one.name for one in self.base if not one.estimate.identifiable)

    @property
    def confirmed(self) -> bool:
        """Return whether every validation agrees; True without any."""
        return all(check.passed for check in self.validations)

    @property
    def model(self) -> ModelRow:
        """Return the row of the model that was kept."""
        return next(row for row in reversed(self.friction.models) if row.kept)


def base_parameters(
    problem: ExcitationProblem, friction: FrictionSelection, consistency: Consistency
) -> tuple[BaseParameter, ...]:
    """Return the linear parameters but friction with their deviations."""
    count, fit = len(problem.names), friction.fit
    unknown = undetermined(problem, fit)
    estimates = [
        ParameterEstimate.unknown(NOT_DETERMINED) if name in unknown else ParameterEstimate(value, deviation)
        for name, value, deviation in zip(
            problem.names, fit.value[:count].tolist(), fit.deviation[:count].tolist(), strict=True
        )
    ]
    consistent = consistency.inertias.base.tolist()
    rows = zip(problem.names, problem.base.groups, estimates, consistent, strict=True)
    return tuple(
        BaseParameter(name, group, UNITS.get(name.split("_")[0].rstrip("R"), "kg m^2"), estimate, near)
        for name, group, estimate, near in rows
    )


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


_PRESLIDING_DISTANCE = 2.5e-4  # rad, at break-away where no c0 is known: that of the shipped RX90B's large joints
ASSUMED_BRISTLES = "no file: bristles that break away after 0.25 mrad are assumed"
"""Where c0, c1 and omega_d come from without a fallback, in words."""
_BRISTLE_RELAXATION = 1e-3  # s, c1 over c0 where no c1 is known, as there
_DAMPING_FADE_SPEED = 1.0  # rad/s, omega_d beside such a c1: the element is passive then at every speed
_NEUTRAL_STRIBECK = {"omega_s": 0.1, "delta": 1.0}  # of no effect while tau_s = tau_c


def simulated_elements(
    estimates: Sequence[ElementEstimate],
    fallback: Sequence[FrictionElement] | None,
    loads: LoadParts | None = None,
) -> tuple[IdentifiedElement, ...]:
    """Return the elements with values for all parameters.

    A part that the model does not have is switched off: tau_s = tau_c, alpha = 1. Bristles, which an arm needs to stand
    still, come from the fallback, else from the presliding distance of large joints; both are assumptions.

    Args:
        estimates: by the names of FrictionElement.
        fallback: elements in the same order; None if there are none.
        loads: the load parts; None where they were not asked for.

    Raises:
        IdentificationError: for an element without an identified Coulomb torque, if there is no fallback.
    """
    others = fallback or (None,) * len(estimates)
    found = []
    for number, (one, other) in enumerate(zip(estimates, others, strict=True)):
        element, known = _element(one.element, one.parameters, other), dict(one.parameters)
        if loads is not None:
            element, known = replace(element, load=loads.part(number)), known | loads.estimates(number)
        found.append(IdentifiedElement.of(element, known, dict.fromkeys(known, one.sources), other))
    return tuple(found)


def _element(name: str, known: Mapping[str, ParameterEstimate], other: FrictionElement | None) -> FrictionElement:
    found: dict[str, Any] = {parameter: one.value for parameter, one in known.items() if one.identifiable}
    for sign in ("positive", "negative"):
        coulomb = f"tau_c_{sign}"
        if found.get(coulomb, 0.0) <= 0.0:
            if other is None:
                reason = known[coulomb].reason if coulomb in known and not known[coulomb].identifiable else "it is 0"
                raise IdentificationError(
                    f"{name}: {coulomb} is not identifiable from these runs ({reason}); accepted: runs in which it is, "
                    "or --fallback with a friction file for such values"
                )
            found[coulomb] = float(getattr(other, coulomb))
        found[f"tau_s_{sign}"] = max(found.get(f"tau_s_{sign}", 0.0), found[coulomb])
    for parameter, value in _NEUTRAL_STRIBECK.items():
        found.setdefault(parameter, value)
    found.setdefault("c2", 0.0)
    mean = 0.5 * (found["tau_c_positive"] + found["tau_c_negative"])
    found.setdefault("c0", mean / _PRESLIDING_DISTANCE if other is None else other.c0)
    if "c1" not in found:
        found["c1"] = found["c0"] * _BRISTLE_RELAXATION if other is None else other.c1
        found["omega_d"] = _DAMPING_FADE_SPEED if other is None else other.omega_d
    return FrictionElement(**found)
