"""Drive gains from runs with and without a payload of known inertia.

A recorded torque is a current times a gain that is known to some per cent. Inertias and friction scale with it, so runs
of the arm alone cannot tell; the torque of a payload that was put on the scales does (Gautier and Briot 2014, "Global
identification of joint drive gains and dynamic parameters of robots", ASME Journal of Dynamic Systems, Measurement and
Control). With s_i = true over recorded torque of motor i and A_i, l_i the motor's part in columns and payload torque,

    recorded = sum_i (A_i @ parameters + l_i) / s_i + friction in recorded units.

This is linear in the inertial parameters for given gains and in 1 / s for given parameters: Gauss and Newton's steps
with weights, robust weights and deviations of `solve`. The recorded torque, which carries the noise, stays on the left;
with it among the columns the gains would come out too small.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from rx90_common.base.arrays import Array, Index
from rx90_common.base.errors import IdentificationError
from rx90_emulator.identification.excitation.least_squares import LinearFit, solve
from rx90_emulator.identification.excitation.problem import ExcitationProblem

_MAX_ROUNDS = 20
_CONVERGED = 1e-6
_MAX_GAIN_SD = 0.1  # deviation of a gain, as a share of it, above which the payload does not tell it
PLAUSIBLE = (0.75, 1.33)
"""Gains that a drive may have. A data sheet's torque constant is right to some 10 %, a hot magnet gives as much less, a
gear's losses take 10 to 15 % and are partly friction; A RMS that are taken for peak A make 0.71 or 1.41."""
_NEGATIVE_SE = 3.0  # deviations below 0: no noise makes a motor push backwards


@dataclass(frozen=True, eq=False)
class DriveGains:
    """Of the motors, in the order of the joints.

    Attributes:
        factor: true over recorded torque, shape (n,); 1 where it is not told.
        covariance: of the factors, shape (n, n); infinite on the diagonal where it is not told, 0 beside it.
        fit: of the inertial parameters b, of friction f and of 1 / factor of the motors told: shape (b + f + t,).
    """

    factor: Array
    covariance: Array
    fit: LinearFit

    @property
    def deviation(self) -> Array:
        """Return standard deviations of the factors, shape (n,); infinite where it is not told."""
        return np.asarray(np.sqrt(np.diag(self.covariance)))

    @property
    def told(self) -> Index:
        """Return the numbers of the motors whose gain is told."""
        return np.flatnonzero(np.isfinite(self.deviation))

    @property
    def implausible(self) -> Index:
        """Return the numbers of the motors whose gain is told, but hardly to be believed."""
        low, high = PLAUSIBLE
        return np.asarray([k for k in self.told if not low <= self.factor[k] <= high], dtype=np.intp)

    def after(self, factor: Array) -> DriveGains:
        """Return the whole gains, where these are of torques that were multiplied by factors before, shape (n,)."""
        known = np.isfinite(self.deviation)
        factor = np.where(known, factor, 1.0)
        return DriveGains(self.factor * factor, self.covariance * np.outer(factor, factor), self.fit)


def drive_gains(problem: ExcitationProblem, friction: Array) -> DriveGains:
    """Identify the factor by which each motor's recorded torque is to be multiplied.

    Args:
        problem: with known payloads in some runs.
        friction: columns, shape (r, f).

    Raises:
        IdentificationError: without a known payload, without a run that carries none or another one, if the payload
            tells no motor's gain, or if a gain comes out at 0 or below.
    """
    _check(problem)
    parts, loads = _by_motor(problem)
    told = [k for k in range(len(loads)) if np.any(loads[k])]
    while told:
        gains = _fitted(problem, friction, parts, loads, told)
        _check_signs(problem, gains, told)
        sure = [k for k in told if gains.deviation[k] < _MAX_GAIN_SD * abs(gains.factor[k])]
        if sure == told:
            return gains
        told = sure
    raise IdentificationError(
        f"the payload tells no drive gain to better than {_MAX_GAIN_SD:.0%}; accepted: a heavier payload, or faster "
        "motion"
    )


def with_gains(problem: ExcitationProblem, gains: DriveGains) -> ExcitationProblem:
    """Return the problem with its recorded torques multiplied by the factors of their motors, and uncertain as they."""
    shares = _motor_shares(problem)
    scale = sum(one * share for one, share in zip(gains.factor.tolist(), shares, strict=True))
    runs = tuple(replace(run, torque=run.torque @ scale) for run in problem.runs)
    told = gains.told
    relative = gains.covariance[np.ix_(told, told)] / np.outer(gains.factor[told], gains.factor[told])
    rows = problem.rows_of([np.stack([run.torque, *(run.torque @ shares[k] for k in told)], axis=2) for run in runs])
    uncertain = rows[:, 1:] @ np.linalg.cholesky(relative)
    return replace(problem, runs=runs, torque=rows[:, 0] - problem.payload, uncertain=uncertain)


def _check(problem: ExcitationProblem) -> None:
    if not np.any(problem.payload):
        raise IdentificationError("no payload is given, and drive gains show in nothing else; accepted: --payload")
    bodies = [None if body is None else tuple(body.parameters().tolist()) for body in problem.payloads]
    if len(set(bodies)) == 1:
        raise IdentificationError(
            "all runs carry the same payload, which the last link's own inertia could stand for; accepted: runs with "
            "and without it"
        )


def _check_signs(problem: ExcitationProblem, gains: DriveGains, told: Sequence[int]) -> None:
    """Refuse gains at 0 or below that are told, or that are below 0 for certain: the payload is not the one given."""
    for k in told:
        value, deviation = float(gains.factor[k]), float(gains.deviation[k])
        if value <= 0.0 and (deviation < _MAX_GAIN_SD or value + _NEGATIVE_SE * deviation < 0.0):
            raise IdentificationError(
                f"drive gain of {problem.arm.names[k]}: {value:.3g} +- {deviation:.2g} by this payload; accepted: "
                "above 0 (is its mass, its centre's direction in the last joint's frame, or the run it is of wrong?)"
            )


def _motor_shares(problem: ExcitationProblem) -> list[Array]:
    """Return for each motor what of joint torques it carries, as joint torques: torque @ share, each shape (n, n)."""
    turns = problem.arm.coupling
    inverse = np.linalg.inv(turns)
    return [np.outer(inverse[:, k], turns[k]) for k in range(len(turns))]


def _by_motor(problem: ExcitationProblem) -> tuple[list[Array], list[Array]]:
    """Return the columns of the base and the torque of the payloads that each motor carries, at the rows."""
    parts, loads = [], []
    for share in _motor_shares(problem):
        columns, load = problem.through(share)
        parts.append(columns)
        loads.append(load)
    return parts, loads


def _fitted(
    problem: ExcitationProblem, friction: Array, parts: Sequence[Array], loads: Sequence[Array], told: Sequence[int]
) -> DriveGains:
    """Return the gains of all motors, those of the motors told free."""
    b, q = problem.regressor.shape[1], problem.regressor.shape[1] + friction.shape[1]
    inverse = np.ones(len(parts))
    recorded = problem.torque + problem.payload
    parameters = np.zeros(b)
    for _ in range(_MAX_ROUNDS):
        mixed = sum(one * part for one, part in zip(inverse.tolist(), parts, strict=True))
        carried = [parts[k] @ parameters + loads[k] for k in told]
        columns = np.column_stack([mixed, friction, *carried])
        rest = [k for k in range(len(parts)) if k not in told]
        # Linearised: mixed @ parameters is counted by the gains' columns, too, and taken off once.
        target = recorded + sum(inverse[k] * (parts[k] @ parameters) for k in told) - sum(loads[k] for k in rest)
        fit = solve(problem, columns, target)
        moved = float(np.max(np.abs(fit.value[q:] - inverse[list(told)])))
        inverse[list(told)] = fit.value[q:]
        parameters = fit.value[:b]
        if moved < _CONVERGED:
            break
    factor, covariance = 1.0 / inverse, np.diag(np.full(len(parts), np.inf))
    slope = factor[list(told)] ** 2
    covariance[np.ix_(told, told)] = fit.covariance[q:, q:] * np.outer(slope, slope)
    return DriveGains(factor, covariance, fit)
