"""The bandwidths of an identification: proposed by the spectra, checked by prediction.

The spectrum of a position shows where its noise begins, but neither the effect of the noise on accelerations nor the
quality of the model. If a log's jittering samples were resampled evenly, for example, interpolation has removed the
noise from the highest frequencies, where the noise floor is estimated. So narrower bandwidths are tried, down to ten
times the band of the motion, and compared by the quantity that counts: how well do their parameters predict times that
the fit has not used?

All candidates are compared on the same rows, those of the narrowest one: each predicts its torque from its motion. So
a narrow bandwidth gains nothing from the torque that it smooths away, and the noise of the accelerations in a wide
bandwidth counts only by its effect on the parameters. The narrowest candidate is fitted to the band in which all are
compared, which gives it a small advantage where the model is not quite right, and a wider one contains more of the
reversals. So the widest candidate is selected whose error is not clearly larger than the least error: by no more than
a tenth, or by no more than two standard errors of the paired differences over blocks of time.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from rx90_common.base.arrays import Array, Index
from rx90_common.base.errors import IdentificationError
from rx90_emulator.identification.excitation.filtering import Bandwidths, least_bandwidth
from rx90_emulator.identification.excitation.fit import solve, time_blocks
from rx90_emulator.identification.excitation.law import coulomb_viscous
from rx90_emulator.identification.excitation.problem import ExcitationProblem
from rx90_emulator.identification.records import JointRecord

Equations = Callable[[Sequence[JointRecord], Bandwidths], ExcitationProblem]
"""Returns the equations of records that were filtered with these bandwidths."""

ROWS_PER_PARAMETER = 2.0
"""Of the simplest model, at least: fewer predict nothing."""
_MIN_BANDWIDTH = 1e-6  # Hz
_NARROWER = 3  # largest number of bandwidths tried beside the widest
_MIN_RATIO = 2.0  # between two of them
# over the least error; standard errors beyond it
_ACCEPTED_RATIO = 1.1
_ACCEPTED_SE = 2.0
_SINGULAR = 1e-10  # relative: directions that the remaining rows do not determine stay 0


_Candidate = tuple[Bandwidths, ExcitationProblem]
"""Bandwidths of both filters, and their equations."""


def choose_bandwidths(
    records: Sequence[JointRecord], equations: Equations, given: float | None = None
) -> tuple[Bandwidths, ExcitationProblem]:
    """Return the selected bandwidths with their equations.

    Args:
        records: of the runs to identify from.
        equations: makes the equations for bandwidths.
        given: bandwidth of the positions, Hz; that of the torque is a third of it. By default it is selected.
    """
    if given is not None:
        if not _MIN_BANDWIDTH <= given < math.inf:
            raise IdentificationError(f"--bandwidth is {given:g} Hz; accepted: a number of at least {_MIN_BANDWIDTH:g}")
        bandwidths = Bandwidths(given, given / 3.0)
        return bandwidths, equations(records, bandwidths)
    widest = Bandwidths.of(records)
    silent = next(filter(None, (record.no_velocity for record in records)), "")
    candidates, residuals, number = _compared(widest, records, equations)
    compared = candidates[-1][1]
    if all(run.reference is not None for run in compared.runs):
        # Velocities of emulated drives' observers predict low frequencies better, but bias rotor inertias by up to 2 %.
        silent = "the set-points in the bags tell more than they"
    (chosen, problem) = candidates[number]
    reason = widest.reason
    if len(candidates) > 1:
        size = np.linalg.norm(compared.torque)
        figures = ", ".join(
            f"{100.0 * float(np.linalg.norm(residual) / size):.3g} % with {bandwidths.position:.3g} Hz"
            for (bandwidths, _), residual in zip(candidates, residuals, strict=True)
        )
        reason += (
            f"; the torque below {compared.runs[0].bandwidths.torque:.3g} Hz of times that were left out is predicted "
            f"to {figures}: the positions get {chosen.position:.3g} Hz"
        )
    if silent:
        reason += f"; velocities are differences of positions, for {silent}"
    else:
        own = residuals[-1] if residuals else _left_out(compared, compared)
        better, velocity = _recorded_velocity(records, equations, compared, own)
        reason += f"; {velocity}"
        if better:
            chosen = chosen._replace(recorded_velocity=True)
            problem = equations(records, chosen)
    chosen = chosen._replace(reason=reason)
    return chosen, replace(problem, runs=tuple(replace(run, bandwidths=chosen) for run in problem.runs))


def _recorded_velocity(
    records: Sequence[JointRecord], equations: Equations, compared: ExcitationProblem, residual: Array
) -> tuple[bool, str]:
    """Return whether recorded velocities predict better than differences of positions, and both results in words.

    Both predict the same torques below the narrowest bandwidth, each from its own motion; a noisy motion predicts
    worse.
    """
    twin = equations(records, compared.runs[0].bandwidths._replace(recorded_velocity=True))
    first_key = (compared.run * len(compared.arm.names) + compared.joint) * max(
        len(run.rows) for run in compared.runs
    ) + compared.place
    second_key = (twin.run * len(twin.arm.names) + twin.joint) * max(
        len(run.rows) for run in compared.runs
    ) + twin.place
    # An element may stop in one motion and not in the other.
    _, rows, its = np.intersect1d(first_key, second_key, assume_unique=True, return_indices=True)
    pair = residual[rows], _left_out(twin, twin)[its]
    better = _best(pair, compared, rows) == 1
    size = float(np.linalg.norm(compared.torque[rows]))
    differences, velocities = (100.0 * float(np.linalg.norm(one)) / size for one in pair)
    text = f"from recorded velocities it is predicted to {velocities:.3g} %, from differences of positions to "
    return better, f"{text}{differences:.3g} %: {'the former' if better else 'differences'} are used"


def _compared(
    widest: Bandwidths, records: Sequence[JointRecord], equations: Equations
) -> tuple[list[_Candidate], list[Array], int]:
    """Return the candidates, the widest first, their residuals, Nm, shape (r,), and the number of the best.

    The last one has ten times the motion's band; its r rows are compared. Bandwidths in between are tried where it
    predicts clearly better than the widest.
    """
    ratio = max(widest.position / least_bandwidth(records), 1.0)
    count = min(_NARROWER, math.floor(math.log(ratio, _MIN_RATIO) + 1e-9))
    narrower = [widest.position * ratio ** (-step / count) for step in range(1, count + 1)]

    def at(position: float) -> _Candidate | None:
        bandwidths = Bandwidths(position, min(widest.torque, position / 3.0))
        try:
            problem = equations(records, bandwidths)
        except IdentificationError:  # the runs are too short for the long filters
            return None
        return (bandwidths, problem) if len(problem) >= ROWS_PER_PARAMETER * problem.parameters else None

    first = last = (widest, equations(records, widest))
    while narrower and first is last:
        last = at(narrower.pop()) or first
    if first is last:
        return [first], [], 0
    found = [first, last]
    residuals = [_left_out(problem, last[1]) for _, problem in found]
    best = _best(residuals, last[1])
    if between := list(filter(None, map(at, narrower if best else ()))):
        found[1:1] = between
        residuals[1:1] = [_left_out(problem, last[1]) for _, problem in between]
        best = _best(residuals, last[1])
    return found, residuals, best


def _best(residuals: Sequence[Array], compared: ExcitationProblem, rows: Index | slice = slice(None)) -> int:
    """Return the first candidate whose residuals on these rows are not clearly larger than the least, joints alike."""
    joint = compared.joint[rows]
    block = time_blocks(compared)[rows]
    least = np.ones(joint.max() + 1)  # for each joint: the RMS of the candidate that predicts it best
    for number in np.unique(joint).tolist():
        own = joint == number
        least[number] = max(min(float(np.sqrt(np.mean(one[own] ** 2))) for one in residuals), 1e-12)
    squares = [np.bincount(block, (one / least[joint]) ** 2) for one in residuals]
    best = min(squares, key=np.sum)
    for number, own in enumerate(squares):
        more = float(np.sum(own - best))
        deviation = float(np.std(own - best, ddof=1) * math.sqrt(len(own)))
        if own.sum() <= _ACCEPTED_RATIO**2 * best.sum() or more <= _ACCEPTED_SE * deviation:
            return number
    raise AssertionError  # the best one is no larger than itself


def _left_out(problem: ExcitationProblem, compared: ExcitationProblem) -> Array:
    """Return residuals of the compared rows, each block of time by the parameters fitted without it, shape (r,)."""
    own = np.hstack([problem.regressor, coulomb_viscous(problem)])
    other = np.hstack([compared.regressor, coulomb_viscous(compared)])
    fit = solve(problem, own)
    weighted = own * (fit.weights / fit.sigma[problem.joint] ** 2)[:, None]
    whole = weighted.T @ own
    right = weighted.T @ problem.torque
    block = time_blocks(compared)
    residual = np.empty(len(compared))
    inside = block[_nearest(problem, compared)]
    for number in np.unique(block).tolist():
        mine = inside == number
        rows = block == number
        gram = whole - weighted[mine].T @ own[mine]
        scale = np.sqrt(np.maximum(np.diag(gram), 1e-300))
        target = (right - weighted[mine].T @ problem.torque[mine]) / scale
        value = np.linalg.lstsq(gram / np.outer(scale, scale), target, rcond=_SINGULAR)[0] / scale
        residual[rows] = compared.torque[rows] - other[rows] @ value
    return residual


def _nearest(problem: ExcitationProblem, compared: ExcitationProblem) -> Index:
    """Return for each row the compared row of the same bag that is nearest in time, shape (r,)."""
    result = np.zeros(len(problem), dtype=np.intp)
    paths = np.array([str(run.source.path) for run in problem.runs])[problem.run]
    theirs = np.array([str(run.source.path) for run in compared.runs])[compared.run]
    for path in np.unique(paths):
        rows = np.flatnonzero(paths == path)
        known = np.flatnonzero(theirs == path)
        if len(known):
            known = known[np.argsort(compared.time[known], kind="stable")]
            time = compared.time[known]
            place = np.clip(np.searchsorted(time, problem.time[rows]), 1, max(len(time) - 1, 1))
            before = problem.time[rows] - time[place - 1] < time[np.minimum(place, len(time) - 1)] - problem.time[rows]
            result[rows] = known[np.minimum(place - before, len(time) - 1)]
    return result
