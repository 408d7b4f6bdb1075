"""Friction that grows with the torque that a joint transmits, along recorded motions, and what is known of it.

The part adds k |l| to the friction torque, k for driving (l v >= 0) and for driven joints. The transmitted torque l is
that of the links and springs, known payload included: the base parameters' without the rotors. It is computed along
the filtered motion, not from the measured torque, whose noise would be in column and torque alike and make k too small.
A rotor that acts as one with its link is taken off by the description's inertia. The lag of the part, a millisecond or
so, is far below the filters'.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from rx90_common.base.arrays import Array
from rx90_common.base.quoting import listed
from rx90_common.friction.parts.load import DIRECTIONS, LoadPart
from rx90_emulator.identification.excitation.filtering import FilteredRun
from rx90_emulator.identification.excitation.payload import Payload
from rx90_emulator.identification.excitation.problem import ExcitationProblem
from rx90_emulator.identification.model.estimates import ParameterEstimate

_DIGITS = 6  # significant ones of a coefficient to simulate with
_BLOCK = 4000  # samples whose columns are in memory at a time


@dataclass(frozen=True, eq=False)
class LoadParts:
    """The load parts of an arm's elements, in its order.

    Attributes:
        value: coefficients by element and direction, as DIRECTIONS has them, >= 0, shape (n_el, 2); 0 without a part.
        kept: numbers of the k elements that have a part.
        covariance: of their coefficients, element by element, shape (2 k, 2 k).
        base: parameters that the transmitted torques are computed with, shape (b,).
        transmitted: RMS torque that each element transmits in the runs, Nm, shape (n_el,).
        reasons: why an element has no part; empty where it has one, shape (n_el,).
        gain: by how much the model predicts better with them than without, in words.
    """

    value: Array
    kept: tuple[int, ...]
    covariance: Array
    base: Array
    transmitted: Array
    reasons: tuple[str, ...]
    gain: str = ""

    @property
    def deviation(self) -> Array:
        """Return the standard deviations of the coefficients, shape (n_el, 2); 0 without a part."""
        result = np.zeros_like(self.value)
        result[list(self.kept)] = np.sqrt(np.diag(self.covariance)).reshape(-1, len(DIRECTIONS))
        return result

    def remark(self, names: Sequence[str]) -> str:
        """Return in a sentence which of these elements have a part, and on what it rests."""
        having = listed([names[e] for e in self.kept]) if self.kept else "no element"
        gain = f"{self.gain}; " if self.gain else ""
        return (
            f"load parts of {having}: {gain}the torque constants count as right; a recorded torque that is too large "
            "by a share adds that to driving and takes it from driven"
        )

    def part(self, element: int) -> LoadPart | None:
        """Return the part of an element, to simulate with."""
        if element not in self.kept:
            return None
        return LoadPart(*(float(f"{value:.{_DIGITS}g}") for value in self.value[element]))

    def estimates(self, element: int) -> dict[str, ParameterEstimate]:
        """Return what is known of an element's coefficients, by their places in the friction file."""
        names = [f"{LoadPart.name}.{direction}" for direction in DIRECTIONS]
        if element not in self.kept:
            return dict.fromkeys(names, ParameterEstimate.unknown(self.reasons[element]))
        pairs = zip(self.value[element].tolist(), self.deviation[element].tolist(), strict=True)
        return {name: ParameterEstimate(*pair) for name, pair in zip(names, pairs, strict=True)}


def transmitted_torques(problem: ExcitationProblem, base: Array) -> list[Array]:
    """Return what each element transmits along each run, Nm, each of shape (m, n_el).

    Args:
        problem: the runs with their payloads.
        base: parameters of its columns, shape (b,).
    """
    names = problem.columns.names
    parameters = np.zeros(len(names))
    parameters[list(problem.base.leading)] = base
    # Rotors that the runs tell from the links.
    alone = {
        place
        for place, row in zip(problem.base.leading, problem.base.combination, strict=True)
        if np.count_nonzero(row) == 1
    }
    described = problem.columns.values()
    for place, name in enumerate(names):
        kind = name.split("_")[0]
        if kind == "Ia":
            parameters[place] -= parameters[place] if place in alone else described[place]
        elif kind == "offset":
            parameters[place] = 0.0
    return [_transmitted(problem, *pair, parameters) for pair in zip(problem.runs, problem.payloads, strict=True)]


def load_columns(problem: ExcitationProblem, transmitted: list[Array]) -> Array:
    """Return the joint torques per unit of the coefficients of all elements, shape (r, 2 n_el).

    The velocity's sign is taken where the torque was recorded, as that of the Coulomb columns.
    """
    elements, along = problem.arm.element_matrix.T, []
    for run, load in zip(problem.runs, transmitted, strict=True):
        sign = run.torque_velocity @ elements
        forward, back = run.evened((sign > 0.0).astype(np.float64)), run.evened((sign < 0.0).astype(np.float64))
        pull, push = np.maximum(load, 0.0), np.maximum(-load, 0.0)
        along.append(np.stack([forward * pull - back * push, forward * push - back * pull], axis=2))
    return problem.element_rows(along)


def with_load_parts(problem: ExcitationProblem, parts: LoadParts) -> ExcitationProblem:
    """Return the problem less the torque of the load parts, uncertain as they are."""
    columns = load_columns(problem, transmitted_torques(problem, parts.base))
    free = [len(DIRECTIONS) * e + k for e in parts.kept for k in range(len(DIRECTIONS))]
    size, directions = np.linalg.eigh(parts.covariance)
    uncertain = columns[:, free] @ (directions * np.sqrt(np.maximum(size, 0.0)))
    torque = problem.torque - columns @ parts.value.ravel()
    return replace(problem, torque=torque, uncertain=np.hstack([problem.uncertain, uncertain]))


def _transmitted(problem: ExcitationProblem, run: FilteredRun, body: Payload | None, parameters: Array) -> Array:
    arm, whole = problem.arm, parameters.copy()
    n = len(arm.names)
    if body is not None:
        whole[10 * n - 10 : 10 * n] += body.parameters()
    joint = np.empty_like(run.position)
    for first in range(0, len(joint), _BLOCK):
        part = slice(first, first + _BLOCK)
        joint[part] = problem.columns.torque(run.position[part], run.velocity[part], run.acceleration[part]) @ whole
    motor = np.linalg.solve(arm.coupling.T, joint.T).T
    together = [k for k, row in enumerate(arm.coupling) if np.count_nonzero(row) > 1]
    return np.hstack([motor, motor[:, together]])
