"""Equation 3 under a ramp torque in closed form: J w' = m t - f_v w - f_c sgn w.

Break-away at t_b = (f_c + f_r) / m, where f_r is by how much static friction exceeds f_c; with s = t - t_b, the time
constant T = J / f_v and a = m / f_v,
    w(t) = a s + (f_r / f_v - a T) (1 - exp(-s / T)),
with the asymptote a t - b, b = a (f_c / m + T) = f_c / f_v + J m / f_v^2, which does not depend on f_r.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from rx90_common.base.arrays import Array


@dataclass(frozen=True)
class RampModel:
    """Friction and inertia of equation 3, one side of the gear: f_c, f_r Nm, f_v Nm s/rad, J kg m²; m in Nm/s."""

    coulomb: float
    viscous: float
    inertia: float
    slope: float
    release: float = 0.0

    @property
    def break_away_time(self) -> float:
        """Return (f_c + f_r) / m, s."""
        return (self.coulomb + self.release) / self.slope

    @property
    def time_constant(self) -> float:
        """Return J / f_v, s."""
        return self.inertia / self.viscous

    def asymptote(self) -> tuple[float, float]:
        """Return a, rad/s², and b, rad/s, of the velocity's asymptote a t - b."""
        a = self.slope / self.viscous
        return a, a * (self.coulomb / self.slope + self.time_constant)

    def velocity(self, time: ArrayLike) -> Array:
        """Return w(t), rad/s."""
        s = np.maximum(np.asarray(time, dtype=np.float64) - self.break_away_time, 0.0)
        T, a = self.time_constant, self.slope / self.viscous
        return np.asarray(a * s - (self.release / self.viscous - a * T) * np.expm1(-s / T))

    def angle(self, time: ArrayLike) -> Array:
        """Return the angle since rest, rad."""
        s = np.maximum(np.asarray(time, dtype=np.float64) - self.break_away_time, 0.0)
        T, a = self.time_constant, self.slope / self.viscous
        return np.asarray(a * s * s / 2 + (self.release / self.viscous - a * T) * (s + T * np.expm1(-s / T)))
