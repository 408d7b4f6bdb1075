"""The fit of friction elements to the laws of other simulators.

The law of a simulator has some of the parameters of a friction element. These are copied; if the result is not the
element's curve, the parameters are fitted by least squares over the speeds in use.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from rx90_common.base.arrays import Array, rms
from rx90_common.base.errors import ConfigError
from rx90_common.friction.element import FrictionElement, stribeck_decay
from rx90_common.friction.parts.part import LINEAR_SPEED
from rx90_common.friction.signs import SIGNS
from rx90_emulator.export.targets import Target

POINTS = 400
"""Number of speeds at which curves are compared, logarithmically spaced."""
DELTA = 2.0
"""The Stribeck exponent of simulators."""

_EXACT = 1e-12  # of the largest torque: rounding
_SPEEDS = 1e-6, 1e4  # rad/s, range of all joints and motors
_STARTS = (0.3, 1.0, 3.0)  # start values, times the Stribeck velocity


@dataclass(frozen=True, eq=False)
class SimulatorLaw:
    """The friction of a target, joint side, SI units, the same for both signs of the velocity.

    Attributes:
        tau_c: Coulomb torque, Nm.
        tau_s: break-away torque, Nm.
        omega_s: Stribeck velocity, rad/s; 0 if the torque falls to tau_c as soon as there is motion.
        delta: Stribeck exponent.
        viscous: a, b and c of a v + b v |v| + c v^3, Nm s/rad, Nm s²/rad², Nm s³/rad³.
        c0: bristle stiffness, Nm/rad; infinite without bristles.
        c1: bristle damping, Nm s/rad.
    """

    tau_c: float
    tau_s: float
    omega_s: float = 0.0
    delta: float = DELTA
    viscous: tuple[float, float, float] = (0.0, 0.0, 0.0)
    c0: float = math.inf
    c1: float = 0.0

    def torque(self, speed: Array) -> Array:
        """Return the torque of steady motion at speeds above 0, rad/s, in Nm."""
        a, b, c = self.viscous
        decay = stribeck_decay(speed, self.omega_s, self.delta) if self.omega_s > 0.0 else 0.0
        return (
            self.tau_c + (self.tau_s - self.tau_c) * decay + speed * (a + speed * (b + speed * c))
        )


@dataclass(frozen=True, eq=False)
class FrictionFit:
    """The approximation of an element, or of all elements that a joint works against, by a target.

    Attributes:
        name: of the element or the joint.
        law: the target's law.
        speeds: of the comparison, rad/s, shape (n,), all above 0.
        largest: largest difference of the torque at these speeds of either sign, Nm.
        rms: root mean square of that difference, Nm.
        break_away: of the element and of the target, each for positive and for negative velocity, Nm.
        stiffness: presliding stiffness of the element and of the target, Nm/rad; infinite for a target without one.
        lost: properties that the target does not represent, a sentence each.
        worst: largest difference at these speeds, also while other joints move at theirs, Nm.
        coupled: how much the torques of shared elements change at most when other joints move, Nm.
    """

    name: str
    law: SimulatorLaw
    speeds: Array
    largest: float
    rms: float
    break_away: tuple[tuple[float, ...], tuple[float, ...]]
    stiffness: tuple[float, float]
    lost: tuple[str, ...]
    worst: float
    coupled: float = 0.0


def speeds_up_to(high: float, low: float = LINEAR_SPEED) -> Array:
    """Return the speeds of a range, rad/s, shape (POINTS,), evenly spaced in their logarithm."""
    least, most = _SPEEDS
    if not least <= low < high <= most:
        accepted = f"two numbers from {least:g} to {most:g}, the second the larger"
        raise ConfigError(f"speeds from {low:g} to {high:g} rad/s; accepted: {accepted}")
    return np.geomspace(low, high, POINTS)


def sum_of(elements: Sequence[FrictionElement], speeds: Array, sign: float) -> Array:
    """Return the absolute torque of elements together at speeds of one sign, rad/s, in Nm, shape (n,)."""
    return np.asarray(sum(sign * one.steady_torque(sign * speeds) for one in elements))


def fit_friction(
    target: Target, name: str, elements: Sequence[FrictionElement], speeds: Array
) -> FrictionFit:
    """Return a target's law for the sum of elements, and its differences from them.

    Args:
        target: one of TARGETS.
        name: of the element or the joint.
        elements: one, or those that a joint works against.
        speeds: in use, rad/s, shape (n,), all above 0; all have equal weights in the fit.
    """
    forward = sum_of(elements, speeds, 1.0)
    backward = sum_of(elements, speeds, -1.0)
    law = _law(target, elements, speeds, 0.5 * (forward + backward))
    at_rest = [one.tau_s if one.curve is None else one.curve.at_rest for one in elements]
    static = sum(one.positive for one in at_rest), sum(one.negative for one in at_rest)
    difference = np.concatenate([forward, backward]) - np.tile(law.torque(speeds), 2)
    largest = float(np.abs(difference).max())
    return FrictionFit(
        name,
        law,
        speeds,
        largest,
        rms(difference),
        (static, (law.tau_s, law.tau_s)),
        (sum(one.c0 for one in elements), law.c0),
        tuple(each for one in elements for each in _lost(target, one, float(speeds.max()))),
        largest,
    )


def _law(
    target: Target, elements: Sequence[FrictionElement], speeds: Array, torque: Array
) -> SimulatorLaw:
    """Return the target's law nearest to the torque, the mean of both signs, at the speeds; both (n,)."""

    def mean(parameter: str) -> float:
        return 0.5 * sum(
            one.parameters[f"{parameter}_{sign}"] for one in elements for sign in SIGNS
        )

    first = elements[0]
    curved = target.lugre and any(element.alpha != 1.0 for element in elements)
    copied = SimulatorLaw(
        tau_c=mean("tau_c"),
        tau_s=mean("tau_s") if target.breaks_away else mean("tau_c"),
        omega_s=first.omega_s if target.lugre else 0.0,
        viscous=(
            float(sum(one.c2 * speeds.max() ** (one.alpha - 1.0) for one in elements)),
            0.0,
            0.0,
        ),
        c0=sum(one.c0 for one in elements) if target.lugre else math.inf,
        c1=sum(one.c1 for one in elements) if target.lugre else 0.0,
    )
    off = float(np.abs(copied.torque(speeds) - torque).max())
    if off <= _EXACT * float(np.abs(torque).max()):
        return copied
    return _fitted(copied, target, curved, speeds, torque)


def _fitted(
    law: SimulatorLaw, target: Target, curved: bool, speeds: Array, torque: Array
) -> SimulatorLaw:
    """Return the law of least squares, started from another one.

    The viscous torque is v ((p + q v)^2 + r v), so that it never generates energy at any speed.
    """
    from scipy.optimize import least_squares

    def law_of(x: Array) -> SimulatorLaw:
        tau_c, rise, p, q, r, logarithm = x.tolist()
        changed = replace(law, tau_c=tau_c, viscous=(p * p, 2.0 * p * q + r, q * q))
        if not target.lugre:
            return replace(changed, tau_s=max(law.tau_s, tau_c) if target.breaks_away else tau_c)
        return replace(changed, tau_s=tau_c + rise, omega_s=math.exp(logarithm))

    free = np.array([True, target.lugre, True, curved, curved, target.lugre])
    least = np.array([0.0, 0.0, 0.0, -np.inf, 0.0, math.log(1e-6)])
    most = np.array([np.inf, np.inf, np.inf, np.inf, np.inf, math.log(1e4)])
    scale = float(np.abs(torque).max())
    least_cost = math.inf
    best = law
    for factor in _STARTS if target.lugre else (1.0,):
        logarithm = math.log(factor * law.omega_s) if target.lugre else 0.0
        start = np.array(
            [law.tau_c, law.tau_s - law.tau_c, math.sqrt(law.viscous[0]), 0.0, 0.0, logarithm]
        )
        if curved:
            start[3:5] = -0.1 * start[2] / speeds[-1], 1e-3 * start[2]
        start = np.where(free, np.clip(start, least + 1e-9, most), start)

        def residuals(x: Array, start: Array = start) -> Array:
            whole = start.copy()
            whole[free] = x
            return (law_of(whole).torque(speeds) - torque) / scale

        result = least_squares(
            residuals, start[free], bounds=(least[free], most[free]), x_scale=np.maximum(np.abs(start[free]), 1e-3),
            xtol=1e-12, ftol=1e-12, gtol=1e-12,
        )  # fmt: skip
        if result.cost < least_cost:
            whole = start.copy()
            whole[free] = result.x
            least_cost = float(result.cost)
            best = law_of(whole)
    return best


def _lost(target: Target, element: FrictionElement, fastest: float) -> list[str]:
    """Return properties of an element that a target does not represent, with sizes up to a speed, rad/s."""
    lost = []
    coulomb = abs(element.tau_c.positive - element.tau_c.negative)
    static = abs(element.tau_s.positive - element.tau_s.negative)
    if coulomb or static:
        lost.append(
            f"signs: tau_c and tau_s differ by {coulomb:.3g} and {static:.3g} Nm, their means are kept"
        )
    rise = max(
        element.tau_s.positive - element.tau_c.positive,
        element.tau_s.negative - element.tau_c.negative,
    )
    if rise and not target.lugre:
        kept = "kept as break-away torque alone" if target.breaks_away else "left out"
        lost.append(f"Stribeck curve: {rise:.3g} Nm above tau_c near rest, {kept}")
    elif rise and element.delta != DELTA:
        lost.append(f"Stribeck exponent {element.delta:g}: {DELTA:g}, fitted")
    if element.alpha != 1.0:
        kind = "a polynomial of the third degree" if target.lugre else "a linear one"
        lost.append(f"viscous exponent {element.alpha:g}: {kind}, fitted")
    if not target.lugre:
        lost.append("bristles: the stiffness of presliding, and its hysteresis")
    elif math.isfinite(element.omega_d):
        limit = element.replaced(omega_d=math.inf).passivity_limit(fastest)
        gives = (
            "" if math.isinf(limit) else f", and the element not passive from {limit:.2g} rad/s on"
        )
        lost.append(f"fading of c1 above {element.omega_d:g} rad/s: it is constant{gives}")
    if element.bristles is not None:
        lost.append(f"bristles of the kind {type(element.bristles).__name__}: those of LuGre")
    if (load := element.load) is not None:
        lost.append(
            f"load: friction grows by {load.driving:.3g} (driving), {load.driven:.3g} (driven) of the load torque"
        )
    if (warmth := element.temperature) is not None:
        warm, cold = warmth.viscous_range
        lost.append(
            f"temperature: viscous torque is {warm:.2g} to {cold:.2g} times that at {warmth.reference:g} °C"
        )
    for part in ("ripple", "scatter"):
        if part in element.parts:
            lost.append(f"{part}: the mean is kept")
    return lost
