"""The links, rotors and springs that can exist nearest to identified base parameters.

With y the base parameters, K the mapping from all parameters theta to base parameters, and R^T R the information of the
weighted rows on y, the sum

    |R (K theta - y)|^2 + w |distance from the prior|^2

is minimised. The first term is what the shift adds to the weighted squares of the torque, as far as no friction makes
up for it; the second one decides what the data leave open.

The unknowns are those of a log-Cholesky factor (Rucker and Wensing 2022, "Smooth parameterization of rigid-body
inertia"): with the prior's pseudo-inertia L0 L0^T a body has P = L0 M D M^T L0^T, M lower triangular with ones on its
diagonal, D diagonal and positive. Every P has a body of positive density. The distance from the prior is that of the
logarithms of D and of the entries of M; it does not depend on units, and hardly on how heavy a body the prior takes.
Near the prior it is the Bregman divergence of -log det (Lee, Wensing and Park 2020). Rotors and springs have a
logarithm each. SciPy's trust region finds the minimum.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy.optimize import least_squares

from rx90_common.base.arrays import Array, Mask
from rx90_common.base.errors import IdentificationError
from rx90_common.description.robot_files import RobotFiles
from rx90_emulator.identification.excitation.bodies import InertialPrior, inertial_parameters
from rx90_emulator.identification.excitation.friction.estimates import FrictionSelection
from rx90_emulator.identification.excitation.friction.identify import linear_columns
from rx90_emulator.identification.excitation.least_squares import LinearFit
from rx90_emulator.identification.excitation.problem import ExcitationProblem
from rx90_emulator.identification.options import RobotOptions
from rx90_emulator.identification.robot import RecordedRobot

_PRIOR_WEIGHT = 1.0  # of logarithms with a deviation of 1: a description is right but for factors of some e
_GUESS_WEIGHT = 0.1  # of what the description does not have: right but for factors of some 20
_MAX_EVALUATIONS = 500  # for each weight of the prior
_MAX_NULL_ENTRY = 1e-6  # of a parameter in the mapping's null space, to be determined by itself
_MIN_SINGULAR_VALUE = 1e-9  # of the mapping, relative: less is rounding
_TOOL = "tool"  # the link that a tool file adds: its inertial is known
_ROWS, _COLUMNS = np.tril_indices(4)
_DIAGONAL = _ROWS == _COLUMNS


@dataclass(frozen=True, eq=False)
class BaseEstimate:
    """Identified base parameters.

    Attributes:
        mapping: K, shape (p, P), from P standard parameters to the base parameters: ten of each joint's body in
            Pinocchio's order, the inertias of k rotors, the amplitudes of s springs, and others, such as offsets. Those
            others, and springs without a prior, may be anything.
        value: SI units, shape (p,).
        covariance: shape (p, p); infinite on the diagonal where the data do not determine a parameter: its value then
            counts for nothing.
        information: R, shape (m, p): R^T R is the inverse of the covariance that independent noise would give.
    """

    mapping: Array
    value: Array
    covariance: Array
    information: Array

    @property
    def determined(self) -> Mask:
        """Return which parameters the data determine, shape (p,)."""
        return np.isfinite(np.diag(self.covariance))

    def distance(self, shift: Array) -> float:
        """Return the Mahalanobis distance of a shift, shape (p,), over the root of the number of its parameters."""
        known = np.flatnonzero(self.determined)
        deviation = np.sqrt(np.diag(self.covariance)[known])
        correlation = self.covariance[np.ix_(known, known)] / np.outer(deviation, deviation)
        size = shift[known] / deviation
        square = float(size @ np.linalg.pinv(correlation, rcond=_MIN_SINGULAR_VALUE, hermitian=True) @ size)
        return math.sqrt(max(square, 0.0) / len(known))


@dataclass(frozen=True, eq=False)
class ConsistentInertias:
    """Bodies and rotors that can exist, near to what was identified.

    Attributes:
        prior: where they began.
        pseudo: of each body, in the frame of its joint, shape (b, 4, 4).
        rotors: kg m^2, > 0, shape (k,).
        parameters: the standard parameters, bodies that stay included, shape (P,).
        base: their base parameters, shape (p,).
        shift: base parameters less the identified ones, shape (p,); 0 for what the data do not determine.
        distance: Mahalanobis distance of the shift over the root of their number: at most about 1 within the noise.
        alone: which standard parameters the data determine by themselves, not only as part of a sum, shape (P,).
    """

    prior: InertialPrior
    pseudo: Array
    rotors: Array
    parameters: Array
    base: Array
    shift: Array
    distance: float
    alone: Mask


@dataclass(frozen=True, eq=False)
class Consistency:
    """Inertias that bodies can have, and what they cost: RMS along the runs at each of n joints, Nm, shape (n,).

    Attributes:
        inertias: nearest to the identified base parameters.
        added: torque that the shift of the base parameters adds; 0 for a joint without rows, here and below.
        before: residuals with the base parameters as identified.
        after: residuals with the shifted ones.
    """

    inertias: ConsistentInertias
    added: Array
    before: Array
    after: Array


def make_consistent(
    problem: ExcitationProblem, friction: FrictionSelection, robot: RecordedRobot, options: RobotOptions
) -> Consistency:
    """Return the consistent inertias nearest to the base parameters of a fit.

    Args:
        problem: the equations.
        friction: the fit.
        robot: whose description says where inertias, rotors and springs begin.
        options: that describe it.

    Raises:
        IdentificationError: if there are none.
    """
    count, arm, fit = len(problem.names), problem.arm, friction.fit
    known: tuple[str, ...] = ()
    springs = arm.spring[list(problem.columns.springs)]
    if robot.setup is None:
        description: Path | str = Path(str(options.urdf))
        rotors = np.zeros(len(arm.names)) if options.rotor_inertia is None else np.array(options.rotor_inertia)
    else:
        description, rotors = robot.setup.robot.urdf, robot.setup.drives.rotor_inertia
        files = robot.setup.files or RobotFiles()
        known = () if files.tool is None else (_TOOL,)
    prior = InertialPrior.of_urdf(description, arm.names, rotors, springs, known)
    covariance = fit.covariance[:count, :count]
    information = base_information(problem, linear_columns(friction, problem)[1], fit)
    estimate = BaseEstimate(problem.base.combination, fit.value[:count], covariance, information)
    inertias = consistent_inertias(estimate, prior)
    residual, added = problem.torque - friction.predicted, problem.regressor @ inertias.shift
    joints = [problem.joint == joint for joint in range(len(arm.names))]
    sizes = [[_rms(values[rows]) for rows in joints] for values in (added, residual, residual - added)]
    return Consistency(inertias, *np.array(sizes))


def base_information(problem: ExcitationProblem, friction: Array, fit: LinearFit) -> Array:
    """Return a root of the information of the weighted rows on the b base parameters, friction free, shape (b, b).

    Neighbouring rows share their errors: it is scaled to variances that are those of the covariance, in the median.

    Args:
        problem: r rows.
        friction: columns of the friction, shape (r, f).
        fit: of base parameters and friction.
    """
    count = len(problem.names)
    weight = np.sqrt(fit.weights) / fit.sigma[problem.joint]
    columns = np.hstack([friction, problem.regressor]) * weight[:, None]
    root = np.asarray(np.linalg.qr(columns, mode="r"))[-count:, -count:]
    variance = np.diag(fit.covariance)[:count]
    white = np.diag(np.linalg.pinv(root.T @ root, hermitian=True))
    share = np.median((white / variance)[np.isfinite(variance)])
    return np.asarray(root * math.sqrt(min(1.0, float(share))))


def _rms(values: Array) -> float:
    return float(np.sqrt(np.mean(values**2))) if len(values) else 0.0


def consistent_inertias(
    estimate: BaseEstimate, prior: InertialPrior, weight: float = _PRIOR_WEIGHT
) -> ConsistentInertias:
    """Return the consistent inertias nearest to the identified base parameters and to the prior.

    Args:
        estimate: of the base parameters.
        prior: of links and rotors.
        weight: w, of the prior.

    Raises:
        IdentificationError: for an estimate and a prior of different arms, if nothing is determined, and if the search
            ends at no minimum.
    """
    n, k, s = len(prior.joints), len(prior.rotors), len(prior.springs)
    if estimate.mapping.shape[1] < 10 * n + k + s:
        raise IdentificationError(
            f"a mapping of {estimate.mapping.shape[1]} parameters; accepted: at least {10 * n + k + s}, of {n} bodies, "
            f"{k} rotors and {s} springs"
        )
    if not estimate.determined.any():
        raise IdentificationError(
            f"none of {len(estimate.value)} base parameters is determined; accepted: runs that determine some"
        )
    unknowns = _Unknowns(prior, estimate.mapping.shape[1])
    known = estimate.determined
    whitened = estimate.information[:, known] @ estimate.mapping[known]
    target = estimate.information[:, known] @ estimate.value[known]
    u = np.zeros(len(unknowns.distance))
    # Sharp data lead a search from afar astray: it begins with a weight with which the prior alone would do.
    squares = float(np.sum((whitened @ unknowns.parameters(u) - target) ** 2))
    for decade in range(max(0, math.ceil(math.log10(max(squares, 1.0) / weight))), -1, -1):
        near = np.diag(math.sqrt(weight * 10.0**decade) * unknowns.distance)
        found = least_squares(
            lambda u, near=near: np.concatenate([whitened @ unknowns.parameters(u) - target, near @ u]),  # type: ignore[misc]
            u,
            lambda u, near=near: np.vstack([whitened @ unknowns.slopes(u), near]),  # type: ignore[misc]
            max_nfev=_MAX_EVALUATIONS,
        )
        u = np.asarray(found.x)
    # Where no body comes near, the search may end before the minimum, which lies at infinity.
    if not np.isfinite(u).all():
        raise IdentificationError(
            "no consistent inertias near the base parameters found; accepted: base parameters of this arm, and a "
            "description with inertials of their order of magnitude"
        )
    parameters = unknowns.parameters(u)
    base = estimate.mapping @ parameters
    shift = np.where(known, base - estimate.value, 0.0)
    return ConsistentInertias(
        prior,
        unknowns.pseudo(u),
        parameters[10 * n : 10 * n + k],
        parameters,
        base,
        shift,
        estimate.distance(shift),
        _determined_alone(estimate.mapping[known]),
    )


class _Unknowns:
    """Parameters as functions of unknowns u, all 0 at the prior.

    Ten for each body: the entries of M below the diagonal and half the logarithms of D; one for each rotor and each
    spring with a prior, half the logarithm of its ratio to it; then one for each other parameter, its value.
    """

    def __init__(self, prior: InertialPrior, count: int) -> None:
        self._joint = [body.joint for body in prior.bodies]
        self._scale = np.linalg.cholesky(np.array([body.pseudo for body in prior.bodies]))
        self._bodies, first = 10 * len(prior.bodies), 10 * len(prior.joints)
        begun = np.concatenate([prior.rotors, prior.springs, np.zeros(count)])[: count - first]
        self._positive, self._other = first + np.flatnonzero(begun), first + np.flatnonzero(begun == 0.0)
        self._begun = begun[begun != 0.0]
        self._known = np.append(prior.known.ravel(), np.zeros(len(begun)))
        self._bounded = self._bodies + len(self._positive)
        entries = np.tile(np.where(_DIAGONAL, 2.0, math.sqrt(2.0)), len(prior.bodies))
        ratios = np.full(len(self._begun), 2.0)
        guessed = np.append(np.repeat(prior.guessed[: len(prior.bodies)], 10), prior.guessed[len(prior.bodies) :])
        self.distance = np.concatenate([entries, ratios, np.zeros(len(self._other))])
        self.distance[: len(guessed)] *= np.where(guessed, math.sqrt(_GUESS_WEIGHT), 1.0)
        """What the unknowns are multiplied by in the distance from the prior, shape (N,)."""

    def _factors(self, u: Array) -> tuple[Array, Array]:
        """Return L0 M and the roots of D of each body, shapes (b, 4, 4) and (b, 4)."""
        entries = u[: self._bodies].reshape(-1, 10)
        unit = np.zeros((len(entries), 4, 4))
        unit[:, _ROWS, _COLUMNS] = np.where(_DIAGONAL, 1.0, entries)
        return self._scale @ unit, np.exp(entries[:, _DIAGONAL])

    def pseudo(self, u: Array) -> Array:
        """Return the pseudo-inertias of the bodies, shape (b, 4, 4)."""
        factors, roots = self._factors(u)
        scaled = factors * roots[:, None, :]
        return np.asarray(scaled @ np.swapaxes(scaled, 1, 2))

    def parameters(self, u: Array) -> Array:
        """Return all standard parameters, shape (P,)."""
        result = self._known.copy()
        for joint, values in zip(self._joint, inertial_parameters(self.pseudo(u)), strict=True):
            result[10 * joint : 10 * joint + 10] += values
        result[self._positive] = self._begun * np.exp(2.0 * u[self._bodies : self._bounded])
        result[self._other] = u[self._bounded :]
        return result

    def slopes(self, u: Array) -> Array:
        """Return the derivatives of the parameters, shape (P, N)."""
        result = np.zeros((len(self._known), len(u)))
        for b, (factor, roots) in enumerate(zip(*self._factors(u), strict=True)):
            # dP = L0 dM D (L0 M)^T and its transpose; a logarithm changes both factors as M's own column would.
            left = np.where(_DIAGONAL[:, None], factor.T[_COLUMNS], self._scale[b].T[_ROWS])
            half = left[:, :, None] * (factor * roots**2).T[_COLUMNS][:, None, :]
            rows = slice(10 * self._joint[b], 10 * self._joint[b] + 10)
            result[rows, 10 * b : 10 * b + 10] = inertial_parameters(half + np.swapaxes(half, 1, 2)).T
        positive = np.arange(self._bodies, self._bounded)
        result[self._positive, positive] = 2.0 * self._begun * np.exp(2.0 * u[positive])
        result[self._other, np.arange(self._bounded, len(u))] = 1.0
        return result


def _determined_alone(mapping: Array) -> Mask:
    """Return which parameters a mapping tells apart from all others, shape (P,): those that its null space has not."""
    scale = np.maximum(np.linalg.norm(mapping, axis=0), 1e-300)
    _, values, rows = np.linalg.svd(mapping / scale)
    rank = int((values > _MIN_SINGULAR_VALUE * values[0]).sum())
    return np.asarray(np.linalg.norm(rows[rank:], axis=0) < _MAX_NULL_ENTRY)
