"""The friction law of one element as the fit writes it: what is linear, what is not, and its derivatives.

Equations 17 to 19 and the viscous exponent, with the bristle's torque over the Coulomb torque u = c0 z / tau_c:

    tau_f = tau_c u + c1 dz/dt + c2 |v|^alpha sign(v)
    du/dt = stiffness (v - |v| u / h(v)),  h(v) = 1 + rise exp(-(|v| / omega_s)^delta)

Linear are tau_c, c2 and c1; not linear are alpha, rise = tau_s / tau_c - 1, omega_s, delta and stiffness = c0 / tau_c,
the inverse of the presliding distance. Without a bristle u is sign(v) h(v). A difference of tau_c between the
directions is a constant torque, which no motion tells from a joint's offset; tau_c is the mean of both directions.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from enum import Enum
from functools import cached_property
from typing import Any

import numpy as np

from rx90_common.base.arrays import Array

COULOMB, VISCOUS, DAMPING = 0, 1, 2
"""Places of the linear parameters tau_c, c2 and c1."""
LINEAR = ("tau_c", "c2", "c1")
FITTED = (*LINEAR, "alpha", "rise", "omega_s", "delta", "stiffness")
"""All parameters of an element as the fit writes them: omega_s and stiffness stand for their logarithms."""


class Part(Enum):
    """What an element's friction may have beside Coulomb and viscous friction."""

    EXPONENT = "viscous exponent"
    STRIBECK = "Stribeck rise"
    BRISTLE = "bristle"
    DAMPING = "bristle damping"

    @property
    def shape(self) -> tuple[str, ...]:
        """Return the names of its parameters in ElementShape."""
        return _SHAPE_OF[self]


_SHAPE_OF = {
    Part.EXPONENT: ("alpha",),
    Part.STRIBECK: ("rise", "omega_s", "delta"),
    Part.BRISTLE: ("stiffness",),
    Part.DAMPING: (),
}
_LOGARITHMIC = frozenset({"omega_s", "stiffness"})


@dataclass(frozen=True)
class ElementShape:
    """The parameters of an element that are not linear; the defaults are those of a part that is off.

    Attributes:
        parts: which parts the element has.
        alpha: viscous exponent, 1.
        rise: static over Coulomb torque, less 1.
        omega_s: Stribeck velocity, rad/s.
        delta: Stribeck exponent, 1.
        stiffness: bristle stiffness over Coulomb torque, 1/rad.
        fixed: names of those that the data do not tell: they stay as they are, though their part is there.
    """

    parts: frozenset[Part] = frozenset()
    alpha: float = 1.0
    rise: float = 0.0
    omega_s: float = math.inf
    delta: float = 1.0
    stiffness: float = math.inf
    fixed: frozenset[str] = frozenset()

    @property
    def free(self) -> tuple[str, ...]:
        """Return the names of the parameters that its parts leave open, in the order of `values`."""
        return tuple(n for part in Part if part in self.parts for n in part.shape if n not in self.fixed)

    @property
    def values(self) -> Array:
        """Return the free parameters as the fit writes them: logarithms of omega_s and stiffness."""
        return np.array([_written(name, getattr(self, name)) for name in self.free])

    def with_values(self, values: Array) -> ElementShape:
        """Return the shape with other free parameters, written as `values`."""
        changed: dict[str, Any] = {n: _read(n, float(x)) for n, x in zip(self.free, values, strict=True)}
        return replace(self, **changed)

    def without(self, part: Part) -> ElementShape:
        """Return the shape without a part; bristle damping goes with the bristle."""
        gone = {part, Part.DAMPING} if part is Part.BRISTLE else {part}
        neutral: dict[str, Any] = {name: getattr(_NEUTRAL, name) for name in part.shape}
        return replace(self, parts=self.parts - gone, fixed=self.fixed - set(part.shape), **neutral)

    def opened(self, name: str) -> ElementShape:
        """Return the shape with a parameter among its free ones, its value as it is."""
        part = next(part for part in Part if name in part.shape)
        closed = frozenset() if part in self.parts else frozenset(part.shape)
        return replace(self, parts=self.parts | {part}, fixed=(self.fixed | closed) - {name})


_NEUTRAL = ElementShape()
_REST = 1e-300  # rad/s
LARGEST_POWER = math.log(700.0)
"""Of (|v| / omega_s)^delta, its logarithm: beyond, a Stribeck rise has faded."""


def _written(name: str, value: float) -> float:
    return math.log(value) if name in _LOGARITHMIC else value


def _read(name: str, value: float) -> float:
    return math.exp(value) if name in _LOGARITHMIC else value


@dataclass(frozen=True, eq=False)
class Speeds:
    """Velocities, rad/s, shape (m,), and what all shapes make use of."""

    velocity: Array

    @cached_property
    def sign(self) -> Array:
        """Return their signs, shape (m,)."""
        return np.asarray(np.sign(self.velocity))

    @cached_property
    def logarithm(self) -> Array:
        """Return the logarithms of their sizes, shape (m,), bounded from below so that rest gives no infinity."""
        return np.asarray(np.log(np.maximum(np.abs(self.velocity), _REST)))


def stribeck_factor(shape: ElementShape, speeds: Speeds) -> tuple[Array, dict[str, Array]]:
    """Return h and its derivatives by rise, ln omega_s and delta where the shape has a Stribeck part, each (m,)."""
    if Part.STRIBECK not in shape.parts:
        return np.ones_like(speeds.velocity), {}
    over = speeds.logarithm - math.log(shape.omega_s)
    ratio = np.exp(np.minimum(shape.delta * over, LARGEST_POWER))
    decay = np.exp(-ratio)
    slope = shape.rise * decay * ratio
    return 1.0 + shape.rise * decay, {"rise": decay, "omega_s": slope * shape.delta, "delta": -slope * over}


def viscous(shape: ElementShape, speeds: Speeds) -> tuple[Array, Array]:
    """Return |v|^alpha sign(v) and its derivative by alpha, each of shape (m,)."""
    column = speeds.sign * np.exp(shape.alpha * speeds.logarithm)
    return column, column * speeds.logarithm


def steady_columns(shape: ElementShape, velocity: Array) -> tuple[Array, dict[str, Array]]:
    """Return what the linear parameters multiply in steady sliding, and its derivatives.

    Args:
        shape: of the element.
        velocity: rad/s, shape (m,).

    Returns:
        Columns of LINEAR, shape (m, 3), and their derivatives by each other parameter in FITTED.
    """
    speeds = Speeds(velocity)
    factor, by_stribeck = stribeck_factor(shape, speeds)
    column, by_alpha = viscous(shape, speeds)
    derivatives = {name: np.zeros((len(velocity), 3)) for name in FITTED[len(LINEAR) :]}
    derivatives["alpha"][:, VISCOUS] = by_alpha
    for name, slope in by_stribeck.items():
        derivatives[name][:, COULOMB] = speeds.sign * slope
    return np.column_stack([speeds.sign * factor, column, np.zeros_like(velocity)]), derivatives
