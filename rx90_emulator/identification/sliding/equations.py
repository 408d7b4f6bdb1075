"""The observation equations of the sliding fit, their weights, and their reduction to the plateaus' friction torques.

A block gives, joint by joint, drive torque - rigid torque = E^T f + Y p with the friction torques f of the
elements and errors p of the inertial parameters (an unknown payload, a wrong mass). The torque of an element that
sticks is unknown, so only combinations of joints are kept in which no such element acts: the columns of N with
E_stuck N = 0. With joints 5 and 6 turning against each other, element 7 sticks, and the one combination left for it
is the difference of the two torques.

An element has one velocity in a plateau, hence one torque. The equations are linear in these torques f and in the
nuisance parameters p. Eliminating p leaves a quadratic form in f, the normal equations, which is sufficient for the
friction. It is small, so the non-linear fit of the curves costs nothing.
"""

from __future__ import annotations

from dataclasses import dataclass, fields
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import qr, solve_triangular
from scipy.sparse import csr_array

from rx90_common.base.arrays import Array
from rx90_emulator.identification.arm import RigidArm
from rx90_emulator.identification.sliding.plateaus import Blocks

_MIN_EFFECT_SD = 1e-2  # effect of an inertial error on all data together, in standard deviations of the noise
_HUBER_SD = 3.0  # standard deviations from which a residual counts linearly
_SPEED_CLASS_WIDTH = 0.1  # width of the classes of ln |speed| that count as one speed
_MIN_RESIDUAL_LEVERAGE = 0.05  # lower bound of 1 - leverage of a plateau's mean
_RANK_CUTOFF = 1e-13  # of the largest eigenvalue: smaller ones count as 0


@dataclass(frozen=True, eq=False)
class SlidingRows:
    """Equations scaled to unit noise: `value` = sum over elements of gain * f(velocity) + nuisance @ p.

    Attributes:
        value: shape (r,).
        gain: of the elements' torques, 1/Nm, shape (r, n_el).
        velocity: of the elements, mean of the plateau, rad/s, shape (r, n_el).
        nuisance: coefficients of errors along k observable directions of the inertial parameters, shape (r, k); the
            prior of each error is 0 with a standard deviation of 1.
        directions: these directions, in SI units, shape (10 n, k).
        scale: square root of the number of samples in the row's block mean, shape (r,).
        group: joint whose noise the row has, shape (r,).
        plateau: shape (r,).
        source: number of the record, shape (r,).
        time: in the series, s, shape (r,).
    """

    value: Array
    gain: Array
    velocity: Array
    nuisance: Array
    directions: Array
    scale: Array
    group: NDArray[np.int64]
    plateau: NDArray[np.int64]
    source: NDArray[np.int64]
    time: Array

    def __len__(self) -> int:
        return len(self.value)


def sliding_rows(blocks: Blocks, arm: RigidArm) -> SlidingRows:
    """Return the observation equations of all blocks, whitened by the covariance of the torques' noise."""
    motion = blocks.position, blocks.velocity, blocks.acceleration
    friction = blocks.torque - arm.torque(*motion)
    regressor = arm.regressor(*motion) * arm.inertial_scale()
    elements = arm.element_matrix
    size = np.bincount(blocks.plateau)
    mean = np.zeros((len(size), len(elements)))
    np.add.at(mean, blocks.plateau, blocks.velocity @ elements.T)
    velocity = (mean / np.maximum(size, 1)[:, None])[blocks.plateau]
    # The floor keeps the scaling finite for data without noise.
    noise = blocks.noise + np.diag((1e-6 * np.abs(blocks.torque).max(axis=0)) ** 2 + 1e-18)
    parts = []
    for pattern in np.unique(blocks.sliding, axis=0):
        combination = _unloaded(elements[~pattern])
        if combination.shape[1] == 0:
            continue
        rows = np.flatnonzero((blocks.sliding == pattern).all(axis=1))
        factor = np.linalg.cholesky(combination.T @ noise @ combination)
        white = solve_triangular(factor, combination.T, lower=True)  # (rows of a block, n)
        gain = white @ elements.T
        gain[:, ~pattern] = 0.0
        weight = np.sqrt(blocks.count[rows])
        height, width = len(rows), len(white)
        parts.append(
            SlidingRows(
                value=(weight[:, None] * (friction[rows] @ white.T)).ravel(),
                gain=(weight[:, None, None] * gain).reshape(height * width, -1),
                velocity=np.repeat(velocity[rows], width, axis=0),
                nuisance=(weight[:, None, None] * (white @ regressor[rows])).reshape(height * width, -1),
                directions=np.zeros((0, 0)),
                scale=np.repeat(weight, width),
                group=np.tile(np.abs(combination).argmax(axis=0), height),
                plateau=np.repeat(blocks.plateau[rows], width),
                source=np.repeat(blocks.source[rows], width),
                time=np.repeat(blocks.time[rows], width),
            )
        )
    joined = {f.name: np.concatenate([getattr(part, f.name) for part in parts]) for f in fields(SlidingRows)}
    # The directions of the inertial parameters that the equations observe.
    _, effect, basis = np.linalg.svd(joined["nuisance"].T @ joined["nuisance"])
    directions = basis[np.sqrt(effect) > _MIN_EFFECT_SD].T
    joined["nuisance"] = joined["nuisance"] @ directions
    joined["directions"] = arm.inertial_scale()[:, None] * directions
    return SlidingRows(**joined)


def _unloaded(stuck: Array) -> Array:
    """Return a sparse basis of the joint torques on which no stuck element, a row of E each, acts, shape (n, k)."""
    n = stuck.shape[1]
    if len(stuck) == 0:
        return np.eye(n)
    _, upper, order = qr(stuck, pivoting=True)
    rank = int(np.sum(np.abs(np.diag(upper)) > 1e-9))
    combination = np.zeros((n, n - rank))
    combination[order[:rank]] = -_back_substituted(upper[:rank, :rank], upper[:rank, rank:])
    combination[order[rank:]] = np.eye(n - rank)
    combination[np.abs(combination) < 1e-12] = 0.0
    return combination


def _back_substituted(upper: NDArray[Any], right: NDArray[Any]) -> Array:
    """Return x of upper @ x = right, shapes (n, n) and (n, k); SciPy 1.11 refuses n = 0."""
    return np.asarray(solve_triangular(upper, right)) if len(upper) else right


@dataclass(frozen=True, eq=False)
class Weights:
    """A transformation of the equations to unit noise (random effects, quasi-demeaning).

    Besides noise from block to block, all blocks of a plateau share an error (ripple, temperature, an arm that is not
    quite rigid). With variances s^2 of a block and t^2 of a plateau of m blocks, the equations less the share
    1 - s / sqrt(s^2 + m t^2) of their plateau's mean, over s, have unit noise. As the equations are scaled, t^2 grows
    with the samples in a block.

    Attributes:
        cluster: number of plateau and joint of each row, shape (r,); c clusters.
        share: of its mean that is subtracted from each cluster, shape (c,).
        factor: of each row, 1 / s and Huber's weight, shape (r,).
    """

    cluster: NDArray[np.int64]
    share: Array
    factor: Array

    @classmethod
    def equal(cls, rows: SlidingRows) -> Weights:
        """Return the weights of rows that have unit noise."""
        pairs = np.column_stack([rows.plateau, rows.group])
        cluster = np.asarray(np.unique(pairs, axis=0, return_inverse=True)[1].ravel(), dtype=np.int64)
        return cls(cluster, np.zeros(cluster.max() + 1), np.ones(len(rows)))

    def updated(self, rows: SlidingRows, residual: Array, leverage: Array) -> Weights:
        """Return the weights by the variance components of a fit's residuals.

        Args:
            rows: the equations.
            residual: shape (r,).
            leverage: of each cluster's mean, shape (c,).
        """
        cluster = self.cluster
        count = np.bincount(cluster)
        mean = np.bincount(cluster, residual) / count
        # The shared error of a plateau is a torque, and the equations of long blocks are scaled up.
        power = np.bincount(cluster, rows.scale**2)
        inner = residual - mean[cluster]
        # Bessel's correction; a plateau of one block has no distance from its mean, and is left out.
        several = count[cluster] > 1
        apart = inner / np.sqrt(1.0 - 1.0 / np.where(several, count[cluster], np.inf))
        group = rows.group[np.unique(cluster, return_index=True)[1]]
        share, factor = np.zeros(len(count)), np.ones(len(rows))
        for g in np.unique(group):
            inside, mine = rows.group == g, group == g
            known = apart[inside & several]
            # Without such plateaus the noise is that of the samples, by which the equations are scaled.
            noise = max(_robust_sd(known), 1e-9) if len(known) else 1.0
            # The mean square of the residuals' means is (1 - leverage) (s^2 / m + t^2).
            left = np.maximum(_MIN_RESIDUAL_LEVERAGE, 1.0 - leverage[mine])
            excess = np.sum(count[mine] * mean[mine] ** 2) - noise**2 * np.sum(left)
            common = max(0.0, float(excess / np.sum(power[mine] * left)))
            share[mine] = 1.0 - noise / np.sqrt(noise**2 + power[mine] * common)
            size = np.abs(inner[inside]) / noise
            factor[inside] = np.sqrt(np.minimum(1.0, _HUBER_SD / np.maximum(size, 1e-12))) / noise
        return Weights(cluster, share, factor)

    def means(self, values: Array | csr_array) -> Array:
        """Return the clusters' means of columns, shape (r, k), scaled to unit noise, shape (c, k)."""
        count = np.bincount(self.cluster)
        members = _members(self.cluster, self.factor)
        return np.asarray(((1.0 - self.share) / np.sqrt(count))[:, None] * (members @ values))

    def operator(self) -> csr_array:
        """Return the matrix of the transformation, shape (r, r)."""
        ones = np.ones(len(self.cluster))
        members = _members(self.cluster, ones)
        less = _diagonal(ones) - members.T @ _diagonal(self.share / np.bincount(self.cluster)) @ members
        return csr_array(_diagonal(self.factor) @ less)


def _members(cluster: NDArray[np.int64], values: Array) -> csr_array:
    return csr_array((values, (cluster, np.arange(len(cluster)))), shape=(int(cluster.max()) + 1, len(cluster)))


def _diagonal(values: Array) -> csr_array:
    """Return a diagonal matrix; scipy.sparse.diags_array and eye_array are younger than SciPy 1.11."""
    place = np.arange(len(values))
    return csr_array((values, (place, place)), shape=(len(values), len(values)))


def _robust_sd(values: Array) -> float:
    """Return the standard deviation about 0 without outliers, which are found by the median absolute deviation."""
    robust = 1.4826 * float(np.median(np.abs(values)))
    good = np.abs(values) <= _HUBER_SD * robust
    # A normal distribution truncated at 3 standard deviations keeps 0.9867 of its standard deviation.
    return float(np.sqrt(np.mean(values[good] ** 2))) / 0.9867 if robust > 0.0 else 0.0


def speed_design_effect(rows: SlidingRows, weights: Weights, residual: Array) -> Array:
    """Return Kish's design effect of plateaus at one speed, whatever their pose and direction.

    Ripple depends on the speed and changes its sign with it, so the errors of plateaus at one speed are correlated. The
    variance of an estimate is that with independent plateaus, times the sum of S^2 over the speeds over the sum of s^2
    over the plateaus, with the residual s of a plateau along its motion, and the sum S of s at one speed.

    Args:
        rows: the equations.
        weights: of the fit.
        residual: of the fit, shape (r,).

    Returns:
        The factor for each row's joint, 1 or more, shape (r,).
    """
    first = np.unique(weights.cluster, return_index=True)[1]
    group, source = rows.group[first], rows.source[first]
    velocity = rows.velocity[first, group]
    along = np.sign(velocity) * weights.means(residual[:, None])[:, 0]
    with np.errstate(divide="ignore"):
        level = np.round(np.log(np.abs(velocity)) / _SPEED_CLASS_WIDTH)
    factor = np.ones(len(rows))
    for g in np.unique(group):
        mine = np.flatnonzero((group == g) & (velocity != 0.0))
        number = np.unique(np.column_stack([source[mine], level[mine]]), axis=0, return_inverse=True)[1].ravel()
        power = float(np.sum(along[mine] ** 2))
        if power > 0.0:
            together = float(np.sum(np.bincount(number, along[mine]) ** 2))
            factor[rows.group == g] = max(1.0, together / power)
    return factor


@dataclass(frozen=True, eq=False)
class NormalForm:
    """Equations of unit noise in the c friction torques alone: root @ f = target.

    Attributes:
        root: shape (k, c).
        target: shape (k,).
        back: the nuisance parameters are back[:, 0] - back[:, 1:] @ f, shape (p, 1 + c).
        spread: root of their covariance at given torques, spread @ spread^T, shape (p, p).
    """

    root: Array
    target: Array
    back: Array
    spread: Array

    @classmethod
    def of(cls, rows: SlidingRows, design: csr_array, weights: Weights) -> NormalForm:
        """Eliminate the nuisance parameters, whose prior is 0 with a standard deviation of 1.

        Args:
            rows: the equations.
            design: coefficients of the torques in them, shape (r, c).
            weights: of the equations.
        """
        operator = weights.operator()
        value = operator @ rows.value[:, None]
        friction = operator @ design
        nuisance = operator @ rows.nuisance
        # By an orthogonal basis (QR): normal equations in nuisance parameters as badly scaled as these would lose all
        # digits.
        basis, upper = np.linalg.qr(np.vstack([nuisance, np.eye(nuisance.shape[1])]))
        basis = basis[: len(value)]
        along = np.hstack([basis.T @ value, basis.T @ friction])
        form = (friction.T @ friction).toarray() - along[:, 1:].T @ along[:, 1:]
        pull = (friction.T @ value)[:, 0] - along[:, 1:].T @ along[:, 0]
        values, vectors = np.linalg.eigh((form + form.T) / 2.0)
        good = values > _RANK_CUTOFF * values[-1]
        scale = np.sqrt(values[good])
        return cls(
            root=scale[:, None] * vectors[:, good].T,
            target=(vectors[:, good].T @ pull) / scale,
            back=_back_substituted(upper, along),
            spread=_back_substituted(upper, np.eye(len(upper))),
        )

    def nuisance(self, torques: Array) -> Array:
        """Return the nuisance parameters that go with friction torques, shape (p,)."""
        return np.asarray(self.back[:, 0] - self.back[:, 1:] @ torques)
