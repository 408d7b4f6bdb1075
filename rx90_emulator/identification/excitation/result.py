"""The result of an identification from excitation runs: parameters, torques and predictions, elements to simulate.

It includes the undetermined parameters, the arm that the files describe, and the identified friction as elements that
can be simulated: values that the runs do not determine are assumed, and marked.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np
from scipy.stats import linregress
from scipy.stats import t as student

from rx90_common.base.arrays import Array, Index
from rx90_common.base.errors import IdentificationError
from rx90_common.friction import FrictionElement
from rx90_emulator.identification.estimates import (
    ElementEstimate,
    IdentifiedElement,
    ParameterEstimate,
    with_passive_fading,
)
from rx90_emulator.identification.excitation.bodies import Consistency
from rx90_emulator.identification.excitation.choice import ModelRow
from rx90_emulator.identification.excitation.fit import LinearFit, time_blocks
from rx90_emulator.identification.excitation.friction import FrictionSelection
from rx90_emulator.identification.excitation.law import overall
from rx90_emulator.identification.excitation.problem import ExcitationProblem
from rx90_emulator.identification.options import ExcitationTolerances, RobotOptions
from rx90_emulator.identification.records import BagSource
from rx90_emulator.identification.robot import RecordedRobot
from rx90_emulator.identification.sanity import MovedBodies
from rx90_emulator.identification.validation.verdict import Criterion, RunTorques, torque_criteria

UNITS = {"m": "kg", "mx": "kg m", "my": "kg m", "mz": "kg m", "k": "Nm", "offset": "Nm"}
"""Units of base parameters by the first word of their names; of all others kg m^2."""
NOT_DETERMINED = "these runs do not determine it"


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
    """The verdict of a run that the identification did not use.

    Attributes:
        torques: of the run, predicted by the identified parameters.
        consistent: the same, predicted with the physically consistent inertias instead of the identified ones.
        tolerances: limits for agreement.
        files: the same, predicted by the robot's files, elements with their bristles: the result of `check_friction`
            for these files.
    """

    torques: RunTorques
    consistent: RunTorques
    tolerances: ExcitationTolerances
    files: RunTorques

    @property
    def criteria(self) -> tuple[Criterion, ...]:
        """Return the criteria of the verdict, by the identified parameters and by the files."""
        limits = self.tolerances
        by = {"": self.torques, " by the files": self.files}
        groups = (
            torque_criteria(one.names, one.total_share, one.share, limits.total, limits.joint, words)
            for words, one in by.items()
        )
        return tuple(one for group in groups for one in group)

    @property
    def passed(self) -> bool:
        """Return whether each joint that moves, and all of them together, agree with both predictions."""
        return all(one.passed for one in self.criteria)


_UNEXPLAINED_SHARE = 0.7  # of a torque's variation: beyond, less than half of its square is explained


def unexplained(runs: Sequence[RunTorques]) -> dict[str, str]:
    """Return, in words by joint, whose torques a model hardly explains, so that their values cannot be trusted.

    An offset explains a constant torque without any information; only the variation counts.
    """
    found = {}
    for number, name in enumerate(runs[0].names):
        own = [run.joints[number] for run in runs if len(run.joints[number].recorded)]
        if own:
            residual = math.sqrt(
                sum(float(np.sum((values - values.mean()) ** 2)) for values in [one.residual for one in own])
            )
            varying = math.sqrt(
                sum(float(np.sum((values - values.mean()) ** 2)) for values in [one.recorded for one in own])
            )
            if residual > _UNEXPLAINED_SHARE * varying:
                share = min(residual / varying, 1.0) if varying else 1.0
                found[name] = (
                    f"{share:.0%} of what varies in the torque of {name} is not explained: its friction and its "
                    "offset, and the inertias that it alone determines, are not to be trusted"
                )
    return found


@dataclass(frozen=True, eq=False)
class ExcitationIdentification:
    """An arm's dynamics from excitation runs.

    Attributes:
        robot: that the runs come from.
        options: the description of the robot.
        problem: the equations of the runs.
        friction: the compared models, and the selected friction.
        elements: of the friction, to simulate with, and the estimates of their parameters.
        base: linear parameters beside friction.
        consistency: possible inertias near these.
        torques: recorded and predicted, of each run that was used.
        validations: the same for runs that were not used, with a verdict.
        trends: drifts within a run.
        bags: the bags by use: excitation, validation.
        bodies: what each joint moves, by the description and by the robot's files.
        alarms: what looks wrong in the log or the result, a sentence each: a verdict is "confirmed, but ..." at most.
        notes: what was excluded or bridged in the recordings, and what they cannot determine.
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
    bodies: tuple[MovedBodies, ...]
    alarms: tuple[str, ...] = ()
    notes: tuple[str, ...] = ()

    @cached_property
    def speeds(self) -> tuple[SpeedResiduals, ...]:
        """Return the residuals by speed of each element."""
        return residuals_by_speed(self.problem, self.problem.torque - self.friction.predicted)

    @property
    def speed_ranges(self) -> tuple[tuple[float, float], ...]:
        """Return the least and the greatest speed with data of each element, rad/s; 0 for none."""
        return tuple(overall(one.ranges) for one in self.friction.fitted)

    @property
    def unit(self) -> str:
        """Return the unit of the torques: Nm, or A without torque constants; all values are in its scale."""
        return self.problem.runs[0].source.unit

    @property
    def base_covariance(self) -> Array:
        """Return the covariance of the base parameters in the order of `base`, SI units, shape (b, b).

        Infinite on the diagonal for a parameter that these runs do not determine.
        """
        count = len(self.base)
        return self.friction.fit.covariance[:count, :count]

    @property
    def undetermined(self) -> tuple[str, ...]:
        """Return the names of base parameters that these runs do not determine."""
        return tuple(one.name for one in self.base if not one.estimate.identifiable)

    @cached_property
    def warnings(self) -> tuple[str, ...]:
        """Return which values cannot be trusted, and why, a sentence each."""
        return (*self._assumed.values(), *unexplained(self.torques).values(), *self.friction.warnings)

    @property
    def element_notes(self) -> dict[str, str]:
        """Return the warnings on the friction of single elements, by their names."""
        arm = self.problem.arm
        poor = unexplained(self.torques)
        last = [arm.names[np.flatnonzero(row)[-1]] for row in arm.element_matrix]
        found = {name: poor[joint] for name, joint in zip(arm.element_names, last, strict=True) if joint in poor}
        return found | {name: "; ".join(filter(None, (text, found.get(name)))) for name, text in self._assumed.items()}

    @cached_property
    def _assumed(self) -> dict[str, str]:
        named = zip(self.problem.arm.element_names, self.elements, strict=True)
        return assumed_friction(dict(named), self.robot.fallback_name)

    @property
    def confirmed(self) -> bool:
        """Return whether every validation agrees, if there is any, and nothing looks wrong."""
        return all(check.passed for check in self.validations) and not self.alarms

    @property
    def model(self) -> ModelRow:
        """Return the table's row of the selected model."""
        return next(row for row in reversed(self.friction.models) if row.kept)


def base_parameters(
    problem: ExcitationProblem, friction: FrictionSelection, consistency: Consistency
) -> tuple[BaseParameter, ...]:
    """Return the linear parameters beside friction with their deviations."""
    fit = friction.fit
    unknown = undetermined(problem, fit)
    parameters = []
    for k, (name, group) in enumerate(zip(problem.names, problem.base.groups, strict=True)):
        estimate = ParameterEstimate(float(fit.value[k]), float(fit.deviation[k]))
        if name in unknown:
            estimate = ParameterEstimate.unknown(NOT_DETERMINED)
        unit = UNITS.get(name.split("_")[0].rstrip("R"), "kg m^2")
        parameters.append(BaseParameter(name, group, unit, estimate, float(consistency.inertias.base[k])))
    return tuple(parameters)


def undetermined(problem: ExcitationProblem, fit: LinearFit) -> tuple[str, ...]:
    """Return the base parameters that these runs do not determine, by name.

    A change of such a parameter by one deviation alone would move torques by more than the torques' own RMS: any
    plausible value would agree with the data.

    Args:
        problem: r rows.
        fit: of the base parameters, and of others behind them.
    """
    count = len(problem.names)
    size = float(np.sqrt(np.mean(problem.torque**2)))
    known = fit.determined[:count]
    effect = np.where(known, fit.deviation[:count], 0.0) * np.sqrt(np.mean(problem.regressor**2, axis=0))
    good = (known & (effect < size)).tolist()
    return tuple(name for name, one in zip(problem.names, good, strict=True) if not one)


_PRESLIDING_DISTANCE = 2.5e-4  # rad, at break-away where no c0 is known: that of the shipped RX90B's large joints
ASSUMED = "no file: bristles that break away after 0.25 mrad are assumed, and the least Coulomb torque of the others"
"""Source, in words, of values that are not identified, without a fallback."""
_BRISTLE_RELAXATION = 1e-3  # s, c1 over c0 where no c1 is known, as there
_NEUTRAL = {"omega_s": 0.1, "delta": 1.0, "c2": 0.0}  # without effect while tau_s = tau_c


def simulated_elements(
    estimates: Sequence[ElementEstimate], fallback: Sequence[FrictionElement] | None
) -> tuple[IdentifiedElement, ...]:
    """Return the elements with values for all parameters.

    A part that the model does not have is off: tau_s = tau_c, alpha = 1. Bristles, without which an arm cannot stand
    still, are the fallback's, or else have the presliding distance of large joints; both are assumptions. So is the
    friction of an element without an identified Coulomb torque: the fallback's, or else the least Coulomb torque of the
    other elements.

    Args:
        estimates: by the names of FrictionElement.
        fallback: elements in the same order; None if there are none.
    """
    known = [one.parameters[_COULOMB[0]].value for one in estimates if _slides(one.parameters)]
    if not known and fallback is None:
        reasons = "; ".join(f"{one.element}: {one.parameters[_COULOMB[0]].reason}" for one in estimates)
        raise IdentificationError(
            f"no friction of any element is identified ({reasons}); accepted: runs that tell some, or --fallback with "
            "a friction file"
        )
    found = []
    for one, other in zip(estimates, fallback or (None,) * len(estimates), strict=True):
        values = dict(one.parameters)
        if not any(estimate.identifiable for estimate in values.values()) and other is not None:
            element = other
        else:
            element = _element(values, other, min(known, default=0.0))
        found.append(IdentifiedElement.of(element, values, dict.fromkeys(values, one.sources), other))
    return tuple(found)


_COULOMB = ("tau_c_positive", "tau_c_negative")


def _slides(estimates: Mapping[str, ParameterEstimate]) -> bool:
    """Return whether an element has an identified Coulomb torque, which is the same in both directions."""
    return estimates[_COULOMB[0]].identifiable


def assumed_friction(elements: Mapping[str, IdentifiedElement], fallback_name: str | None) -> dict[str, str]:
    """Return, in words by element, whose Coulomb torque is assumed, why, and its source."""
    whose = "the least of the others" if fallback_name is None else f"that of {fallback_name}"
    missing = {name: one.estimates[_COULOMB[0]] for name, one in elements.items() if not _slides(one.estimates)}
    return {
        name: f"the friction of {name} is not identified ({estimate.reason}); assumed is a Coulomb torque of "
        f"{elements[name].element.tau_c.positive:.3g} Nm, {whose}"
        for name, estimate in missing.items()
    }


def _element(known: Mapping[str, ParameterEstimate], other: FrictionElement | None, least: float) -> FrictionElement:
    """Return an element; `other` or the `least` Coulomb torque replace unknown values."""
    found: dict[str, Any] = {parameter: one.value for parameter, one in known.items() if one.identifiable}
    for sign in ("positive", "negative"):
        coulomb = f"tau_c_{sign}"
        found.setdefault(coulomb, least if other is None else other.parameters[coulomb])
        found[f"tau_s_{sign}"] = max(found.get(f"tau_s_{sign}", 0.0), found[coulomb])
    found = _NEUTRAL | found
    mean = 0.5 * (found["tau_c_positive"] + found["tau_c_negative"])
    found.setdefault("c0", mean / _PRESLIDING_DISTANCE if other is None else other.c0)
    own = "c1" in found  # a fallback's own c1 fades as it does there
    found.setdefault("c1", found["c0"] * _BRISTLE_RELAXATION if other is None else other.c1)
    element = FrictionElement.of(found)
    return with_passive_fading(element, other) if own or other is None else element.replaced(omega_d=other.omega_d)


_MIN_TREND_BLOCKS = 6  # least number of blocks for a test
_TREND_LEVEL = 0.01  # chance of a false trend, over all joints and runs together


class Trend(NamedTuple):
    """A drift of the friction within a run.

    Attributes:
        bag: name of the run.
        joint: its name.
        change: of the friction torque from the first to the last sample, Nm; positive where it grows.
        deviation: its standard deviation, Nm.
    """

    bag: str
    joint: str
    change: float
    deviation: float

    @property
    def text(self) -> str:
        """Return it in words."""
        grows = "grows" if self.change > 0.0 else "falls"
        return (
            f"in {self.bag} the friction of {self.joint} {grows} by {abs(self.change):.3g} +- {self.deviation:.2g} Nm "
            "from begin to end"
        )


def trends(runs: Sequence[RunTorques], block: float) -> tuple[Trend, ...]:
    """Return drifts of friction that are significant at 1 % over all tests together (Bonferroni).

    A line is fitted to the means over blocks of the difference times the sign of the velocity; these means are nearly
    independent, unlike neighbouring samples.

    Args:
        runs: to test, joint by joint.
        block: length of the blocks, s.
    """
    tests = [(run, name, joint) for run in runs for name, joint in zip(run.names, run.joints, strict=True)]
    found = []
    for run, name, joint in tests:
        number = ((joint.time - joint.time[:1]) / block).astype(np.intp)
        count = np.bincount(number)
        filled = np.flatnonzero(count > 0.5 * count.max(initial=0))
        if len(filled) < _MIN_TREND_BLOCKS:
            continue
        opposing = joint.residual * np.sign(joint.velocity)
        means = np.bincount(number, opposing)[filled] / count[filled]
        times = np.bincount(number, joint.time)[filled] / count[filled]
        line = linregress(times, means)
        span = float(joint.time[-1] - joint.time[0])
        if line.pvalue < _TREND_LEVEL / len(tests):
            found.append(Trend(run.source.path.name, name, float(line.slope) * span, float(line.stderr) * span))
    return tuple(found)


_SPEED_BINS = 12
_MIN_BIN_ROWS = 5
_MISFIT_LEVEL = 0.05  # chance of a false misfit, over all bins together


class SpeedResiduals(NamedTuple):
    """Mean residuals of an element's joint at several speeds of the element, k bins.

    Attributes:
        element: its name.
        velocity: mean in each bin, rad/s, shape (k,).
        residual: mean, Nm, shape (k,).
        deviation: of that mean, from the means of blocks of time, Nm, shape (k,); NaN in a bin with a single block.
        blocks: number of blocks, shape (k,).
    """

    element: str
    velocity: Array
    residual: Array
    deviation: Array
    blocks: Index


def residuals_by_speed(problem: ExcitationProblem, residual: Array) -> tuple[SpeedResiduals, ...]:
    """Return mean residuals over the speed of each element: the misfit of its friction curve.

    The joint is the last one on which the element acts. Reversals are excluded.

    Args:
        problem: r rows.
        residual: recorded less predicted torque, Nm, shape (r,).
    """
    block = time_blocks(problem)
    result = []
    for e, (name, acts) in enumerate(zip(problem.arm.element_names, problem.arm.element_matrix != 0.0, strict=True)):
        rows = np.flatnonzero((problem.joint == np.flatnonzero(acts)[-1]) & ~problem.reversal)
        velocity = problem.velocity[rows, e]
        bins = []
        if len(rows):
            edges = np.quantile(velocity, np.linspace(0.0, 1.0, _SPEED_BINS + 1))
            number = np.clip(np.searchsorted(edges, velocity, "right") - 1, 0, _SPEED_BINS - 1)
            for some in (rows[number == k] for k in range(_SPEED_BINS)):
                if len(some) >= _MIN_BIN_ROWS:
                    means = [residual[some[block[some] == k]].mean() for k in np.unique(block[some])]
                    spread = np.std(means, ddof=1) / math.sqrt(len(means)) if len(means) > 1 else math.nan
                    bins.append((problem.velocity[some, e].mean(), residual[some].mean(), spread, len(means)))
        speed, mean, deviation, blocks = np.array(bins, dtype=np.float64).reshape(-1, 4).T
        result.append(SpeedResiduals(name, speed, mean, deviation, blocks.astype(np.intp)))
    return tuple(result)


def misfits(speeds: Sequence[SpeedResiduals]) -> list[str]:
    """Return, in words, each element's largest significant mean residual (5 % over all bins together)."""
    found = []
    tests = sum(len(one.residual) for one in speeds)
    for one in speeds:
        with np.errstate(invalid="ignore", divide="ignore"):
            size = np.nan_to_num(np.abs(one.residual) / one.deviation, posinf=0.0)
        limit = student.ppf(1.0 - 0.5 * _MISFIT_LEVEL / max(tests, 1), np.maximum(one.blocks - 1, 1))
        clear = np.flatnonzero(size > limit)
        if len(clear):
            worst = clear[np.argmax(np.abs(one.residual[clear]))]
            found.append(
                f"the torque of {one.element} is off by {one.residual[worst]:.3g} +- {one.deviation[worst]:.2g} Nm at "
                f"{one.velocity[worst]:.3g} rad/s"
            )
    return found
