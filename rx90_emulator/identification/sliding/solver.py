"""The equations of the sliding fit, and the non-linear least-squares fit of all elements' curves to them.

A block gives, joint by joint, drive torque - rigid torque = E^T f + Y p with the friction torques f of the
elements and errors p of the inertial parameters (an unknown payload, a wrong mass). The torque of an element that
sticks is unknown, so only combinations of joints are used in which no such element acts: the columns of N with
E_stuck N = 0. With joints 5 and 6 turning against each other, element 7 sticks, and the only remaining combination
is the difference of the two torques.

An element has one velocity in a plateau, hence one torque. The equations are linear in these torques f and in the
nuisance parameters p. Eliminating p leaves a quadratic form in f, the normal equations, which is sufficient for the
friction. It is small, so the non-linear fit of the curves takes hardly any time.

With dz/dt = 0, equations 17 to 19 leave f = sign(v) [tau_c + d exp(-(|v| / omega_s)^delta) + c2 |v|^alpha] with the
Stribeck rise d = tau_s - tau_c. Written in d and in the logarithms of omega_s, delta and alpha, the bounds
tau_s >= tau_c > 0 and omega_s, delta > 0 are plain, and five of the eight parameters are linear.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import qr, solve_triangular
from scipy.optimize import least_squares, lsq_linear
from scipy.sparse import csr_array, diags

from rx90_common.base.arrays import Array, Mask
from rx90_common.friction.element import ALPHA_BOUNDS, stribeck_decay_slopes, viscous_torque
from rx90_common.friction.parts.part import LINEAR_SPEED
from rx90_emulator.identification.arm import RigidArm
from rx90_emulator.identification.estimates import SLIDING, VISCOUS_EXPONENT
from rx90_emulator.identification.sliding.plateaus import Blocks
from rx90_emulator.identification.sliding.quality import Drift, Residuals, drifts_of, misfits_of

FITTED = ("tau_c_positive", "tau_c_negative", "tau_s_positive", "tau_s_negative", "c2", "omega_s", "delta", "alpha")
"""The parameters of an element in the fit, tau_c+, tau_c-, d+, d-, c2, ln omega_s, ln delta, ln alpha, by the names
that they determine."""
SIZE = len(FITTED)
LINEAR = slice(0, 5)
RISE = slice(2, 4)
VISCOUS = 4
OMEGA_S = 5
SHAPE = slice(5, 7)
EXPONENT = 7

_REWEIGHTINGS = 4  # of iteratively reweighted least squares
_DELTA_RANGE = (0.2, 5.0)
_STARTS = ((0.3, 1.0), (0.1, 1.0), (0.03, 1.0), (0.1, 2.0), (0.3, 2.0))
"""Starts: omega_s as the squared share of the range of ln omega_s from its lower bound, and delta."""
_ALPHA_START = 0.8
_BOUND_MARGIN = 1e-3  # Nm, or of a logarithm
_TIE_WEIGHT = 10.0  # weight of an exact equation over that of the data
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


def sliding_rows(blocks: Blocks, arm: RigidArm) -> SlidingRows:
    """Return the observation equations of all blocks, whitened by the covariance of the torques' noise."""
    motion = blocks.position, blocks.velocity, blocks.acceleration
    friction = blocks.torque - arm.torque(*motion)
    regressor = arm.regressor(*motion) * arm.inertial_scale()
    elements = arm.element_matrix
    mean = np.zeros((int(blocks.plateau.max()) + 1, len(elements)))
    np.add.at(mean, blocks.plateau, blocks.velocity @ elements.T)
    velocity = mean[blocks.plateau] / np.bincount(blocks.plateau)[blocks.plateau, None]
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
        width = len(white)
        weight = np.sqrt(blocks.count[rows])
        parts.append(
            {
                "value": (weight[:, None] * (friction[rows] @ white.T)).ravel(),
                "gain": (weight[:, None, None] * gain).reshape(len(rows) * width, -1),
                "velocity": np.repeat(velocity[rows], width, axis=0),
                "nuisance": (weight[:, None, None] * (white @ regressor[rows])).reshape(len(rows) * width, -1),
                "scale": np.repeat(weight, width),
                "group": np.tile(np.abs(combination).argmax(axis=0), len(rows)),
                **{name: np.repeat(getattr(blocks, name)[rows], width) for name in ("plateau", "source", "time")},
            }
        )
    joined = {name: np.concatenate([part[name] for part in parts]) for name in parts[0]}
    # The directions of the inertial parameters that the equations observe.
    _, effect, basis = np.linalg.svd(joined["nuisance"].T @ joined["nuisance"])
    directions = basis[np.sqrt(effect) > _MIN_EFFECT_SD].T
    joined["nuisance"] = joined["nuisance"] @ directions
    return SlidingRows(**joined, directions=arm.inertial_scale()[:, None] * directions)


def _unloaded(stuck: Array) -> Array:
    """Return a sparse basis of the joint torques on which no stuck element, a row of E each, acts, shape (n, k)."""
    n = stuck.shape[1]
    if len(stuck) == 0:
        return np.eye(n)
    _, upper, order = qr(stuck, pivoting=True)
    rank = int(np.sum(np.abs(np.diag(upper)) > 1e-9))
    combination = np.zeros((n, n - rank))
    combination[order[:rank]] = -np.linalg.solve(upper[:rank, :rank], upper[:rank, rank:])
    combination[order[rank:]] = np.eye(n - rank)
    combination[np.abs(combination) < 1e-12] = 0.0
    return combination


class _Weights:
    """A transformation of the equations to unit noise (random effects, quasi-demeaning).

    Besides noise from block to block, all blocks of a plateau have a common error (ripple, temperature, an arm that is
    not quite rigid). With variances s^2 of a block and t^2 of a plateau of m blocks, the equations less the share
    1 - s / sqrt(s^2 + m t^2) of their plateau's mean, over s, have unit noise. As the equations are scaled, t^2 grows
    with the samples in a block. At first all of the noise is taken as that of the samples.
    """

    def __init__(self, rows: SlidingRows) -> None:
        self._rows = rows
        pairs = np.column_stack([rows.plateau, rows.group])
        _, self.first, number, self.count = np.unique(
            pairs, axis=0, return_index=True, return_inverse=True, return_counts=True
        )
        self.cluster = np.asarray(number.ravel(), dtype=np.int64)  # of plateau and joint, shape (r,)
        self.share = np.zeros(len(self.count))  # of its mean that is subtracted from each cluster
        self.factor = np.ones(len(rows.value))  # of each row, 1 / s and Huber's weight

    def update(self, residual: Array, leverage: Array) -> None:
        """Estimate the weights by the variance components of residuals (r,), with the leverage of clusters' means."""
        cluster = self.cluster
        count = self.count
        rows = self._rows
        mean = np.bincount(cluster, residual) / count
        # The common error of a plateau is a torque, and the equations of long blocks are scaled up.
        power = np.bincount(cluster, rows.scale**2)
        inner = residual - mean[cluster]
        # Bessel's correction; a plateau of one block equals its mean, and is excluded.
        several = count[cluster] > 1
        corrected = inner / np.sqrt(1.0 - 1.0 / np.where(several, count[cluster], np.inf))
        group = rows.group[self.first]
        for g in np.unique(group):
            inside = rows.group == g
            of_group = group == g
            known = corrected[inside & several]
            # Without such plateaus the noise is that of the samples, by which the equations are scaled.
            noise = max(_robust_sd(known), 1e-9) if len(known) else 1.0
            # The mean square of the residuals' means is (1 - leverage) (s^2 / m + t^2).
            residual_share = np.maximum(_MIN_RESIDUAL_LEVERAGE, 1.0 - leverage[of_group])
            excess = np.sum(count[of_group] * mean[of_group] ** 2) - noise**2 * np.sum(residual_share)
            common = max(0.0, float(excess / np.sum(power[of_group] * residual_share)))
            self.share[of_group] = 1.0 - noise / np.sqrt(noise**2 + power[of_group] * common)
            size = np.abs(inner[inside]) / noise
            self.factor[inside] = np.sqrt(np.minimum(1.0, _HUBER_SD / np.maximum(size, 1e-12))) / noise

    def _members(self, values: Array) -> csr_array:
        return csr_array((values, (self.cluster, np.arange(len(values)))), shape=(len(self.count), len(values)))

    def means(self, values: Array | csr_array) -> Array:
        """Return the clusters' means of columns, shape (r, k), scaled to unit noise, shape (c, k)."""
        scale = (1.0 - self.share) / np.sqrt(self.count)
        return np.asarray(scale[:, None] * (self._members(self.factor) @ values))

    def operator(self) -> csr_array:
        """Return the matrix of the transformation, shape (r, r)."""
        ones = np.ones(len(self.cluster))
        members = self._members(ones)
        less = _diagonal(ones) - members.T @ _diagonal(self.share / self.count) @ members
        return csr_array(_diagonal(self.factor) @ less)

    def design_effect(self, residual: Array) -> Array:
        """Return Kish's design effect of plateaus at one speed, in any pose and direction, for each row (r,).

        Ripple depends on the speed and changes its sign with it, so the errors of plateaus at one speed are correlated.
        The variance of an estimate is that with independent plateaus, times the sum of S^2 over the speeds over the sum
        of s^2 over the plateaus, with the residual s of a plateau along its motion, and the sum S of s at one speed.
        """
        rows = self._rows
        group = rows.group[self.first]
        source = rows.source[self.first]
        velocity = rows.velocity[self.first, group]
        along = np.sign(velocity) * self.means(residual[:, None])[:, 0]
        with np.errstate(divide="ignore"):
            level = np.round(np.log(np.abs(velocity)) / _SPEED_CLASS_WIDTH)
        factor = np.ones(len(residual))
        for g in np.unique(group):
            of_group = np.flatnonzero((group == g) & (velocity != 0.0))
            number = np.unique(np.column_stack([source[of_group], level[of_group]]), axis=0, return_inverse=True)[
                1
            ].ravel()
            power = float(np.sum(along[of_group] ** 2))
            if power > 0.0:
                together = float(np.sum(np.bincount(number, along[of_group]) ** 2))
                factor[rows.group == g] = max(1.0, together / power)
        return factor


def _diagonal(values: Array) -> csr_array:
    return csr_array(diags(values))


def _robust_sd(values: Array) -> float:
    """Return the standard deviation about 0 without outliers, which are found by the median absolute deviation."""
    robust = 1.4826 * float(np.median(np.abs(values)))
    good = np.abs(values) <= _HUBER_SD * robust
    # A normal distribution truncated at 3 standard deviations keeps 0.9867 of its standard deviation.
    return float(np.sqrt(np.mean(values[good] ** 2))) / 0.9867 if robust > 0.0 else 0.0


def torque(velocity: Array, parameters: Array) -> Array:
    """Return the friction torque of an element, Nm, shape (m,), by velocities in rad/s and parameters of the fit."""
    return np.asarray(torque_jacobian(velocity, parameters)[:, LINEAR] @ parameters[LINEAR])


def torque_jacobian(velocity: Array, parameters: Array) -> Array:
    """Return the derivatives of the torque by all parameters, shape (m, 8)."""
    omega_s, delta, alpha = np.exp(parameters[SHAPE.start :]).tolist()
    decay, by_omega_s, by_delta = stribeck_decay_slopes(velocity, omega_s, delta)
    forward = 1.0 * (velocity > 0.0)
    backward = -1.0 * (velocity < 0.0)
    rise = forward * parameters[2] + backward * parameters[3]
    viscous = viscous_torque(velocity, 1.0, alpha)
    by_alpha = alpha * parameters[VISCOUS] * viscous * np.log(np.maximum(np.abs(velocity), LINEAR_SPEED))
    return np.column_stack(
        [forward, backward, decay * forward, decay * backward, viscous, rise * by_omega_s, rise * by_delta, by_alpha]
    )


def natural(parameters: Array) -> dict[str, float]:
    """Return the parameters by the names in SLIDING, and the viscous exponent by its own."""
    coulomb = parameters[:2]
    rise = parameters[RISE]
    (omega_s, delta, alpha) = np.exp(parameters[SHAPE.start :])
    values = np.array([*coulomb, *(coulomb + rise), omega_s, delta, parameters[VISCOUS], alpha])
    return dict(zip((*SLIDING, VISCOUS_EXPONENT), values.tolist(), strict=True))


def natural_jacobian(parameters: Array) -> Array:
    """Return the derivatives of the result of `natural` by the parameters of the fit, shape (8, 8)."""
    matrix = np.zeros((SIZE, SIZE))
    matrix[0, 0] = matrix[1, 1] = matrix[2, 0] = matrix[2, 2] = matrix[3, 1] = matrix[3, 3] = matrix[6, VISCOUS] = 1.0
    matrix[4, 5], matrix[5, 6], matrix[7, EXPONENT] = np.exp(parameters[SHAPE.start :])
    return matrix


class CurveFit:
    """The curves of all elements that fit the equations best, all fitted together.

    Args:
        rows: the equations.
        free: parameters of the elements to fit, shape (n_el, 8); where they are not free, the Stribeck rise is 0 and
            the viscous exponent 1.

    Attributes:
        rows: the equations.
        free: as the argument.
        parameters: of the elements, shape (n_el, 8), in the order of FITTED.
        nuisance: errors of the arm's weights along the directions of `rows`, shape (k,).
        nuisance_covariance: shape (k, k).
        covariance: of the elements' parameters, shape (8 n_el, 8 n_el); 0 where fixed.
        at_bound: free parameters that lie on a bound, shape (n_el, 8).
        residual: of the equations, shape (r,).
        noise: standard deviation of each row over the one that it was scaled by, shape (r,).
        common: intraclass correlation: share of the variance of a plateau's mean that is common to its blocks, shape
            (r,).
        design_effect: Kish's factor on the variance due to the correlation of plateaus at one speed, shape (r,).
        agreement, widening: misfit of each element's curve and the factor on the variances due to it, as in
            `misfits_of`, shapes (n_el,) and (n_el, 8).
        drifts: of each element's friction over the series.
    """

    def __init__(self, rows: SlidingRows, free: Mask) -> None:
        self.rows = rows
        self.free = free
        # A friction torque for each plateau and element that slides in it; c of them.
        at, element = np.nonzero(rows.gain)
        keys, number = np.unique(rows.plateau[at] * len(free) + element, return_inverse=True)
        self._velocity = np.bincount(number, rows.velocity[at, element]) / np.bincount(number)
        self._columns = [np.flatnonzero(keys % len(free) == e) for e in range(len(free))]
        self._design = csr_array((rows.gain[at, element], (at, number)), shape=(len(rows.value), len(keys)))
        self._lower, self._upper = self._bounds()
        weights = _Weights(rows)
        self._eliminate_nuisance(weights.operator())
        self.parameters = min((self._solved(self._start(*start)) for start in _STARTS), key=lambda pair: pair[1])[0]
        for _ in range(_REWEIGHTINGS):
            slope = weights.means(self._design @ self._slope(self.parameters))
            leverage = _leverage(slope, weights.means(rows.nuisance))
            weights.update(self._left(), leverage)
            self._eliminate_nuisance(weights.operator())
            self.parameters = self._solved(self.parameters)[0]
        inside = np.minimum(self.parameters - self._lower, self._upper - self.parameters)
        self.at_bound = free & (inside < _BOUND_MARGIN)
        self.residual, self.nuisance = self._left(), self._nuisance(self._torques(self.parameters))
        slope = self._slope(self.parameters)
        # The covariance of the free parameters is huge for those that are not identifiable.
        jacobian = np.vstack([self._root @ slope, self._ties()])
        scale = np.linalg.norm(jacobian, axis=0)
        scale[scale == 0.0] = 1.0
        _, values, directions = np.linalg.svd(jacobian / scale, full_matrices=False)
        root = directions.T / np.maximum(values, 1e-10 * values[0])
        own = (root @ root.T) / np.outer(scale, scale)
        follows = self._back[:, 1:] @ slope
        self.nuisance_covariance = self._spread @ self._spread.T + follows @ own @ follows.T
        self.covariance = np.zeros((free.size, free.size))
        self.covariance[np.ix_(*2 * [np.flatnonzero(free)])] = own
        self.noise = 1.0 / weights.factor
        self.common = 1.0 - (1.0 - weights.share[weights.cluster]) ** 2
        self.design_effect = weights.design_effect(self.residual)
        residuals = self._residuals(weights.operator(), self._design @ slope)
        self.agreement, self.widening = misfits_of(residuals, free, own)
        self.drifts: list[Drift] = drifts_of(residuals, free)

    def _eliminate_nuisance(self, operator: csr_array) -> None:
        """Find the equations of unit noise in the friction torques f alone: root @ f = target, shapes (k, c) and (k,).

        The nuisance parameters, whose prior is 0 with a standard deviation of 1, are back[:, 0] - back[:, 1:] @ f, and
        their covariance at given torques is spread @ spread^T.
        """
        value = operator @ self.rows.value[:, None]
        friction = operator @ self._design
        # By an orthogonal basis (QR): normal equations in such badly scaled nuisance parameters would lose all digits.
        basis, upper = _basis(operator @ self.rows.nuisance)
        along = np.hstack([basis.T @ value, basis.T @ friction])
        form = (friction.T @ friction).toarray() - along[:, 1:].T @ along[:, 1:]
        pull = (friction.T @ value)[:, 0] - along[:, 1:].T @ along[:, 0]
        values, vectors = np.linalg.eigh((form + form.T) / 2.0)
        good = values > _RANK_CUTOFF * values[-1]
        scale = np.sqrt(values[good])
        self._root = scale[:, None] * vectors[:, good].T
        self._target = (vectors[:, good].T @ pull) / scale
        self._back = np.linalg.solve(upper, along)
        self._spread = np.linalg.inv(upper)

    def _nuisance(self, torques: Array) -> Array:
        return np.asarray(self._back[:, 0] - self._back[:, 1:] @ torques)

    def _residuals(self, operator: csr_array, slope: Array) -> Residuals:
        """Return the residuals of the fit, with the equations' derivatives by the free parameters, shape (r, q)."""
        rows = self.rows
        residual = np.asarray(operator @ self.residual)
        number = np.asarray(np.unique(rows.plateau, return_inverse=True)[1], dtype=np.int64)
        gather = csr_array((np.ones(len(residual)), (number, np.arange(len(residual)))))
        slides = rows.gain != 0.0
        shared = np.maximum(np.asarray(gather @ slides.astype(np.float64)), 1.0)
        gain = np.asarray(operator @ (np.sign(rows.velocity) * rows.gain))
        basis = _basis(operator @ rows.nuisance)[0]
        both = np.hstack([np.asarray(operator @ slope), gain])
        both = both - basis @ (basis.T @ both)
        return Residuals(
            residual=residual,
            slope=both[:, : slope.shape[1]],
            gain=both[:, slope.shape[1] :],
            plateau=number,
            velocity=np.asarray(gather @ (rows.velocity * slides)) / shared,
            along=np.asarray(gather @ (gain * residual[:, None])) / np.sqrt(np.maximum(gather @ gain**2, 1e-300)),
            time=np.asarray(gather @ rows.time) / np.bincount(number),
        )

    @cached_property
    def exponent_score(self) -> Array:
        """Return by how many standard deviations a Gauss-Newton step moves each exponent from 1, shape (n_el,).

        It is 0 where the exponent is free already.
        """
        exponent = np.zeros_like(self.free)
        exponent[:, EXPONENT] = self.free[:, VISCOUS] & ~self.free[:, EXPONENT]
        root = self._root
        parameters = self.parameters
        added = root @ self._slope(parameters, exponent)
        basis = np.linalg.qr(root @ self._slope(parameters))[0]
        # The part that the other parameters do not explain (Frisch, Waugh and Lovell).
        added -= basis @ (basis.T @ added)
        residual = self._target - root @ self._torques(parameters)
        normal = np.linalg.pinv(added.T @ added, hermitian=True)
        step = normal @ (added.T @ residual)
        deviation = np.sqrt(np.maximum(np.diag(normal), 0.0))
        result = np.zeros(len(self.free))
        result[exponent[:, EXPONENT]] = np.abs(step) / np.where(deviation > 0.0, deviation, np.inf)
        return result

    def block(self, element: int) -> Array:
        """Return the covariance of the fitted parameters of an element, shape (8, 8)."""
        rows = slice(element * SIZE, (element + 1) * SIZE)
        return np.asarray(self.covariance[rows, rows])

    def _torques(self, parameters: Array) -> Array:
        result = np.zeros(len(self._velocity))
        for columns, values in zip(self._columns, parameters, strict=True):
            result[columns] = torque(self._velocity[columns], values)
        return result

    def _slope(self, parameters: Array, chosen: Mask | None = None) -> Array:
        """Return the derivatives of the friction torques by the free, or the chosen, parameters, shape (c, p)."""
        parts = []
        chosen = self.free if chosen is None else chosen
        for columns, values, free in zip(self._columns, parameters, chosen, strict=True):
            part = np.zeros((len(self._velocity), int(free.sum())))
            part[columns] = torque_jacobian(self._velocity[columns], values)[:, free]
            parts.append(part)
        return np.hstack(parts)

    def _left(self) -> Array:
        friction = self._torques(self.parameters)
        return np.asarray(self.rows.value - self._design @ friction - self.rows.nuisance @ self._nuisance(friction))

    def _solved(self, start: Array) -> tuple[Array, float]:
        """Return the solution from a start, and its cost."""
        ties = self._ties()
        root = self._root
        target = self._target
        fixed = start.copy()
        fixed[:, LINEAR][~self.free[:, LINEAR]] = 0.0

        def filled(x: Array) -> Array:
            values = fixed.copy()
            values[self.free] = x
            return values

        def residual(x: Array) -> Array:
            return np.concatenate([root @ self._torques(filled(x)) - target, ties @ x])

        def jacobian(x: Array) -> Array:
            return np.vstack([root @ self._slope(filled(x)), ties])

        low = self._lower[self.free]
        high = self._upper[self.free]
        inside = np.clip(start[self.free], low + 1e-9, high - 1e-9)
        result = least_squares(residual, inside, jacobian, (low, high), x_scale="jac", max_nfev=200)
        return filled(result.x), float(result.cost)

    def _start(self, place: float, delta: float) -> Array:
        """Return the start with one guess of omega_s and delta for all elements, and the best linear parameters."""
        start = np.zeros(self.free.shape)
        low = self._lower[:, OMEGA_S]
        high = self._upper[:, OMEGA_S]
        start[:, OMEGA_S] = low + place**0.5 * (high - low)
        start[:, OMEGA_S + 1] = np.log(delta)
        start[self.free[:, EXPONENT], EXPONENT] = np.log(_ALPHA_START)
        linear = self.free & (np.arange(SIZE) < LINEAR.stop)
        matrix = self._root @ self._slope(start, linear)
        start[linear] = lsq_linear(matrix, self._target, (0.0, np.inf)).x
        return start

    def _bounds(self) -> tuple[Array, Array]:
        lower = np.full(self.free.shape, -np.inf)
        upper = np.full(self.free.shape, np.inf)
        lower[:, LINEAR] = 0.0
        for e, columns in enumerate(self._columns):
            speed = np.abs(self._velocity[columns]) if len(columns) else np.array([0.01, 1.0])
            lower[e, SHAPE] = np.log(speed.min() / 3.0), np.log(_DELTA_RANGE[0])
            upper[e, SHAPE] = np.log(2.0 * speed.max()), np.log(_DELTA_RANGE[1])
        lower[:, EXPONENT], upper[:, EXPONENT] = np.log(ALPHA_BOUNDS)
        return lower, upper

    def _ties(self) -> Array:
        """Return equations tau_c+ = tau_c- for the elements beyond the joints, shape (n_el - n or less, p).

        The difference of the two is a constant torque. Constants k of the elements act on the joints as E^T k, for any
        motion, so n_el - n of them are not identifiable.
        """
        column = np.cumsum(self.free.ravel()).reshape(self.free.shape) - 1
        joints = len(self.rows.directions) // 10
        coupled = [e for e in range(joints, len(self.free)) if self.free[e, 0]]
        ties = np.zeros((len(coupled), int(self.free.sum())))
        for row, e in zip(ties, coupled, strict=True):
            scale = _TIE_WEIGHT * float(np.linalg.norm(self._root[:, self._columns[e]]))
            row[column[e, 0]] = scale
            row[column[e, 1]] = -scale
        return ties


def _basis(nuisance: Array) -> tuple[Array, Array]:
    """Return Q and R of the nuisance columns with the rows of their prior; Q has only the rows of the equations."""
    basis, upper = np.linalg.qr(np.vstack([nuisance, np.eye(nuisance.shape[1])]))
    return basis[: len(nuisance)], upper


def _leverage(slope: Array, nuisance: Array) -> Array:
    """Return the diagonal of the hat matrix of all parameters, nuisance with its prior, shape (c,)."""
    count = nuisance.shape[1]
    prior = np.hstack([np.zeros((count, slope.shape[1])), np.eye(count)])
    matrix = np.vstack([np.hstack([slope, nuisance]), prior])
    size = np.linalg.norm(matrix, axis=0)
    left_vectors, values, _ = np.linalg.svd(matrix / np.where(size > 0.0, size, 1.0), full_matrices=False)
    return np.asarray(np.sum(left_vectors[: len(slope), values > 1e-10 * values[0]] ** 2, axis=1))
