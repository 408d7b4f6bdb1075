"""Friction elements, equations 17 to 19: their parameters, declared once, and their curves.

The fields of `FrictionElement` are the only declaration of a parameter or a part: file, schema, checks, legends, units
and paths follow from them.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from typing import Annotated, Any

import numpy as np
from numpy.typing import ArrayLike
from pydantic import ConfigDict, Field, ValidationError, model_validator

from rx90_common.base.arrays import Array, Mask
from rx90_common.base.models import (
    FileModel,
    JsonSchema,
    NotNegative,
    Positive,
    quantity,
    refusal,
    refusals,
    word_of,
)
from rx90_common.friction.parts.bristles import BRISTLES, LUGRE_PASSIVITY, Bristles
from rx90_common.friction.parts.curve import CURVE, CurvePart
from rx90_common.friction.parts.load import LOAD, LoadPart
from rx90_common.friction.parts.part import LINEAR_SPEED, MIN_SPEED, FrictionPart, Part, legend_of
from rx90_common.friction.parts.ripple import RIPPLE, RipplePart
from rx90_common.friction.parts.scatter import SCATTER, ScatterPart
from rx90_common.friction.parts.temperature import TEMPERATURE, TemperaturePart
from rx90_common.friction.signs import SIGNS, BySign

ALPHA_BOUNDS = (0.3, 2.0)
"""Range of the viscous exponent.

Two is the drag of a turbulent fluid. Below 0.3 the slope at rest, LINEAR_SPEED^(alpha - 1) c2, approaches the limit of
a light wrist in a tick: the part would be a Coulomb torque without bristles.
"""

_SIGNED = "; one value, or {positive: x, negative: y}"


class CoulombTorque(BySign[Positive]):
    """Coulomb torque for each sign of the velocity."""


class StaticTorque(BySign[NotNegative]):
    """Static torque for each sign of the velocity."""


def _require_curve_or_law(schema: JsonSchema) -> None:
    law = ["tau_c", "tau_s", "omega_s", "delta"]
    schema["required"] = [name for name in schema["required"] if name not in law]
    schema["anyOf"] = [{"required": ["curve"]}, {"required": law}]


class FrictionElement(FileModel):
    """A LuGre friction element (equations 17 to 19), joint side.

        dz/dt = v - |v| / g(v) * z                                            (17)
        tau_f = c0 z + c1(v) dz/dt + c2 |v|^alpha sign(v)                     (18)
        c0 g(v) = tau_c + (tau_s - tau_c) exp(-(|v| / omega_s)^delta)         (19)

    The paper's c1 is a constant. That model is passive only while c1 < 4 c0 g(v) / |v|, so c1 may fade as
    c1 exp(-(v / omega_d)^2) (Olsson 1996, section 3.5); `omega_d` infinite is the paper's constant c1.
    The paper's viscous part is c2 v, `alpha` 1. With another exponent it is linear below LINEAR_SPEED, up to the same
    value there. Its power is never negative: the limit of c1 does not depend on it (docs/explanation/closed_loop.md).

    `tau_c` and `tau_s` have a value for each sign of the velocity, or one for both. They may be left out beside a
    curve, and so may `omega_s` and `delta` where no load has friction of its own. A part that is None is off: load
    by the transmitted torque, temperature of the joint, ripple by the angles of joint and motor, scatter as a slow
    random walk, bristles of another kind than equation 17, and a curve in place of equation 19. The curves below are
    those without load, at the reference temperature, in the mean over angle and scatter.
    """

    model_config = ConfigDict(json_schema_extra=_require_curve_or_law)

    tau_c: Annotated[
        CoulombTorque,
        quantity("Nm", "Coulomb friction torque.", accepted=f"a number > 0{_SIGNED}"),
    ]
    tau_s: Annotated[
        StaticTorque,
        quantity(
            "Nm", "Static friction torque, at least tau_c.", accepted=f"a number >= 0{_SIGNED}"
        ),
    ]
    omega_s: Annotated[float, quantity("rad/s", "Stribeck velocity.", ge=MIN_SPEED)]
    delta: Annotated[Positive, quantity("1", "Stribeck exponent.")]
    c0: Annotated[Positive, quantity("Nm/rad", "Bristle stiffness.")]
    c1: Annotated[NotNegative, quantity("Nm s/rad", "Micro-viscous damping at rest.")]
    c2: Annotated[NotNegative, quantity("Nm (s/rad)^alpha", "Viscous friction.")]
    omega_d: Annotated[
        float,
        quantity("rad/s", "Velocity in the fading c1 exp(-(v/omega_d)^2).", ge=MIN_SPEED),
        Field(allow_inf_nan=True),
    ] = math.inf
    alpha: Annotated[
        float, quantity("1", "Viscous exponent.", ge=ALPHA_BOUNDS[0], le=ALPHA_BOUNDS[1])
    ] = 1.0
    load: Annotated[LoadPart | None, LOAD] = None
    temperature: Annotated[TemperaturePart | None, TEMPERATURE] = None
    ripple: Annotated[RipplePart | None, RIPPLE] = None
    scatter: Annotated[ScatterPart | None, SCATTER] = None
    bristles: Annotated[Bristles | None, BRISTLES] = None
    curve: Annotated[CurvePart | None, CURVE] = None

    @model_validator(mode="before")
    @classmethod
    def _complete_curve(cls, content: Any) -> Any:
        """Take what is left out beside a curve for its torque at rest, without a rise; it does not count."""
        if not isinstance(content, Mapping) or content.get("curve") is None:
            return content
        try:
            torque: Any = CurvePart.model_validate(content["curve"]).at_rest
        except ValidationError:  # which is told of the curve
            torque = 1.0
        missing = {"tau_c": torque, "tau_s": torque}
        if content.get("load") is None:
            missing |= {"omega_s": 1.0, "delta": 1.0}
        return {**missing, **content}

    @classmethod
    def of(cls, parameters: Mapping[str, Any]) -> FrictionElement:
        """Return the element with parameters by the names of FRICTION_UNITS, or with `tau_c` for both signs.

        Raises:
            ConfigError: naming the value and what is accepted.
        """
        fields = by_fields(parameters)
        with refusals(cls, content=fields):
            return cls.model_validate(fields)

    @model_validator(mode="after")
    def _check_static(self) -> FrictionElement:
        for coulomb, static in zip(self.tau_c.both, self.tau_s.both, strict=True):
            if static < coulomb:
                raise refusal("tau_s", static, f"a number >= tau_c = {coulomb} Nm")
        return self

    @property
    def parameters(self) -> dict[str, float]:
        """Return the numbers of the bristle law by the names of FRICTION_UNITS."""
        return {
            "tau_c_positive": self.tau_c.positive,
            "tau_c_negative": self.tau_c.negative,
            "tau_s_positive": self.tau_s.positive,
            "tau_s_negative": self.tau_s.negative,
            "omega_s": self.omega_s,
            "delta": self.delta,
            "c0": self.c0,
            "c1": self.c1,
            "c2": self.c2,
            "omega_d": self.omega_d,
            "alpha": self.alpha,
        }

    def with_parameters(self, changes: Mapping[str, float]) -> FrictionElement:
        """Return the element with other values of some `parameters`."""
        return self.replaced(**by_fields({**self.parameters, **changes}))

    @property
    def parts(self) -> dict[str, FrictionPart]:
        """Return the parts that are on, by their names."""
        return {name: self.__dict__[name] for name in PARTS if self.__dict__[name] is not None}

    def without_parts(self) -> FrictionElement:
        """Return the element with all parts off."""
        return self.replaced(**dict.fromkeys(PARTS))

    def sliding_torque(self, velocity: ArrayLike) -> Array:
        """Return c0 g(v), equation 19, without a sign: the Stribeck curve less the viscous part, Nm."""
        v = np.asarray(velocity, dtype=np.float64)
        forward = v >= 0
        coulomb = np.where(forward, *self.tau_c.both)
        static = np.where(forward, *self.tau_s.both)
        torque = np.asarray(
            coulomb + (static - coulomb) * stribeck_decay(v, self.omega_s, self.delta)
        )
        for part in self.parts.values():
            torque = part.sliding_torque(v, torque)
        return torque

    def damping(self, velocity: ArrayLike) -> Array:
        """Return c1(v), Nm s/rad."""
        return self.c1 * stribeck_decay(np.asarray(velocity), self.omega_d, 2.0)

    def viscous_torque(self, velocity: ArrayLike) -> Array:
        """Return c2 |v|^alpha sign(v), below LINEAR_SPEED the chord of it, Nm."""
        return viscous_torque(np.asarray(velocity, dtype=np.float64), self.c2, self.alpha)

    def viscous_slopes(self, max_velocity: float) -> tuple[float, float, float]:
        """Return the slope of the viscous part: at rest as warm and as cold as it gets, and cold at speed, Nm s/rad."""
        warm, cold = (1.0, 1.0) if self.temperature is None else self.temperature.viscous_range
        rest = self.c2 if self.alpha == 1.0 else self.c2 * LINEAR_SPEED ** (self.alpha - 1.0)
        fast = (
            self.c2 * self.alpha * max_velocity ** (self.alpha - 1.0) if self.alpha > 1.0 else rest
        )
        growth = sum(part.steepest for part in self.parts.values())
        return warm * rest, cold * rest + growth, cold * fast + growth

    def steady_torque(self, velocity: ArrayLike) -> Array:
        """Return the torque after a long time at constant velocity, Nm (zero at rest)."""
        v = np.asarray(velocity, dtype=np.float64)
        return np.sign(v) * self.sliding_torque(v) + self.viscous_torque(v)

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

    def _gives(self, speed: ArrayLike) -> Mask:
        """Return at which speeds, rad/s, the element may give energy."""
        speed = np.asarray(speed, dtype=np.float64)
        return np.asarray(self.damping(speed) * speed >= self._least_dissipation(speed))

    def passive_damping(self, max_velocity: float) -> float:
        """Return the c1, Nm s/rad, below which the element is passive up to `max_velocity`, rad/s."""
        speed = _speeds_up_to(max_velocity)
        fading = stribeck_decay(speed, self.omega_d, 2.0)
        with np.errstate(divide="ignore"):
            return float(np.min(self._least_dissipation(speed) / (speed * fading)))

    def _least_dissipation(self, speed: Array) -> Array:
        """Return 4 c0 g, Nm, or the bound of other bristles, with the sign and the parts that make it least."""
        weakest = self
        least = 1.0
        for part in self.parts.values():
            weakest = part.weakest(weakest)
            least = least * part.least_factor
        factor = (
            LUGRE_PASSIVITY
            if self.bristles is None
            else self.bristles.passivity_factor(self.c0, speed)
        )
        return (
            factor
            * least
            * np.minimum(weakest.sliding_torque(speed), weakest.sliding_torque(-speed))
        )


def _speeds_up_to(largest: float) -> Array:
    """Return the speeds, rad/s, shape (n,), between which passivity is looked at."""
    return np.geomspace(1e-4 * min(1.0, largest), largest, 4000)


PARTS: dict[str, Part] = {
    name: part
    for name, field in FrictionElement.model_fields.items()
    for part in field.metadata
    if isinstance(part, Part)
}
"""The parts that an element may have, by the keys of their blocks, which are its attributes."""

FRICTION_UNITS = {
    name: word_of(FrictionElement, name.removesuffix("_positive").removesuffix("_negative"), "unit")
    for name in (
        *(f"{torque}_{sign}" for torque in ("tau_c", "tau_s") for sign in SIGNS),
        *("omega_s", "delta", "c0", "c1", "c2", "omega_d", "alpha"),
    )
}
"""Units of the numbers of `FrictionElement.parameters`."""


def by_fields(parameters: Mapping[str, Any]) -> dict[str, Any]:
    """Return parameters by the names of FRICTION_UNITS, torques of both signs or none, as fields of FrictionElement."""
    fields = dict(parameters)
    for torque in ("tau_c", "tau_s"):
        if f"{torque}_positive" in fields:
            fields[torque] = {sign: fields.pop(f"{torque}_{sign}") for sign in SIGNS}
    return fields


def legend(parts: Iterable[str] = ()) -> str:
    """Return the parameters as lines of comment, for the head of friction files, and those of parts."""
    blocks = "".join(part.legend(name) for name, part in PARTS.items() if name in parts)
    return legend_of(FrictionElement, " ", 8, without=PARTS) + blocks


_MAX_POWER = 700.0  # of (|v| / omega_s)^delta: beyond it, exp(-x) is no normal number


def stribeck_decay(velocity: Array, omega_s: float, delta: float) -> Array:
    """Return exp(-(|v| / omega_s)^delta), the remaining share of the Stribeck rise; shape of the velocity in rad/s."""
    with np.errstate(over="ignore"):  # nothing is left then
        return np.exp(-((np.abs(velocity) / omega_s) ** delta))


def stribeck_decay_slopes(
    velocity: Array, omega_s: float, delta: float
) -> tuple[Array, Array, Array]:
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
        return c2 * velocity
    return c2 * velocity * np.maximum(np.abs(velocity), LINEAR_SPEED) ** (alpha - 1.0)
