"""Fit f_c, f_v and J to the sliding parts of all ramps of one load at once.

The shaft obeys J w' = tau - f_v w - f_c - delta_s exp(-(w / w_s)^e); the last term is the remainder of a Stribeck
effect. Angle and velocity at the beginning of each window are free, so that neither the time of break-away nor
presliding and the release of the stiction before it need a model, and the transient of the release, which decays
with T = J / f_v, is part of the fit. With alpha = 1 / f_v, beta = f_c / f_v, kappa = delta_s / f_v and T as
parameters the angle is linear in all but T, the Stribeck velocity w_s and the exponent e.

Residuals are whitened by a Kalman filter (`whiten`); the intensity of the torque noise is estimated by restricted
maximum likelihood. The torque's scale and the friction differ slightly from ramp to ramp, so alpha and beta of a ramp
are the common values plus an error, whose variances are also estimated by restricted maximum likelihood (a linear mixed
model). T is found by Gauss-Newton steps. The data seldom determine the Stribeck effect: the fits without an effect and
with each w_s and e of a grid are averaged by their marginal likelihoods (Bayesian model averaging), so that the
intervals contain this uncertainty. Around each point of the grid w_s and e are fitted, too, with a prior as wide as the
grid's cell: readings that determine them more finely than the grid change them, and the marginal likelihoods are
Laplace's approximation there.

Units: w in rad/s at the motor; tau, f_c and delta_s in Nm, f_v in Nm s/rad, J in kg m²; hence alpha in rad/(s Nm),
beta and kappa in rad/s, T in s.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from scipy.optimize import minimize, minimize_scalar

from friction_bench.experiment.record import SlidingWindow
from rx90_common.base.arrays import Array
from rx90_common.friction.element import stribeck_decay_slopes
from rx90_common.kernels.compiled import kernel

EXPONENTS = (0.7, 1.0, 1.5, 2.0)
"""Stribeck exponents of the grid: published values lie between these."""
VELOCITIES = 10
"""Stribeck velocities of the grid, in equal ratios."""
CELL = 0.5
"""Standard deviation of the prior of ln w_s and of ln e about a point of the grid, in distances of its points: the sum
over the grid is even within 2 %."""
FARTHEST = 2.0
"""w_s and e are sought within so many distances of the grid's points."""
HIGHEST_VELOCITY = 1.0 / 6.0
"""The highest w_s over the velocity at the ramps' end: a Stribeck effect that reaches into the ramps' second half
cannot be distinguished from less viscous friction."""
RISE_PRIOR_SD = 0.5
"""Standard deviation of the prior of delta_s / f_c about zero."""
FIRST_NOISE = 1e-2
"""Intensity of the torque noise over f_v, (rad/s)² s, to begin with."""
NOISE_RANGE = range(-18, 10, 2)
"""Logarithms of intensities between which the noise is sought."""
STEPS = 3
"""Gauss-Newton steps without a Stribeck effect; the second already changes less than the noise."""
STRIBECK_STEPS = 16
"""Largest number of further steps for each assumption with a Stribeck effect; each step computes the effect with the
velocities of the step before, so that w_s and e converge."""
SETTLED = 0.02
"""They end with the step that promises less than this in the logarithm of the likelihood."""
NEAR = 0.1
"""If the last step still predicts an increase of more than 1 and of more than this share of the gain over no effect,
there is no optimum to approximate, and no fit."""
HOPELESS = 20.0
"""The steps also end if the marginal likelihood, with the predicted increase, is this far below the best one."""
SHORTEST = 0.01
"""Least time constant T in ticks: the command's steps, whose sizes differ by a code, still show T far below a tick."""
SPREADS = (1e-5, 0.3)
"""Standard deviations of alpha and of beta from ramp to ramp, relative, between which they are sought."""
_ANGLE, _SPEED = 7, 8
"""Of the rows of `_derivatives`, those to angle and velocity at the beginning; the others belong to all ramps."""


@kernel
def respond(time: Array, final: Array, speed: float, T: float) -> tuple[Array, Array]:
    """Return angle, rad, and velocity, rad/s, from an initial velocity, each shape (n,).

    Args:
        time: of the readings, s, shape (n,).
        final: torque over f_v, held from each reading to the next, rad/s, shape (n,).
        speed: velocity at the first reading, rad/s.
        T: time constant, s.
    """
    angles = np.zeros(time.size)
    speeds = np.full(time.size, speed)
    for k in range(1, time.size):
        step = time[k] - time[k - 1]
        decay = math.exp(-step / T)
        excess = speeds[k - 1] - final[k - 1]
        angles[k] = angles[k - 1] + final[k - 1] * step + excess * T * (1.0 - decay)
        speeds[k] = final[k - 1] + excess * decay
    return angles, speeds


@kernel
def whiten(time: Array, columns: Array, T: float, q: float, r: float) -> tuple[Array, float]:
    """Return columns of angles so that their errors are independent and of variance 1, and the log determinant.

    Errors of the angle are white with the variance r (quantisation), plus the effect of white torque noise on a shaft
    whose angle and velocity at the first reading are known: an integrated Ornstein-Uhlenbeck process. The innovations
    of a Kalman filter for these, divided by their standard deviations, are the columns times the inverse Cholesky
    factor of the covariance.

    Args:
        time: of the readings, s, shape (n,).
        columns: angles, shape (p, n).
        T: time constant, s.
        q: intensity of the torque noise over f_v, (rad/s)² s.
        r: variance of a reading, rad².
    """
    white = np.empty(columns.shape)
    count = columns.shape[0]
    angle = np.zeros(count)
    speed = np.zeros(count)
    aa = ab = bb = 0.0  # covariance of angle and velocity
    determinant = 0.0
    for k in range(time.size):
        if k > 0:
            step = time[k] - time[k - 1]
            e = math.exp(-step / T)
            g = T * (1.0 - e)
            for i in range(count):
                angle[i] += g * speed[i]
                speed[i] *= e
            aa += 2.0 * g * ab + g * g * bb + q * (step - 2.0 * g + T / 2.0 * (1.0 - e * e))
            ab = e * (ab + g * bb) + q * (1.0 - e) ** 2 / 2.0
            bb = e * e * bb + q * (1.0 - e * e) / (2.0 * T)
        variance = aa + r
        deviation = math.sqrt(variance)
        determinant += math.log(variance)
        for i in range(count):
            innovation = columns[i, k] - angle[i]
            white[i, k] = innovation / deviation
            angle[i] += aa / variance * innovation
            speed[i] += ab / variance * innovation
        aa, ab, bb = aa - aa * aa / variance, ab - aa * ab / variance, bb - ab * ab / variance
    return white, determinant


@kernel
def _derivatives(time: Array, angle: Array, torque: Array, shares: Array, shared: Array, start: Array) -> Array:
    """Return the angle's residual, and its derivatives to the shared parameters, initial angle and velocity, (9, n).

    `shares` are the remainder of a Stribeck effect and its derivatives to ln w_s and ln e, shape (3, n); `shared` are
    alpha, beta, T, kappa and the changes of ln w_s and ln e; `start` is the initial angle and velocity.
    """
    alpha = shared[0]
    beta = shared[1]
    T = shared[2]
    kappa = shared[3]
    final = alpha * torque - beta - kappa * shares[0]
    h = 1e-3 * T
    columns = np.empty((9, time.size))
    columns[0] = angle - start[0] - respond(time, final, start[1], T)[0]
    columns[1] = respond(time, torque, 0.0, T)[0]
    columns[2] = respond(time, np.full(time.size, -1.0), 0.0, T)[0]
    later = respond(time, final, start[1], T + h)[0]
    earlier = respond(time, final, start[1], T - h)[0]
    columns[3] = (later - earlier) / (2 * h)
    columns[4] = respond(time, -shares[0], 0.0, T)[0]
    columns[5] = respond(time, -kappa * shares[1], 0.0, T)[0]
    columns[6] = respond(time, -kappa * shares[2], 0.0, T)[0]
    columns[_ANGLE] = 1.0
    columns[_SPEED] = -T * np.expm1(-(time - time[0]) / T)
    return columns


class Stribeck(NamedTuple):
    """What is assumed of a Stribeck effect before a fit.

    Attributes:
        velocity: w_s, rad/s at the motor, 0 for no effect.
        exponent: e.
        widths: distances of ln w_s and ln e from the next assumptions.
    """

    velocity: float = 0.0
    exponent: float = 1.0
    widths: tuple[float, float] = (0.0, 0.0)

    def shares(self, speed: Array, changes: Array) -> Array:
        """Return the remainder of the effect from each reading to the next, and its derivatives, shape (3, n).

        Args:
            speed: at the readings, rad/s, shape (n,).
            changes: of ln w_s and ln e, the variables of the derivatives.
        """
        if not self.velocity:
            return np.zeros((3, speed.size))
        velocity, exponent = np.array([self.velocity, self.exponent]) * np.exp(changes)
        left = np.array(stribeck_decay_slopes(np.maximum(speed, 0.0), float(velocity), float(exponent)))
        return np.concatenate(((left[:, 1:] + left[:, :-1]) / 2, left[:, -1:]), axis=1)


@dataclass(frozen=True)
class RampsFit:
    """The joint fit of all ramps of one load.

    Attributes:
        values: f_c (Nm), f_v (Nm s/rad), J (kg m²), shape (3,).
        covariance: of the values, shape (3, 3).
        freedom: degrees of freedom of each variance, shape (3,): few where it comes from the ramps' differences.
        spread: standard deviations, relative, of the torque's scale and of f_c from ramp to ramp, shape (2,).
        stribeck: probability that there is a Stribeck effect.
        velocities: fitted velocity of each ramp at the readings of its window, rad/s.
        point: alpha, beta, T of the most likely assumption about the Stribeck effect.
        grams: of each ramp (see `_reduced`) at this point, shape (K, 7, 7).
    """

    values: Array
    covariance: Array
    freedom: Array
    spread: Array
    stribeck: float
    velocities: list[Array]
    point: Array
    grams: Array

    def subset(self, ramps: Sequence[int]) -> Array:
        """Return f_c, f_v and J from some of the ramps alone, the Stribeck effect as found from all."""
        gram = self.grams[list(ramps)].sum(axis=0)
        change = np.linalg.solve(gram[1:4, 1:4], gram[1:4, 0])
        return _to_friction(self.point + change)

    def chi_square(self) -> tuple[float, int]:
        """Return by how much alphas and betas of each ramp's own would fit better, and the degrees of freedom."""
        total = self.grams.sum(axis=0)
        square = -float(total[1:4, 0] @ np.linalg.solve(total[1:4, 1:4], total[1:4, 0]))
        slope = curvature = 0.0
        for gram in self.grams:
            by_own = np.linalg.solve(gram[1:3, 1:3], gram[1:3, [0, 3]])
            square += float(gram[1:3, 0] @ by_own[:, 0])
            slope += float(gram[3, 0] - gram[1:3, 3] @ by_own[:, 0])
            curvature += float(gram[3, 3] - gram[1:3, 3] @ by_own[:, 1])
        return square + slope**2 / curvature, 2 * len(self.grams) - 2


def _to_friction(shared: Array) -> Array:
    """Return f_c, f_v and J of alpha, beta, T (and more)."""
    alpha, beta, T = shared[:3]
    return np.array([beta / alpha, 1.0 / alpha, T / alpha])


@kernel
def _reduced(time: Array, columns: Array, T: float, noise: float, variance: float) -> tuple[Array, Array, float]:
    """Return the information of the rows of `_derivatives` of one ramp about the shared parameters.

    That is the gram of the whitened shared rows with initial angle and velocity projected out, shape (7, 7); the
    coefficients of that projection, shape (2, 7); the logarithm of the determinants of the noise and of the
    information on the start.
    """
    white, determinant = whiten(time, columns, T, noise, variance)
    length = math.sqrt(np.sum(white[_ANGLE] ** 2))
    first = white[_ANGLE] / length
    along = np.sum(white[_SPEED] * first)
    second = white[_SPEED] - along * first
    height = math.sqrt(np.sum(second**2))
    second = second / height
    free = np.empty((_ANGLE, time.size))
    starts = np.empty((2, _ANGLE))
    gram = np.empty((_ANGLE, _ANGLE))
    for i in range(_ANGLE):
        a = np.sum(white[i] * first)
        b = np.sum(white[i] * second)
        free[i] = white[i] - a * first - b * second
        starts[1, i] = b / height
        starts[0, i] = (a - along * starts[1, i]) / length
        for j in range(i + 1):
            gram[i, j] = gram[j, i] = np.sum(free[i] * free[j])
    return gram, starts, determinant + 2.0 * math.log(length * height)


@dataclass(frozen=True)
class _Point:
    """A step of the fit for one assumption about the Stribeck effect.

    `shared` are alpha, beta, T, kappa and the changes of ln w_s and ln e; `starts` angle and velocity at each window's
    start; `speeds` velocities; `covariance` is that of the fitted ones of `shared`; `evidence` the logarithm of the
    marginal likelihood before the step, and `gain` by how much the step promised to raise that of the likelihood.
    """

    stribeck: Stribeck
    shared: Array
    starts: Array
    speeds: list[Array]
    covariance: Array
    evidence: float = 0.0
    gain: float = 0.0

    def friction(self) -> tuple[Array, Array]:
        """Return f_c, f_v and J, and their covariance, shape (3, 3)."""
        alpha, beta, T = self.shared[:3]
        jacobian = np.array(
            [[-beta / alpha**2, 1 / alpha, 0.0], [-1 / alpha**2, 0.0, 0.0], [-T / alpha**2, 0.0, 1 / alpha]]
        )
        return _to_friction(self.shared), np.asarray(jacobian @ self.covariance[:3, :3] @ jacobian.T)


class _Ramps:
    """The windows of one load, and the steps of a fit to them."""

    def __init__(self, windows: Sequence[SlidingWindow]) -> None:
        self.windows = windows
        self.step = windows[0].record.angle_step
        self.tick = windows[0].record.tick
        self.variance = self.step**2 / 12
        slopes = np.array([window.record.slope for window in windows])
        self.repeats = [slopes == slope for slope in np.unique(slopes)]
        self.freedom = slopes.size - len(self.repeats)
        self.spread = np.zeros(2)
        """Variances of alpha and beta from ramp to ramp."""

    def grid(self) -> list[Stribeck]:
        """Return the assumptions about a Stribeck effect, from the slowest that a reading resolves."""
        slowest = self.step / self.tick / 2
        fastest = max(_speed(window, slice(-6, None, 5)) for window in self.windows) * HIGHEST_VELOCITY
        if fastest <= slowest:
            return []
        velocities = np.geomspace(slowest, fastest, VELOCITIES)
        by_velocity = math.log(velocities[-1] / velocities[0]) / (len(velocities) - 1)
        by_exponent = math.log(EXPONENTS[-1] / EXPONENTS[0]) / (len(EXPONENTS) - 1)
        widths = by_velocity, by_exponent
        return [Stribeck(float(velocity), exponent, widths) for exponent in EXPONENTS for velocity in velocities]

    def start(self) -> _Point:
        """Return a point to begin with, from the velocities at each window's beginning and end."""
        starts = np.array([(window.angle[0], _speed(window, slice(0, 4, 3))) for window in self.windows])
        speeds = [np.full_like(window.time, start[1]) for window, start in zip(self.windows, starts, strict=True)]
        T = max(2.5 * self.tick, 0.05 * max(float(np.ptp(window.time)) for window in self.windows))
        point = _Point(Stribeck(), np.array([1.0, 0.0, T, 0.0, 0.0, 0.0]), starts, speeds, np.empty((0, 0)))
        return self.fit(self.advance(point, FIRST_NOISE, [1, 2]), FIRST_NOISE)

    def fit(self, point: _Point, noise: float) -> _Point:
        """Return the fit without a Stribeck effect, from a point nearby."""
        point = replace(point, stribeck=Stribeck(), shared=point.shared * [1, 1, 1, 0, 0, 0])
        for _ in range(STEPS):
            point = self.advance(point, noise, [1, 2, 3])
        return point

    def with_effects(self, point: _Point, effects: Sequence[Stribeck], noise: float) -> list[_Point]:
        """Return the converged fits for each effect, from a nearby point, without those much less likely."""
        moving = [self.advance(replace(point, stribeck=effect), noise, [1, 2, 3, 4]) for effect in effects]
        settled = list[_Point]()
        for _ in range(STRIBECK_STEPS):
            moving = [self.advance(one, noise, [1, 2, 3, 4, 5, 6]) for one in moving]
            settled += [one for one in moving if one.gain < SETTLED]
            least = max((one.evidence for one in (*settled, *moving)), default=0.0) - HOPELESS
            moving = [one for one in moving if one.gain >= SETTLED and one.evidence + one.gain > least]
        return settled + [one for one in moving if one.gain < max(1.0, NEAR * (one.evidence - point.evidence))]

    def noise(self, point: _Point) -> float:
        """Return the intensity of the torque noise by restricted maximum likelihood, above any Stribeck effect.

        Each ramp has its own alpha and beta here, because differences between ramps are no torque noise.
        """
        T = float(point.shared[2])
        halves = []
        for window, whole in zip(self.windows, self._columns(replace(point, stribeck=Stribeck())), strict=True):
            half = slice(window.time.size // 2, None)  # the faster one
            time = window.time[half]
            columns = whole[:, half].copy()
            columns[_SPEED] = -T * np.expm1(-(time - time[0]) / T)  # of a velocity that is free at its start
            halves.append((time, columns))

        def misfit(logarithm: float) -> float:
            parts = [_reduced(*half, T, math.exp(logarithm), self.variance) for half in halves]
            return sum(part[2] - 2.0 * _solve(part[0], [1, 2], np.zeros(2), np.zeros(2))[2] for part in parts)

        # Below the quantisation the likelihood is flat: the minimum is bracketed first.
        best = min(NOISE_RANGE, key=misfit)
        return math.exp(float(minimize_scalar(misfit, bounds=(best - 2.0, best + 2.0), method="bounded").x))

    def between(self, point: _Point, noise: float) -> Array:
        """Return the variances of alpha and beta from ramp to ramp of one slope, by restricted maximum likelihood.

        Each slope has an alpha and a beta of its own here, so that model errors do not count as differences of repeats.
        The variances are 0 if no slope was run twice.
        """
        if self.freedom == 0:
            return np.zeros(2)
        grams = np.array([gram for gram, _, _ in self.parts(point, noise)])
        size = np.abs(point.shared[:2])

        def misfit(logarithms: Array) -> float:
            loose, determinants = _loosened(grams, (size * np.exp(logarithms)) ** 2)
            sums = (loose[of_slope].sum(axis=0) for of_slope in self.repeats)
            return float(determinants.sum()) - 2.0 * sum(
                _solve(one, [1, 2], np.zeros(2), np.zeros(2))[2] for one in sums
            )

        low, high = np.log(SPREADS)
        middle = np.full(2, (low + high) / 2)
        # Differences over less than `eps` drown in the rounding of a likelihood of millions.
        found = minimize(misfit, middle, method="L-BFGS-B", bounds=[(low, high)] * 2, options={"eps": 1e-4}).x
        return np.asarray((size * np.exp(found)) ** 2)

    def _columns(self, point: _Point) -> list[Array]:
        """Return the rows of `derivatives` for each ramp."""
        return [
            _derivatives(window.time, window.angle, window.torque, shares, point.shared, start)
            for window, shares, start in zip(self.windows, self._shares(point), point.starts, strict=True)
        ]

    def _shares(self, point: _Point) -> list[Array]:
        return [point.stribeck.shares(speeds, point.shared[4:]) for speeds in point.speeds]

    def parts(self, point: _Point, noise: float) -> list[tuple[Array, Array, float]]:
        """Return the information of each ramp about the shared parameters (see `_reduced`)."""
        pairs = zip(self.windows, self._columns(point), strict=True)
        T = float(point.shared[2])
        return [_reduced(window.time, columns, T, noise, self.variance) for window, columns in pairs]

    def advance(self, point: _Point, noise: float, used: list[int]) -> _Point:
        """Take one Gauss-Newton step in the parameters `used`; T changes at most by a factor of two."""
        parts = self.parts(point, noise)
        indices = np.array(used) - 1
        prior = np.zeros(6)
        widths = np.array(point.stribeck.widths)
        if point.stribeck.velocity:
            prior[4:] = 1.0 / (CELL * widths) ** 2
            prior[3] = 1.0 / (RISE_PRIOR_SD * max(abs(float(point.shared[1])), 1e-9)) ** 2
        grams = np.array([gram for gram, _, _ in parts])
        loose, determinants = _loosened(grams, self.spread)
        change, covariance, evidence, gain = _solve(loose.sum(axis=0), used, prior[indices], point.shared[indices])
        evidence -= gain + (sum(part[2] for part in parts) + float(determinants.sum())) / 2
        shared = point.shared.copy()
        T = point.shared[2]
        shared[indices] += change
        shared[2] = np.clip(shared[2], max(T / 2, SHORTEST * self.tick), 2 * T)
        shared[4:] = np.clip(shared[4:], -FARTHEST * widths, FARTHEST * widths)
        # Differences of alpha and beta of each ramp: the best linear prediction from the residual after the change.
        projected = grams[:, 1:3, 0] - grams[:, 1:3, used] @ change
        root = np.sqrt(self.spread)
        inner = np.eye(2) + root[:, None] * grams[:, 1:3, 1:3] * root
        own = root * np.linalg.solve(inner, (root * projected)[:, :, None])[:, :, 0]
        starts = np.empty_like(point.starts)
        speeds = []
        for k, (window, shares) in enumerate(zip(self.windows, self._shares(point), strict=True)):
            by_row = parts[k][1]
            starts[k] = point.starts[k] + by_row[:, 0] - by_row[:, used] @ change - by_row[:, 1:3] @ own[k]
            alpha, beta = shared[:2] + own[k]
            final = alpha * window.torque - beta - shared[3] * shares[0]
            speeds.append(respond(window.time, final, starts[k, 1], shared[2])[1])
        return _Point(point.stribeck, shared, starts, speeds, covariance, evidence, gain)


def _speed(window: SlidingWindow, ends: slice) -> float:
    """Return the mean velocity between two readings, rad/s."""
    return float(np.diff(window.angle[ends])[0] / np.diff(window.time[ends])[0])


def _loosened(grams: Array, spread: Array) -> tuple[Array, Array]:
    """Return grams of ramps whose alpha and beta have individual errors, and the log determinants of these errors.

    Args:
        grams: of each ramp (see `_reduced`), shape (K, 7, 7).
        spread: variances of the errors of alpha and beta, shape (2,).
    """
    root = np.sqrt(spread)
    left = grams[:, :, 1:3] * root
    inner = np.eye(2) + root[:, None] * grams[:, 1:3, 1:3] * root
    return grams - left @ np.linalg.solve(inner, left.swapaxes(1, 2)), np.linalg.slogdet(inner)[1]


def _solve(gram: Array, used: list[int], prior: Array, at: Array) -> tuple[Array, Array, float, float]:
    """Solve the normal equations with a normal prior about zero.

    Returns the change of the parameters from `at`, their covariance, the logarithm of the marginal likelihood but for
    the determinants of the noise's covariances, and how much of it is due to the change.
    """
    information = gram[np.ix_(used, used)] + np.diag(prior)
    right = gram[used, 0] - prior * at
    scale = 1.0 / np.sqrt(np.diag(information))
    scaled = information * scale * scale[:, None]
    covariance = np.linalg.inv(scaled) * scale * scale[:, None]
    change = covariance @ right
    gain = float(right @ change)
    square = float(gram[0, 0] + prior @ at**2) - gain
    determinant = float(np.linalg.slogdet(scaled)[1] - 2.0 * np.log(scale).sum())
    strength = float(np.log(prior[prior > 0.0]).sum())
    return change, covariance, -(square + determinant - strength) / 2, gain / 2


def fit_sliding(windows: Sequence[SlidingWindow]) -> RampsFit:
    """Fit all ramps of one load.

    Args:
        windows: of ramps with at least two slopes.
    """
    ramps = _Ramps(windows)
    point = ramps.start()
    for _ in range(2):
        noise = ramps.noise(point)
        ramps.spread = ramps.between(point, noise)
        point = ramps.fit(point, noise)
    grid = ramps.grid()
    fits = [point, *ramps.with_effects(point, grid, noise)]
    evidence = np.array([fit.evidence for fit in fits])
    evidence[1:] -= math.log(max(len(grid), 1))  # no effect, and any effect, are equally likely beforehand
    weights = np.exp(np.nan_to_num(evidence, nan=-np.inf) - np.nanmax(evidence))
    weights /= weights.sum()
    used = [(w, *fit.friction()) for w, fit in zip(weights, fits, strict=True) if w > 0.0]
    values = sum(w * v for w, v, _ in used)
    covariance = sum(w * (c + np.outer(v - values, v - values)) for w, v, c in used)
    best = fits[int(np.argmax(weights))]
    grams = np.array([gram for gram, _, _ in ramps.parts(best, noise)])
    # Of a variance the part that the ramps' differences make is known as well as they are (Satterthwaite).
    _, total = best.friction()
    ramps.spread, spread = np.zeros(2), np.sqrt(ramps.spread) / np.abs(best.shared[:2])
    _, within = ramps.advance(best, noise, [1, 2, 3, 4, 5, 6] if best.stribeck.velocity else [1, 2, 3]).friction()
    share = np.clip(1.0 - np.diag(within) / np.diag(total), 1e-9, 1.0)
    freedom = max(ramps.freedom, 1) / share**2
    likely = 1.0 - float(weights[0])
    values = np.asarray(values)
    covariance = np.asarray(covariance)
    return RampsFit(values, covariance, freedom, spread, likely, best.speeds, best.shared[:3], grams)
