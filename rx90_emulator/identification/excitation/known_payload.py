"""Runs with and without a payload of known inertia: identification of drive gains, or of load parts of the friction.

**Drive gains.** A recorded torque is a current times a gain that is known to some per cent. Inertias and friction scale
with it, so runs of the arm alone cannot determine it; the torque of a payload of known mass does (Gautier and Briot
2014, "Global identification of joint drive gains and dynamic parameters of robots", ASME Journal of Dynamic Systems,
Measurement and Control). With s_i = true over recorded torque of motor i and A_i, l_i the motor's part in columns and
payload torque,

    recorded = sum_i (A_i @ parameters + l_i) / s_i + friction in recorded units.

This is linear in the inertial parameters for given gains and in 1 / s for given parameters: Gauss-Newton steps with
weights, robust weights and deviations of `solve`. The recorded torque, which contains the noise, stays on the left-hand
side; as a column it would bias the gains low.

**Load parts.** The part adds k |l| to the friction torque, with one k for driving (l v >= 0) and one for driven joints.
The transmitted torque l is that of the links and springs, known payload included: that of the base parameters without
the rotors. It is computed along the filtered motion, not from the measured torque, whose noise would be in column and
torque alike and bias k low. A rotor whose inertia cannot be separated from its link's is subtracted with the
description's inertia. The lag of the part, about a millisecond, is negligible beside the filters'.

If the arm's own inertias are unknown, a friction that is larger for driving than for driven joints acts like larger
inertias: l + (k+ - k-) / 2 l. A payload of known inertia separates the two. It does not separate the friction from a
drive gain, which has the same effect: so either the torque constants count as right here, or the drive gains are
identified and no load parts.

All elements' coefficients are linear in the torque for given transmitted torques; these depend on the base parameters,
which depend on the coefficients: both are fitted in turn. An error of the coefficients returns multiplied by at most
the coefficients themselves, so that every round reduces it by an order of magnitude. A part is removed from elements
that predict as well without it, the least useful first, by the cross-validation that selects the other parts; those
that remain must also be significant (1 % over all elements together).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.stats import chi2

from rx90_common.base.arrays import Array, Index
from rx90_common.base.errors import IdentificationError
from rx90_common.base.quoting import listed
from rx90_common.friction.parts.load import DIRECTIONS, LARGEST_COEFFICIENT, LoadPart
from rx90_emulator.identification.estimates import ParameterEstimate
from rx90_emulator.identification.excitation.checks import coulomb_viscous
from rx90_emulator.identification.excitation.choice import Scored, Selection, TimeBlocks
from rx90_emulator.identification.excitation.fit import SeparableFit, WeightedProblem, fit_shapes, solve
from rx90_emulator.identification.excitation.friction import FrictionSelection, linear_columns
from rx90_emulator.identification.excitation.problem import ExcitationProblem

PLAUSIBLE = (0.75, 1.33)
"""Plausible gains of a drive. A data sheet's torque constant is right to some 10 %, a hot magnet gives as much less, a
gear's losses are 10 to 15 % and partly friction; RMS currents that are taken for peak values make 0.71 or 1.41."""
_MAX_GAIN_ROUNDS, _GAIN_CONVERGED = 20, 1e-6
_MAX_GAIN_SD = 0.1  # relative deviation of a gain, above which the payload does not determine it
_NEGATIVE_SE = 3.0  # deviations below 0: noise alone makes no motor push backwards, and no friction fall with the load


@dataclass(frozen=True, eq=False)
class DriveGains:
    """Gains of the motors, in the order of the joints.

    Attributes:
        factor: true over recorded torque, shape (n,); 1 where it is not identified.
        covariance: of the factors, shape (n, n); where one is not identified infinite on the diagonal and otherwise 0.
    """

    factor: Array
    covariance: Array

    @property
    def deviation(self) -> Array:
        """Return standard deviations of the factors, shape (n,); infinite where a gain is not identified."""
        return np.asarray(np.sqrt(np.diag(self.covariance)))

    @property
    def identified(self) -> Index:
        """Return the numbers of the motors whose gain is identified."""
        return np.flatnonzero(np.isfinite(self.deviation))

    @property
    def implausible(self) -> Index:
        """Return the numbers of the motors whose identified gain is not plausible."""
        low, high = PLAUSIBLE
        return self.identified[(self.factor[self.identified] < low) | (self.factor[self.identified] > high)]

    def after(self, factor: Array) -> DriveGains:
        """Return the total gains, if these belong to torques that were multiplied by `factor`, shape (n,), before."""
        factor = np.where(np.isfinite(self.deviation), factor, 1.0)
        return DriveGains(self.factor * factor, self.covariance * np.outer(factor, factor))

    def applied(self, problem: ExcitationProblem) -> ExcitationProblem:
        """Return the problem with its torques multiplied by the gains, and with their uncertainty."""
        shares, identified = _motor_shares(problem), self.identified
        scale = np.tensordot(self.factor, shares, 1)
        runs = tuple(replace(run, torque=run.torque @ scale) for run in problem.runs)
        relative = self.covariance[np.ix_(identified, identified)] / np.outer(
            self.factor[identified], self.factor[identified]
        )
        along = [np.stack([run.torque, *(run.torque @ shares[k] for k in identified)], axis=2) for run in runs]
        rows = problem.rows_of(along)
        uncertain = rows[:, 1:] @ np.linalg.cholesky(relative)
        return replace(problem, runs=runs, torque=rows[:, 0] - problem.payload, uncertain=uncertain)


def _motor_shares(problem: ExcitationProblem) -> Array:
    """Return each motor's contribution to joint torques, as joint torques: torque @ share, shape (n, n, n)."""
    turns = problem.arm.coupling
    return np.asarray(np.linalg.inv(turns).T[:, :, None] * turns[:, None, :])


def _bodies(problem: ExcitationProblem, wanted: str) -> list[tuple[float, ...] | None]:
    """Return the parameters of each run's payload; refuse runs that all carry the same, naming `wanted`."""
    bodies = [None if body is None else tuple(body.parameters().tolist()) for body in problem.payloads]
    if len(set(bodies)) < 2:
        raise IdentificationError(
            f"{wanted}: all runs carry the same payload, which the last link's own inertia could stand for; accepted: "
            "runs with two payloads or more, of which one may be none"
        )
    return bodies


def identify_gains(
    problem: ExcitationProblem, identified: Callable[[ExcitationProblem], FrictionSelection]
) -> DriveGains:
    """Identify drive gains: first with Coulomb and viscous friction, then with the parts that are selected with these.

    Args:
        problem: with known payloads in some runs.
        identified: `identify_friction_parts` with the parts to try.

    Raises:
        IdentificationError: if the payloads determine no gain.
    """
    rough = drive_gains(problem, coulomb_viscous(problem))
    scaled = rough.applied(problem)
    return drive_gains(scaled, linear_columns(identified(scaled), scaled)[1]).after(rough.factor)


def drive_gains(problem: ExcitationProblem, friction: Array) -> DriveGains:
    """Identify the factor by which each motor's recorded torque is to be multiplied.

    Args:
        problem: with known payloads in some runs.
        friction: columns, shape (r, f).

    Raises:
        IdentificationError: if all runs carry the same payload, or none; if the payload determines no motor's gain; or
            if a gain comes out at 0 or below.
    """
    _bodies(problem, "drive gains")
    pairs = [problem.through(share) for share in _motor_shares(problem)]
    parts, loads = np.array([columns for columns, _ in pairs]), np.array([load for _, load in pairs])
    identified = np.flatnonzero(loads.any(axis=1))
    while len(identified):
        gains = _fitted_gains(problem, friction, parts, loads, identified)
        value, deviation = gains.factor[identified], gains.deviation[identified]
        # An accurate value at 0 or below, or one significantly below 0: the payload is not the one given.
        wrong = (value <= 0.0) & ((deviation < _MAX_GAIN_SD) | (value + _NEGATIVE_SE * deviation < 0.0))
        for k in identified[wrong][:1]:
            raise IdentificationError(
                f"drive gain of {problem.arm.names[k]}: {gains.factor[k]:.3g} +- {gains.deviation[k]:.2g} by this "
                "payload; accepted: above 0 (is its mass, its centre's direction in the last joint's frame, or the run "
                "it is of wrong?)"
            )
        sure = identified[deviation < _MAX_GAIN_SD * np.abs(value)]
        if len(sure) == len(identified):
            return gains
        identified = sure
    raise IdentificationError(
        f"the payload determines no drive gain better than {_MAX_GAIN_SD:.0%}; accepted: a heavier payload, or faster "
        "motion"
    )


def _fitted_gains(
    problem: ExcitationProblem, friction: Array, parts: Array, loads: Array, identified: Index
) -> DriveGains:
    """Return the gains of all motors, those of `identified` free; `parts`, (n, r, b), and `loads` are by motor."""
    b, q = parts.shape[2], parts.shape[2] + friction.shape[1]
    inverse, parameters = np.ones(len(parts)), np.zeros(b)
    rest = np.setdiff1d(np.arange(len(parts)), identified)
    recorded = problem.torque + problem.payload - loads[rest].sum(axis=0)
    for _ in range(_MAX_GAIN_ROUNDS):
        own = parts[identified] @ parameters
        columns = np.column_stack([np.tensordot(inverse, parts, 1), friction, *(own + loads[identified])])
        # Linearised: the parameters' torque is contained in the gains' columns, too, and subtracted once.
        fit = solve(problem, columns, recorded + inverse[identified] @ own)
        moved = float(np.max(np.abs(fit.value[q:] - inverse[identified])))
        inverse[identified], parameters = fit.value[q:], fit.value[:b]
        if moved < _GAIN_CONVERGED:
            break
    factor, covariance = 1.0 / inverse, np.diag(np.full(len(parts), np.inf))
    slope = factor[identified] ** 2
    covariance[np.ix_(identified, identified)] = fit.covariance[q:, q:] * np.outer(slope, slope)
    return DriveGains(factor, covariance)


_WIDTH = len(DIRECTIONS)
_DIGITS = 6  # significant ones of a coefficient to simulate with
_BLOCK_SAMPLES = 4000  # samples whose columns are in memory at a time
_MAX_ROUNDS, _FIRST_ROUNDS = 12, 3
_CONVERGED = 1e-5  # change of a coefficient
_LEVEL = 0.01  # chance of finding a part on any element of an arm that has none
_MAX_COEFFICIENT_SD = 0.05  # deviation above which a coefficient is not identifiable


@dataclass(frozen=True, eq=False)
class LoadParts:
    """The load parts of an arm's elements, in its order.

    Attributes:
        value: coefficients by element and direction, in the order of DIRECTIONS, >= 0, shape (n_el, 2); 0 without a
            part.
        kept: numbers of the k elements that have a part.
        covariance: of their coefficients, element by element, shape (2 k, 2 k).
        base: parameters for the transmitted torques, shape (b,).
        transmitted: RMS torque that each element transmits in the runs, Nm, shape (n_el,).
        reasons: why an element has no part; empty if it has one, shape (n_el,).
        gain: improvement of the model's prediction by the parts, in words.
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
        result[list(self.kept)] = np.sqrt(np.diag(self.covariance)).reshape(-1, _WIDTH)
        return result

    def applied(self, problem: ExcitationProblem) -> ExcitationProblem:
        """Return the problem less the torque of the load parts, with their uncertainty."""
        columns = load_columns(problem, transmitted_torques(problem, self.base))
        size, directions = np.linalg.eigh(self.covariance)
        uncertain = columns[:, _places(self.kept)] @ (directions * np.sqrt(np.maximum(size, 0.0)))
        torque = problem.torque - columns @ self.value.ravel()
        return replace(problem, torque=torque, uncertain=np.hstack([problem.uncertain, uncertain]))

    def remark(self, names: Sequence[str]) -> str:
        """Return in a sentence which of these elements have a part, and by what evidence."""
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
        """Return the estimates of an element's coefficients, by their places in the friction file."""
        names = [f"{LoadPart.name}.{direction}" for direction in DIRECTIONS]
        if element not in self.kept:
            return dict.fromkeys(names, ParameterEstimate.unknown(self.reasons[element]))
        pairs = zip(self.value[element].tolist(), self.deviation[element].tolist(), strict=True)
        return {name: ParameterEstimate(*pair) for name, pair in zip(names, pairs, strict=True)}


def _places(elements: Sequence[int]) -> list[int]:
    """Return the indices of some elements' coefficients among those of all."""
    return [_WIDTH * e + k for e in elements for k in range(_WIDTH)]


def transmitted_torques(problem: ExcitationProblem, base: Array) -> list[Array]:
    """Return the torque that each element transmits along each run, Nm, each of shape (m, n_el).

    Args:
        problem: the runs with their payloads.
        base: parameters of its columns, shape (b,).
    """
    arm, names, leading = problem.arm, problem.columns.names, list(problem.base.leading)
    parameters, described = np.zeros(len(names)), problem.columns.values()
    parameters[leading] = base
    # Rotors that the runs separate from the links.
    alone = {k for k, row in zip(leading, problem.base.combination, strict=True) if np.count_nonzero(row) == 1}
    for k, name in enumerate(names):
        if name.startswith("Ia_"):
            parameters[k] -= parameters[k] if k in alone else described[k]
        elif name.startswith("offset_"):
            parameters[k] = 0.0
    last = slice(10 * len(arm.names) - 10, 10 * len(arm.names))
    together = [k for k, row in enumerate(arm.coupling) if np.count_nonzero(row) > 1]
    found = []
    for run, body in zip(problem.runs, problem.payloads, strict=True):
        whole, joint = parameters.copy(), np.empty_like(run.position)
        whole[last] += 0.0 if body is None else body.parameters()
        for first in range(0, len(joint), _BLOCK_SAMPLES):
            part = slice(first, first + _BLOCK_SAMPLES)
            motion = run.position[part], run.velocity[part], run.acceleration[part]
            joint[part] = problem.columns.torque(*motion) @ whole
        motor = np.linalg.solve(arm.coupling.T, joint.T).T
        found.append(np.hstack([motor, motor[:, together]]))
    return found


def load_columns(problem: ExcitationProblem, transmitted: list[Array]) -> Array:
    """Return the joint torques per unit of the coefficients of all elements, shape (r, 2 n_el).

    As in the Coulomb columns, the sign is that of the velocity at the instants at which the torque was recorded.
    """
    along = []
    for run, load in zip(problem.runs, transmitted, strict=True):
        velocity = run.torque_velocity @ problem.arm.element_matrix.T
        forward, back = (run.evened((sign * velocity > 0.0).astype(np.float64)) for sign in (1.0, -1.0))
        pull, push = np.maximum(load, 0.0), np.maximum(-load, 0.0)
        along.append(np.stack([forward * pull - back * push, forward * push - back * pull], axis=2))
    return problem.element_rows(along)


def identify_load_parts(problem: ExcitationProblem, select: Callable[[ExcitationProblem], Selection]) -> LoadParts:
    """Identify the load parts of all elements, together with everything else.

    Args:
        problem: of runs with at least two different known payloads; to carry none counts as one of them.
        select: `select_parts` with the parts of the friction to try in addition.

    Raises:
        IdentificationError: for runs that all carry the same payload.
    """
    bodies = _bodies(problem, "load parts")
    names, friction, regressor = problem.arm.element_names, coulomb_viscous(problem), problem.regressor
    b, moving = regressor.shape[1], [e for e in range(len(names)) if friction[:, 2 * e].any()]
    # First values, with Coulomb and viscous friction alone.
    base = solve(problem, np.hstack([regressor, friction])).value[:b]
    rough = np.zeros((len(names), _WIDTH))
    for _ in range(_FIRST_ROUNDS):
        columns = load_columns(problem, transmitted_torques(problem, base))[:, _places(moving)]
        whole = solve(problem, np.hstack([regressor, columns, friction])).value
        base, rough[moving] = whole[:b], whole[b : b + _WIDTH * len(moving)].reshape(-1, _WIDTH)
    first = LoadParts(rough, (), np.zeros((0, 0)), base, np.zeros(len(names)), ("",) * len(names))
    selected = select(first.applied(problem))
    time = TimeBlocks.of(problem, selected.weighted.linearised(selected.fit)[0])

    def fitted(kept: Sequence[int], columns: Array) -> tuple[WeightedProblem, SeparableFit]:
        wide = replace(problem, regressor=np.hstack([regressor, columns[:, _places(kept)]]))
        weighted = WeightedProblem.of(wide, selected.weighted.elements, selected.weighted.weight)
        return weighted, fit_shapes(weighted, selected.fit.shapes)

    def converged(kept: Sequence[int], base: Array) -> tuple[Array, Array, Array, Array]:
        """Return base, coefficients, their covariance and columns, with the load by the same base parameters."""
        value = np.zeros(_WIDTH * len(kept))
        for _ in range(_MAX_ROUNDS):
            columns = load_columns(problem, transmitted_torques(problem, base))
            weighted, fit = fitted(kept, columns)
            # All rows are weighted by this model itself, with deviations that hold under misfit.
            whole, own = solve(weighted.problem, weighted.tangent(fit, fit.inner())), slice(b, b + len(value))
            moved = float(np.max(np.abs(whole.value[own] - value), initial=0.0))
            base, value = whole.value[:b], whole.value[own]
            if moved < _CONVERGED:
                break
        return base, value, whole.covariance[own, own], columns

    # Runs with a single payload cannot predict the others: then the test is by blocks alone.
    tested_by_runs = all(len(set(bodies[:k] + bodies[k + 1 :])) > 1 for k in range(len(bodies)))
    base, value, covariance, columns = converged(moving, base)

    def scored(kept: Sequence[int]) -> Scored:
        model = Scored.of(*fitted(kept, columns), time)
        return model if tested_by_runs else replace(model, held_out={"blocks": model.held_out["blocks"]})

    reasons = beyond_chance(moving, value, covariance)
    kept, useless, gain = trimmed([e for e in moving if e not in reasons], scored)
    base, value, covariance, _ = converged(kept, base)
    size = np.sqrt(np.mean(np.vstack(transmitted_torques(problem, base)) ** 2, axis=0))
    coefficients = np.zeros((len(names), _WIDTH))
    coefficients[list(kept)] = np.maximum(value, 0.0).reshape(-1, _WIDTH)
    texts = ["" if e in kept else f"{(reasons | useless).get(e, 'it rests')} (RMS of the load {size[e]:.3g} Nm)"
             for e in range(len(names))]  # fmt: skip
    return LoadParts(coefficients, kept, covariance, base, size, tuple(texts), gain)


def trimmed(
    kept: Sequence[int], scored: Callable[[Sequence[int]], Scored]
) -> tuple[tuple[int, ...], dict[int, str], str]:
    """Return the elements that need their part to predict, the reasons of the others, and the gain of all parts.

    Args:
        kept: elements that may have a part.
        scored: returns the model in which some elements have one.
    """
    remaining: list[int] = list(kept)
    reasons: dict[int, str] = {}
    now = scored(remaining) if remaining else None
    while now is not None:
        trials = {e: scored([other for other in remaining if other != e]) for e in remaining}
        useless = {e: now.validations(one)["blocks"].gain for e, one in trials.items() if not now.better_than(one)}
        if not useless:
            return tuple(remaining), reasons, now.verdict(scored(()))
        worst = min(useless, key=lambda e: useless[e])
        reasons[worst] = f"with a load part, {now.verdict(trials[worst])}"
        remaining.remove(worst)
        now = trials[worst] if remaining else None
    return (), reasons, ""


def beyond_chance(elements: Sequence[int], values: Array, covariances: Array) -> dict[int, str]:
    """Return why elements have no part: coefficients that are not identifiable, or not significant.

    Args:
        elements: k of them.
        values: of their coefficients, element by element, shape (2 k,).
        covariances: of these, shape (2 k, 2 k).
    """
    reasons: dict[int, str] = {}
    for k, e in enumerate(elements):
        own = slice(_WIDTH * k, _WIDTH * (k + 1))
        value, covariance = values[own], covariances[own, own]
        deviation = np.sqrt(np.diag(covariance))
        texts = " and ".join(
            f"{name} {100.0 * one:.2g} +- {100.0 * size:.2g} %"
            for name, one, size in zip(DIRECTIONS, value.tolist(), deviation.tolist(), strict=True)
        )
        if not (deviation < _MAX_COEFFICIENT_SD).all():
            reasons[e] = f"the runs do not determine it: {texts} of the load"
        elif (value < -_NEGATIVE_SE * deviation).any() or value.max() > LARGEST_COEFFICIENT:
            reasons[e] = f"no load part has these coefficients: {texts} of the load"
        elif value @ np.linalg.solve(covariance, value) < chi2.ppf(1.0 - _LEVEL / len(elements), _WIDTH):
            reasons[e] = f"no more than chance: {texts} of the load"
    return reasons
