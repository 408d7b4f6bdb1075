"""The laws of friction that a fit tries: their parameters, their curves and columns, and the element of friction.

Steady sliding by equations 17 to 19 (`rx90_common.friction.element`, whose functions these are),

    tau_f = sign(v) (tau_c + rise exp(-(|v| / omega_s)^delta)) + c2 |v|^alpha sign(v),   rise = tau_s - tau_c,

for each element. What is missing in a law has the value that leaves it out. Sizes (tau_c, rise, c2, c1; Nm and so on)
are fitted as they are, from 0 on, because 0 is a possible answer; a shape (omega_s, delta, alpha) is fitted by its
logarithm. With a bristle, the dry torque is that of its deflection along the motion (`along`), and c1 damps it; the
stiffness is fitted by the logarithm of c0 over tau_c, the inverse of the presliding distance.

Friction that falls with speed is a Stribeck rise with a velocity omega_s of the order of the top speed; omega_s is free
up to twice the top speed with data. Such an element is passive at all speeds, as a negative c2 would not be.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from enum import Enum
from itertools import product
from typing import NamedTuple

import numpy as np

from rx90_common.base.arrays import Array
from rx90_common.friction.bristle import decay
from rx90_common.friction.element import (
    ALPHA_BOUNDS,
    FrictionElement,
    stribeck_decay,
    stribeck_decay_slopes,
    viscous_torque,
)
from rx90_common.friction.parts.part import LINEAR_SPEED
from rx90_common.kernels.compiled import kernel

DELTA_BOUNDS = (0.2, 5.0)
"""Of the Stribeck exponent: published ones lie between 0.5 and 2."""
LONGEST_PRESLIDING = 0.3
"""Presliding distance tau_c / c0, rad, at most."""
LEAST_STRIBECK = 1.0 / 3.0
"""Least Stribeck velocity over the least speed with data: a rise that has faded by then cannot be seen."""
MOST_STRIBECK = 2.0
"""Greatest Stribeck velocity over the greatest speed with data: such a rise is almost a straight line there."""
BRISTLE_STEP = 1e-4
"""Step of the parameters of a bristle's motion, as they are fitted, for difference quotients."""
_LEAST_COULOMB = 1e-9  # Nm, that a bristle's motion is divided by


class Part(Enum):
    """What an element's friction may have beside Coulomb and viscous friction, in the order in which it is tried."""

    STRIBECK = "stribeck-rise"
    STRIBECK_EXPONENT = "stribeck-exponent"
    EXPONENT = "viscous-exponent"
    BRISTLE = "bristle"


class Speeds(NamedTuple):
    """Least and greatest speed with data, rad/s, and the least presliding distance that the data can show, rad."""

    low: float
    high: float
    presliding: float = 1e-7


@dataclass(frozen=True)
class Law:
    """A law of friction of one element, and the order of its k fitted parameters.

    Attributes:
        parts: beside Coulomb and viscous friction.
        signed: whether tau_c and rise have a value for each direction. Their difference is a constant torque, so data
            with an unknown offset cannot tell it.
        balanced: whether tau_c has one value although the law is signed: several joints share the element, and the
            difference of its directions is a constant torque that theirs contain.
    """

    parts: frozenset[Part] = frozenset()
    signed: bool = False
    balanced: bool = False

    @property
    def names(self) -> tuple[str, ...]:
        """Return the names of the fitted parameters, shape (k,): sizes first."""
        return (*self.sizes, *self.shapes)

    @property
    def sizes(self) -> tuple[str, ...]:
        """Return the names of the parameters that a steady torque is linear in, from 0 on."""
        torques = ["tau_c"]
        if self.signed and not self.balanced:
            torques = ["tau_c_positive", "tau_c_negative"]
        if Part.STRIBECK in self.parts:
            torques += ["rise_positive", "rise_negative"] if self.signed else ["rise"]
        damping = ["c1"] if Part.BRISTLE in self.parts else []
        return (*torques, "c2", *damping)

    @property
    def shapes(self) -> tuple[str, ...]:
        """Return the names of the parameters that are fitted by their logarithms."""
        shape = {
            "omega_s": Part.STRIBECK,
            "delta": Part.STRIBECK_EXPONENT,
            "alpha": Part.EXPONENT,
            "stiffness": Part.BRISTLE,
        }
        return tuple(name for name, part in shape.items() if part in self.parts)

    def bounds(self, speeds: Speeds) -> Array:
        """Return lower and upper bounds of the fitted parameters, shape (2, k)."""
        low = max(speeds.low, 1e-6)
        shortest = min(speeds.presliding, 0.1 * LONGEST_PRESLIDING)
        ranges = {
            "omega_s": (LEAST_STRIBECK * low, MOST_STRIBECK * max(speeds.high, low)),
            "delta": DELTA_BOUNDS,
            "alpha": ALPHA_BOUNDS,
            "stiffness": (1.0 / LONGEST_PRESLIDING, 1.0 / shortest),
        }
        sizes = [[0.0, math.inf]] * len(self.sizes)
        shapes = [[math.log(bound) for bound in ranges[name]] for name in self.shapes]
        return np.array(sizes + shapes).T

    def starts(self, speeds: Speeds, known: Mapping[str, float] | None = None) -> list[Array]:
        """Return where a search may begin, shape (k,) each.

        Args:
            speeds: with data.
            known: fitted parameters of a simpler law, which all starts have. Other sizes are 1: a linear step finds
                them.
        """
        known = known or {}
        lower, upper = self.bounds(speeds)
        choices: dict[str, Sequence[float]] = {
            "omega_s": (0.3, 0.55, 0.8, 1.0),  # shares of the logarithm's range
            "delta": (math.log(1.0), math.log(2.0)),
            "alpha": (math.log(0.7), 0.0),
            "stiffness": (0.3, 0.5, 0.7),
        }
        starts = []
        unknown = [name for name in self.shapes if name not in known]
        for values in product(*(choices[name] for name in unknown)):
            start = np.array([known.get(name, 1.0) for name in self.names])
            for name, value in zip(unknown, values, strict=True):
                place = self.names.index(name)
                share = name in ("omega_s", "stiffness")
                start[place] = (
                    lower[place] + value * (upper[place] - lower[place]) if share else value
                )
            starts.append(start)
        return starts

    def values(self, x: Array) -> dict[str, float]:
        """Return all parameters of fitted ones x, shape (k,), by name; those that the law lacks leave it out."""
        fitted = dict(zip(self.names, x.tolist(), strict=True))
        values = {
            "c2": 0.0,
            "c1": 0.0,
            "omega_s": 1.0,
            "delta": 1.0,
            "alpha": 1.0,
            "stiffness": math.inf,
        }
        for torque in ("tau_c", "rise"):
            common = fitted.pop(torque, 0.0)
            for sign in ("positive", "negative"):
                values[f"{torque}_{sign}"] = fitted.get(f"{torque}_{sign}", common)
        return values | {
            name: math.exp(value) if name in self.shapes else value
            for name, value in fitted.items()
        }

    def curve(self, velocity: Array, x: Array) -> tuple[Array, Array]:
        """Return the torque of steady sliding, Nm, (m,), and its derivatives by the fitted parameters, (m, k).

        Args:
            velocity: rad/s, shape (m,).
            x: fitted parameters, shape (k,).
        """
        values = self.values(x)
        forward = 1.0 * (velocity > 0.0)
        backward = -1.0 * (velocity < 0.0)
        fading, by_omega_s, by_delta = stribeck_decay_slopes(
            velocity, values["omega_s"], values["delta"]
        )
        rise = forward * values["rise_positive"] + backward * values["rise_negative"]
        viscous = viscous_torque(velocity, 1.0, values["alpha"])
        growth = np.log(np.maximum(np.abs(velocity), LINEAR_SPEED))
        slopes = {
            "tau_c": forward + backward,
            "tau_c_positive": forward,
            "tau_c_negative": backward,
            "rise": (forward + backward) * fading,
            "rise_positive": forward * fading,
            "rise_negative": backward * fading,
            "c2": viscous,
            "c1": np.zeros_like(velocity),
            "omega_s": rise * by_omega_s,
            "delta": rise * by_delta,
            "alpha": values["c2"] * values["alpha"] * viscous * growth,
            "stiffness": np.zeros_like(velocity),
        }
        columns = np.column_stack([slopes[name] for name in self.names])
        return columns[:, : len(self.sizes)] @ x[: len(self.sizes)], columns

    def along(self, velocity: Array, step: float, x: Array) -> tuple[Array, Array]:
        """Return the dry torque of a bristle along a motion, from rest, Nm, (m,), and its derivatives, (m, k).

        The torque is the mean over each step, c1's damping included and the viscous part left out.

        Args:
            velocity: constant in each step, rad/s, shape (m,).
            step: s.
            x: fitted parameters, shape (k,).
        """
        torque, rate = self._deflected(velocity, step, x)
        damping = x[self.names.index("c1")]
        total = torque + damping * rate
        slopes = np.zeros((len(velocity), len(x)))
        for place, name in enumerate(self.names):
            if name == "c1":
                slopes[:, place] = rate
            elif name not in ("c2", "alpha"):
                moved = x.copy()
                difference = BRISTLE_STEP * (
                    1.0 if name in self.shapes else max(x[0], _LEAST_COULOMB)
                )
                moved[place] += difference
                torque, moved_rate = self._deflected(velocity, step, moved)
                slopes[:, place] = (torque + damping * moved_rate - total) / difference
        return total, slopes

    def _deflected(self, velocity: Array, step: float, x: Array) -> tuple[Array, Array]:
        values = self.values(x)
        coulomb = np.where(velocity >= 0.0, values["tau_c_positive"], values["tau_c_negative"])
        rise = np.where(velocity >= 0.0, values["rise_positive"], values["rise_negative"])
        fading = stribeck_decay(velocity, values["omega_s"], values["delta"])
        sliding = np.maximum(coulomb + rise * fading, _LEAST_COULOMB)
        mean = max(0.5 * (values["tau_c_positive"] + values["tau_c_negative"]), _LEAST_COULOMB)
        result = np.empty((len(velocity), 2))
        deflect(velocity, sliding, step, values["stiffness"] * mean, 0.0, result)
        return result[:, 0], result[:, 1]

    def natural(self, x: Array) -> tuple[dict[str, float], Array]:
        """Return the parameters that the law has by the names of FRICTION_UNITS, and their derivatives, (n, k)."""
        values = self.values(x)
        unit = dict(zip(self.names, np.eye(len(self.names)), strict=True))
        natural: dict[str, tuple[float, Array]] = {}
        coulomb_slopes = []
        for sign in ("positive", "negative"):
            coulomb = values[f"tau_c_{sign}"]
            slopes = unit[f"tau_c_{sign}" if f"tau_c_{sign}" in unit else "tau_c"]
            natural[f"tau_c_{sign}"] = (coulomb, slopes)
            coulomb_slopes.append(slopes)
            if Part.STRIBECK in self.parts:
                rise = unit[f"rise_{sign}" if self.signed else "rise"]
                natural[f"tau_s_{sign}"] = (coulomb + values[f"rise_{sign}"], slopes + rise)
        natural["c2"] = (values["c2"], unit["c2"])
        for name in self.shapes:
            if name != "stiffness":
                natural[name] = (values[name], values[name] * unit[name])
        if Part.BRISTLE in self.parts:
            mean = 0.5 * (values["tau_c_positive"] + values["tau_c_negative"])
            stiffness = values["stiffness"]
            slopes = 0.5 * stiffness * sum(coulomb_slopes) + stiffness * mean * unit["stiffness"]
            natural["c0"] = (stiffness * mean, slopes)
            natural["c1"] = (values["c1"], unit["c1"])
        slopes_of = np.array([slopes for _, slopes in natural.values()])
        return {name: value for name, (value, _) in natural.items()}, slopes_of

    def element(self, x: Array, assumed: Mapping[str, float]) -> FrictionElement:
        """Return the element of fitted parameters, with `assumed` ones for those that the law lacks (c0, c1 and so on).

        Without a Stribeck rise tau_s is tau_c, omega_s and delta then have no effect.
        """
        natural = self.natural(x)[0]
        static = {f"tau_s_{sign}": natural[f"tau_c_{sign}"] for sign in ("positive", "negative")}
        return FrictionElement.of({"omega_s": 1.0, "delta": 1.0, **static, **assumed, **natural})


@kernel
def deflect(
    velocity: Array, sliding: Array, step: float, c0: float, start: float, result: Array
) -> None:
    """Deflect a LuGre bristle along a motion, by steps that are exact for a constant velocity, as the plant's are.

    Args:
        velocity: constant in each step, rad/s, shape (m,).
        sliding: c0 g(v) at it, Nm, shape (m,).
        step: s.
        c0: stiffness, Nm/rad.
        start: deflection before the first step, rad.
        result: receives the means over each step of the bristle's torque c0 z, Nm, and of dz/dt, rad/s, shape (m, 2).
    """
    z = start
    for row in range(len(velocity)):
        rate = c0 * abs(velocity[row]) / sliding[row]
        phi, psi = decay(rate * step)
        z_dot = velocity[row] - rate * z
        result[row, 0] = c0 * (z + step * z_dot * psi)
        result[row, 1] = z_dot * phi
        z += step * z_dot * phi
