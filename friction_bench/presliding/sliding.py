"""Friction of a sliding joint from readings at changing speed: Stribeck's curve and the inertia, by least squares."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares

from friction_bench.presliding.trace import Trace
from rx90_common.base.arrays import Array
from rx90_common.base.errors import IdentificationError

SLOWEST = 3.0
"""Counts per tick below which a reading does not count as sliding."""
TICKS = 7
FEWEST = 40


@dataclass(frozen=True, eq=False)
class SlidingReadings:
    """Readings of a sliding joint: speed, rad/s, acceleration, rad/s^2, motor's torque at the joint, Nm; shape (n,)."""

    speed: Array
    acceleration: Array
    torque: Array

    def __add__(self, other: SlidingReadings) -> SlidingReadings:
        return SlidingReadings(
            np.concatenate((self.speed, other.speed)),
            np.concatenate((self.acceleration, other.acceleration)),
            np.concatenate((self.torque, other.torque)),
        )

    def chosen(self, rows: NDArray[np.int64]) -> SlidingReadings:
        """Return some of the readings."""
        return SlidingReadings(self.speed[rows], self.acceleration[rows], self.torque[rows])


def sliding_readings(trace: Trace) -> SlidingReadings:
    """Return speed, acceleration and torque over stretches of TICKS in which the joint slides, without overlap.

    All three are means between the middles of the first and the last tick of a stretch, so that they belong together
    also where the torque changes within.
    """
    rows, held = [], trace.held
    weight = np.full(TICKS, 1.0 / (TICKS - 1))
    weight[[0, -1]] *= 0.5
    moved = np.diff(trace.angle) / trace.tick
    for first in range(0, moved.size - TICKS + 1, TICKS):
        window = slice(first, first + TICKS)
        if np.diff(trace.counts)[window].min() >= SLOWEST:
            speeds = moved[window]
            gained = (speeds[-1] - speeds[0]) / ((TICKS - 1) * trace.tick)
            rows.append((float(weight @ speeds), gained, float(weight @ held[first + 1 : first + 1 + TICKS])))
    table = np.array(rows, dtype=np.float64).reshape(-1, 3)
    return SlidingReadings(table[:, 0], table[:, 1], table[:, 2])


@dataclass(frozen=True)
class SlidingFriction:
    """Steady sliding, joint side: tau_c + (tau_s - tau_c) exp(-v / omega_s) + c2 v, and the inertia, kg m^2.

    Attributes:
        spread: standard deviation of a reading about it, Nm.
        readings: so many.
    """

    tau_c: float
    tau_s: float
    omega_s: float
    c2: float
    inertia: float
    spread: float
    readings: int

    def torque(self, speed: Array) -> Array:
        """Return the friction at forward speeds, Nm."""
        return np.asarray(self.tau_c + (self.tau_s - self.tau_c) * np.exp(-speed / self.omega_s) + self.c2 * speed)


def fit_sliding_friction(readings: SlidingReadings, stribeck: bool = True) -> SlidingFriction:
    """Fit friction and inertia to readings of a sliding joint; without `stribeck` Coulomb and viscous friction alone.

    Raises:
        IdentificationError: if they are too few.
    """
    if readings.speed.size < FEWEST:
        raise IdentificationError(f"{readings.speed.size} readings of a sliding joint; accepted: at least {FEWEST}")
    start = fit_at(readings, None)
    if not stribeck:
        return start
    fastest = float(readings.speed.max())
    tries = [fit_at(readings, omega) for omega in np.geomspace(fastest / 40.0, fastest, 9)]
    best = min(tries, key=lambda one: one.spread)

    def misfit(logarithm: Array) -> Array:
        one = fit_at(readings, float(np.exp(logarithm[0])))
        return np.asarray(one.torque(readings.speed) + one.inertia * readings.acceleration - readings.torque)

    found = least_squares(misfit, [np.log(best.omega_s)], loss="soft_l1", f_scale=2.0 * best.spread)
    omega = float(np.clip(np.exp(found.x[0]), fastest / 60.0, 1.5 * fastest))
    return fit_at(readings, omega)


def fit_at(readings: SlidingReadings, omega_s: float | None) -> SlidingFriction:
    """Fit with a given Stribeck speed, rad/s, without the effect if it is None: what is left is linear."""
    columns = [np.ones_like(readings.speed), readings.speed, readings.acceleration]
    if omega_s is not None:
        columns.append(np.exp(-readings.speed / omega_s))
    design = np.column_stack(columns)
    weight = np.ones_like(readings.speed)
    values = np.zeros(design.shape[1])
    for _ in range(8):  # Huber's weights: a reading in which the joint broke away is off by far
        values = np.linalg.lstsq(design * weight[:, None], readings.torque * weight, rcond=None)[0]
        rest = np.abs(readings.torque - design @ values)
        scale = 1.5 * 1.4826 * float(np.median(rest)) + 1e-12
        weight = np.sqrt(np.minimum(1.0, scale / np.maximum(rest, 1e-300)))
    rest = readings.torque - design @ values
    spread = 1.4826 * float(np.median(np.abs(rest)))
    static = max(float(values[3]), 0.0) if omega_s is not None else 0.0
    coulomb, viscous, inertia = (float(value) for value in values[:3])
    return SlidingFriction(
        coulomb, coulomb + static, omega_s or 1.0, max(viscous, 0.0), inertia, spread, readings.speed.size
    )
