"""What an identification from excitation runs returns."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

from rx90_emulator.identification.excitation.consistency import Consistency
from rx90_emulator.identification.excitation.fit_quality import (
    SpeedResiduals,
    residuals_by_speed,
    undetermined,
)
from rx90_emulator.identification.excitation.friction.models import FrictionSelection, ModelRow
from rx90_emulator.identification.excitation.gains import DriveGains
from rx90_emulator.identification.excitation.instruments import InstrumentalComparison
from rx90_emulator.identification.excitation.load_parts import LoadParts
from rx90_emulator.identification.excitation.problem import ExcitationProblem
from rx90_emulator.identification.excitation.torques import RunTorques, TorqueValidation, Trend
from rx90_emulator.identification.model.estimates import ParameterEstimate
from rx90_emulator.identification.model.options import RobotOptions
from rx90_emulator.identification.model.robot import RecordedRobot
from rx90_emulator.identification.model.zeros import ZeroCheck
from rx90_emulator.identification.records.record import BagSource
from rx90_emulator.identification.result.identification import IdentifiedElement

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
