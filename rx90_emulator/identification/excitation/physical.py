"""The links, rotors and springs that can exist nearest to identified base parameters.

With y the base parameters, K the mapping from all parameters theta to base parameters, and R^T R the information of the
weighted rows on y, the sum

    |R (K theta - y)|^2 + w |distance from the prior|^2

is minimised. The first term is what the shift adds to the weighted squares of the torque, with the friction as it was
identified: that is what the files hold beside the bodies. The second one decides what the data leave open. The prior
is the <inertial> of the URDF, or the geometry of the arm where it has none.

With P0 of the prior, the squared distance of a body is twice the Bregman divergence of -log det (Lee, Wensing and Park
2020, "Geometric robot dynamic identification: a convex programming approach"),

    2 (tr(P0^-1 P) - log det(P0^-1 P) - 4),

near the prior the sum of the squared entries of log(P0^-1 P). It does not depend on units or frames, grows without
bound towards what no body can be, and in proportion to a mass that is too large. A rotor or spring is a matrix of order
1. The whole sum is convex in the parameters: it has one minimum.

A body is kept as its Cholesky factor, P = L L^T, and a step of the search changes the factor about itself, to first
order as log-Cholesky parameters do (Rucker and Wensing 2022, "Smooth parameterization of rigid-body inertia"), but
along a straight line in P: of sharp data some sums are known to 1e-3 and others not at all, and the valley that this
makes is straight in P and bent in a factor's logarithms, where searches crawl along it.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from scipy.optimize import brentq

from rx90_common.base.arrays import Array, Mask
from rx90_common.base.errors import IdentificationError
from rx90_emulator.identification.excitation.prior import InertialPrior, inertial_parameters

_PRIOR_WEIGHT = 1.0  # of logarithms with a deviation of 1: a description is right but for factors of some e
_GUESS_WEIGHT = 0.1  # of what the description does not have: right but for factors of some 20
_MAX_STEPS = 50  # for each weight of the prior
_DECREMENT = 1e-12  # of what is minimised, relative: a step that gains less is the last one
_STEP_SHARE = 0.99  # of the way to where a body would lose a dimension, at most
_LONGEST_STEP = 2.0  # in Newton steps
_MAX_NULL_ENTRY = 1e-6  # of a parameter in the mapping's null space, to be determined by itself
_MIN_SINGULAR_VALUE = 1e-9  # of the mapping, relative: less is rounding
_MIN_STEP_VALUE = 1e-14  # the same of the equations of a step
_OPEN_SHARE = 0.5  # of the prior's variance of a mass: where the runs leave more of it, the prior decides
_ROWS, _COLUMNS = np.tril_indices(4)
_BASIS = np.zeros((10, 4, 4))  # of symmetric matrices: the sum of an element's squares is that of its entries
_BASIS[range(10), _ROWS, _COLUMNS] = _BASIS[range(10), _COLUMNS, _ROWS] = np.where(_ROWS == _COLUMNS, 1.0, 0.5**0.5)


@dataclass(frozen=True, eq=False)
class BaseEstimate:
    """Identified base parameters.

    Attributes:
        mapping: K, shape (p, P), from P standard parameters to the base parameters: ten of each joint's body in
            Pinocchio's order, the inertias of k rotors, the amplitudes of s springs, and others, such as offsets. Those
            others, and springs without a prior, may be anything.
        value: SI units, shape (p,).
        information: R, shape (m, p): R^T R is the information on them.
        determined: which parameters the data determine, shape (p,).
    """

    mapping: Array
    value: Array
    information: Array
    determined: Mask

    def distance(self, shift: Array) -> float:
        """Return the length of a shift, shape (p,), in standard deviations: RMS over what the data determine."""
        return float(np.linalg.norm(self.information @ shift)) / math.sqrt(int(self.determined.sum()))


@dataclass(frozen=True, eq=False)
class ConsistentInertias:
    """Bodies and rotors that can exist, near to what was identified.

    Attributes:
        prior: where they began.
        pseudo: of each body, in the frame of its joint, shape (b, 4, 4).
        rotors: kg m^2, > 0 where the torque holds theirs, else 0, shape (k,).
        parameters: the standard parameters, bodies that stay included, shape (P,).
        base: their base parameters, shape (p,).
        shift: base parameters less the identified ones, shape (p,).
        distance: length of the shift in standard deviations, RMS: at most about 1 within the noise.
        alone: which standard parameters the data determine by themselves, not only as part of a sum, shape (P,).
        open: joints of which the prior, rather than the data, decides the mass of the bodies, shape (n,).
    """

    prior: InertialPrior
    pseudo: Array
    rotors: Array
    parameters: Array
    base: Array
    shift: Array
    distance: float
    alone: Mask
    open: Mask


def consistent_inertias(
    estimate: BaseEstimate, prior: InertialPrior, weight: float = _PRIOR_WEIGHT
) -> ConsistentInertias:
    """Return the consistent inertias nearest to the identified base parameters and to the prior.

    Args:
        estimate: of the base parameters.
        prior: of links and rotors.
        weight: w, of the prior.

    Raises:
        IdentificationError: if nothing is determined.
    """
    if not estimate.determined.any():
        count = len(estimate.determined)
        raise IdentificationError(f"none of {count} base parameters is determined; accepted: runs that determine some")
    mapping, known = estimate.mapping, estimate.mapping[estimate.determined]
    search = _Search(prior, estimate.information @ mapping, estimate.information @ estimate.value)
    # Sharp data would end the first steps where a body loses a dimension: the prior begins with a weight as sharp.
    squares = float(np.sum(search.residual**2))
    for decade in range(max(0, math.ceil(math.log10(max(squares, 1.0) / weight))), -1, -1):
        search.minimise(weight * 10.0**decade)
    base = mapping @ search.parameters
    # Those that the null space of the mapping has not are determined by themselves.
    _, sizes, rows = np.linalg.svd(known / np.maximum(np.linalg.norm(known, axis=0), 1e-300))
    null = rows[int((sizes > _MIN_SINGULAR_VALUE * sizes[0]).sum()) :]
    alone = np.asarray(np.linalg.norm(null, axis=0) < _MAX_NULL_ENTRY)
    shift = base - estimate.value
    return ConsistentInertias(
        prior=prior,
        pseudo=search.pseudo,
        rotors=search.behind[: len(prior.rotors)],
        parameters=search.parameters,
        base=base,
        shift=shift,
        distance=estimate.distance(shift),
        alone=alone,
        open=search.open_masses(weight),
    )


class _Search:
    """Newton's method for bodies and what stands behind them in the parameters, from the prior on.

    Attributes:
        pseudo: of the bodies, shape (b, 4, 4).
        behind: rotors, springs and others, shape (P - 10 n,).
    """

    def __init__(self, prior: InertialPrior, whitened: Array, target: Array) -> None:
        self._joint, self._known = [body.joint for body in prior.bodies], prior.known.ravel()
        self._whitened, self._target = whitened, target
        self.pseudo = np.array([body.pseudo for body in prior.bodies])
        begun = np.concatenate([prior.rotors, prior.springs])
        self.behind = np.append(begun, np.zeros(whitened.shape[1] - len(self._known) - len(begun)))
        self._positive = self.behind > 0.0
        self._inverse, self._begun = np.linalg.inv(self.pseudo), np.where(self._positive, self.behind, 1.0)
        share = np.where(prior.guessed, _GUESS_WEIGHT, 1.0)
        rest = np.append(share[len(self.pseudo) :], np.ones(len(self.behind) - len(prior.rotors)))
        self._share = np.append(np.repeat(share[: len(self.pseudo)], 10), np.where(self._positive, rest, 0.0))

    @property
    def parameters(self) -> Array:
        """Return all standard parameters, shape (P,)."""
        links = self._known.copy().reshape(-1, 10)
        np.add.at(links, self._joint, inertial_parameters(self.pseudo))
        return np.append(links, self.behind)

    @property
    def residual(self) -> Array:
        """Return what is left of the data, in standard deviations, shape (m,)."""
        return np.asarray(self._whitened @ self.parameters - self._target)

    def _tangent(self, factors: Array) -> Array:
        """Return the derivatives of the residual by a step: ten for each body, then one each; shape (m, 10 b + ...)."""
        moves = inertial_parameters(factors[:, None] @ _BASIS @ np.swapaxes(factors, 1, 2)[:, None])
        links = self._whitened[:, : len(self._known)].reshape(len(self._target), -1, 10)[:, self._joint]
        bodies = np.einsum("mbp,bkp->mbk", links, moves).reshape(len(self._target), -1)
        behind = self._whitened[:, len(self._known) :] * np.where(self._positive, self.behind, 1.0)
        return np.hstack([bodies, behind])

    def minimise(self, weight: float) -> None:
        """Go to the minimum with this weight of the prior."""
        count, weights = 10 * len(self.pseudo), weight * self._share
        near = np.sqrt(weights)
        for _ in range(_MAX_STEPS):
            factors, residual = np.linalg.cholesky(self.pseudo), self.residual
            turned = np.swapaxes(factors, 1, 2)
            slopes = np.einsum("kij,bij->bk", _BASIS, turned @ self._inverse @ factors - np.eye(4)).ravel()
            slopes = np.append(slopes, np.where(self._positive, self.behind / self._begun - 1.0, 0.0))
            tangent = self._tangent(factors)
            rows, sides = np.vstack([tangent, np.diag(near)]), np.append(residual, near * slopes)
            size, step = np.linalg.norm(rows, axis=0), np.zeros(rows.shape[1])
            there = size > 0.0  # all but the rotors and offsets that no row holds
            step[there] = -np.linalg.lstsq(rows[:, there] / size[there], sides, rcond=_MIN_STEP_VALUE)[0] / size[there]
            moves = np.tensordot(step[:count].reshape(-1, 10), _BASIS, 1)
            stretch = np.append(np.linalg.eigvalsh(moves), step[count:])
            own = np.append(np.repeat(weights[:count:10], 4), weights[count:])
            change = tangent @ step
            gain = -float(residual @ change + (weights * slopes) @ step)
            length = _best_length(gain, float(change @ change), own, stretch)
            shares = np.where(self._positive, self.behind, 1.0)
            self.pseudo = factors @ (np.eye(4) + length * moves) @ turned
            self.pseudo = 0.5 * (self.pseudo + np.swapaxes(self.pseudo, 1, 2))
            self.behind = self.behind + length * shares * step[count:]
            if gain < _DECREMENT * float(residual @ residual + weights.sum()):
                break

    def open_masses(self, weight: float) -> Mask:
        """Return at which joints the data leave more than half of the variance that the prior gives the mass alone."""
        factors, near = np.linalg.cholesky(self.pseudo), np.sqrt(weight * self._share)
        inverse = np.linalg.pinv(np.vstack([self._tangent(factors), np.diag(near)]))
        # A step's change of the mass that moves with each joint.
        masses = (factors[:, None] @ _BASIS @ np.swapaxes(factors, 1, 2)[:, None])[:, :, 3, 3]
        moved = np.zeros((len(self._known) // 10, len(near)))
        for b, joint in enumerate(self._joint):
            moved[joint, 10 * b : 10 * b + 10] = masses[b]
        count = 10 * len(self._joint)
        alone = np.sum((moved[:, :count] / near[:count]) ** 2, axis=1)
        return np.asarray(np.sum((moved @ inverse) ** 2, axis=1) > _OPEN_SHARE * alone)


def _best_length(gain: float, square: float, weights: Array, stretch: Array) -> float:
    """Return how far to go in a direction, in Newton steps.

    Args:
        gain: minus the slope of the minimised sum where it begins.
        square: of the change of the residual over one step.
        weights: of the logarithms, shape (k,).
        stretch: change over one step of what these are of, 1 where it begins, shape (k,).
    """

    def slope(length: float) -> float:
        return float(length * square - gain + weights @ (length * stretch**2 / (1.0 + length * stretch)))

    shrinks = -float(np.min(stretch[weights > 0.0], initial=0.0))
    longest = min(_LONGEST_STEP, _STEP_SHARE / max(shrinks, 1e-300))
    return longest if slope(longest) <= 0.0 else float(brentq(slope, 0.0, longest))
