"""The result of an identification: elements to simulate, verdicts, alarms, and what each kind of data tells beside."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from datetime import datetime, timezone
from functools import cached_property

import numpy as np

from rx90_common.base.arrays import Array, column_rms, rms
from rx90_common.friction import FrictionSet
from rx90_emulator.identification.arm import RigidArm
from rx90_emulator.identification.bodies import ConsistentInertias
from rx90_emulator.identification.estimates import (
    PRESLIDING,
    FrictionCurve,
    IdentifiedElement,
    ParameterEstimate,
)
from rx90_emulator.identification.fitted import FittedArm
from rx90_emulator.identification.presliding import PreslidingFit
from rx90_emulator.identification.records import BagSource
from rx90_emulator.identification.robot import RecordedRobot
from rx90_emulator.identification.rows.excitation import ExcitationProblem
from rx90_emulator.identification.rows.filtering import Bandwidths
from rx90_emulator.identification.sanity import MovedBodies
from rx90_emulator.identification.sliding import SlidingFit
from rx90_emulator.identification.validation.prediction import Validation
from rx90_emulator.identification.validation.verdict import RunTorques

UNITS = {"m": "kg", "mx": "kg m", "my": "kg m", "mz": "kg m", "k": "Nm", "offset": "Nm"}
"""Units of base parameters by the first word of their names; of all others kg m^2."""
NOT_DETERMINED = "these runs do not determine it"
UNEXPLAINED = 0.7
"""Share of a torque's variation: beyond, less than half of its square is explained."""
_LINE_POINTS = 100


@dataclass(frozen=True)
class BaseParameter:
    """A combination of inertial parameters, or another linear parameter, that the torque depends on.

    Attributes:
        name: short, such as mzR_2: the R means that other parameters belong to its group.
        group: in words, such as "mz_2 + 0.45 m_3".
        unit: SI.
        estimate: together with the friction, by weighted least squares.
        consistent: its value by the physically consistent inertias.
    """

    name: str
    group: str
    unit: str
    estimate: ParameterEstimate
    consistent: float


def unexplained(runs: Sequence[RunTorques]) -> dict[str, str]:
    """Return, in words by joint, whose torques a model hardly explains, so that their values cannot be trusted.

    An offset explains a constant torque without any information; only the variation counts.
    """
    texts = {}
    residuals = np.sqrt(sum(run.variation(run.difference) for run in runs))
    recorded = np.sqrt(sum(run.variation(run.recorded) for run in runs))
    for name, residual, varying in zip(runs[0].names, residuals, recorded, strict=True):
        if residual > UNEXPLAINED * varying:
            share = min(residual / varying, 1.0) if varying else 1.0
            texts[name] = (
                f"{share:.0%} of what varies in the torque of {name} is not explained: its friction and its offset, "
                "and the inertias that it alone determines, are not to be trusted"
            )
    return texts


def objection(validations: Sequence[Validation], alarms: Sequence[str] = ()) -> str:
    """Return in words what speaks against a friction; "" for nothing."""
    if not all(check.passed for check in validations):
        return "the validation does not confirm"
    return "an alarm stands against" if alarms or any(check.alarms for check in validations) else ""


@dataclass(frozen=True, eq=False, kw_only=True)
class Identification:
    """The identified friction of an arm, whatever kind of recordings it comes from.

    Attributes:
        robot: that the recordings come from.
        elements: of the friction, in the order of the arm's, to simulate with; and the estimates of their parameters.
        bags: what was read, by use.
        validations: comparisons with bags that the identification did not use.
        alarms: what looks wrong in the log or the result, a sentence each: a verdict is "confirmed, but ..." at most.
        date: of the identification.
    """

    robot: RecordedRobot
    elements: tuple[IdentifiedElement, ...]
    bags: tuple[tuple[str, BagSource], ...] = ()
    validations: tuple[Validation, ...] = ()
    alarms: tuple[str, ...] = ()
    date: datetime = field(default_factory=lambda: datetime.now(timezone.utc))

    @property
    def arm(self) -> RigidArm:
        """Return the arm, by its description."""
        return self.robot.arm

    @property
    def unit(self) -> str:
        """Return the unit of the torques: Nm, or A without torque constants; all values are in its scale."""
        return next((bag.unit for _, bag in self.bags), "Nm")

    @property
    def curves(self) -> dict[str, FrictionCurve]:
        """Return measured and identified torque against velocity, by element."""
        return {}

    @property
    def element_notes(self) -> dict[str, str]:
        """Return why the friction of single elements cannot be trusted, by their names."""
        return {}

    @property
    def friction(self) -> FrictionSet:
        """Return the friction to simulate this project's robot with."""
        return FrictionSet(
            self.arm.element_names, tuple(identified.element for identified in self.elements)
        )

    @property
    def assumed_bristles(self) -> bool:
        """Return whether c0 or c1 of an element are assumed."""
        return not all(
            element.estimates[name].identifiable for element in self.elements for name in PRESLIDING
        )

    @property
    def confirmed(self) -> bool:
        """Return whether every validation agrees, if there is any, and nothing looks wrong."""
        return not objection(self.validations, self.alarms)

    @property
    def scope(self) -> str:
        """Return the scope of a verdict, "54 of 63 values are assumed"; "" where nothing is assumed."""
        known = [
            estimate.identifiable
            for element in self.elements
            for estimate in element.estimates.values()
        ]
        assumed = known.count(False)
        return f"{assumed} of {len(known)} values are assumed" if assumed else ""


@dataclass(frozen=True, eq=False, kw_only=True)
class FrictionIdentification(Identification):
    """The friction of an arm from sweeps and micro-oscillations.

    Attributes:
        sliding: the fit of the sliding regime.
        presliding: the fit of the presliding regime.
    """

    sliding: SlidingFit
    presliding: PreslidingFit

    @property
    def curves(self) -> dict[str, FrictionCurve]:
        """Return a point for each stretch of constant velocity, by element."""
        curves = zip(self.arm.element_names, self.sliding.curves, strict=True)
        return {name: curve for name, curve in curves if curve is not None}


@dataclass(frozen=True, eq=False, kw_only=True)
class ExcitationIdentification(Identification):
    """An arm's dynamics from excitation runs.

    Attributes:
        problem: the equations of the runs.
        fitted: laws of friction and base parameters, with deviations.
        base: linear parameters beside friction.
        consistency: possible inertias near these.
        compared: bandwidths in which torques are compared: the motion's, whatever those of the fit are.
        torques: recorded and predicted, of each run that was used.
        bodies: what each joint moves, by the description and by the robot's files.
        notes: gaps that were bridged or split the recordings, and what these cannot determine.
    """

    problem: ExcitationProblem
    fitted: FittedArm
    base: tuple[BaseParameter, ...]
    consistency: ConsistentInertias
    compared: Bandwidths
    torques: tuple[RunTorques, ...]
    bodies: tuple[MovedBodies, ...]
    notes: tuple[str, ...] = ()

    @property
    def curves(self) -> dict[str, FrictionCurve]:
        """Return the identified torque against velocity, without points, by element."""
        curves = {}
        nothing = np.zeros(0)
        for number, name in enumerate(self.arm.element_names):
            low, high = self.fitted.speeds[number]
            if high > 0.0:
                speed = np.linspace(low, high, _LINE_POINTS)
                velocity = np.concatenate([-speed[::-1], speed])
                line = np.stack([velocity, *self.fitted.elements[number].curve(velocity)])
                curves[name] = FrictionCurve(nothing, nothing, nothing, nothing, line)
        return curves

    @property
    def base_covariance(self) -> Array:
        """Return the covariance of the base parameters in the order of `base`, SI units, shape (b, b).

        Infinite on the diagonal for a parameter that these runs do not determine.
        """
        first = len(self.fitted.fit.x)
        covariance = self.fitted.covariance[first:, first:].copy()
        unknown = np.flatnonzero(~self.fitted.determined[first:])
        covariance[unknown, unknown] = np.inf
        return covariance

    @property
    def undetermined(self) -> tuple[str, ...]:
        """Return the names of base parameters that these runs do not determine."""
        return tuple(
            parameter.name for parameter in self.base if not parameter.estimate.identifiable
        )

    @cached_property
    def warnings(self) -> tuple[str, ...]:
        """Return which values cannot be trusted, and why, a sentence each."""
        return (*self.in_currents, *unexplained(self.torques).values(), *self._falling)

    @property
    def element_notes(self) -> dict[str, str]:
        """Return the warnings on the friction of single elements, and which Coulomb torque is assumed."""
        arm = self.arm
        poor = unexplained(self.torques)
        source = self.robot.fallback_name
        whose = "the least of the others" if source is None else f"that of {source}"
        notes = {}
        for name, row, identified in zip(
            arm.element_names, arm.element_matrix, self.elements, strict=True
        ):
            texts = []
            coulomb = identified.estimates["tau_c_positive"]
            if not coulomb.identifiable:
                texts.append(
                    f"the friction of {name} is not identified ({coulomb.reason}); assumed is a Coulomb torque of "
                    f"{identified.element.tau_c.positive:.3g} Nm, {whose}"
                )
            last = arm.names[np.flatnonzero(row)[-1]]
            if last in poor:
                texts.append(poor[last])
            if texts:
                notes[name] = "; ".join(texts)
        return notes

    @property
    def in_currents(self) -> tuple[str, ...]:
        """Return a warning if torques are currents, which a simulation must not use as torques; else nothing."""
        if self.unit == "Nm":
            return ()
        return (
            f"efforts in {self.unit} and no torque constants: friction, inertias and the files are in that scale, and "
            "no simulation should load them",
        )

    @property
    def _falling(self) -> list[str]:
        """Return, in words, whose friction falls with speed up to the highest one with data."""
        texts = []
        names = zip(self.arm.element_names, self.elements, self.fitted.speeds, strict=True)
        for name, identified, (low, high) in names:
            slow, fast = (
                identified.element.without_parts().steady_torque([low, high])
                if high
                else (0.0, 0.0)
            )
            if fast < slow:
                texts.append(
                    f"the friction of {name} falls from {slow:.3g} Nm at {low:.2g} rad/s to {fast:.3g} Nm at "
                    f"{high:.2g} rad/s, the highest speed of these runs"
                )
        return texts


def base_parameters(
    problem: ExcitationProblem, fitted: FittedArm, consistency: ConsistentInertias
) -> tuple[BaseParameter, ...]:
    """Return the linear parameters beside friction with their deviations.

    A parameter is not determined where a change by one deviation alone would move torques by more than the torques'
    own RMS: any plausible value would agree with the data.
    """
    first = len(fitted.fit.x)
    deviation = fitted.deviation[first:]
    size = rms(problem.torque)
    effect = deviation * column_rms(problem.regressor)
    parameters = []
    for k, (name, group) in enumerate(zip(problem.names, problem.base.groups, strict=True)):
        estimate = ParameterEstimate(float(fitted.fit.linear[k]), float(deviation[k]))
        if not effect[k] < size:
            estimate = ParameterEstimate.unknown(NOT_DETERMINED)
        unit = UNITS.get(name.split("_")[0].rstrip("R"), "kg m^2")
        parameters.append(BaseParameter(name, group, unit, estimate, float(consistency.base[k])))
    return tuple(parameters)
