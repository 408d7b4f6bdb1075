"""Piecewise polynomials: cubic or quintic through points, put together in time, and bounds of what they reach."""

from __future__ import annotations

from dataclasses import dataclass
from math import comb

import numpy as np

from rx90_common.base.arrays import Array, Mask
from rx90_common.kernels.compiled import kernel


@dataclass(frozen=True)
class Spline:
    """A set-point for every time from the first knot on; after the last knot it rests there.

    Attributes:
        times: knots, s, shape (n,), increasing.
        coefficients: of powers 0 to 5 of the time since the knot, shape (n - 1, 6 powers, 6 joints).
        final: position after the last knot, rad, shape (6,).
        blend_error: by how much it misses the points that it is to pass, at most, rad.
    """

    times: Array
    coefficients: Array
    final: Array
    blend_error: float = 0.0

    @property
    def duration(self) -> float:
        """Return the time of the last knot, s."""
        return float(self.times[-1])

    def sample(self, times: Array) -> Array:
        """Return set-points at `times`, s, shape (m,): position, velocity, acceleration, shape (m, 3, 6)."""
        setpoints = np.empty((times.size, 3, 6))
        sample_spline(self.times, self.coefficients, self.final, times, setpoints)
        return setpoints

    def bounds(self) -> tuple[Array, Array]:
        """Return what positions, velocities and accelerations lie between, shape (3, 6) each; infinite for no numbers.

        Between its ends a polynomial lies within its control points as a Bezier curve (Farin 2002, chapter 5).
        """
        low, high = np.full((3, 6), np.inf), np.full((3, 6), -np.inf)
        _control_points(self.coefficients, np.diff(self.times), low, high)
        return low, high


@kernel
def _control_points(coefficients: Array, span: Array, low: Array, high: Array) -> None:
    """Lower `low` and raise `high`, shape (3, 6), to the control points of all pieces."""
    scaled = np.empty(6)
    for k in range(span.size):
        for j in range(6):
            for row in range(3):
                degree = 5 - row
                factor = 1.0
                for i in range(degree + 1):
                    # The derivative's coefficient, by the share of the span.
                    scaled[i] = coefficients[k, i + row, j] * factor
                    factor *= span[k]
                    for d in range(row):
                        scaled[i] *= i + row - d
                # Differences of the control points, upwards: b_m = sum of C(m, i)/C(degree, i) scaled_i.
                for m in range(degree + 1):
                    value, share = 0.0, 1.0
                    for i in range(m + 1):
                        value += share * scaled[i]
                        share *= (m - i) / (degree - i) if i < degree else 0.0
                    if not abs(value) < np.inf:
                        low[row, j], high[row, j] = -np.inf, np.inf
                    low[row, j] = min(low[row, j], value)
                    high[row, j] = max(high[row, j], value)


@kernel
def sample_spline(knots: Array, coefficients: Array, final: Array, times: Array, setpoints: Array) -> None:
    """Write the set-points at `times` into `setpoints`, shape (m, 3, 6)."""
    last = knots.size - 1
    for m in range(times.size):
        t = times[m]
        if t >= knots[last]:
            for j in range(6):
                setpoints[m, 0, j] = final[j]
                setpoints[m, 1, j] = 0.0
                setpoints[m, 2, j] = 0.0
            continue
        k = max(np.searchsorted(knots, t, side="right") - 1, 0)
        s = t - knots[k]
        for j in range(6):
            c0, c1, c2 = coefficients[k, 0, j], coefficients[k, 1, j], coefficients[k, 2, j]
            c3, c4, c5 = coefficients[k, 3, j], coefficients[k, 4, j], coefficients[k, 5, j]
            setpoints[m, 0, j] = c0 + s * (c1 + s * (c2 + s * (c3 + s * (c4 + s * c5))))
            setpoints[m, 1, j] = c1 + s * (2 * c2 + s * (3 * c3 + s * (4 * c4 + s * 5 * c5)))
            setpoints[m, 2, j] = 2 * c2 + s * (6 * c3 + s * (12 * c4 + s * 20 * c5))


def resting(position: Array) -> Spline:
    """Return the spline that holds a position, rad, shape (6,)."""
    return Spline(np.zeros(1), np.zeros((0, 6, 6)), position)


def smooth(times: Array, position: Array, velocity: Array) -> Spline:
    """Return the cubic spline through the points whose acceleration is continuous from its begin to its end.

    Args:
        times: s, shape (n,), increasing, n >= 2.
        position: rad, shape (n, 6).
        velocity: rad/s, shape (n, 6); only the first and the last row count.
    """
    slopes = velocity.copy()
    _slopes(times, position, slopes)
    return interpolate(times, position, slopes, None)


@kernel
def _slopes(times: Array, position: Array, slopes: Array) -> None:
    """Fill the slopes of the C2 cubic between the first and the last row, shape (n, 6) (de Boor 2001, chapter IV)."""
    # h1 s0 + 2 (h0 + h1) s1 + h0 s2 = 3 (h1 d0 + h0 d1), h: spans, d: differences of the positions by the spans.
    last = times.size - 1
    factor = np.zeros(times.size)
    for i in range(1, last):
        before, after = times[i] - times[i - 1], times[i + 1] - times[i]
        pivot = 2.0 * (before + after) - after * factor[i - 1]
        factor[i] = before / pivot
        for j in range(6):
            left = (position[i, j] - position[i - 1, j]) / before
            right = (position[i + 1, j] - position[i, j]) / after
            slopes[i, j] = (3.0 * (after * left + before * right) - after * slopes[i - 1, j]) / pivot
    for i in range(last - 1, 0, -1):
        for j in range(6):
            slopes[i, j] -= factor[i] * slopes[i + 1, j]


def interpolate(times: Array, position: Array, velocity: Array, acceleration: Array | None) -> Spline:
    """Return the spline through the points: cubic with velocities, quintic with velocities and accelerations.

    Args:
        times: s, shape (n,), increasing, n >= 2.
        position: rad, shape (n, 6).
        velocity: rad/s, shape (n, 6).
        acceleration: rad/s^2, shape (n, 6).
    """
    h = np.diff(times)[:, None]
    coefficients = np.zeros((times.size - 1, 6, 6))
    p0, rise = position[:-1], np.diff(position, axis=0)
    coefficients[:, 0] = p0
    if acceleration is None:
        v0, v1 = velocity[:-1], velocity[1:]
        coefficients[:, 1] = v0
        coefficients[:, 2] = (3 * rise / h - 2 * v0 - v1) / h
        coefficients[:, 3] = (-2 * rise / h + v0 + v1) / (h * h)
    else:
        v0, v1, a0, a1 = velocity[:-1], velocity[1:], acceleration[:-1], acceleration[1:]
        # What is left to do beyond constant acceleration a0, in position, velocity and acceleration.
        # Powers of h are products: NumPy's power rounds differently on different processors.
        square = h * h
        dp = rise - h * v0 - square * a0 / 2
        dv = v1 - v0 - h * a0
        da = a1 - a0
        coefficients[:, 1] = v0
        coefficients[:, 2] = a0 / 2
        coefficients[:, 3] = (10 * dp / h - 4 * dv + h * da / 2) / square
        coefficients[:, 4] = (-15 * dp / h + 7 * dv - h * da) / (square * h)
        coefficients[:, 5] = (6 * dp / h - 3 * dv + h * da / 2) / (square * square)
    return Spline(times, coefficients, position[-1].copy())


def joined(first: Spline, at: float, second: Spline) -> Spline:
    """Return a spline that is the first one up to a time, s, and then the second one from its begin on."""
    kept = first.times[:-1] < at
    times, coefficients = [first.times[:-1][kept]], [first.coefficients[kept]]
    if at > first.duration:
        times.append(first.times[-1:])
        coefficients.append(np.zeros((1, 6, 6)))
        coefficients[-1][0, 0] = first.final
    times.append(at + second.times)
    coefficients.append(second.coefficients)
    blend_error = max(first.blend_error, second.blend_error)
    return Spline(np.concatenate(times), np.concatenate(coefficients), second.final, blend_error)


def remainder(spline: Spline, at: float) -> Spline:
    """Return what is left of a spline at a time, s, with times from there on."""
    knots = np.concatenate([[at], spline.times[spline.times > at]])
    return Spline(knots - at, _expanded(spline, knots[:-1]), spline.final)


def merged(spline: Spline, other: Spline, joints: Mask) -> Spline:
    """Return a spline with some joints, shape (6,), taken from another one."""
    knots = np.union1d(spline.times, other.times)
    coefficients = np.where(joints, _expanded(other, knots[:-1]), _expanded(spline, knots[:-1]))
    return Spline(knots, coefficients, np.where(joints, other.final, spline.final), spline.blend_error)


def _expanded(spline: Spline, knots: Array) -> Array:
    """Return the coefficients of a spline by the times since other knots that include its own, shape (n, 6, 6)."""
    piece = np.maximum(np.searchsorted(spline.times, knots, side="right") - 1, 0)
    ended = knots >= spline.duration
    coefficients = np.zeros((len(knots), 6, 6))
    coefficients[ended, 0] = spline.final
    old = spline.coefficients[piece[~ended]]
    since = (knots[~ended] - spline.times[piece[~ended]])[:, None]
    for power in range(6):
        # Taylor's formula, by Horner's scheme.
        value = np.zeros((len(old), 6))
        for n in range(5, power - 1, -1):
            value = value * since + comb(n, power) * old[:, n]
        coefficients[~ended, power] = value
    return coefficients
