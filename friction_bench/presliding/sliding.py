"""The sliding joint: friction at changing speed, break-away against the torque's rate, stick-slip; and the drift.

Elasto-plastic or LuGre: the drift under ten thousand small cycles of torque below break-away decides.
A LuGre joint under a torque that changes slowly between `low` and `high`, both below its static torque F_s, moves on in
each cycle, because its bristles yield more on the way up than on the way down. With a = high / F_s, b = low / F_s and
the deflection g = F_s / c0, dx = dz / (1 - z / g) up and dz / (1 + z / g) down give

    drift of a cycle   d = g ln((1 - b^2) / (1 - a^2))
    swing, downwards   s = g ln((1 + a) / (1 + b))

so that d / s does not depend on the stiffness: the prediction of LuGre's law needs only the break-away torque. An
elasto-plastic joint is purely elastic up to its break-away deflection, and blocks of Maxwell slip close their loops:
both have d = 0. The drift of many cycles adds up to counts even if that of one, and the swing, are far below a count.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from enum import Enum
from typing import NamedTuple

import numpy as np
from scipy import stats
from scipy.linalg import expm
from scipy.optimize import least_squares

from friction_bench.presliding.motions import DAC_DELAY, Trace
from rx90_common.base.arrays import Array, Mask
from rx90_common.base.errors import IdentificationError
from rx90_common.friction.element import FrictionElement

MIN_COUNTS_PER_TICK = 3.0
"""Counts per tick below which a reading does not count as sliding."""
STRETCH_TICKS = 7
MIN_READINGS = 40
RATES = (0.1, 0.4, 1.6, 6.0, 16.0)
"""Of the ramps, codes a tick."""
REPEATS = 3
STICK_SHARE, SLIP_SHARE = 0.2, 1.8
"""Of the mean speed: a joint that is slower than the one and faster than the other in turn sticks and slips."""
_SMOOTHING_TICKS = 5
"""Ticks over which speeds are averaged."""
_AVERAGING_RISE = 0.1
"""Rise of the torque, Nm, over which friction is averaged against the counts' noise, up to _MAX_AVERAGING readings."""
_MAX_AVERAGING = 5

LOW_SHARE, HIGH_SHARE = 0.05, 0.25
"""Of the break-away torque: the turning points of the cycles."""
HALF_CYCLE_TICKS = 3
"""Ticks for each half of a cycle."""
DRIFT_BLOCKS = 20
"""Of cycles, whose drifts are compared."""
_STATIC_TORQUE_UNCERTAINTY = 0.25
"""Relative uncertainty of the break-away torque as a measure of LuGre's static torque."""
_NO_DRIFT_SHARE = 0.2
"""Share of LuGre's drift below which there is no drift."""
_MIN_SWING = 1.5
"""Least swing that can be measured, counts."""


class SlidingReadings(NamedTuple):
    """Readings of a sliding joint: speed, rad/s, acceleration, rad/s^2, motor's torque at the joint, Nm; shape (n,)."""

    speed: Array
    acceleration: Array
    torque: Array

    def rows(self, chosen: Mask) -> SlidingReadings:
        """Return some of the readings."""
        return SlidingReadings(*(column[chosen] for column in self))


def sliding_readings(trace: Trace) -> SlidingReadings:
    """Return speed, acceleration and torque over stretches of STRETCH_TICKS in which the joint slides, without overlap.

    All three are means between the middles of the first and the last tick of a stretch, so that they belong together
    also where the torque changes within.
    """
    rows, held = [], trace.held
    weight = np.full(STRETCH_TICKS, 1.0 / (STRETCH_TICKS - 1))
    weight[[0, -1]] *= 0.5
    moved, speed = np.diff(trace.counts), np.diff(trace.counts * trace.angle_step) / trace.tick
    for first in range(0, moved.size - STRETCH_TICKS + 1, STRETCH_TICKS):
        last = first + STRETCH_TICKS
        if moved[first:last].min() >= MIN_COUNTS_PER_TICK:
            gained = (speed[last - 1] - speed[first]) / ((STRETCH_TICKS - 1) * trace.tick)
            rows.append((float(weight @ speed[first:last]), gained, float(weight @ held[first + 1 : last + 1])))
    return SlidingReadings(*np.array(rows, dtype=np.float64).reshape(-1, 3).T)


@dataclass(frozen=True)
class SlidingFriction:
    """Steady sliding, joint side: tau_c + (tau_s - tau_c) exp(-v / omega_s) + c2 v, and the inertia, kg m^2.

    `spread` is the standard deviation of a reading about it, Nm; `backward` the friction that way, where it is known.
    """

    tau_c: float
    tau_s: float
    omega_s: float
    c2: float
    inertia: float
    spread: float
    backward: SlidingFriction | None = None

    def torque(self, speed: Array) -> Array:
        """Return the friction at forward speeds, Nm."""
        return np.asarray(self.tau_c + (self.tau_s - self.tau_c) * np.exp(-speed / self.omega_s) + self.c2 * speed)

    def misfit(self, readings: SlidingReadings) -> Array:
        """Return by how much the predicted torque exceeds that of readings, Nm, shape (n,)."""
        return np.asarray(self.torque(readings.speed) + self.inertia * readings.acceleration - readings.torque)

    @property
    def turning_speed(self) -> float | None:
        """Return the speed, rad/s, at which steady friction has its minimum; None if it rises from rest."""
        fall = (self.tau_s - self.tau_c) / self.omega_s
        return float(self.omega_s * np.log(fall / self.c2)) if 0.0 < self.c2 < fall else None


def fit_sliding_friction(readings: SlidingReadings, stribeck: bool = True) -> SlidingFriction:
    """Fit friction and inertia to readings of a sliding joint; without `stribeck` Coulomb and viscous friction alone.

    Raises:
        IdentificationError: if they are too few.
    """
    if readings.speed.size < MIN_READINGS:
        few = f"{readings.speed.size} readings of a sliding joint"
        raise IdentificationError(f"{few}; accepted: at least {MIN_READINGS}")
    if not stribeck:
        return _fit_at(readings, None)
    fastest = float(readings.speed.max())
    tries = [_fit_at(readings, omega) for omega in np.geomspace(fastest / 40.0, fastest, 9)]
    best = min(tries, key=lambda one: one.spread)

    def misfit(logarithm: Array) -> Array:
        return _fit_at(readings, float(np.exp(logarithm[0]))).misfit(readings)

    found = least_squares(misfit, [np.log(best.omega_s)], loss="soft_l1", f_scale=2.0 * best.spread)
    return _fit_at(readings, float(np.clip(np.exp(found.x[0]), fastest / 60.0, 1.5 * fastest)))


def _fit_at(readings: SlidingReadings, omega_s: float | None) -> SlidingFriction:
    """Fit with a given Stribeck speed, rad/s, without the effect if it is None: the other parameters are linear."""
    columns = [np.ones_like(readings.speed), readings.speed, readings.acceleration]
    if omega_s is not None:
        columns.append(np.exp(-readings.speed / omega_s))
    design = np.column_stack(columns)
    weight = np.ones_like(readings.speed)
    for _ in range(8):  # Huber's weights: a reading in which the joint broke away is off by far
        values = np.linalg.lstsq(design * weight[:, None], readings.torque * weight, rcond=None)[0]
        rest = np.abs(readings.torque - design @ values)
        median = float(np.median(rest))
        weight = np.sqrt(np.minimum(1.0, (1.5 * 1.4826 * median + 1e-12) / np.maximum(rest, 1e-300)))
    coulomb, viscous, inertia, *rise = (float(value) for value in values)
    static = coulomb + max(rise[0], 0.0) if rise else coulomb
    return SlidingFriction(coulomb, static, omega_s or 1.0, max(viscous, 0.0), inertia, 1.4826 * median)


def break_away_torque(rate: float, ramp: Trace, inertia: float) -> tuple[float, float]:
    """Return the torque's rate at the joint, Nm/s, and the largest friction before it slides, Nm, of a ramp.

    Friction is the motor's torque less that of the joint's acceleration, so that inertia is not taken for friction; the
    remaining influence of the rate belongs to the law. LuGre's break-away torque falls with the rate (Canudas de Wit
    and others 1995): the joint is fast before its bristles are deflected. Damping of the bristles, c1 rate / c0, raises
    it.

    Args:
        rate: of the ramp, codes a tick.
        ramp: its readings.
        inertia: at the joint, kg m^2.
    """
    rate = rate * ramp.torque_step / ramp.tick
    rising = int(np.argmax(ramp.code))  # later readings belong to the slide's end
    angle, held = ramp.angle_step * ramp.counts[: rising + 1], ramp.held[: rising + 1]
    acceleration = (angle[2:] - 2.0 * angle[1:-1] + angle[:-2]) / ramp.tick**2
    friction = 0.5 * (held[2:] + held[1:-1]) - inertia * acceleration
    count = int(np.clip(round(_AVERAGING_RISE / (rate * ramp.tick)), 1, _MAX_AVERAGING))
    return rate, float(np.convolve(friction, np.full(count, 1.0 / count), "valid").max())


def by_rate(torques: Sequence[tuple[float, float]]) -> list[tuple[float, float, float]]:
    """Return each rate, Nm/s, the mean of its break-away torques, and their standard error, Nm."""
    rates, torque = np.array(torques).T
    groups = [(float(rate), torque[rates == rate]) for rate in np.unique(rates)]
    return [
        (rate, float(group.mean()), float(group.std(ddof=1) / np.sqrt(group.size)) if group.size > 1 else 0.0)
        for rate, group in groups
    ]


def break_away_code(ramp: Trace, slid: float) -> float:
    """Return the code on the DAC when the joint has moved by half of the distance that counts as a slide.

    Raises:
        IdentificationError: if it did not move that far.
    """
    if ramp.counts.max() < slid:
        highest = f"{ramp.torque_step * ramp.code.max():.3g} Nm"
        raise IdentificationError(
            f"{ramp.label}: no break-away up to {highest}; the joint sticks up to the motor's limit"
        )
    return float(ramp.code[int(np.argmax(ramp.counts >= 0.5 * slid))])


class Pull(NamedTuple):
    """What one pull showed, for the speed of the spring's end, rad/s, and its stiffness, Nm/rad."""

    speed: float
    stiffness: float
    sticks_and_slips: bool


def evaluate_pull(trace: Trace, speed: float, stiffness: float) -> Pull:
    """Tell from the second half of a pull whether the joint did not slide steadily."""
    angle = trace.counts[trace.time.size // 2 :] * trace.angle_step
    smoothed = (angle[_SMOOTHING_TICKS:] - angle[:-_SMOOTHING_TICKS]) / (_SMOOTHING_TICKS * trace.tick)
    return Pull(speed, stiffness, bool(smoothed.min() < STICK_SHARE * speed and smoothed.max() > SLIP_SHARE * speed))


def sampled_growth(element: FrictionElement, inertia: float, speed: float, stiffness: float, tick: float) -> float:
    """Return the factor by which small deviations of a LuGre joint from steady sliding grow in a tick; stable below 1.

    The joint is pulled by a spring whose other end moves at a steady speed. With the bristles' rate r = v / g,
    s = v g' / g, the slope F' = dF / dv of steady friction and an ideal spring, deviations obey

        J x''' + (J r + c2 + c1 s) x'' + (r F' + K) x' + K r x = 0,

    so that (Routh) where F' < 0 sliding is stable only with a spring stiffer than -r F' (J r + C) / C, C = c2 + c1 s >
    0;
    no spring is stiff enough where C <= 0. The host's spring is sampled and delayed, which reduces the damping.

    Args:
        element: LuGre's, alpha 1.
        inertia: kg m^2.
        speed: rad/s.
        stiffness: of the spring, which the host computes from the counts, Nm/rad.
        tick: s.
    """
    sliding = float(element.sliding_torque(speed))
    ratio = (speed / element.omega_s) ** element.delta
    fall = (element.tau_s_positive - element.tau_c_positive) * math.exp(-ratio) * ratio * element.delta / speed
    # d(x, v, z)/dt = A (x, v, z) + (0, 1/J, 0) torque, in deviations from steady sliding.
    bristle = np.array([0.0, -speed * fall / sliding, -speed * element.c0 / sliding])
    force = float(element.damping(speed)) * bristle + np.array([0.0, element.c2, element.c0])
    motion = np.zeros((4, 4))
    motion[:3, :3] = [[0.0, 1.0, 0.0], -force / inertia, bristle]
    motion[:3, 3] = 0.0, 1.0 / inertia, 0.0
    whole, late = np.asarray(expm(motion * tick)), np.asarray(expm(motion * ((1.0 - DAC_DELAY) * tick)))
    spring = np.array([-stiffness, 0.0, 0.0, 0.0])
    step = np.zeros((4, 4))  # of x, v, z, and the torque that was sent last
    step[:3, :3] = whole[:3, :3]
    step[:3, 3] = whole[:3, 3] - late[:3, 3]
    step[:3] += np.outer(late[:3, 3], spring)
    step[3] = spring
    return float(np.abs(np.linalg.eigvals(step)).max())


def least_steady_speed(
    element: FrictionElement, inertia: float, stiffness: float, tick: float, fastest: float
) -> float:
    """Return the speed, rad/s, from which a joint slides steadily behind the host's spring; NaN beyond `fastest`."""
    low, high = 0.0, fastest
    if sampled_growth(element, inertia, high, stiffness, tick) > 1.0:
        return math.nan
    for _ in range(20):
        middle = 0.5 * (low + high)
        steady = sampled_growth(element, inertia, middle, stiffness, tick) <= 1.0
        low, high = (low, middle) if steady else (middle, high)
    return high


class DriftVerdict(str, Enum):
    """Verdict on the drift."""

    DRIFTS = "LuGre"
    NO_DRIFT = "no drift: elasto-plastic or Maxwell slip, not LuGre"
    UNKNOWN = "cannot tell"


@dataclass(frozen=True, eq=False)
class DriftResult:
    """The results of the cycles, in counts.

    Attributes:
        position: at the end of each cycle, counts, shape (n,).
        swing: of a cycle, counts.
        drift: of a cycle, counts, and the bounds of its 99 % interval.
        expected: drift over swing by LuGre's law, lower and upper bound from the uncertainty of the break-away torque.
        low, high: turning points over the break-away torque.
        verdict, reason: the conclusion, and its reason.
    """

    position: Array
    swing: float
    drift: tuple[float, float, float]
    expected: tuple[float, float]
    low: float
    high: float
    verdict: DriftVerdict
    reason: str

    @property
    def by_lugre(self) -> tuple[float, float] | None:
        """Return the drift of a cycle by LuGre's law, counts, lower and upper bound; None if no swing is measured."""
        return (self.expected[0] * self.swing, self.expected[1] * self.swing) if self.swing > 0.0 else None


def _verdict(swing: float, least: float, largest: float, lowest: float, highest: float) -> tuple[DriftVerdict, str]:
    """Return the verdict and its reason, from the drift's bounds and those of LuGre's drift over swing.

    The swing is the mean of differences of whole counts: a joint that drifts passes all phases of a count, and the
    mean is right; one that stays may be off by a count.
    """
    if largest < _NO_DRIFT_SHARE * lowest * (swing - 1.0) and swing >= _MIN_SWING:
        return (
            DriftVerdict.NO_DRIFT,
            f"the drift is less than {100 * _NO_DRIFT_SHARE:g} % of what LuGre's law would give",
        )
    if least > 0.0 and swing > 0.0 and 0.5 * lowest < least / swing and largest / swing < 2.0 * highest:
        return DriftVerdict.DRIFTS, "the joint drifts as LuGre's law says"
    if swing < _MIN_SWING and least <= 0.0:
        reason = "neither a swing nor a drift is seen: the joint is too stiff for the encoder"
    elif largest / max(swing, 1e-9) > 2.0 * highest:
        reason = "the joint drifts more than LuGre's law says: the torque is too near to break-away"
    else:
        reason = "the joint drifts, but less than LuGre's law says"
    return DriftVerdict.UNKNOWN, reason


def turning_codes(break_away: float) -> tuple[int, int]:
    """Return the codes between which small cycles go, for a break-away code."""
    return max(round(LOW_SHARE * break_away), 1), round(HIGH_SHARE * break_away)


def lugre_ratio(low: float, high: float) -> float:
    """Return drift over swing of a LuGre joint for turning points over the static torque; 1 where it breaks away."""
    if high >= 1.0:
        return 1.0
    return math.log((1.0 - low**2) / (1.0 - high**2)) / math.log((1.0 + high) / (1.0 + low))


def evaluate_drift(trace: Trace, low: int, high: int, break_away: float) -> DriftResult:
    """Determine from the readings of the cycles whether the joint drifts as LuGre's law predicts.

    Args:
        trace: the whole experiment.
        low: code of the lower turning point.
        high: of the upper one.
        break_away: code at which the joint breaks away.

    Raises:
        IdentificationError: if there are too few cycles.
    """
    code = trace.code
    last = np.flatnonzero(np.diff(code) != 0.0)  # the last reading of each code
    at_low = last[(code[last] == low) & (code[last + 1] == high)]
    at_high = last[code[last] == high]
    at_high = at_high[at_high > at_low.min(initial=code.size)]
    count = min(at_low.size, at_high.size)
    if count < 2 * DRIFT_BLOCKS:
        raise IdentificationError(f"{trace.label}: {count} cycles; accepted: at least {2 * DRIFT_BLOCKS}")
    lower, upper = trace.counts[at_low[:count]], trace.counts[at_high[:count]]
    per = count // DRIFT_BLOCKS
    ends = lower[::per][: DRIFT_BLOCKS + 1]
    if ends.size == DRIFT_BLOCKS:
        ends = np.append(ends, lower[-1])
    drifts = np.diff(ends) / per
    # A count of the whole is not known.
    reach = float(stats.t.ppf(0.995, DRIFT_BLOCKS - 1) * stats.sem(drifts)) + 1.0 / count
    drift = float(ends[-1] - ends[0]) / (per * DRIFT_BLOCKS)
    a, b = high / break_away, low / break_away
    factors = 1 - _STATIC_TORQUE_UNCERTAINTY, 1 + _STATIC_TORQUE_UNCERTAINTY
    least, largest = (lugre_ratio(b * factor, a * factor) for factor in factors)
    swing = float(np.mean(upper[:-1] - lower[1:]))
    verdict = _verdict(swing, drift - reach, drift + reach, least, largest)
    return DriftResult(lower, swing, (drift, drift - reach, drift + reach), (least, largest), b, a, *verdict)
