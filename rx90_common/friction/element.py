"""Friction elements, equations 17 to 19: their parameters, declared once, and their curves.

The fields of `FrictionElement` are the only declaration of a parameter: file, schema, checks, legends, units, paths and
the data of compiled code follow from them.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass, replace
from typing import Annotated, Final, get_args, get_type_hints

import numpy as np
from numpy.typing import ArrayLike, NDArray

from rx90_common.base.arrays import Array
from rx90_common.base.declared import Declared, declarations
from rx90_common.base.entries import REQUIRED, Entry, Number
from rx90_common.base.errors import ConfigError
from rx90_common.base.groups import Either, Group
from rx90_common.friction.parts.bristles import LUGRE_PASSIVITY, BristlesPart
from rx90_common.friction.parts.load import LoadPart
from rx90_common.friction.parts.part import LINEAR_SPEED, MIN_SPEED, FrictionPart, in_words
from rx90_common.friction.parts.ripple import RipplePart
from rx90_common.friction.parts.scatter import ScatterPart
from rx90_common.friction.parts.temperature import TemperaturePart

SIGNS = ("positive", "negative")
"""Of the velocity, in the order in which everything keeps them."""

ALPHA_BOUNDS = (0.3, 2.0)
"""Range of the viscous exponent.

Two is the drag of a turbulent fluid. Below 0.3 the slope at rest, LINEAR_SPEED^(alpha - 1) c2, approaches the limit of
a light wrist in a tick: the part would be a Coulomb torque without bristles.
"""

INVERSE: Final = object()
"""Follows the entry of a parameter whose inverse compiled code contains."""

_coulomb = Number("Coulomb friction torque.", "Nm", low=0.0, above=True)
_static = Number("Static friction torque, at least tau_c.", "Nm", low=0.0)


@dataclass(frozen=True)
class FrictionElement(Declared):
    """One friction element, joint side, SI units.

        dz/dt = v - |v| / g(v) * z                                            (17)
        tau_f = c0 z + c1(v) dz/dt + c2 |v|^alpha sign(v)                     (18)
        c0 g(v) = tau_c + (tau_s - tau_c) exp(-(|v| / omega_s)^delta)         (19)

    The paper's c1 is a constant. That model is passive only while c1 < 4 c0 g(v) / |v|, so c1 may fade as
    c1 exp(-(v / omega_d)^2) (Olsson 1996, section 3.5); `omega_d` infinite is the paper's constant c1.
    The paper's viscous part is c2 v, `alpha` 1. With another exponent it is linear below LINEAR_SPEED, up to the same
    value there. Its power is never negative: the limit of c1 does not depend on it (docs/explanation/closed_loop.md).

    A parameter for each sign of the velocity has two fields; v = 0 counts as positive. A part that is None is off: load
    by the transmitted torque, temperature of the joint, ripple by the angles of joint and motor, scatter as a slow
    random walk, and bristles of another kind than equation 17. The curves below are those without load, at the
    reference temperature, in the mean over angle and scatter.

    Raises:
        ConfigError: for a value that is not finite or not in its range.
    """

    about = "A LuGre friction element (equations 17 to 19), joint side."

    tau_c_positive: Annotated[float, _coulomb]
    tau_c_negative: Annotated[float, _coulomb]
    tau_s_positive: Annotated[float, _static]
    tau_s_negative: Annotated[float, _static]
    omega_s: Annotated[float, Number("Stribeck velocity.", "rad/s", low=MIN_SPEED), INVERSE]
    delta: Annotated[float, Number("Stribeck exponent.", "1", low=0.0, above=True)]
    c0: Annotated[float, Number("Bristle stiffness.", "Nm/rad", low=0.0, above=True)]
    c1: Annotated[float, Number("Micro-viscous damping at rest.", "Nm s/rad", low=0.0)]
    c2: Annotated[float, Number("Viscous friction.", "Nm (s/rad)^alpha", low=0.0)]
    omega_d: Annotated[
        float,
        Number("Velocity in the fading c1 exp(-(v/omega_d)^2).", "rad/s", low=MIN_SPEED, infinite=True),
        INVERSE,
    ] = math.inf
    alpha: Annotated[float, Number("Viscous exponent.", "1", low=ALPHA_BOUNDS[0], high=ALPHA_BOUNDS[1])] = 1.0
    load: LoadPart | None = None
    temperature: TemperaturePart | None = None
    ripple: RipplePart | None = None
    scatter: ScatterPart | None = None
    bristles: BristlesPart | None = None

    def __post_init__(self) -> None:
        super().__post_init__()
        for sign in SIGNS:
            coulomb = getattr(self, f"tau_c_{sign}")
            static = getattr(self, f"tau_s_{sign}")
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
        return np.asarray(coulomb + (static - coulomb) * stribeck_decay(v, self.omega_s, self.delta))

    def damping(self, velocity: ArrayLike) -> NDArray[np.float64]:
        """Return c1(v), Nm s/rad."""
        with np.errstate(over="ignore"):
            return np.asarray(self.c1 * np.exp(-((np.asarray(velocity) / self.omega_d) ** 2)))

    def viscous_torque(self, velocity: ArrayLike) -> NDArray[np.float64]:
        """Return c2 |v|^alpha sign(v), below LINEAR_SPEED the chord of it, Nm."""
        return viscous_torque(np.asarray(velocity, dtype=np.float64), self.c2, self.alpha)

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
        low = speed[first - 1]
        high = speed[first]
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
        """Return 4 c0 g, Nm, or the bound of other bristles, with the sign and the parts that make it least."""
        weakest = self
        least = 1.0
        for part in self.parts.values():
            weakest = part.weakest(weakest)
            least = least * part.least_factor
        factor = LUGRE_PASSIVITY if self.bristles is None else self.bristles.passivity_factor(self.c0, speed)
        return factor * least * np.minimum(weakest.sliding_torque(speed), weakest.sliding_torque(-speed))


def _speeds_up_to(largest: float) -> NDArray[np.float64]:
    """Return the speeds, rad/s, shape (n,), between which passivity is looked at."""
    return np.geomspace(1e-4 * min(1.0, largest), largest, 4000)


@dataclass(frozen=True)
class FrictionParameter:
    """One parameter of an element as in files.

    Attributes:
        name: its key.
        number: its accepted values.
        attributes: of FrictionElement that contain it: one, or one for each of SIGNS.
        inverse: whether compiled code contains the inverse.
    """

    name: str
    number: Number
    attributes: tuple[str, ...]
    inverse: bool

    @property
    def meaning(self) -> str:
        """Return its description."""
        return in_words(self.number.about)

    @property
    def signed(self) -> bool:
        """Return whether it has a value for each sign of the velocity."""
        return len(self.attributes) > 1

    @property
    def accepted(self) -> str:
        """Return its range in words."""
        return self.number.acceptance()

    @property
    def unit(self) -> str:
        """Return its unit, 1 for a pure number."""
        return self.number.unit

    @property
    def default(self) -> float | None:
        """Return its value if it is left out; None if it is required."""
        return None if self.number.default is REQUIRED else float(self.number.default)

    def entry(self) -> Entry:
        """Return the accepted values of its key in a file: a number, or one for each sign of the velocity."""
        if not self.signed:
            return self.number
        about = self.number.about
        pair = {sign: replace(self.number, about=f"{about} Of {sign} velocities.") for sign in SIGNS}
        plain = replace(self.number, about=f"{about} For both signs of the velocity.")
        return Either(
            about, self.unit, mapping=Group(f"{about} For each sign of the velocity.", keys=pair), plain=plain
        )


def _parameters() -> tuple[FrictionParameter, ...]:
    hints = get_type_hints(FrictionElement, include_extras=True)
    found = []
    for one in declarations(FrictionElement).values():
        name, _, sign = one.name.rpartition("_")
        if sign == SIGNS[1]:
            continue
        attributes = tuple(f"{name}_{each}" for each in SIGNS) if sign == SIGNS[0] else (one.name,)
        assert isinstance(one.entry, Number)
        inverse = INVERSE in get_args(hints[one.name])
        found.append(FrictionParameter(name if sign == SIGNS[0] else one.name, one.entry, attributes, inverse))
    return tuple(found)


FRICTION_PARAMETERS = _parameters()

PARTS: dict[str, type[FrictionPart]] = {
    name: kind
    for name, hint in get_type_hints(FrictionElement).items()
    for kind in get_args(hint)[:1]
    if issubclass(kind, FrictionPart)
}
"""The parts that an element may have, by the keys of their blocks, which are its attributes."""

ELEMENT = Group(
    FrictionElement.about,
    keys={parameter.name: parameter.entry() for parameter in FRICTION_PARAMETERS}
    | {name: part.entry() for name, part in PARTS.items()},
)
"""The keys of one element in a file."""

FRICTION_UNITS = FrictionElement.units()
"""Units of the attributes of FrictionElement."""


def legend(parts: Iterable[str] = ()) -> str:
    """Return the parameters as lines of comment, for the head of friction files, and those of parts."""
    lines = ""
    for parameter in FRICTION_PARAMETERS:
        signed = "; one value, or {positive: x, negative: y}" if parameter.signed else ""
        optional = "" if parameter.default is None else f"; {parameter.default:g} if it is left out"
        accepted = parameter.accepted.rpartition("number ")[2]
        lines += f"# {parameter.name:<8} {parameter.meaning}, {parameter.unit}, {accepted}{signed}{optional}\n"
    return lines + "".join(part.legend() for name, part in PARTS.items() if name in parts)


_MAX_POWER = 700.0  # of (|v| / omega_s)^delta: beyond it, exp(-x) is no normal number


def stribeck_decay(velocity: Array, omega_s: float, delta: float) -> Array:
    """Return exp(-(|v| / omega_s)^delta), the remaining share of the Stribeck rise; shape of the velocity in rad/s."""
    with np.errstate(over="ignore"):  # nothing is left then
        return np.asarray(np.exp(-((np.abs(velocity) / omega_s) ** delta)))


def stribeck_decay_slopes(velocity: Array, omega_s: float, delta: float) -> tuple[Array, Array, Array]:
    """Return the same, and its derivatives by ln omega_s and by ln delta, each with the shape of the velocity."""
    speed = np.abs(velocity)
    power = np.minimum((speed / omega_s) ** delta, _MAX_POWER)
    decay = np.exp(-power)
    by_omega_s = decay * power * delta
    logarithm = np.log(speed / omega_s, out=np.zeros_like(power), where=speed > 0.0)
    return decay, by_omega_s, -by_omega_s * logarithm


def viscous_torque(velocity: Array, c2: float, alpha: float) -> Array:
    """Return c2 |v|^alpha sign(v), below LINEAR_SPEED the chord of it, Nm, with the shape of the velocity in rad/s.

    The derivative by alpha is this torque times ln max(|v|, LINEAR_SPEED).
    """
    if alpha == 1.0:
        return np.asarray(c2 * velocity)
    return np.asarray(c2 * velocity * np.maximum(np.abs(velocity), LINEAR_SPEED) ** (alpha - 1.0))
