"""The result of an identification from excitation runs: parameters, torques and predictions, elements to simulate."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from rx90_common.base.arrays import Array
from rx90_emulator.identification.bodies import Consistency
from rx90_emulator.identification.estimates import IdentifiedElement, ParameterEstimate
from rx90_emulator.identification.fitted import FittedArm
from rx90_emulator.identification.options import ExcitationTolerances, RobotOptions
from rx90_emulator.identification.records import BagSource
from rx90_emulator.identification.robot import RecordedRobot
from rx90_emulator.identification.rows.excitation import ExcitationProblem
from rx90_emulator.identification.rows.filtering import Bandwidths
from rx90_emulator.identification.sanity import MovedBodies
from rx90_emulator.identification.validation.verdict import Criterion, RunTorques, torque_criteria

UNITS = {"m": "kg", "mx": "kg m", "my": "kg m", "mz": "kg m", "k": "Nm", "offset": "Nm"}
"""Units of base parameters by the first word of their names; of all others kg m^2."""
NOT_DETERMINED = "these runs do not determine it"
UNEXPLAINED = 0.7
"""Share of a torque's variation: beyond, less than half of its square is explained."""


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


@dataclass(frozen=True, eq=False)
class TorqueValidation:
    """The verdict of a run that the identification did not use, all predictions on the same rows in the same band.

    Attributes:
        torques: of the run, predicted by the identified parameters.
        simplest: by a rigid body with Coulomb and viscous friction, fitted to the same rows.
        files: by the robot's files, elements with their bristles: the result of `check_friction` for these files.
        assumed_bristles: whether c0 and c1 of any element are assumed: then rows at reversals do not judge the files.
        tolerances: limits for agreement.
    """

    torques: RunTorques
    simplest: RunTorques
    files: RunTorques
    assumed_bristles: bool
    tolerances: ExcitationTolerances

    @property
    def criteria(self) -> tuple[Criterion, ...]:
        """Return the criteria of the verdict, by the identified parameters and by the files."""
        limits = self.tolerances
        files = self.files
        words = " by the files"
        if self.assumed_bristles:
            files = files.away_from_reversals
            words = " by the files, away from reversals"
        ours = torque_criteria(
            self.torques.names, self.torques.total_share, self.torques.share, limits.total, limits.joint
        )
        theirs = torque_criteria(files.names, files.total_share, files.share, limits.total, limits.joint, words)
        return (*ours, *theirs)

    @property
    def remarks(self) -> tuple[str, ...]:
        """Return, in words, what the assumed bristles miss at reversals, and what the simplest model does."""
        remarks = []
        at_reversals = self.files.at_reversals.total_share
        if self.assumed_bristles and np.isfinite(at_reversals):
            remarks.append(f"at reversals, where the assumed c0 and c1 act, {at_reversals:.2%}")
        remarks.append(f"Coulomb and viscous friction alone {self.simplest.total_share:.2%}")
        return tuple(remarks)

    @property
    def passed(self) -> bool:
        """Return whether each joint that moves, and all of them together, agree with both predictions."""
        return all(criterion.passed for criterion in self.criteria)


def unexplained(runs: Sequence[RunTorques]) -> dict[str, str]:
    """Return, in words by joint, whose torques a model hardly explains, so that their values cannot be trusted.

    An offset explains a constant torque without any information; only the variation counts.
    """
    texts = {}
    for number, name in enumerate(runs[0].names):
        series = [run.joints[number] for run in runs if len(run.joints[number].recorded)]
        residual = np.sqrt(sum(len(joint.residual) * float(np.var(joint.residual)) for joint in series))
        varying = np.sqrt(sum(len(joint.recorded) * float(np.var(joint.recorded)) for joint in series))
        if series and residual > UNEXPLAINED * varying:
            share = min(residual / varying, 1.0) if varying else 1.0
            texts[name] = (
                f"{share:.0%} of what varies in the torque of {name} is not explained: its friction and its offset, "
                "and the inertias that it alone determines, are not to be trusted"
            )
    return texts


@dataclass(frozen=True, eq=False)
class ExcitationIdentification:
    """An arm's dynamics from excitation runs.

    Attributes:
        robot: that the runs come from.
        options: the description of the robot.
        problem: the equations of the runs.
        fitted: laws of friction and base parameters, with deviations.
        elements: of the friction, to simulate with, and the estimates of their parameters.
        base: linear parameters beside friction.
        consistency: possible inertias near these.
        compared: bandwidths in which torques are compared: the motion's, whatever those of the fit are.
        torques: recorded and predicted, of each run that was used.
        validations: the same for runs that were not used, with a verdict.
        bags: the bags by use: excitation, validation.
        bodies: what each joint moves, by the description and by the robot's files.
        alarms: what looks wrong in the log or the result, a sentence each: a verdict is "confirmed, but ..." at most.
        notes: what was bridged in the recordings, and what they cannot determine.
    """

    robot: RecordedRobot
    options: RobotOptions
    problem: ExcitationProblem
    fitted: FittedArm
    elements: tuple[IdentifiedElement, ...]
    base: tuple[BaseParameter, ...]
    consistency: Consistency
    compared: Bandwidths
    torques: tuple[RunTorques, ...]
    validations: tuple[TorqueValidation, ...]
    bags: tuple[tuple[str, BagSource], ...]
    bodies: tuple[MovedBodies, ...]
    alarms: tuple[str, ...] = ()
    notes: tuple[str, ...] = ()

    @property
    def unit(self) -> str:
        """Return the unit of the torques: Nm, or A without torque constants; all values are in its scale."""
        return self.problem.runs[0].source.unit

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
        return tuple(parameter.name for parameter in self.base if not parameter.estimate.identifiable)

    @cached_property
    def warnings(self) -> tuple[str, ...]:
        """Return which values cannot be trusted, and why, a sentence each."""
        return (*self._assumed.values(), *unexplained(self.torques).values(), *self._falling)

    @property
    def element_notes(self) -> dict[str, str]:
        """Return the warnings on the friction of single elements, by their names."""
        arm = self.problem.arm
        poor = unexplained(self.torques)
        last = [arm.names[np.flatnonzero(row)[-1]] for row in arm.element_matrix]
        notes = {name: poor[joint] for name, joint in zip(arm.element_names, last, strict=True) if joint in poor}
        return notes | {name: "; ".join(filter(None, (text, notes.get(name)))) for name, text in self._assumed.items()}

    @cached_property
    def _assumed(self) -> dict[str, str]:
        """Return, in words by element, whose Coulomb torque is assumed, why, and its source."""
        name = self.robot.fallback_name
        whose = "the least of the others" if name is None else f"that of {name}"
        texts = {}
        for element, identified in zip(self.problem.arm.element_names, self.elements, strict=True):
            estimate = identified.estimates["tau_c_positive"]
            if not estimate.identifiable:
                texts[element] = (
                    f"the friction of {element} is not identified ({estimate.reason}); assumed is a Coulomb torque of "
                    f"{identified.element.tau_c.positive:.3g} Nm, {whose}"
                )
        return texts

    @property
    def _falling(self) -> list[str]:
        """Return, in words, whose friction falls with speed up to the highest one with data."""
        texts = []
        names = zip(self.problem.arm.element_names, self.elements, self.fitted.speeds, strict=True)
        for name, identified, (low, high) in names:
            slow, fast = identified.element.without_parts().steady_torque([low, high]) if high else (0.0, 0.0)
            if fast < slow:
                texts.append(
                    f"the friction of {name} falls from {slow:.3g} Nm at {low:.2g} rad/s to {fast:.3g} Nm at "
                    f"{high:.2g} rad/s, the highest speed of these runs"
                )
        return texts

    @property
    def confirmed(self) -> bool:
        """Return whether every validation agrees, if there is any, and nothing looks wrong."""
        return all(check.passed for check in self.validations) and not self.alarms


def base_parameters(
    problem: ExcitationProblem, fitted: FittedArm, consistency: Consistency
) -> tuple[BaseParameter, ...]:
    """Return the linear parameters beside friction with their deviations.

    A parameter is not determined where a change by one deviation alone would move torques by more than the torques'
    own RMS: any plausible value would agree with the data.
    """
    first = len(fitted.fit.x)
    deviation = fitted.deviation[first:]
    size = float(np.sqrt(np.mean(problem.torque**2)))
    effect = deviation * np.sqrt(np.mean(problem.regressor**2, axis=0))
    parameters = []
    for k, (name, group) in enumerate(zip(problem.names, problem.base.groups, strict=True)):
        estimate = ParameterEstimate(float(fitted.fit.linear[k]), float(deviation[k]))
        if not effect[k] < size:
            estimate = ParameterEstimate.unknown(NOT_DETERMINED)
        unit = UNITS.get(name.split("_")[0].rstrip("R"), "kg m^2")
        parameters.append(BaseParameter(name, group, unit, estimate, float(consistency.inertias.base[k])))
    return tuple(parameters)
