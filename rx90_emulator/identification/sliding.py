"""Identify the sliding regime of all friction elements from sweeps at constant velocity (paper, section 4)."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from rx90_common.base.arrays import Array
from rx90_common.base.errors import IdentificationError
from rx90_common.estimation.choose import choose
from rx90_common.estimation.deviations import deviations
from rx90_common.estimation.elements import SteadyRows, fit_laws, fitted_values, places
from rx90_common.estimation.fit import Fit
from rx90_common.estimation.law import Law, Part, Speeds
from rx90_emulator.identification.arm import RigidArm
from rx90_emulator.identification.estimates import (
    SLIDING,
    VISCOUS_EXPONENT,
    Estimates,
    FittedLaw,
    FrictionCurve,
    ParameterEstimate,
    fitted_laws,
    unknown_estimates,
)
from rx90_emulator.identification.records import JointRecord
from rx90_emulator.identification.rows.plateaus import BagUse
from rx90_emulator.identification.rows.sweeps import Blocks, SweepRows, find_blocks, sweep_rows
from rx90_emulator.identification.sanity import Recorded, alarms, torque_scales

MIN_SPEEDS = 5
"""Least number of speeds in each direction: four determine the seven parameters of an element, and one more leaves a
degree of freedom."""
_SAME_SPEED_RATIO = 1.1  # of speeds, up to which they count as one
# deviation of the difference of two Coulomb torques, over their sum, that tells both
_MOST_DIFFERENCE = 0.1
_MAX_RELATIVE_SD = 0.3  # relative standard deviation up to which a parameter is identifiable
# share of an element's friction beyond which its values cannot be trusted to a fourth
_MOST_UNEXPLAINED = 0.2
_LINE_POINTS = 100
_DOES_NOT_SLIDE = "does not slide at constant velocity; accepted: sweeps in both directions"


class SlidingFit(NamedTuple):
    """The sliding regime of all elements.

    Attributes:
        estimates: for each element of the arm, in its order; the parameters are those in SLIDING, and the viscous
            exponent where it is not 1.
        curves: for each element; None where it could not be identified.
        inertial: estimated error of the arm's inertial parameters, to be added to them, shape (10 n,):
            rigid torque = arm.torque(...) + arm.regressor(...) @ inertial.
        inertial_covariance: its covariance, the prior's along directions that sweeps do not observe, (10 n, 10 n).
        usage: what was used of each record, and why the rest was not.
        alarms: which unit, sign, zero, column or delay looks wrong, a sentence each.
        scales: by joint, how many times the torque that the described bodies need was recorded, as in `torque_scales`.
    """

    estimates: tuple[Estimates, ...]
    curves: tuple[FrictionCurve | None, ...]
    inertial: Array
    inertial_covariance: Array
    usage: tuple[BagUse, ...]
    alarms: tuple[str, ...]
    scales: Mapping[str, float]


def identify_sliding(
    records: Sequence[JointRecord],
    arm: RigidArm,
    zero: Array | None = None,
) -> SlidingFit:
    """Fit tau_c+-, tau_s+-, omega_s, delta, c2 and, where the data prefer one, alpha of every element that slides.

    Errors of the arm's inertial parameters, such as an unknown payload, are nuisance parameters of the same fit, so
    that they do not bias the friction. Parameters that are not identifiable are marked as such in the estimates.

    Args:
        records: sweeps of the arm's joints at constant velocity, both directions, several speeds.
        arm: rigid-body model.
        zero: zeros of the encoders that were subtracted from the records, rad, shape (n,); by default 0.
    """
    names = arm.element_names
    where = ", ".join(str(record.source) for record in records)
    blocks, usage = find_blocks(records, arm.element_matrix)
    lacking = _lacking(blocks, names)
    known = np.array([e for e, name in enumerate(names) if name not in lacking], dtype=np.intp)
    if not len(known):
        # The reason of an element that moves is more informative than that of one at rest.
        name = min(lacking, key=lambda name: lacking[name] == _DOES_NOT_SLIDE)
        raise IdentificationError(f"{where}: {name} {lacking[name]}")
    used = ~(~blocks.sliding[blocks.plateau] @ (arm.element_matrix != 0.0)) & arm.identified
    recorded = Recorded(blocks.motion, blocks.later, used, blocks.plateau)
    scales = torque_scales(arm, recorded)
    doubts = alarms(arm, recorded, zero=zero, scales=scales)
    rows = sweep_rows(blocks, arm, known)
    shared = [int(e) >= len(arm.names) for e in known]
    many = min(min(_speeds(blocks.velocity[blocks.sliding[:, e], e])) for e in known) > MIN_SPEEDS
    laws, result = _laws(rows, shared, curved=many)
    if not many:  # of few rows, those that lie far out are needed to tell the parameters apart
        result = fit_laws(rows.friction, laws, result.weight, fitted_values(laws, result.x))
    spread = deviations(result)
    untold = [_untold(element) for element in fitted_laws(laws, result, spread)]
    if any(untold):
        even = [
            replace(law, balanced=law.balanced or alone)
            for law, alone in zip(laws, untold, strict=True)
        ]
        other = fit_laws(rows.friction, even, result.weight, fitted_values(laws, result.x))
        # else the data contradict, and the deviations say the rest
        if other.at_bound.sum() <= result.at_bound.sum():
            laws = even
            result = other
            spread = deviations(result)
    estimates = [unknown_estimates(SLIDING, lacking.get(name, "")) for name in names]
    curves: list[FrictionCurve | None] = [None] * len(names)
    fitted = fitted_laws(laws, result, spread)
    for k, (e, element) in enumerate(zip(known.tolist(), fitted, strict=True)):
        at_bound = result.at_bound[places(laws)[k]]
        # all torques are 0; they may be a weight in another pose
        if at_bound[: len(element.law.sizes)].all():
            error = (
                f"{where}: {names[e]}: the torque does not oppose the motion; accepted: efforts of the sign with which "
                "the drive moves the joint (check the signs of gears and torque constants)"
            )
            raise IdentificationError("; ".join((error, *doubts)))
        estimates[e] = _estimates(element, rows.friction.elements[k].speeds)
        curve = _curve(element, rows, k, result)
        curves[e] = curve
        if curve.share > _MOST_UNEXPLAINED:
            left = f"the law leaves {curve.share:.0%} of the friction of {names[e]} unexplained"
            doubts = (*doubts, f"{left}; accepted: torques and masses that fit each other")
    scale = arm.inertial_scale()
    first = len(result.x)
    covariance = spread.covariance[first:, first:] * np.outer(scale, scale)
    return SlidingFit(
        tuple(estimates),
        tuple(curves),
        scale * result.linear,
        covariance,
        usage,
        doubts,
        scales,
    )


def _lacking(blocks: Blocks, names: Sequence[str]) -> dict[str, str]:
    """Return why elements cannot be identified: those with sweeps at too few speeds, by name."""
    lacking = {}
    for e, name in enumerate(names):
        up, down = _speeds(blocks.velocity[blocks.sliding[:, e], e])
        if up == down == 0:
            lacking[name] = _DOES_NOT_SLIDE
        elif min(up, down) == 0:
            only = "positive" if up else "negative"
            lacking[name] = f"slides at {only} velocities only; accepted: sweeps in both directions"
        elif min(up, down) < MIN_SPEEDS:
            lacking[name] = (
                f"slides at {up} speeds in positive and {down} in negative direction; accepted: {MIN_SPEEDS} or more"
            )
    return lacking


def _speeds(velocity: Array) -> list[int]:
    """Return how many distinct speeds there are in positive and in negative direction."""
    counts = []
    for sign in (1.0, -1.0):
        distinct = [0.0]
        for speed in np.sort(np.abs(velocity[sign * velocity > 0.0])).tolist():
            if speed > _SAME_SPEED_RATIO * distinct[-1]:
                distinct.append(speed)
        counts.append(len(distinct) - 1)
    return counts


def _laws(rows: SweepRows, shared: Sequence[bool], *, curved: bool) -> tuple[list[Law], Fit]:
    """Return the laws that the rows support by held-out plateaus, with exponents if `curved`."""
    plain = [Law(signed=True, balanced=balanced) for balanced in shared]
    # With a rise its exponent is free, so that its uncertainty counts in the other parameters.
    rising = [_shaped(law) for law in choose(rows.friction, [Part.STRIBECK], plain).laws]
    chosen = choose(rows.friction, [Part.EXPONENT] if curved else [], rising)
    return list(chosen.laws), chosen.fit


def _untold(element: FittedLaw) -> bool:
    """Return whether the poses do not tell the difference of an element's two Coulomb torques from a weight."""
    law = element.law
    if law.balanced:
        return False
    sides = [law.names.index(name) for name in ("tau_c_positive", "tau_c_negative")]
    covariance = element.covariance[np.ix_(sides, sides)]
    variance = covariance[0, 0] - 2.0 * covariance[0, 1] + covariance[1, 1]
    return math.sqrt(max(variance, 0.0)) > _MOST_DIFFERENCE * float(element.x[sides].sum())


def _shaped(law: Law) -> Law:
    return (
        replace(law, parts=law.parts | {Part.STRIBECK_EXPONENT})
        if Part.STRIBECK in law.parts
        else law
    )


def _estimates(element: FittedLaw, speeds: Speeds) -> Estimates:
    """Return the estimates, given the speeds with data."""
    absent = f"no Stribeck effect shows at speeds from {speeds.low:.3g} to {speeds.high:.3g} rad/s"
    known = element.estimates(_doubt)
    estimates = {name: known.get(name, ParameterEstimate.unknown(absent)) for name in SLIDING}
    if VISCOUS_EXPONENT in known:
        estimates[VISCOUS_EXPONENT] = known[VISCOUS_EXPONENT]
    return estimates


def _doubt(_: str, value: float, deviation: float, determined: bool) -> str:
    if not determined:
        return f"at a bound of its range, or not separable from other parameters: {value:.3g}"
    if deviation > _MAX_RELATIVE_SD * abs(value):
        return f"standard deviation {deviation:.3g} at a value of {value:.3g}"
    return ""


def _curve(element: FittedLaw, rows: SweepRows, number: int, result: Fit) -> FrictionCurve:
    """Return the points of an element: what everything but it leaves of each row on which it acts."""
    steady = rows.friction.elements[number]
    assert isinstance(steady, SteadyRows)
    fitted = element.curve(steady.velocity)[0]
    sides = []
    for sign in (-1.0, 1.0):
        speed = np.abs(steady.velocity[sign * steady.velocity > 0.0])
        sides.append(sign * np.geomspace(speed.min(), speed.max(), _LINE_POINTS))
    grid = np.sort(np.concatenate(sides))
    return FrictionCurve(
        velocity=steady.velocity,
        torque=fitted + result.residual[steady.rows] / steady.gain,
        deviation=result.noise[rows.slopes[steady.rows]] / np.abs(steady.gain),
        fitted=fitted,
        line=np.stack([grid, *element.curve(grid)]),
    )
