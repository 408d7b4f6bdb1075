"""Stick-slip against speed and stiffness, and where it begins by the stability of steady sliding.

The joint is pulled by a spring whose other end moves at a steady speed; the host computes the spring from the counts,
so its stiffness is a number. With the bristles' rate r = v / g, s = v g' / g, the slope F' = dF / dv of steady friction
and an ideal spring, small deviations of a LuGre joint from steady sliding obey

    J x''' + (J r + c2 + c1 s) x'' + (r F' + K) x' + K r x = 0,

so that (Routh) sliding is stable where K (c2 + c1 s) + r F' (J r + c2 + c1 s) > 0. Where F' < 0 that takes a spring
stiffer than

    K* = -r F' (J r + C) / C,    C = c2 + c1 s > 0; no spring is stiff enough where C <= 0.

The spring of the host is sampled and late, which takes damping away: `sampled_growth` has that, too.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from scipy.linalg import expm

from friction_bench.presliding.trace import LATE, Trace
from rx90_common.base.arrays import Array
from rx90_common.friction.element import FrictionElement

STICKS, RUSHES = 0.2, 1.8
"""Of the mean speed: a joint that is slower than the one and faster than the other in turn sticks and slips."""
_SMOOTHED = 5
"""Ticks over which speeds are averaged."""


@dataclass(frozen=True, eq=False)
class PulledJoint:
    """What one pull showed: speed of the spring's end, rad/s, its stiffness, Nm/rad, least and largest speed, rad/s."""

    speed: float
    stiffness: float
    least: float
    largest: float
    trace: Trace

    @property
    def sticks_and_slips(self) -> bool:
        """Tell whether the joint did not slide steadily."""
        return self.least < STICKS * self.speed and self.largest > RUSHES * self.speed


def pulled_joint(trace: Trace, speed: float, stiffness: float) -> PulledJoint:
    """Return what the second half of a pull showed."""
    later = trace.part(trace.time.size // 2)
    smoothed = (later.angle[_SMOOTHED:] - later.angle[:-_SMOOTHED]) / (_SMOOTHED * trace.tick)
    return PulledJoint(speed, stiffness, float(smoothed.min()), float(smoothed.max()), trace)


@dataclass(frozen=True)
class SteadySliding:
    """A LuGre joint at steady forward sliding, for small deviations: r, 1/s, s, 1, F', Nm s/rad, and J, kg m^2."""

    rate: float
    share: float
    slope: float
    damping: float
    viscous: float
    inertia: float
    c0: float

    @classmethod
    def of(cls, element: FrictionElement, inertia: float, speed: float) -> SteadySliding:
        """Return the deviations' coefficients of an element at a speed, rad/s; alpha is 1."""
        sliding = float(element.sliding_torque(speed))
        ratio = (speed / element.omega_s) ** element.delta
        fall = (element.tau_s_positive - element.tau_c_positive) * math.exp(-ratio) * ratio * element.delta / speed
        return cls(
            rate=speed * element.c0 / sliding,
            share=-speed * fall / sliding,
            slope=element.c2 - fall,
            damping=float(element.damping(speed)),
            viscous=element.c2,
            inertia=inertia,
            c0=element.c0,
        )

    def least_stiffness(self) -> float:
        """Return K*, Nm/rad: 0 where any spring is stiff enough, infinite where none is."""
        if self.slope >= 0.0:
            return 0.0
        left = self.viscous + self.damping * self.share
        if left <= 0.0:
            return math.inf
        return -self.rate * self.slope * (self.inertia * self.rate + left) / left

    def matrix(self) -> Array:
        """Return A of d(x, v, z)/dt = A (x, v, z) + (0, 1/J, 0) torque, deviations from steady sliding."""
        bristle = np.array([0.0, self.share, -self.rate])
        force = self.damping * bristle + np.array([0.0, self.viscous, self.c0])
        return np.array([[0.0, 1.0, 0.0], -force / self.inertia, bristle])

    def sampled_growth(self, stiffness: float, tick: float) -> float:
        """Return by what deviations grow in a tick, s, pulled by the host's spring, Nm/rad; below 1 they die out."""
        a, b = self.matrix(), np.array([0.0, 1.0 / self.inertia, 0.0])
        whole, late = _step(a, b, tick), _step(a, b, (1.0 - LATE) * tick)
        # State: x, v, z, and the torque that was sent last.
        told = np.array([-stiffness, 0.0, 0.0, 0.0])
        step = np.zeros((4, 4))
        step[:3, :3] = whole[:3, :3]
        step[:3, 3] = whole[:3, 3] - late[:3, 3]
        step[:3] += np.outer(late[:3, 3], told)
        step[3] = told
        return float(np.abs(np.linalg.eigvals(step)).max())


def _step(a: Array, b: Array, time: float) -> Array:
    block = np.zeros((4, 4))
    block[:3, :3], block[:3, 3] = a, b
    return np.asarray(expm(block * time))


def least_steady_speed(
    element: FrictionElement, inertia: float, stiffness: float, tick: float, fastest: float
) -> float:
    """Return the speed, rad/s, from which a joint slides steadily behind the host's spring; NaN beyond `fastest`.

    Args:
        element: LuGre's.
        inertia: kg m^2.
        stiffness: Nm/rad.
        tick: s.
        fastest: rad/s.
    """
    low, high = 0.0, fastest
    if SteadySliding.of(element, inertia, high).sampled_growth(stiffness, tick) > 1.0:
        return math.nan
    for _ in range(20):
        middle = 0.5 * (low + high)
        steady = SteadySliding.of(element, inertia, middle).sampled_growth(stiffness, tick) <= 1.0
        low, high = (low, middle) if steady else (middle, high)
    return high
