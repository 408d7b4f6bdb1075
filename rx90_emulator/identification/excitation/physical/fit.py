"""The consistent inertias nearest to identified base parameters: a convex problem, solved by Newton's method.

With y the base parameters, C their covariance, K the mapping from all parameters theta to base parameters, P_b the
pseudo-inertia of body b, r_k the rotors and the springs, and P0_b, r0_k their priors, the sum

    1/2 (K theta - y)^T C^-1 (K theta - y) + w (sum_b D(P_b, P0_b) + sum_k D(r_k, r0_k))

has one minimum. D(P, P0) = tr(P0^-1 P) - log det(P0^-1 P) - order is the Bregman divergence of -log det (Lee, Wensing
and Park 2020): it does not depend on units and frames, and grows without bound where P ceases to be positive definite,
so that every P on the way has a body of positive density. The sum is self-concordant, hence damped Newton steps find
the minimum from any beginning (Boyd and Vandenberghe 2004, section 9.6). Where they would be many, `factors` leads.

The weight w of the prior falls from where the prior alone would do to 0.001, or to where it pulls no more. Of the
weights up to 1, the largest is taken with which the base parameters are as near to the identified ones as with the
smallest, within a tolerance that lies below their noise: the prior decides what the data leave open, and no more than
that. Where no consistent inertias come near, weights and tolerance count in units of the distance that is left, for the
deviations then say too little.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from scipy.linalg import block_diag, lstsq, solve_triangular

from rx90_common.base.arrays import Array, Mask
from rx90_common.base.errors import IdentificationError
from rx90_common.base.quoting import plain
from rx90_emulator.identification.excitation.bodies import InertialPrior, inertial_parameters
from rx90_emulator.identification.excitation.physical.factors import Target, nearer

_RATIO = 10.0**0.5
_LEAST_WEIGHT = 1e-3  # far below, the prior would be a barrier alone, and the steps along it short
_SETTLED = 0.95  # of the distance before: a prior of which less weight brings so little pulls no more
_TOLERANCE = 0.3  # standard deviations, RMS over the base parameters
_SHARPEST = 1e-9  # of a base parameter's deviation, as a share of its size in the prior: beyond are rounding errors
_LEAST_VARIANCE = 1e-9  # of the correlation matrix's eigenvalues: less is rounding
_APART = 1e-6
_MOST_STEPS = 100
_MOST_TRIALS = 4
_DONE = 1e-7
_NEAR = 0.1  # Newton decrement from which full steps converge quadratically


@dataclass(frozen=True, eq=False)
class BaseEstimate:
    """Identified base parameters.

    Attributes:
        names: of the p parameters, for messages.
        mapping: K, shape (p, P), from P standard parameters to the base parameters: ten of each joint's body in
            Pinocchio's order, the inertias of k rotors, the amplitudes of s springs, and others, such as offsets. Those
            others, and springs without a prior, may be anything.
        value: SI units, shape (p,).
        covariance: shape (p, p); infinite on the diagonal where the data do not determine a parameter: its value then
            counts for nothing.

    Raises:
        IdentificationError: for shapes that do not fit, numbers that are not finite, variances that are not > 0, and if
            nothing is determined.
    """

    names: tuple[str, ...]
    mapping: Array
    value: Array
    covariance: Array

    def __post_init__(self) -> None:
        p = len(self.names)
        if self.value.shape != (p,) or self.covariance.shape != (p, p) or self.mapping.shape[:1] != (p,):
            shapes = f"{self.mapping.shape}, {self.value.shape} and {self.covariance.shape}"
            raise IdentificationError(
                f"mapping, value and covariance of shapes {shapes}; accepted: {p} base parameters"
            )
        variance = np.diag(self.covariance)
        for name, value, spread in zip(self.names, self.value, variance, strict=True):
            if not spread > 0.0 or (np.isfinite(spread) and not np.isfinite(value)):
                raise IdentificationError(
                    f"base parameter {plain(name)} is {value:g}, its variance {spread:g}; accepted: finite numbers, "
                    "variances > 0"
                )
        known = self.determined
        if not known.any():
            raise IdentificationError(f"none of {p} base parameters is determined; accepted: runs that determine some")
        if not (np.isfinite(self.covariance[np.ix_(known, known)]).all() and np.isfinite(self.mapping).all()):
            raise IdentificationError("a covariance or mapping that is not finite; accepted: finite numbers")

    @property
    def determined(self) -> Mask:
        """Return which parameters the data determine, shape (p,)."""
        return np.isfinite(np.diag(self.covariance))

    @property
    def deviation(self) -> Array:
        """Return standard deviations, shape (p,)."""
        return np.sqrt(np.diag(self.covariance))


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
        deviations: the shift in standard deviations of each parameter, shape (p,).
        distance: Mahalanobis distance of the shift over the root of their number: at most about 1 within the noise.
        prior_weight: w.
        alone: which standard parameters the data determine by themselves, not only as part of a sum, shape (P,).
    """

    prior: InertialPrior
    pseudo: Array
    rotors: Array
    parameters: Array
    base: Array
    shift: Array
    deviations: Array
    distance: float
    prior_weight: float
    alone: Mask


def consistent_inertias(
    estimate: BaseEstimate, prior: InertialPrior, tolerance: float = _TOLERANCE
) -> ConsistentInertias:
    """Return the consistent inertias nearest to the identified base parameters, and nearest to the prior among these.

    Args:
        estimate: of the base parameters.
        prior: of links and rotors.
        tolerance: by how much the prior may move the base parameters beyond what consistency asks for, standard
            deviations, RMS over them.

    Raises:
        IdentificationError: for an estimate and a prior of different arms.
    """
    n, k, s = len(prior.joints), len(prior.rotors), len(prior.springs)
    if estimate.mapping.shape[1] < 10 * n + k + s:
        raise IdentificationError(
            f"a mapping of {estimate.mapping.shape[1]} parameters; accepted: at least {10 * n + k + s}, of {n} bodies, "
            f"{k} rotors and {s} springs"
        )
    problem = _Problem(estimate, prior)
    found = problem.path()
    last = found[-1].distance
    unit = max(1.0, last)
    allowed = np.hypot(last, tolerance * unit)
    # The weights up to 1 carry their rounding errors.
    chosen = next(one for one in found if one.weight < 1.001 * unit**2 and one.distance <= allowed)
    return problem.result(chosen.weight, problem.minimum(chosen.x, chosen.weight, _DONE))


class _Minimum(NamedTuple):
    """Of the sum with one weight of the prior: the unknowns, and the distance per root of p."""

    weight: float
    x: Array
    distance: float


def _enough(found: list[_Minimum]) -> bool:
    """Tell whether the last minimum is as near to the identified base parameters as one with less weight would be."""
    if len(found) < 2:
        return False
    before, (weight, _, distance) = found[-2].distance, found[-1]
    light = weight <= 1.001 * _LEAST_WEIGHT * max(1.0, distance**2)
    return (light and (distance > _SETTLED * before or distance < _TOLERANCE)) or weight < _LEAST_WEIGHT**2


class _Problem:
    """The problem in units of the prior: blocks Q with P = L0 Q L0^T, L0 L0^T = P0, all 1 at the beginning.

    The unknowns x are the entries of these blocks, orthonormal: ten for each body, one for each rotor and each spring
    with a prior, then the others.
    """

    def __init__(self, estimate: BaseEstimate, prior: InertialPrior) -> None:
        self.estimate, self.prior = estimate, prior
        self.scale = np.linalg.cholesky(np.array([body.pseudo for body in prior.bodies]))
        n, count, bodies = len(prior.joints), estimate.mapping.shape[1], len(prior.bodies)
        begun = np.concatenate([prior.rotors, prior.springs, np.zeros(count)])[: count - 10 * n]
        positive = np.flatnonzero(begun)
        other = np.flatnonzero(begun == 0.0)
        self.positive, self.others = len(positive), len(other)
        parts = np.zeros((count, 10 * bodies + len(begun)))
        for b, body in enumerate(prior.bodies):
            rows = slice(10 * body.joint, 10 * body.joint + 10)
            parts[rows, 10 * b : 10 * b + 10] = inertial_parameters(self.scale[b] @ _BASIS @ self.scale[b].T).T
        order = np.concatenate([positive, other])
        parts[10 * n + order, 10 * bodies + np.arange(len(order))] = np.where(begun == 0.0, 1.0, begun)[order]
        self.parts = parts
        self.offset = np.append(prior.known.ravel(), np.zeros(len(begun)))
        self.whitening = _whitening(estimate, np.abs(estimate.mapping @ parts).sum(axis=1))
        self.jacobian = self.whitening @ estimate.mapping @ parts
        known = np.where(estimate.determined, estimate.value, 0.0)
        self.target = self.whitening @ (known - estimate.mapping @ self.offset)

    def misfit(self, x: Array) -> Array:
        """Return the distance from the identified base parameters, whitened, shape (p,)."""
        return np.asarray(self.jacobian @ x - self.target)

    def path(self) -> list[_Minimum]:
        """Return the minima for falling weights, roughly, each from that of the weight before it, from the prior on."""
        bodies = np.tile(_entries(np.eye(4)), len(self.scale))
        x = np.concatenate([bodies, np.ones(self.positive), np.zeros(self.others)])
        exponent = int(np.ceil(np.log(max(1.0, float(np.square(self.misfit(x)).sum()))) / np.log(_RATIO)))
        found: list[_Minimum] = []
        while not _enough(found):
            weight = _RATIO**exponent
            x = self.minimum(x, weight, _NEAR)
            found.append(_Minimum(weight, x, self._distance(x)))
            exponent -= 1
        return found

    def minimum(self, x: Array, weight: float, enough: float) -> Array:
        """Return the minimum, as near as a Newton decrement below `enough` says, from an x that is near."""
        for _ in range(_MOST_TRIALS):
            x, done = self._newton(x, weight, enough)
            if done:
                return x
            x = nearer(x, Target(self.jacobian, self.target, weight, _BASIS, len(self.scale), self.positive))
        raise IdentificationError(
            f"no consistent inertias near the base parameters found with a prior's weight of {weight:.1g}; accepted: "
            "base parameters of this arm, and a description with inertials of their order of magnitude"
        )

    def _newton(self, x: Array, weight: float, enough: float) -> tuple[Array, bool]:
        """Return where damped Newton steps lead, and whether that is the minimum."""
        last = np.inf
        for _ in range(_MOST_STEPS):
            factor, scalars = np.linalg.cholesky(self._blocks(x)), self._scalars(x)
            free = np.zeros((0, self.others))
            barrier = block_diag(*(_whitened_entries(one) for one in factor), np.diag(1.0 / scalars), free)
            ahead = np.concatenate([*(_entries(one.T @ one - np.eye(4)) for one in factor), scalars - 1.0])
            rows = np.vstack([self.jacobian, np.sqrt(weight) * barrier])
            residual = np.concatenate([self.misfit(x), np.sqrt(weight) * ahead])
            step = lstsq(rows, -residual, lapack_driver="gelsy", check_finite=False)[0]
            decrement = float(np.linalg.norm(rows @ step)) / np.sqrt(weight)
            # Rounding errors keep the decrement of very sharp data from falling to nothing.
            if decrement < enough or (last < _NEAR and decrement >= last):
                return x, True
            x = x + step / (1.0 if decrement < _NEAR else 1.0 + decrement)
            last = decrement
        return x, False

    def _blocks(self, x: Array) -> Array:
        return np.array([_matrix(x[10 * b : 10 * b + 10]) for b in range(len(self.scale))])

    def _scalars(self, x: Array) -> Array:
        """Return rotors and springs in units of their prior."""
        first = 10 * len(self.scale)
        return x[first : first + self.positive]

    def _distance(self, x: Array) -> float:
        return float(np.sqrt(np.square(self.misfit(x)).mean()))

    def result(self, weight: float, x: Array) -> ConsistentInertias:
        """Return a minimum in SI units."""
        pseudo = self.scale @ self._blocks(x) @ np.swapaxes(self.scale, 1, 2)
        parameters = self.offset + self.parts @ x
        base = self.estimate.mapping @ parameters
        shift = np.where(self.estimate.determined, base - self.estimate.value, 0.0)
        first = 10 * len(self.prior.joints)
        rotors = parameters[first : first + len(self.prior.rotors)]
        deviations = shift / self.estimate.deviation
        return ConsistentInertias(
            self.prior, pseudo, rotors, parameters, base, shift, deviations, self._distance(x), weight,
            _alone(self.estimate.mapping[self.estimate.determined]),
        )  # fmt: skip


def _whitening(estimate: BaseEstimate, size: Array) -> Array:
    """Return W with W C W^T = 1 for the d parameters that are determined, shape (d, p)."""
    known = np.flatnonzero(estimate.determined)
    deviation = estimate.deviation[known]
    scaled = estimate.covariance[np.ix_(known, known)] / np.outer(deviation, deviation)
    values, vectors = np.linalg.eigh(0.5 * (scaled + scaled.T))
    values = np.maximum(values, _LEAST_VARIANCE * values[-1])
    whitening = np.zeros((len(known), len(size)))
    whitening[:, known] = (vectors / np.sqrt(values)).T / np.maximum(deviation, _SHARPEST * size[known])
    return whitening


def _alone(mapping: Array) -> Mask:
    """Return which parameters a mapping tells apart from all others, shape (P,): those that its null space has not."""
    scale = np.maximum(np.linalg.norm(mapping, axis=0), 1e-300)
    _, values, rows = np.linalg.svd(mapping / scale)
    rank = int((values > 1e-9 * values[0]).sum())
    return np.asarray(np.linalg.norm(rows[rank:], axis=0) < _APART)


def _orthonormal() -> Array:
    """Return an orthonormal basis of the symmetric matrices of order 4, shape (10, 4, 4)."""
    basis = np.zeros((10, 4, 4))
    for k, (i, j) in enumerate(zip(*np.triu_indices(4), strict=True)):
        basis[k, i, j] = basis[k, j, i] = 1.0 if i == j else np.sqrt(0.5)
    return basis


_BASIS = _orthonormal()


def _entries(matrix: Array) -> Array:
    """Return the coordinates (10,) of a symmetric matrix (4, 4)."""
    return np.asarray(np.einsum("kij,ij->k", _BASIS, matrix))


def _matrix(entries: Array) -> Array:
    """Return the symmetric matrix (4, 4) of coordinates (10,)."""
    return np.asarray(np.einsum("kij,k->ij", _BASIS, entries))


def _whitened_entries(factor: Array) -> Array:
    """Return the change of coordinates from D to F^-1 D F^-T for a triangular F, shape (10, 10)."""
    inverse = solve_triangular(factor, np.eye(4), lower=True)
    return np.asarray(np.einsum("lij,kij->lk", _BASIS, inverse @ _BASIS @ inverse.T))
