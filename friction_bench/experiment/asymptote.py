"""Fit the velocity's asymptote a t - b to encoder angles, with the covariance of quantisation and torque noise.

After break-away the angle follows c - b t + a t^2 / 2. Its deviations have two sources: the encoder's
quantisation, white, and torque noise. White torque noise makes the velocity of an inertia J with viscous friction f_v
an Ornstein-Uhlenbeck process with the time constant T = J / f_v, and the angle its integral. Ordinary least squares
ignores that the latter is correlated, and its intervals are far too narrow. This is generalised least squares with
    V = r I + q K,  r = step^2 / 12,
where K is the covariance of the integrated Ornstein-Uhlenbeck process from rest, by the Kalman filter of
`sliding_fit.whiten`. Its intensity q is estimated by restricted maximum likelihood.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from scipy.optimize import minimize_scalar

from friction_bench.experiment.record import RampModel, RampRecord, first_motion, fit_break_away
from friction_bench.experiment.sliding_fit import respond, whiten
from rx90_common.base.arrays import Array, Mask
from rx90_common.base.errors import IdentificationError

SETTLED = 6.0
"""The window starts after so many time constants: 0.25 % of the transient is left."""
ONSET_TICKS = 10
"""Break-away is fitted to so many readings after the first certain motion."""
ONSET_SHARE = 0.1
"""Break-away is searched over this share of the motion's time before it."""
MIN_POINTS = 30
MIN_WINDOW = 4.0
"""Shortest window, in time constants."""
MAX_POINTS = 100
ROUGH_POINTS = 30
"""Least squares are solved with at most so many readings, as their cost is cubic; fewer for preliminary fits."""
CURVATURE_LIMIT = 0.05


@dataclass(frozen=True)
class RampFit:
    """The asymptote of one ramp; time counts from the zero of the commanded torque.

    Attributes:
        a, b: asymptote of the velocity, rad/s² and rad/s.
        covariance: of (a, b), shape (2, 2).
        break_away: time of break-away, s.
        window: first and last time used, s.
    """

    a: float
    b: float
    covariance: Array
    break_away: float
    window: tuple[float, float]


class ShortRampError(IdentificationError):
    """A ramp does not show enough of its asymptote."""


def fit_asymptote(record: RampRecord, time_constant: float | None = None) -> RampFit:
    """Fit the asymptote of one ramp.

    Args:
        record: the ramp.
        time_constant: J / f_v, s, as identified from two slopes; by default this ramp's own b / a - t_b.

    Raises:
        ShortRampError: too few readings after the transient.
    """
    time, angle, first = first_motion(record)
    T, a, b = _rough(record, time, angle, float(time[first]) - record.tick)

    def released(moment: float) -> RampModel:
        """Return the ramp of a break-away for an f_v of 1; without a known time constant the asymptote has it."""
        return RampModel(moment * a, 1.0, time_constant or b / a - moment, a)

    onset = slice(max(first - 2, 0), first + ONSET_TICKS)
    latest = float(time[first]) if time_constant else min(float(time[first]), b / a - 1e-3 * record.tick)
    back = max(ONSET_TICKS * record.tick, ONSET_SHARE * float(time[-1] - time[first])) + (time_constant or 0.0)
    break_away = fit_break_away(time[onset], angle[onset], (latest - back, latest), released)
    T = time_constant or max(T, b / a - break_away)
    if record.torque is not None:
        # The command is a staircase about the ramp. Its steps are known, so their effect on an inertia with time
        # constant T is subtracted instead of being counted as noise.
        final = (record.torque - record.slope * (time + record.tick / 2)) * a / record.slope
        angle = angle - respond(time, np.where(time >= break_away, final, 0.0), 0.0, T)[0]
    use = _settled(record, time, break_away, T)
    time = time[use]
    angle = angle[use]
    a, b, covariance = _solve(time, angle, record.angle_step, break_away, T)
    half = time.size // 2
    if half >= MIN_POINTS // 2:
        early, late = (
            _solve(time[part], angle[part], record.angle_step, break_away, T, ROUGH_POINTS)
            for part in (slice(half), slice(half, None))
        )
        difference = abs(late[0] - early[0])
        error = math.sqrt(early[2][0, 0] + late[2][0, 0])
        if difference > 5 * error and difference > CURVATURE_LIMIT * a:
            raise IdentificationError(
                f"{record.label}: the velocity follows no straight asymptote, its slope goes from "
                f"{early[0]:.4g} to {late[0]:.4g} rad/s²; saturation, or a transient that is not over"
            )
    return RampFit(a, b, covariance, break_away, (float(time[0]), float(time[-1])))


def _rough(record: RampRecord, time: Array, angle: Array, break_away: float) -> tuple[float, float, float]:
    """Return T, a and b roughly: ordinary least squares where the transient, by T, is over."""
    T = (float(time[-1]) - break_away) / (4 * SETTLED)
    for _ in range(20):
        use = _settled(record, time, break_away, T)
        a, b = np.polyfit(time[use], angle[use], 2)[:2] * (2.0, -1.0)
        if a <= 0.0:
            raise IdentificationError(
                f"{record.label}: the shaft does not accelerate after break-away (a = {a:.3g} rad/s²); "
                "saturation, or the joint runs against a stop"
            )
        fresh = max(b / a - break_away, record.tick)
        if abs(fresh - T) < 0.02 * T:
            break
        T = (T + fresh) / 2
    return T, float(a), float(b)


def _settled(record: RampRecord, time: Array, break_away: float, T: float) -> Mask:
    """Return at which times the transient is over; refuse a ramp that shows too little then."""
    start = break_away + SETTLED * T
    use = time >= start
    points = int(use.sum())
    length = float(time[-1]) - start
    if points < MIN_POINTS or length < MIN_WINDOW * T:
        raise ShortRampError(
            f"{record.label}: the ramp is too short, {points} readings in {length:.2g} s after a transient with a time "
            f"constant of {T:.2g} s; accepted: at least {MIN_POINTS}, and {MIN_WINDOW:g} time constants; take a slower "
            "ramp or a higher end torque"
        )
    return np.asarray(use)


def _solve(
    time: Array, angle: Array, step: float, break_away: float, T: float, most: int = MAX_POINTS
) -> tuple[float, float, Array]:
    """Return a, b and their covariance by generalised least squares; q by restricted maximum likelihood."""
    every = -(-time.size // most)  # decimation costs next to nothing: neighbouring angles are strongly correlated
    time = time[::every]
    angle = angle[::every]
    # A reading of zeros at break-away, where the noise begins, adds nothing.
    times = np.append(break_away, time)
    columns = np.pad([np.ones_like(time), -time, time * time / 2, angle], ((0, 0), (1, 0)))
    variance = step**2 / 12

    def fit(log_q: float) -> tuple[Array, Array, float]:
        """Return the coefficients of c - b t + a t^2 / 2, their covariance's root, and minus twice the likelihood."""
        white, determinant = whiten(times, columns, T, math.exp(log_q), variance)
        basis, triangle = np.linalg.qr(white[:3].T)
        root = np.linalg.inv(triangle)
        found = root @ (basis.T @ white[3])
        determinant += 2.0 * float(np.log(np.abs(np.diag(triangle))).sum())
        return found, root, determinant + float(np.sum((white[3] - found @ white[:3]) ** 2))

    span = math.log(variance / max(float(time[-1] - time[0]), 1e-9))
    best = minimize_scalar(lambda v: fit(v)[2], bounds=(span - 14, span + 20), method="bounded")
    (_, b, a), root, _ = fit(float(best.x))
    return float(a), float(b), np.asarray((root @ root.T)[:0:-1, :0:-1])
