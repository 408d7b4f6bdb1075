"""Equation 3 under a ramp torque in closed form: J w' = m t - f_v w - f_c sgn w.

Break-away at t_b = f_c / m; with s = t - t_b, the time constant T = J / f_v and a = m / f_v,
    w(t) = a (s - T (1 - exp(-s / T))),   asymptote a t - b with b = a (t_b + T) = f_c / f_v + J m / f_v^2.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from rx90_common.base.arrays import Array


@dataclass(frozen=True)
class RampModel:
    """Friction and inertia of equation 3, one side of the gear: f_c Nm, f_v Nm s/rad, J kg m²; m in Nm/s."""

    coulomb: float
    viscous: float
    inertia: float
    slope: float

    @property
    def break_away_time(self) -> float:
        """Return f_c / m, s."""
        return self.coulomb / self.slope

    @property
    def time_constant(self) -> float:
        """Return J / f_v, s."""
        return self.inertia / self.viscous

    def asymptote(self) -> tuple[float, float]:
        """Return a, rad/s², and b, rad/s, of the velocity's asymptote a t - b."""
        a = self.slope / self.viscous
        return a, a * (self.break_away_time + self.time_constant)

    def velocity(self, time: ArrayLike) -> Array:
        """Return w(t), rad/s."""
        s = np.maximum(np.asarray(time, dtype=np.float64) - self.break_away_time, 0.0)
        T = self.time_constant
        return np.asarray(self.slope / self.viscous * (s + T * np.expm1(-s / T)))

    def angle(self, time: ArrayLike) -> Array:
        """Return the angle since rest, rad."""
        s = np.maximum(np.asarray(time, dtype=np.float64) - self.break_away_time, 0.0)
        T = self.time_constant
        return np.asarray(self.slope / self.viscous * (s * s / 2 - T * s - T * T * np.expm1(-s / T)))
