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

from rx90_common.base.arrays import Array
from rx90_common.base.errors import IdentificationError
from rx90_emulator.identification.excitation.least_squares import LinearFit, solve
from rx90_emulator.identification.excitation.problem import ExcitationProblem

_ROUNDS = 20
_CONVERGED = 1e-6
_TOLD = 0.1  # deviation of a gain, above which the payload does not tell it


@dataclass(frozen=True, eq=False)
class DriveGains:
    """Of the motors, in the order of the joints.

    Attributes:
        factor: true over recorded torque, shape (n,); 1 where it is not told.
        deviation: of the factors, shape (n,); infinite where it is not told.
        fit: of the inertial parameters b, of friction f and of 1 / factor of the motors told: shape (b + f + t,).
    """

    factor: Array
    deviation: Array
    fit: LinearFit


def drive_gains(problem: ExcitationProblem, friction: Array) -> DriveGains:
    """Identify the factor by which each motor's recorded torque is to be multiplied.

    Args:
        problem: with known payloads in some runs.
        friction: columns, shape (r, f).

    Raises:
        IdentificationError: without a known payload, without a run that carries none or another one, or if the payload
            tells no motor's gain.
    """
    _check(problem)
    parts, loads = _by_motor(problem)
    told = [k for k in range(len(loads)) if np.any(loads[k])]
    while told:
        factor, deviation, fit = _fitted(problem, friction, parts, loads, told)
        sure = [k for k in told if deviation[k] < _TOLD]
        if sure == told:
            return DriveGains(factor, deviation, fit)
        told = sure
    raise IdentificationError(
        f"the payload tells no drive gain to better than {_TOLD:.0%}; accepted: a heavier payload, or faster motion"
    )


def with_gains(problem: ExcitationProblem, factor: Array) -> ExcitationProblem:
    """Return the problem with its recorded torques multiplied by the factors of their motors, shape (n,)."""
    turns = problem.arm.coupling
    scale = np.linalg.inv(turns) @ np.diag(factor) @ turns
    runs = tuple(replace(run, torque=run.torque @ scale) for run in problem.runs)
    recorded = problem.rows_of([run.torque[:, :, None] for run in runs])[:, 0]
    return replace(problem, runs=runs, torque=recorded - problem.payload)


def _check(problem: ExcitationProblem) -> None:
    if not np.any(problem.payload):
        raise IdentificationError("no payload is given, and drive gains show in nothing else; accepted: --payload")
    bodies = [None if body is None else tuple(body.parameters().tolist()) for body in problem.payloads]
    if len(set(bodies)) == 1:
        raise IdentificationError(
            "all runs carry the same payload, which the last link's own inertia could stand for; accepted: runs with "
            "and without it"
        )


def _by_motor(problem: ExcitationProblem) -> tuple[list[Array], list[Array]]:
    """Return the columns of the base and the torque of the payloads that each motor carries, at the rows."""
    turns, n = problem.arm.coupling, len(problem.arm.names)
    shares = [np.outer(np.linalg.inv(turns)[:, k], turns[k]) for k in range(n)]  # of joint torques, to joint torques
    parts, loads = [], []
    for share in shares:
        columns, load = problem.through(share)
        parts.append(columns)
        loads.append(load)
    return parts, loads


def _fitted(
    problem: ExcitationProblem, friction: Array, parts: Sequence[Array], loads: Sequence[Array], told: Sequence[int]
) -> tuple[Array, Array, LinearFit]:
    """Return factors and deviations of all motors, and the fit."""
    b, q = problem.regressor.shape[1], problem.regressor.shape[1] + friction.shape[1]
    inverse = np.ones(len(parts))
    recorded = problem.torque + problem.payload
    parameters = np.zeros(b)
    for _ in range(_ROUNDS):
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
    factor, deviation = 1.0 / inverse, np.full(len(parts), np.inf)
    deviation[list(told)] = fit.deviation[q:] * factor[list(told)] ** 2
    return factor, deviation, fit
