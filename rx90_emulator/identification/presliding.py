"""Identify the presliding regime, c0 and c1, from micro-oscillations (paper, section 4)."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from rx90_common.base.arrays import Array
from rx90_common.base.errors import IdentificationError
from rx90_common.estimation.deviations import deviations
from rx90_common.estimation.fit import Fit, Projected, fit
from rx90_common.friction import FrictionElement
from rx90_emulator.identification.arm import JointGroup, RigidArm, joint_groups
from rx90_emulator.identification.estimates import (
    LARGEST_DEVIATION,
    PRESLIDING,
    Estimates,
    ParameterEstimate,
    unknown_estimates,
)
from rx90_emulator.identification.records import BagSource, JointRecord
from rx90_emulator.identification.rows.micro_oscillations import (
    INERTIA_SD,
    BristleRows,
    MicroMotion,
    amplitudes,
    find_micro_motions,
)

# of break-away; beyond it bristles slide, and their torque depends little on c0 and c1
_BREAK_AWAY_SHARE = 0.7
_MIN_RELATIVE_LOAD = 0.25  # of the strongest motion of a group: fainter ones tell little
_MAX_MOTIONS_PER_BAG = 3  # of a group
_PASSES = 3  # each with the noise that the previous one left
# relative deviation of c0 and c1: residuals show neither errors of tau_c, nor of 10 us
_FLOOR = (0.005, 0.01)
_NEARLY_SLIDING = 0.75  # of an element's Coulomb torque: beyond it small errors of the motion deflect bristles far
_SLIDING_LOAD = 0.95  # of it: bristles slide
_MAX_MISFIT = 0.3  # of the friction torque
_MAX_INERTIA_SD = 2.0  # prior deviations of an error of the mass matrix
_REACTIONS = "its joints were moved by the reactions of others alone; accepted: micro-oscillations of their own"


class PreslidingFit(NamedTuple):
    """The presliding regime of all elements.

    Attributes:
        estimates: for each element of the arm, in its order; the parameters are those in PRESLIDING.
        sources: bags that the estimates of each element come from.
        motions: number of micro-motions that were used.
    """

    estimates: tuple[Estimates, ...]
    sources: tuple[tuple[BagSource, ...], ...]
    motions: int = 0


def identify_presliding(
    records: Sequence[JointRecord], arm: RigidArm, sliding: Sequence[FrictionElement]
) -> PreslidingFit:
    """Fit c0 and c1 of every element whose joints make micro-oscillations.

    Args:
        records: motion with reversals well within the bristles' range, 500 samples per second or more.
        arm: rigid-body model of the same joints.
        sliding: the sliding regime of the arm's elements, in its order; their c0 and c1 are not used.
    """
    groups = joint_groups(arm)
    motions_of = [find_micro_motions(record, arm, groups) for record in records]
    if not any(any(of_record) for of_record in motions_of):
        where = ", ".join(str(record.source) for record in records) or "no bag"
        raise IdentificationError(
            f"{where}: no velocity reversals small enough for the presliding regime; accepted: oscillations of "
            "some 0.1 mrad at some 3 to 30 Hz, such as rx90 experiment makes"
        )
    reason = f"no micro-oscillation of its joints in the bags, or {_REACTIONS}"
    estimates = [unknown_estimates(PRESLIDING, reason)] * len(arm.element_names)
    sources: list[tuple[BagSource, ...]] = [()] * len(estimates)
    used = 0
    for number, group in enumerate(groups):
        elements = [sliding[e] for e in group.elements]
        break_away = group.break_away(elements)
        motions = [
            motion
            for of_record in motions_of
            for motion in _most_informative(of_record[number], break_away)
        ]
        if not motions:
            continue
        result = _GroupFit.of(motions, group, elements)
        far = [
            motion
            for motion, load in zip(motions, result.loads.max(axis=1), strict=True)
            if load < _NEARLY_SLIDING
        ]
        if 0 < len(far) < len(motions):
            # An element of several joints may nearly slide although the torque of each is far from break-away.
            result = _GroupFit.of(far, group, elements)
        used += len(result.rows.motions)
        bags = tuple(dict.fromkeys(motion.record.bag for motion in result.rows.motions))
        for e, estimate in zip(group.elements, result.estimates(arm, group), strict=True):
            estimates[e] = estimate
            sources[e] = bags
    return PreslidingFit(tuple(estimates), tuple(sources), used)


def _most_informative(motions: Sequence[MicroMotion], break_away: Array) -> list[MicroMotion]:
    """Return the motions of a group in one record with the largest friction torques short of break-away, Nm, (k,)."""
    loads = np.array([motion.load(break_away) for motion in motions])
    below = loads[loads <= _BREAK_AWAY_SHARE]
    if not len(below):  # all break away: the smallest is best
        return [motions[int(loads.argmin())]] if motions else []
    strong = np.flatnonzero(
        (loads <= _BREAK_AWAY_SHARE) & (loads >= _MIN_RELATIVE_LOAD * below.max())
    )
    best = strong[np.argsort(-loads[strong])][:_MAX_MOTIONS_PER_BAG]
    return [motions[k] for k in best.tolist()]


@dataclass(frozen=True, eq=False)
class _GroupFit:
    """The fit of the bristles of a group's e elements to M motions."""

    rows: BristleRows
    fit: Fit

    @classmethod
    def of(
        cls, motions: Sequence[MicroMotion], group: JointGroup, elements: Sequence[FrictionElement]
    ) -> _GroupFit:
        rows = BristleRows(motions, group.inputs, elements)
        problem = rows.problem()
        weight = 1.0 / group.break_away(elements)[problem.group] ** 2
        projected = Projected(problem, weight)
        x = min(rows.starts(), key=lambda start: float(np.sum(projected.residual(start) ** 2)))
        for _ in range(_PASSES):
            # The prior of the start deflections is about 0, where the search for them begins again.
            start = np.where(np.arange(len(x)) < rows.bristles.stop, x, 0.0)
            result = fit(replace(problem, start=start), weight)
            x = result.x
            weight = 1.0 / np.maximum(result.noise, 1e-9)[problem.group] ** 2
        return cls(rows, result)

    @property
    def loads(self) -> Array:
        """Return the amplitude of each bristle's torque over its Coulomb torque, shape (M, e)."""
        coulomb = [element.tau_c.positive for element in self.rows.elements]
        motions = range(len(self.rows.motions))
        along = [amplitudes(self.rows.deflection_torque(self.fit.x, k)) for k in motions]
        return np.array(along) / coulomb

    def estimates(self, arm: RigidArm, group: JointGroup) -> list[Estimates]:
        """Return the elements' estimates."""
        spread = deviations(self.fit)
        doubts = self._doubts(arm, group)
        estimates = []
        for place in range(len(group.elements)):
            parameters = {}
            for number, name in enumerate(PRESLIDING, 2 * place):
                relative = math.hypot(
                    math.sqrt(spread.covariance[number, number]), _FLOOR[number - 2 * place]
                )
                value = math.exp(self.fit.x[number])
                reason = doubts[place]
                if not reason and not (spread.determined[number] and relative < LARGEST_DEVIATION):
                    reason = f"relative standard deviation {relative:.2g} at a value of {value:.3g}"
                estimate = ParameterEstimate(value, value * relative)
                parameters[name] = ParameterEstimate.unknown(reason) if reason else estimate
            estimates.append(parameters)
        return estimates

    def _doubts(self, arm: RigidArm, group: JointGroup) -> list[str]:
        """Return why the model does not hold for each element; empty if it does."""
        inertia = np.abs(self.fit.linear)
        first, second = np.triu_indices(len(group.joints))
        worst = int(np.argmax(inertia))
        heavy = " and ".join(
            dict.fromkeys(arm.names[group.joints[k]] for k in (first[worst], second[worst]))
        )
        # The residual torque beyond noise over the friction, RMS, of each joint.
        misfit = []
        for joint in range(len(group.joints)):
            rows = self.fit.problem.group == joint
            beyond = np.mean(self.fit.residual[rows] ** 2) - self.fit.noise[joint] ** 2
            friction = np.mean((self.fit.problem.target - self.fit.residual)[rows] ** 2)
            misfit.append(float(np.sqrt(max(beyond, 0.0) / friction)))
        doubts = []
        for place, load in enumerate(self.loads.min(axis=0).tolist()):
            missed = [
                joint
                for joint in np.flatnonzero(group.inputs[place])
                if misfit[joint] > _MAX_MISFIT
            ]
            doubt = ""
            if load > _SLIDING_LOAD:
                doubt = f"its bristles slide in every micro-oscillation: {load:.2g} of the Coulomb torque or more"
            elif inertia[worst] > _MAX_INERTIA_SD * INERTIA_SD:
                doubt = (
                    f"the inertia at {heavy} would be {inertia[worst]:.0%} off the description's: a payload, a rotor "
                    "or the torque's delay may be missing"
                )
            elif missed:
                name = arm.names[group.joints[missed[0]]]
                doubt = (
                    f"the model misses {misfit[missed[0]]:.0%} of the friction torque of {name}: another delay of the "
                    "torque, another inertia, or no bristles"
                )
            doubts.append(doubt)
        return doubts
