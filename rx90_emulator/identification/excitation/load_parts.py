"""Friction that grows with the torque that a joint transmits, along recorded motions, and what is known of it.

The part adds k |l| to the friction torque, k for driving (l v >= 0) and for driven joints. The transmitted torque l is
that of the links and springs, known payload included: the base parameters' without the rotors. It is computed along
the filtered motion, not from the measured torque, whose noise would be in column and torque alike and make k too small.
A rotor that acts as one with its link is taken off by the description's inertia. The lag of the part, a millisecond or
so, is far below the filters'.

Which elements' friction grows with the load, and by how much, from runs with different known payloads.

With the arm's own inertias unknown, a friction that is larger for driving than for driven joints acts like larger
inertias: l + (k+ - k-) / 2 l. A payload of known inertia tells the two apart. It cannot tell that from a drive gain,
which does the same: the torque constants count as right here, or else the drive gains are identified and no load parts.

All elements' coefficients are linear in the torque for given transmitted torques, which depend on the base parameters
and these on the coefficients: both are fitted in turn. A change of the coefficients comes back multiplied by at most
the coefficients themselves, so that every round takes off an order of magnitude. Elements that predict as well without
their part lose it, the least useful first, by the cross-validation that chooses the other parts; those that remain
must also be there beyond chance (1 % over all elements together).
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.stats import chi2

from rx90_common.base.arrays import Array
from rx90_common.base.errors import IdentificationError
from rx90_common.base.quoting import listed
from rx90_common.friction.parts.load import DIRECTIONS, LARGEST_COEFFICIENT, LoadPart
from rx90_emulator.identification.estimates import ParameterEstimate
from rx90_emulator.identification.excitation.checks import coulomb_viscous
from rx90_emulator.identification.excitation.filtering import FilteredRun
from rx90_emulator.identification.excitation.friction.cross_validation import Linearised, Scored, TimeBlocks
from rx90_emulator.identification.excitation.friction.fit import SeparableFit, WeightedProblem, fit_shapes
from rx90_emulator.identification.excitation.friction.law import Part
from rx90_emulator.identification.excitation.friction.selection import Selected, select_parts, tangent, verdict
from rx90_emulator.identification.excitation.least_squares import solve
from rx90_emulator.identification.excitation.payload import Payload
from rx90_emulator.identification.excitation.problem import ExcitationProblem

_DIGITS = 6  # significant ones of a coefficient to simulate with
_BLOCK_SAMPLES = 4000  # samples whose columns are in memory at a time


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
    for first in range(0, len(joint), _BLOCK_SAMPLES):
        part = slice(first, first + _BLOCK_SAMPLES)
        joint[part] = problem.columns.torque(run.position[part], run.velocity[part], run.acceleration[part]) @ whole
    motor = np.linalg.solve(arm.coupling.T, joint.T).T
    together = [k for k, row in enumerate(arm.coupling) if np.count_nonzero(row) > 1]
    return np.hstack([motor, motor[:, together]])


_MAX_ROUNDS, _FIRST_ROUNDS = 12, 3
_CONVERGED = 1e-5  # change of a coefficient
_LEVEL = 0.01  # of finding a part on any element of an arm that has none
_MAX_COEFFICIENT_SD = 0.05  # deviation of a coefficient from which on the runs do not tell it
_NEGATIVE_SE = 3.0  # deviations below 0: no friction falls with the load
_WIDTH = len(DIRECTIONS)


def identify_load_parts(
    problem: ExcitationProblem, parts: Sequence[Part], progress: Callable[[str], None] = lambda _: None
) -> LoadParts:
    """Identify the load parts of all elements, together with everything else.

    Args:
        problem: of runs with two different known payloads or more, none being one.
        parts: of the friction, to try beside.
        progress: as in `select_parts`.

    Raises:
        IdentificationError: for runs that all carry the same payload.
    """
    _check(problem)
    names, columns = coulomb_viscous(problem)
    moving = tuple(e for e in range(len(names) // 2) if columns[:, 2 * e].any())
    rough = _rough(problem, columns, moving)
    search = _Search(problem, select_parts(with_load_parts(problem, rough), parts, progress))
    everywhere = search.converged(moving, rough.base)
    kept, reasons, gain = search.trimmed(moving, everywhere)
    return replace(_load_parts(problem, search.converged(kept, everywhere.base), kept, reasons), gain=gain)


@dataclass(frozen=True, eq=False)
class _Model:
    """A fit of everything.

    Attributes:
        base: parameters, shape (b,).
        value: coefficients of the elements that may have a part, element by element, shape (2 k,).
        covariance: of these, shape (2 k, 2 k).
        columns: of all elements' coefficients, shape (r, 2 n_el).
    """

    base: Array
    value: Array
    covariance: Array
    columns: Array


class _Search:
    """The rows with the shapes of the other friction, and models of who has a load part."""

    def __init__(self, problem: ExcitationProblem, selected: Selected) -> None:
        self._problem, self._elements = problem, selected.weighted.elements
        self._weight, self._shapes = selected.weighted.weight, selected.fit.shapes
        # A run is no test of what the others cannot tell: they have one payload alone.
        bodies = _bodies(problem)
        others = [bodies[:k] + bodies[k + 1 :] for k in range(len(bodies))]
        self._told_without_each_run = all(len(set(some)) > 1 for some in others)
        self._time = TimeBlocks.of(problem, Linearised.of(selected.weighted, selected.fit).residual)

    def converged(self, kept: Sequence[int], base: Array) -> _Model:
        """Return the model of those elements whose transmitted torques are those of its own base parameters."""
        value = np.zeros(_WIDTH * len(kept))
        for _ in range(_MAX_ROUNDS):
            columns = load_columns(self._problem, transmitted_torques(self._problem, base))
            weighted, fit = self._fitted(kept, columns)
            # All rows count by the weights of this model itself, with deviations that hold under misfit.
            whole = solve(weighted.problem, tangent(weighted, fit, fit.inner()))
            places = len(base) + np.arange(len(value))
            moved = float(np.max(np.abs(whole.value[places] - value), initial=0.0))
            base, value = whole.value[: len(base)], whole.value[places]
            if moved < _CONVERGED:
                break
        return _Model(base, value, whole.covariance[np.ix_(places, places)], columns)

    def trimmed(self, kept: Sequence[int], model: _Model) -> tuple[tuple[int, ...], dict[int, str], str]:
        """Return the elements that need their part to predict, why the others have none, and what all parts gain."""
        left, reasons = list(kept), _beyond_chance(kept, model)
        left = [e for e in left if e not in reasons]
        while left:
            now = self._scored(left, model.columns)
            trials = {e: self._scored([other for other in left if other != e], model.columns) for e in left}
            useless = {e: now.validations(one)[0].gain for e, one in trials.items() if not now.better_than(one)}
            if not useless:
                break
            worst = min(useless, key=lambda e: useless[e])
            reasons[worst] = f"with a load part, {verdict(now, trials[worst])}"
            left.remove(worst)
        gain = verdict(self._scored(left, model.columns), self._scored((), model.columns)) if left else ""
        return tuple(left), reasons, gain

    def _fitted(self, kept: Sequence[int], columns: Array) -> tuple[WeightedProblem, SeparableFit]:
        regressor = np.hstack([self._problem.regressor, columns[:, _places(kept)]])
        weighted = WeightedProblem.of(replace(self._problem, regressor=regressor), self._elements, self._weight)
        return weighted, fit_shapes(weighted, self._shapes)

    def _scored(self, kept: Sequence[int], columns: Array) -> Scored:
        model = Scored.of(*self._fitted(kept, columns), self._time)
        return model if self._told_without_each_run else replace(model, by_runs=None)


def _rough(problem: ExcitationProblem, friction: Array, moving: Sequence[int]) -> LoadParts:
    """Return first values, beside Coulomb and viscous friction."""
    base = solve(problem, np.hstack([problem.regressor, friction])).value[: problem.regressor.shape[1]]
    count = len(problem.arm.element_names)
    value = np.zeros((count, _WIDTH))
    for _ in range(_FIRST_ROUNDS):
        columns = load_columns(problem, transmitted_torques(problem, base))[:, _places(moving)]
        whole = solve(problem, np.hstack([problem.regressor, columns, friction])).value
        base = whole[: len(base)]
        value[list(moving)] = whole[len(base) : len(base) + _WIDTH * len(moving)].reshape(-1, _WIDTH)
    return LoadParts(value, (), np.zeros((0, 0)), base, np.zeros(count), ("",) * count)


def _beyond_chance(elements: Sequence[int], model: _Model) -> dict[int, str]:
    """Return why elements have no part, of which the coefficients are not told, or not there beyond chance."""
    reasons = {}
    for k, e in enumerate(elements):
        own = slice(_WIDTH * k, _WIDTH * (k + 1))
        value, covariance = model.value[own], model.covariance[own, own]
        deviation = np.sqrt(np.diag(covariance))
        texts = " and ".join(
            f"{name} {100.0 * one:.2g} +- {100.0 * size:.2g} %"
            for name, one, size in zip(DIRECTIONS, value.tolist(), deviation.tolist(), strict=True)
        )
        if not (deviation < _MAX_COEFFICIENT_SD).all():
            reasons[e] = f"the runs do not tell it: {texts} of the load"
        elif (value < -_NEGATIVE_SE * deviation).any() or value.max() > LARGEST_COEFFICIENT:
            reasons[e] = f"no load part has these coefficients: {texts} of the load"
        elif value @ np.linalg.solve(covariance, value) < chi2.ppf(1.0 - _LEVEL / len(elements), _WIDTH):
            reasons[e] = f"no more than chance: {texts} of the load"
    return reasons


def _load_parts(
    problem: ExcitationProblem, model: _Model, kept: tuple[int, ...], reasons: Mapping[int, str]
) -> LoadParts:
    names = problem.arm.element_names
    loads = np.vstack(transmitted_torques(problem, model.base))
    size = np.sqrt(np.mean(loads**2, axis=0))
    value = np.zeros((len(names), _WIDTH))
    value[list(kept)] = np.maximum(model.value, 0.0).reshape(-1, _WIDTH)
    texts = [
        "" if e in kept else f"{reasons.get(e, 'it rests')} (RMS of the load {size[e]:.3g} Nm)"
        for e in range(len(names))
    ]
    return LoadParts(value, kept, model.covariance, model.base, size, tuple(texts))


def _bodies(problem: ExcitationProblem) -> list[tuple[float, ...] | None]:
    return [None if body is None else tuple(body.parameters().tolist()) for body in problem.payloads]


def _places(elements: Sequence[int]) -> list[int]:
    return [_WIDTH * e + k for e in elements for k in range(_WIDTH)]


def _check(problem: ExcitationProblem) -> None:
    if len(set(_bodies(problem))) < 2:
        raise IdentificationError(
            "load parts from runs that all carry the same payload; accepted: runs with two or more, of which one may "
            "be none"
        )
