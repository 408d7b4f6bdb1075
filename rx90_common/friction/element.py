"""Friction elements, equations 17 to 19: their parameters, and what compiled code makes of them."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from rx90_common.base.errors import ConfigError
from rx90_common.friction.parameters import FRICTION_PARAMETERS, LINEAR_SPEED, SIGNS
from rx90_common.friction.parts.bristles import LUGRE_PASSIVITY, BristlesPart
from rx90_common.friction.parts.load import LoadPart
from rx90_common.friction.parts.part import FrictionPart
from rx90_common.friction.parts.ripple import RipplePart
from rx90_common.friction.parts.scatter import ScatterPart
from rx90_common.friction.parts.table import PARTS
from rx90_common.friction.parts.temperature import TemperaturePart


@dataclass(frozen=True)
class FrictionElement:
    """One friction element, joint side, SI units.

        dz/dt = v - |v| / g(v) * z                                            (17)
        tau_f = c0 z + c1(v) dz/dt + c2 |v|^alpha sign(v)                     (18)
        c0 g(v) = tau_c + (tau_s - tau_c) exp(-(|v| / omega_s)^delta)         (19)

    The paper's c1 is a constant. That model is passive only while c1 < 4 c0 g(v) / |v|, so c1 may fade as
    c1 exp(-(v / omega_d)^2) (Olsson 1996, section 3.5); `omega_d` infinite is the paper's constant c1.
    The paper's viscous part is c2 v, `alpha` 1. With another exponent it is linear below LINEAR_SPEED, up to the same
    value there. Its power is never negative: the limit of c1 does not depend on it (docs/explanation/closed_loop.md).

    Attributes:
        tau_c_positive, tau_c_negative: Coulomb friction torque, Nm, for v >= 0 and for v < 0.
        tau_s_positive, tau_s_negative: static friction torque, at least tau_c, Nm, the same.
        omega_s: Stribeck velocity, rad/s.
        delta: Stribeck exponent, 1.
        c0: bristle stiffness, Nm/rad.
        c1: micro-viscous damping at rest, Nm s/rad.
        c2: viscous friction, Nm (s/rad)^alpha.
        omega_d: velocity in the fading c1 exp(-(v/omega_d)^2), rad/s.
        alpha: viscous exponent, 1.
        load: friction that grows with the transmitted torque; None is off, as for the parts below.
        temperature: viscous and static friction by the temperature of the joint, which friction heats.
        ripple: friction that changes with the angles of joint and motor.
        scatter: a slow random walk of the friction.
        bristles: of another kind than LuGre's, in place of equation 17.

    The curves below are those without load, at the reference temperature, in the mean over angle and scatter.

    Raises:
        ConfigError: for a value that is not finite or not in its range.
    """

    tau_c_positive: float
    tau_c_negative: float
    tau_s_positive: float
    tau_s_negative: float
    omega_s: float
    delta: float
    c0: float
    c1: float
    c2: float
    omega_d: float = math.inf
    alpha: float = 1.0
    load: LoadPart | None = None
    temperature: TemperaturePart | None = None
    ripple: RipplePart | None = None
    scatter: ScatterPart | None = None
    bristles: BristlesPart | None = None

    def __post_init__(self) -> None:
        for parameter in FRICTION_PARAMETERS:
            for name in parameter.attributes:
                object.__setattr__(self, name, parameter.check(name, getattr(self, name)))
        for sign in SIGNS:
            coulomb, static = getattr(self, f"tau_c_{sign}"), getattr(self, f"tau_s_{sign}")
            if static < coulomb:
                raise ConfigError(f"tau_s_{sign} is {static}; accepted: a number >= tau_c_{sign} = {coulomb} Nm")
        for name, kind in PARTS.items():
            part = getattr(self, name)
            if part is not None and not isinstance(part, kind):
                raise ConfigError(f"{name} is {part}; accepted: a {kind.__name__}, or None")

    @property
    def parts(self) -> dict[str, FrictionPart]:
        """Return the parts that are on, by their names."""
        return {name: part for name in PARTS if (part := getattr(self, name)) is not None}

    def without_parts(self) -> FrictionElement:
        """Return the element with all parts off."""
        return replace(self, **dict.fromkeys(PARTS))  # type: ignore[arg-type]  # names of fields, each optional

    def sliding_torque(self, velocity: ArrayLike) -> NDArray[np.float64]:
        """Return c0 g(v), equation 19, without a sign: the Stribeck curve less the viscous part, Nm."""
        v = np.asarray(velocity, dtype=np.float64)
        forward = v >= 0
        coulomb = np.where(forward, self.tau_c_positive, self.tau_c_negative)
        static = np.where(forward, self.tau_s_positive, self.tau_s_negative)
        with np.errstate(over="ignore"):  # the Stribeck part is gone then
            fading = np.exp(-((np.abs(v) / self.omega_s) ** self.delta))
        return np.asarray(coulomb + (static - coulomb) * fading)

    def damping(self, velocity: ArrayLike) -> NDArray[np.float64]:
        """Return c1(v), Nm s/rad."""
        with np.errstate(over="ignore"):
            return np.asarray(self.c1 * np.exp(-((np.asarray(velocity) / self.omega_d) ** 2)))

    def viscous_torque(self, velocity: ArrayLike) -> NDArray[np.float64]:
        """Return c2 |v|^alpha sign(v), below LINEAR_SPEED the chord of it, Nm."""
        v = np.asarray(velocity, dtype=np.float64)
        if self.alpha == 1.0:
            return np.asarray(self.c2 * v)
        return np.asarray(self.c2 * v * np.maximum(np.abs(v), LINEAR_SPEED) ** (self.alpha - 1.0))

    def viscous_slopes(self, max_velocity: float) -> tuple[float, float, float]:
        """Return the slope of the viscous part: at rest as warm and as cold as it gets, and cold at speed, Nm s/rad."""
        warm, cold = (1.0, 1.0) if self.temperature is None else self.temperature.viscous_range
        rest = self.c2 if self.alpha == 1.0 else self.c2 * LINEAR_SPEED ** (self.alpha - 1.0)
        fast = self.c2 * self.alpha * max_velocity ** (self.alpha - 1.0) if self.alpha > 1.0 else rest
        return warm * rest, cold * rest, cold * fast

    def steady_torque(self, velocity: ArrayLike) -> NDArray[np.float64]:
        """Return the torque after a long time at constant velocity, Nm (zero at rest)."""
        v = np.asarray(velocity, dtype=np.float64)
        return np.asarray(np.sign(v) * self.sliding_torque(v) + self.viscous_torque(v))

    def passivity_limit(self, max_velocity: float) -> float:
        """Return the speed, rad/s, from which the element is not passive; infinite if none up to `max_velocity`.

        The map from v to tau_f is passive where c1 < 4 c0 g / |v| (Barahanov and Ortega 2000); Maxwell slip has
        another factor there (`BristlesPart.passivity_factor`).
        """
        speed = np.concatenate([[0.0], _speeds_up_to(max_velocity)])
        broken = self._gives(speed)
        if not broken.any():
            return math.inf
        first = int(np.argmax(broken))
        low, high = speed[first - 1], speed[first]
        while low < (middle := 0.5 * (low + high)) < high:
            low, high = (low, middle) if self._gives(middle) else (middle, high)
        return float(high)

    def _gives(self, speed: ArrayLike) -> NDArray[np.bool_]:
        """Return at which speeds, rad/s, the element may give energy."""
        speed = np.asarray(speed, dtype=np.float64)
        return np.asarray(self.damping(speed) * speed >= self._least_dissipation(speed))

    def passive_damping(self, max_velocity: float) -> float:
        """Return the c1, Nm s/rad, below which the element is passive up to `max_velocity`, rad/s."""
        speed = _speeds_up_to(max_velocity)
        fading = np.exp(-((speed / self.omega_d) ** 2))
        with np.errstate(divide="ignore"):
            return float(np.min(self._least_dissipation(speed) / (speed * fading)))

    def _least_dissipation(self, speed: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return 4 c0 g, or what other bristles have there, Nm, with the sign and the parts that leave least of it."""
        weakest, least = self, 1.0
        for part in self.parts.values():
            weakest, least = part.weakest(weakest), least * part.least_factor
        factor = LUGRE_PASSIVITY if self.bristles is None else self.bristles.passivity_factor(self.c0, speed)
        return factor * least * np.minimum(weakest.sliding_torque(speed), weakest.sliding_torque(-speed))


def _speeds_up_to(largest: float) -> NDArray[np.float64]:
    """Return the speeds, rad/s, shape (n,), between which passivity is looked at."""
    return np.geomspace(1e-4 * min(1.0, largest), largest, 4000)


def elements_dtype(width: int) -> np.dtype[np.void]:
    """Return the type of `width` elements as compiled code reads them: a struct of arrays, the element the last index.

    The torques have a row for each of SIGNS; v = 0 counts as positive.
    """
    signed, plain = (len(SIGNS), width), (width,)
    return np.dtype(
        [
            ("tau_c", np.float64, signed),
            ("tau_s", np.float64, signed),
            ("inverse_omega_s", np.float64, plain),
            ("delta", np.float64, plain),
            ("c0", np.float64, plain),
            ("c1", np.float64, plain),
            ("c2", np.float64, plain),
            ("inverse_omega_d", np.float64, plain),  # 0 for a constant c1
            ("alpha", np.float64, plain),
        ],
        align=True,
    )


def element_arrays(elements: Sequence[FrictionElement]) -> np.ndarray[Any, Any]:
    """Return elements as compiled code reads them, shape (1,), dtype `elements_dtype(len(elements))`."""
    arrays = np.zeros(1, elements_dtype(len(elements)))
    for parameter in FRICTION_PARAMETERS:
        values = np.array([[getattr(element, name) for element in elements] for name in parameter.attributes])
        if parameter.name in ("omega_s", "omega_d"):
            arrays[f"inverse_{parameter.name}"] = 1.0 / values
        else:
            arrays[parameter.name] = values
    return arrays
