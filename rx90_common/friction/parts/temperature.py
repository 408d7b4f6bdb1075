"""Temperature: viscous friction, Stribeck velocity and static torque depend on the temperature of the heated joint.

    c2 (f + (1 - f) exp(-d / T_V)),    d = T - reference
    omega_s (1 + a d)
    tau_c + (tau_s - tau_c) (1 + b d)

with f = viscous_floor, T_V = viscous_scale, a = speed_slope and b = static_slope. At T = reference all three are the
element's own to the last bit. Bittencourt and Gunnarsson (2012, Static friction in a robot joint, J. Dyn. Sys. Meas.
Control 134(5) 051013) found these forms on an industrial robot: viscous friction falls, with a floor, while static
torque and Stribeck velocity grow linearly. With their names

    f = F_v0 / (F_v0 + F_vT exp(-reference / T_V)),    a = w_sT / (w_s0 + w_sT reference),
    b = F_sT / (F_s0 + F_sT reference)

The law holds from `lowest` to `highest`. Start and surroundings must be in this range, and the linear factors positive.
As the joint is only heated, it never gets colder than both. A joint that gets warmer than `highest` keeps the friction
of that temperature, which is reported (`rx90_sim.plant.beyond_law`).

The joint is one thermal node:

    capacity dT/dt = heat - (T - ambient) / resistance
    heat = friction + motor_share I^2 R

The friction's heat is its work less the increase of the energy in its bristles. Motor 6 turns with joints 5 and 6, as
the seventh element does, which gets its heat; the sixth gets none from a motor. R is that of `winding` in the drives
file, at the winding's temperature; without such a block motors give no heat. The node is advanced once in a tick,
exactly for a constant heat.

The storage c0 z^2 / 2 does not depend on T, so an element is passive whose sliding torque is positive at every
temperature: passive_damping is that of the least static torque and the least Stribeck velocity in the range.
"""

from __future__ import annotations

from typing import Annotated, Any

import numpy as np
from pydantic import model_validator

from rx90_common.base.arrays import RecordType, record_type
from rx90_common.base.models import Positive, quantity, refusal
from rx90_common.friction.parts.part import FrictionPart, Moment, Part, Present, Surroundings
from rx90_common.friction.signs import SIGNS
from rx90_common.kernels.compiled import inlined
from rx90_common.kernels.elementary import exponential_less_one, exponential_less_one_of
from rx90_common.kernels.lanes import Lanes, fma, load, select, store

LOWEST = -50.0
"""Of every temperature, degrees Celsius: oils and greases are liquid at most from here on."""
HIGHEST = 200.0


def _degrees(description: str) -> Any:
    return quantity("°C", description, ge=LOWEST, le=HIGHEST)


def _slope(description: str) -> Any:
    return quantity("1/K", description, ge=-1.0, le=1.0)


def _share(description: str) -> Any:
    return quantity("1", description, ge=0.0, le=1.0)


class TemperaturePart(FrictionPart):
    """Friction by the temperature of the joint, which friction and motor heat.

    A thermal node; equations in this module's docstring, degrees Celsius.
    """

    reference: Annotated[
        float, _degrees("Temperature at which the element has its own parameters.")
    ]
    lowest: Annotated[float, _degrees("Lowest temperature for which the law holds.")]
    highest: Annotated[float, _degrees("Highest temperature for which it holds.")]
    start: Annotated[float, _degrees("Temperature at the start and after a reset.")]
    ambient: Annotated[float, _degrees("Temperature of the surroundings.")]
    capacity: Annotated[Positive, quantity("J/K", "Heat capacity of the joint.", le=1e9)]
    resistance: Annotated[Positive, quantity("K/W", "Between joint and surroundings.", le=1e6)]
    viscous_scale: Annotated[
        float, quantity("K", "Rise that takes viscous friction to 1/e.", ge=1.0, le=1000.0)
    ]
    viscous_floor: Annotated[
        float, _share("Share of viscous friction that stays however warm it is.")
    ] = 0.0
    speed_slope: Annotated[
        float, _slope("Growth of the Stribeck velocity, share of that at the reference.")
    ] = 0.0
    static_slope: Annotated[
        float, _slope("Growth of static less Coulomb torque, share of that at the reference.")
    ] = 0.0
    motor_share: Annotated[
        float, _share("Share of the heat of the motor's winding that comes to the joint.")
    ] = 1.0

    @model_validator(mode="after")
    def _check_range(self) -> TemperaturePart:
        if not self.lowest < self.highest:
            raise refusal("lowest", self.lowest, f"below highest = {self.highest:g} °C")
        held = (
            f"from lowest to highest, where the law holds, [{self.lowest:g}, {self.highest:g}] °C"
        )
        for name, value in (("start", self.start), ("ambient", self.ambient)):
            if not self.lowest <= value <= self.highest:
                raise refusal(name, value, held)
        for name, slope in (("speed_slope", self.speed_slope), ("static_slope", self.static_slope)):
            for end in (self.lowest, self.highest):
                factor = 1.0 + slope * (end - self.reference)
                if not factor > 0.0:
                    accepted = f"a growth that leaves more than 0 times at {end:g} °C; this leaves {factor:.3g} times"
                    raise refusal(name, slope, accepted)
        return self

    @property
    def viscous_range(self) -> tuple[float, float]:
        """Return the least and the largest number that the viscous friction of a run is multiplied with."""
        rise = np.array([self.highest, min(self.start, self.ambient)]) - self.reference
        warm, cold = self.viscous_floor + (1.0 - self.viscous_floor) * np.exp(
            -rise / self.viscous_scale
        )
        return float(warm), float(cold)

    def weakest(self, element: Any) -> Any:
        """Return an element that has nowhere more friction than this one has at any temperature."""
        ends = np.array([self.lowest, self.highest]) - self.reference
        speed = float(np.min(1.0 + self.speed_slope * ends))
        share = min(1.0, float(np.min(1.0 + self.static_slope * ends)))
        static = [
            max(coulomb, static + (share - 1.0) * (static - coulomb))
            for coulomb, static in zip(element.tau_c.both, element.tau_s.both, strict=True)
        ]
        return element.replaced(
            omega_s=element.omega_s * min(1.0, speed),
            tau_s=dict(zip(SIGNS, static, strict=True)),
            temperature=None,
        )


_PLAIN = ("reference", "highest", "start", "ambient", "resistance", "speed_slope", "static_slope")


def temperature_dtype(width: int) -> RecordType:
    """Return the type of the constants; a slope, or the share that fades, is 0 where the part is off."""
    names = (*_PLAIN, "inverse_scale", "fading", "gain", "motor")
    return record_type(used=np.int64, **dict.fromkeys(names, width))


def temperature_state_dtype(width: int) -> RecordType:
    """Return the type of the state."""
    return record_type(
        temperature=width,  # degrees Celsius
        viscous=width,  # factor of c2
        speed=width,  # factor of 1 / omega_s
        static=width,  # by how much static less Coulomb torque has grown, a share of it
        work=width,  # of friction in this tick, J
        stored=width,  # in the bristles at the start of the tick, J
        heat=width,  # of friction and motor since the start, J
    )


def fill_temperature(
    record: Any, e: int, part: TemperaturePart, surroundings: Surroundings
) -> None:
    """Write the constants of element e."""
    record["used"] = 1
    values = part.numbers()
    for name in _PLAIN:
        record[name][e] = values[name]
    record["inverse_scale"][e] = 1.0 / part.viscous_scale
    record["fading"][e] = 1.0 - part.viscous_floor
    record["gain"][e] = -exponential_less_one_of(
        -surroundings.period / (part.capacity * part.resistance)
    )
    record["motor"][e] = part.motor_share * surroundings.motor_heat[e]


@inlined
def start_temperatures(part: Any, state: Any, width: int) -> None:
    """Begin with the temperatures that the elements start with, and undeflected bristles."""
    store(state.temperature, load(part.start, width))
    nothing = 0.0 * load(part.start, width)
    store(state.work, nothing)
    store(state.stored, nothing)
    store(state.heat, nothing)
    follow_temperatures(part, state, width)


@inlined
def follow_temperatures(part: Any, state: Any, width: int) -> None:
    """Write the parameters of the elements at the present temperatures."""
    now = load(state.temperature, width)
    highest = load(part.highest, width)
    above = select(now > highest, highest, now) - load(part.reference, width)
    store(
        state.viscous,
        fma(
            load(part.fading, width),
            exponential_less_one(-above * load(part.inverse_scale, width)),
            1.0,
        ),
    )
    store(state.speed, 1.0 / fma(load(part.speed_slope, width), above, 1.0))
    store(state.static, load(part.static_slope, width) * above)


@inlined
def warm_static(state: Any, coulomb: Lanes, static: Lanes, width: int) -> Lanes:
    """Return the static torque of elements at their temperatures, Nm, for one sign of the velocity."""
    return fma(load(state.static, width), static - coulomb, static)


@inlined
def add_work(state: Any, torque: Lanes, velocity: Lanes, step: float, width: int) -> None:
    """Add the work of friction in a step: torques, Nm, at velocities, rad/s."""
    store(state.work, fma(step * torque, velocity, load(state.work, width)))


@inlined
def advance_temperatures(
    part: Any, state: Any, stored: Lanes, motor: Lanes, period: float, width: int
) -> None:
    """Warm the joints over a tick.

    Args:
        part: record of `temperature_dtype(width)`.
        state: record of `temperature_state_dtype(width)`, advanced in place.
        stored: energy of the bristles now, J.
        motor: squares of the torques of the elements' motors, Nm^2, each times the winding's resistance over that at
            its reference temperature.
        period: of a tick, s.
        width: elements, a literal.
    """
    heat = (
        load(state.work, width)
        - (stored - load(state.stored, width))
        + period * load(part.motor, width) * motor
    )
    store(state.stored, stored)
    store(state.work, 0.0 * heat)
    store(state.heat, load(state.heat, width) + heat)
    before = load(state.temperature, width)
    end = fma(load(part.resistance, width), heat / period, load(part.ambient, width))
    store(state.temperature, fma(load(part.gain, width), end - before, before))
    follow_temperatures(part, state, width)


@inlined
def warmed(_parts: Any, state: Any, present: Present, _moment: Moment, width: int) -> Present:
    """Change static torque, Stribeck velocity and viscous friction by the present temperature."""
    return Present(
        present.tau_c,
        (
            warm_static(state.temperature, present.tau_c[0], present.tau_s[0], width),
            warm_static(state.temperature, present.tau_c[1], present.tau_s[1], width),
        ),
        present.inverse_omega_s * load(state.temperature.speed, width),
        present.c2 * load(state.temperature.viscous, width),
        present.scale,
        present.coulomb,
        present.static,
    )


TEMPERATURE = Part(
    (TemperaturePart,),
    temperature_dtype,
    fill_temperature,
    state=temperature_state_dtype,
    present=warmed,
)
