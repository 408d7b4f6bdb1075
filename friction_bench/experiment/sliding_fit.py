"""Fit f_c, f_v and J to the sliding parts of all ramps of one load at once.

The rows are those of `ramp_rows`; fit, deviations and held-out error those of `rx90_common.estimation`. What is not
known of the rows (T, the torque noise, the differences of ramps) is found in passes. The data seldom show a Stribeck
effect: it is kept where it lowers the error of ramps that the fit did not see, and otherwise the deviations contain
what it may be.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import NamedTuple

import numpy as np
from scipy.optimize import minimize_scalar

from friction_bench.experiment.ramp_rows import Alone, Errors, Sliding, slide
from friction_bench.experiment.record import SlidingWindow
from rx90_common.base.arrays import Array, Index
from rx90_common.estimation.choose import Gain, held_out_gain, held_out_squares
from rx90_common.estimation.deviations import USUAL_RISE, deviations
from rx90_common.estimation.fit import Fit, Problem, fit

PASSES = 3
"""Fits, each with what the one before tells of the rows."""
FIRST_NOISE = 1e-2
"""Intensity of the torque noise over f_v, (rad/s)² s, to begin with."""
NOISE_RANGE = range(-18, 10, 2)
"""Logarithms of intensities between which the noise is sought."""
SHORTEST = 0.01
"""Least T in ticks: the command's steps, whose sizes differ by a code, still show T far below a tick."""
LONGEST = 0.25
"""Standard deviation of what is known of T beforehand, over the longest time of sliding."""
HIGHEST_VELOCITY = 1.0 / 6.0
"""The highest w_s over the velocity at the ramps' end: a Stribeck effect that reaches into the ramps' second half
cannot be distinguished from less viscous friction."""
VELOCITIES = 3
"""Parts of the range of ln w_s, in each of which it is sought."""
EXPONENT_DEVIATION = 0.35
"""Standard deviation of what is known of ln e beforehand: published exponents lie between 0.5 and 2."""
LEAST_FREEDOM = 3
"""Ramps beyond one of each slope from which the deviations are those of ramps; with fewer, of stretches of them."""
STRETCH = 20
"""Readings."""
SETTLED = 6.0
"""Time constants after which 0.25 % of the release's transient is left."""
LEAST_HALF = 15
"""Readings of half a ramp from which a bend is seen."""
LEAST_BEND = 0.05
"""Difference of the velocity's slope in both halves, relative, from which a ramp is bent."""
BEND_DEVIATIONS = 5.0
"""The same in standard deviations."""
LONGEST_SETTLING = 0.5
"""Share of the longest time of sliding that may be left out as the transient."""
LONGEST_T = 5.0
"""T in ticks that a fit with an effect may have, whatever the ramps show: a longer one would imitate a bend."""
DIFFERENCE = 1e-5
"""Step of parameters for difference quotients."""
_ALPHA, _BETA, _T, _KAPPA, _VELOCITY, _EXPONENT = range(6)
"""Places of alpha, beta, T, kappa, ln w_s and ln e among the parameters; without an effect there are three."""


class RampsFit(NamedTuple):
    """The joint fit of all ramps of one load.

    Attributes:
        values: f_c (Nm), f_v (Nm s/rad), J (kg m²), shape (3,).
        covariance: of the values; 1.96 deviations are a 95 % interval, shape (3, 3).
        spread: standard deviations, relative, of the torque's scale and of f_c from ramp to ramp, shape (2,).
        effect: what a Stribeck effect explains.
        velocities: fitted velocity of each ramp at the readings of its window, rad/s.
        asymptotes: a, rad/s², and b, rad/s, of each ramp: as much of its own as is no noise.
    """

    values: Array
    covariance: Array
    spread: Array
    effect: Gain
    velocities: list[Array]
    asymptotes: list[tuple[float, float]]

    def at_slope(self, slope: float) -> tuple[Array, Array]:
        """Return the source's f_c = m b / a, which is f_c + J a, and f_v = m / a, and their covariance, (2, 2)."""
        coulomb, viscous, inertia = self.values
        from_values = np.array(
            [[1.0, -inertia * slope / viscous**2, slope / viscous], [0.0, 1.0, 0.0]]
        )
        values = np.array([coulomb + inertia * slope / viscous, viscous])
        return values, from_values @ self.covariance @ from_values.T


def _shaft(x: Array) -> Sliding:
    if len(x) == _KAPPA:
        return Sliding(*x.tolist())
    return Sliding(*x[:_VELOCITY].tolist(), *np.exp(x[_VELOCITY:]).tolist())


def _speed(window: SlidingWindow, ends: slice) -> float:
    """Return the mean velocity between two readings, rad/s."""
    return float(np.diff(window.angle[ends])[0] / np.diff(window.time[ends])[0])


@dataclass(frozen=True)
class _Ramps:
    """The ramps of one load, and what is known of their rows.

    Attributes:
        windows: K of them.
        errors: of their angles.
        level: alpha and beta, shape (2,).
        starts: velocity at the first reading of each, rad/s, shape (K,).
        longest_transient: upper bound of T, s.
    """

    windows: Sequence[SlidingWindow]
    errors: Errors
    level: Array
    starts: Array
    longest_transient: float = math.inf

    @classmethod
    def begin(cls, windows: Sequence[SlidingWindow]) -> _Ramps:
        """Return the ramps before the first fit."""
        record = windows[0].record
        errors = Errors(2.5 * record.tick, FIRST_NOISE, record.angle_step**2 / 12.0, np.zeros(2))
        starts = np.array([_speed(window, slice(0, 4, 3)) for window in windows])
        return cls(windows, errors, np.array([1.0, 0.0]), starts)

    @property
    def slopes(self) -> Array:
        """Return the slope of each ramp, Nm/s, shape (K,)."""
        return np.array([window.record.slope for window in self.windows])

    @property
    def longest(self) -> float:
        """Return the longest time of sliding, s."""
        return max(float(np.ptp(window.time)) for window in self.windows)

    @property
    def freedom(self) -> int:
        """Return how many ramps there are beyond one of each slope."""
        return len(self.windows) - len(np.unique(self.slopes))

    @property
    def block(self) -> Index:
        """Return the number of each reading's block: its ramp, or its stretch where too few ramps repeat a slope."""
        sizes = [window.time.size for window in self.windows]
        ramp = np.repeat(np.arange(len(sizes)), sizes)
        if self.freedom >= LEAST_FREEDOM:
            return ramp
        stretch = np.concatenate([np.arange(size) // STRETCH for size in sizes])
        return np.asarray(ramp * max(sizes) + stretch)

    @property
    def speeds(self) -> tuple[float, float]:
        """Return the range of ln w_s, from the slowest velocity that a reading resolves."""
        record = self.windows[0].record
        slowest = record.angle_step / record.tick / 2.0
        fastest = HIGHEST_VELOCITY * max(
            _speed(window, slice(-6, None, 5)) for window in self.windows
        )
        return math.log(slowest), math.log(max(fastest, 2.0 * slowest))

    def residual(self, k: int, x: Array) -> Array:
        """Return the angles of a ramp less those of a model."""
        window = self.windows[k]
        return np.asarray(
            window.angle - slide(window.time, window.torque, float(self.starts[k]), _shaft(x))[0]
        )

    def problem(self, effect: tuple[float, float] | None = None) -> Problem:
        """Return the problem of all ramps.

        Args:
            effect: where ln w_s of a Stribeck effect is sought; None without an effect.
        """
        tick = self.windows[0].record.tick
        longest = self.longest
        low, high = effect or self.speeds
        usual_kappa = USUAL_RISE * max(abs(float(self.level[1])), 1e-9)
        usual_T = min(max(2.5 * tick, 0.05 * longest), self.longest_transient / 2.0)
        alpha, beta = self.level
        last = 3.0 * EXPONENT_DEVIATION
        known = [  # of each parameter: where it begins, its deviation, and its bounds
            (alpha, np.inf, -np.inf, np.inf),
            (beta, np.inf, -np.inf, np.inf),
            (usual_T, LONGEST * longest, SHORTEST * tick, self.longest_transient),
            (0.0, usual_kappa, 0.0, np.inf),
            ((low + high) / 2.0, (high - low) / 2.0, 2.0 * low - high, 2.0 * high - low),
            (0.0, EXPONENT_DEVIATION, -last, last),
        ]
        start, spread, lower, upper = np.array(known[: _KAPPA if effect is None else None]).T.copy()
        block = self.block

        def model(x: Array) -> tuple[Array, Array]:
            rows = np.hstack([self._columns(k, x) for k in range(len(self.windows))])
            return rows[0], rows[1:].T

        return Problem(
            target=np.zeros(len(block)),
            linear=np.empty((len(block), 0)),
            model=model,
            start=start,
            lower=lower,
            upper=upper,
            group=np.zeros(len(block), dtype=np.intp),
            block=block,
            prior=np.empty((0, 0)),
            spread=spread,
        )

    def _columns(self, k: int, x: Array) -> Array:
        """Return rows of a ramp: the model less the angles, and its derivatives by x, shape (1 + q, n)."""
        residual = self.residual(k, x)
        slopes = []
        for step in np.diag(DIFFERENCE * np.maximum(np.abs(x), 1.0)):
            slopes.append((residual - self.residual(k, x + step)) / step.max())
        return self.errors.rows(self.windows[k], np.array([-residual, *slopes]))

    def fit(self, effect: tuple[float, float] | None = None) -> Fit:
        """Return the fit, whose rows have a variance of 1."""
        problem = self.problem(effect)
        return fit(problem, np.ones(len(problem.target)))

    def alone(self, k: int, x: Array, part: slice = slice(None)) -> Alone:
        """Return what readings of a ramp tell by themselves."""
        window = self.windows[k]
        return self.errors.alone(window.time[part], window.torque[part], self.residual(k, x)[part])

    def started(self, x: Array) -> _Ramps:
        """Return the ramps with the velocities at the first readings that fit a model."""
        changes = [self.alone(k, x).change[3] for k in range(len(self.windows))]
        highest = [2.0 * _speed(window, slice(0, 4, 3)) for window in self.windows]
        return replace(self, starts=np.clip(self.starts + changes, 0.0, highest))

    def moved(self, x: Array) -> _Ramps:
        """Return the ramps with what a fit tells of their rows."""
        ramps = replace(self, level=x[:_T], errors=self.errors._replace(T=float(x[_T])))
        ramps = ramps.with_noise(x)
        ramps = replace(ramps, errors=ramps.errors._replace(spread=ramps.spread(x)))
        return ramps.started(x)

    def with_noise(self, x: Array) -> _Ramps:
        """Return the ramps with the intensity of the torque noise by restricted maximum likelihood.

        It is that of the faster half of each ramp, above any Stribeck effect, with alpha and beta of the half's own:
        differences between ramps are no torque noise.
        """

        def trial(logarithm: float) -> _Ramps:
            return replace(self, errors=self.errors._replace(noise=math.exp(logarithm)))

        def misfit(logarithm: float) -> float:
            ramps = trial(logarithm)
            halves = enumerate(self.windows)
            return sum(
                ramps.alone(k, x, slice(window.time.size // 2, None)).misfit for k, window in halves
            )

        # Below the quantisation the likelihood is flat: the minimum is bracketed first.
        best = min(NOISE_RANGE, key=misfit)
        return trial(
            float(minimize_scalar(misfit, bounds=(best - 2.0, best + 2.0), method="bounded").x)
        )

    def spread(self, x: Array) -> Array:
        """Return the standard deviations of alpha and beta from ramp to ramp of one slope, 0 without repeats.

        The variance of the ramps' values is that of their differences and that of their noise (method of moments).
        """
        ramps = [self.alone(k, x) for k in range(len(self.windows))]
        changes = np.array([ramp.change[:_T] for ramp in ramps])
        noise = np.mean([np.diag(ramp.covariance)[:_T] for ramp in ramps], axis=0)
        if self.freedom == 0:
            return np.zeros(_T)
        squares = np.zeros(_T)
        for slope in np.unique(self.slopes):
            repeats = changes[self.slopes == slope]
            squares += np.sum((repeats - repeats.mean(axis=0)) ** 2, axis=0)
        return np.asarray(np.sqrt(np.maximum(squares / self.freedom - noise, 0.0)))

    def level_of(self, k: int, x: Array) -> Array:
        """Return alpha and beta of a ramp: those of all, and its own difference as far as it is no noise."""
        ramp = self.alone(k, x)
        variance = self.errors.spread**2
        share = variance / (variance + np.diag(ramp.covariance)[:_T])
        return x[:_T] + share * ramp.change[:_T]

    def bend(self, k: int, x: Array) -> tuple[float, float] | None:
        """Return the slope of the velocity in both halves of a ramp, rad/s², where it is not the same or none."""
        window = self.windows[k]
        first = int(np.searchsorted(window.time, window.time[0] + SETTLED * self.errors.T))
        middle = (first + window.time.size) // 2
        if middle - first < LEAST_HALF:
            return None
        early = self.alone(k, x, slice(first, middle))
        late = self.alone(k, x, slice(middle, None))
        slopes = x[_ALPHA] + np.array([early.change[0], late.change[0]])
        error = math.sqrt(early.covariance[0, 0] + late.covariance[0, 0])
        difference = max(BEND_DEVIATIONS * error, LEAST_BEND * float(slopes[0]))
        if slopes[1] > BEND_DEVIATIONS * error and abs(slopes[1] - slopes[0]) < difference:
            return None
        return tuple((window.record.slope * slopes).tolist())


def find_bends(windows: Sequence[SlidingWindow]) -> list[tuple[float, float] | None]:
    """Return the slope of the velocity in both halves of each ramp, rad/s², where it is not the same or none.

    T is the middle one of those that ramps show by themselves, so that a bent ramp does not change it for others. What
    a Stribeck effect of all ramps explains is no bend, if they have two slopes: an effect is over at a velocity, a
    transient at a time.
    """
    ramps = _Ramps.begin(windows)
    T = float(np.median([_Ramps.begin([window]).fit().x[_T] for window in windows]))
    T = min(T, LONGEST_SETTLING / SETTLED * ramps.longest)
    x = np.array([*ramps.level, T])
    ramps = replace(ramps, errors=ramps.errors._replace(T=T)).with_noise(x)
    bends = [ramps.bend(k, x) for k in range(len(windows))]
    if any(bends) and len(np.unique(ramps.slopes)) > 1:
        bounded = replace(ramps, longest_transient=max(2.0 * T, LONGEST_T * windows[0].record.tick))
        common, effect = _with_effect(bounded.moved(bounded.fit().x))
        common = replace(common, errors=ramps.errors)
        bends = [bend and common.bend(k, effect.x) for k, bend in enumerate(bends)]
    return bends


def fit_sliding(windows: Sequence[SlidingWindow]) -> RampsFit:
    """Fit all ramps of one load.

    Args:
        windows: of the ramps. Those of one slope determine f_c + J a, and neither of the two.
    """
    ramps = _Ramps.begin(windows)
    for _ in range(PASSES):
        ramps = ramps.moved(ramps.fit().x)
    result = ramps.fit()
    moved, effect = _with_effect(ramps)
    gain = _gain(result, effect)
    if gain.kept:
        result = effect
        ramps = moved
        problem = effect.problem
        x = effect.x
    else:
        problem = ramps.problem(ramps.speeds)  # what an effect may be makes the deviations greater
        x = np.concatenate([result.x, problem.start[_KAPPA:]])
    free = np.zeros(len(x), dtype=np.bool_)
    covariance = deviations(
        result._replace(problem=problem, x=x, slopes=problem.model(x)[1], at_bound=free)
    ).covariance
    alpha, beta, T = result.x[:_KAPPA].tolist()
    to_values = np.array(
        [
            [-beta / alpha**2, 1.0 / alpha, 0.0],
            [-1.0 / alpha**2, 0.0, 0.0],
            [-T / alpha**2, 0.0, 1.0 / alpha],
        ]
    )
    velocities = []
    asymptotes = []
    for k, window in enumerate(windows):
        velocities.append(
            slide(window.time, window.torque, float(ramps.starts[k]), _shaft(result.x))[1]
        )
        ramp_alpha, ramp_beta = ramps.level_of(k, result.x).tolist()
        a = window.record.slope * ramp_alpha
        asymptotes.append((a, ramp_beta + a * T))
    return RampsFit(
        values=np.array([beta / alpha, 1.0 / alpha, T / alpha]),
        covariance=to_values @ covariance[:_KAPPA, :_KAPPA] @ to_values.T,
        spread=ramps.spread(result.x) / np.abs(result.x[:_T]),
        effect=gain,
        velocities=velocities,
        asymptotes=asymptotes,
    )


def _with_effect(ramps: _Ramps) -> tuple[_Ramps, Fit]:
    """Return the best fit with a Stribeck effect, and the ramps' velocities with it."""
    results = []
    for effect in pairwise(np.linspace(*ramps.speeds, VELOCITIES + 1).tolist()):
        moved = ramps.started(ramps.fit(effect).x)
        results.append((moved, moved.fit(effect)))
    return min(results, key=lambda result: result[1].cost)


def _gain(simple: Fit, effect: Fit) -> Gain:
    """Judge a Stribeck effect by the error of blocks that the fits did not see."""
    squares = held_out_squares(simple), held_out_squares(effect)
    bound = "delta_s" if effect.at_bound[_KAPPA] else ""
    return Gain(*held_out_gain(effect.problem.block, *squares), bound)
