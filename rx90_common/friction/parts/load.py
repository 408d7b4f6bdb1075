"""Load: Coulomb and static torque grow with the torque that the joint transmits to its link.

    tau_c + k(dir) |l|                                                       Coulomb torque
    tau_s + (k(dir) + s(dir)) |l| + m(dir) l^2                               static torque
    relax_time dl/dt = tau_t - l                                             transmitted torque l
    tau_t = drive torque - friction, brakes included - B a                   B: inertia of the rotors

dir is `driving` where l v >= 0: the motor moves the link; `driven` elsewhere: the link moves the motor, as in lowering
a mass. At v = 0 it is `driving`.

With `omega_s` the load's share of the static torque decreases with a Stribeck velocity of its own, whatever the
element's:
(s |l| + m l^2) exp(-(|v| / omega_s)^delta) comes to the sliding torque, as Bittencourt and Gunnarsson have it.

k and s are Bittencourt and Gunnarsson's F_c,tau and F_s,tau (2012, Static friction in a robot joint, J. Dyn. Sys. Meas.
Control 134(5) 051013), which have one value for both directions. Duclusaud and others (2024, Extended friction models
for the physics simulation of servo actuators, arXiv 2410.08650) write their load as the torque on the gears,
|tau_m - tau_e|, of motor torque and external torque; in steady sliding under a constant load tau_e = -l and
tau_m = l + friction, so that their models are

    M3    driving = 2 K_l / (1 - K_l), driven = 2 K_l / (1 + K_l)
    M4    also stribeck_driving = 2 K_ls, stribeck_driven = 2 K_ls, to first order in K
    M5    driving = (K_m + K_e) / (1 - K_m), driven = (K_m + K_e) / (1 + K_m); stribeck_ from K_ms and K_es likewise
    M6    also quadratic_driving = K_q of the external torque, quadratic_driven = K_q of the motor's; both fade with
          speed, as in the source

and their Coulomb torque is 1 / (1 -+ K) of the one here: to first order in K the same.

Friction that depends on the transmitted torque, which depends on friction, is an algebraic loop. Here l is a state
with a time constant of its own, so that the law is defined in continuous time and does not depend on the step. A step
extrapolates l to its midpoint from the slope of the last one, and advances l exactly for a constant tau_t: second
order.
The loop's gain is below 1 if the coefficients are, and the step is then stable for every relax_time not below it.

The part only adds to the sliding torque, so it does not reduce the passivity of the element.
"""

from __future__ import annotations

from typing import Annotated, Any, TypeAlias

import numpy as np
from pydantic import Field, model_validator

from rx90_common.base.arrays import RecordType, record_type
from rx90_common.base.models import NotNegative, Positive, quantity, refusal
from rx90_common.friction.parts.part import (
    MIN_SPEED,
    FrictionPart,
    Moment,
    Part,
    Present,
    Surroundings,
)
from rx90_common.kernels.compiled import inlined
from rx90_common.kernels.elementary import exponential, power
from rx90_common.kernels.lanes import Lanes, absolute, fma, load, select, store

DIRECTIONS = ("driving", "driven")
"""Of the power flow, in the order in which everything keeps them."""

RELAX_TIME = 1e-3
"""Time constant with which the friction follows the load, unless a file gives another, s."""

LARGEST_COEFFICIENT = 0.95
"""Largest Coulomb torque over load torque: below 1 the loop above is stable."""

_Coefficient: TypeAlias = Annotated[NotNegative, quantity("1", "", le=LARGEST_COEFFICIENT)]
_Quadratic: TypeAlias = Annotated[NotNegative, quantity("1/Nm", "", le=1.0)]


class LoadPart(FrictionPart):
    """Friction by the torque that the joint transmits.

    The equations stand in this module's docstring.
    """

    driving: Annotated[
        _Coefficient,
        Field(
            description="Share of the load torque by which friction grows where the motor moves the link."
        ),
    ]
    driven: Annotated[_Coefficient, Field(description="The same where the link moves the motor.")]
    stribeck_driving: Annotated[
        _Coefficient, Field(description="Share by which static torque grows beyond driving.")
    ] = 0.0
    stribeck_driven: Annotated[
        _Coefficient, Field(description="Share by which static torque grows beyond driven.")
    ] = 0.0
    quadratic_driving: Annotated[
        _Quadratic,
        Field(description="Growth of static torque by the square of the load torque, driving."),
    ] = 0.0
    quadratic_driven: Annotated[
        _Quadratic,
        Field(description="Growth of static torque by the square of the load torque, driven."),
    ] = 0.0
    omega_s: Annotated[
        NotNegative,
        quantity(
            "rad/s",
            "Stribeck velocity of the load's share; 0: that of the element.",
            le=1e6,
        ),
    ] = 0.0
    relax_time: Annotated[
        Positive,
        quantity(
            "s",
            "Time in which friction follows the load, at least the plant's step.",
            le=1.0,
        ),
    ] = RELAX_TIME

    @model_validator(mode="after")
    def _check_speed(self) -> LoadPart:
        if 0.0 < self.omega_s < MIN_SPEED:
            raise refusal(
                "omega_s",
                self.omega_s,
                f"0 for that of the element, or a number in [{MIN_SPEED:g}, 1e+06]",
            )
        return self


def load_dtype(width: int) -> RecordType:
    """Return the type of the constants: a row for each of DIRECTIONS; the rate is 0 where the part is off."""
    rows = (len(DIRECTIONS), width)
    return record_type(
        fades=np.int64,  # 1 if any load's share has a Stribeck velocity of its own
        coulomb=rows,
        stribeck=rows,
        quadratic=rows,
        inverse_omega_s=width,  # 0 for the element's
        rate=width,
    )


def load_state_dtype(width: int) -> RecordType:
    """Return the type of the state: the load, Nm, and its slope over the last step, Nm/s."""
    return record_type(torque=width, slope=width)


def fill_load(record: Any, e: int, part: LoadPart, _: Surroundings) -> None:
    """Write the constants of element e."""
    record["coulomb"][:, e] = part.driving, part.driven
    record["stribeck"][:, e] = part.stribeck_driving, part.stribeck_driven
    record["quadratic"][:, e] = part.quadratic_driving, part.quadratic_driven
    if part.omega_s > 0.0:
        record["fades"] = 1
        record["inverse_omega_s"][e] = 1.0 / part.omega_s
    record["rate"][e] = 1.0 / part.relax_time


@inlined
def loaded(parts: Any, state: Any, present: Present, moment: Moment, width: int) -> Present:
    """Add the load's share of Coulomb and static torque.

    A share with a Stribeck velocity of its own counts as Coulomb torque, as large as it is at this velocity.
    """
    part = parts.load
    transmitted = fma(moment.ahead, load(state.load.slope, width), load(state.load.torque, width))
    driving = transmitted * moment.velocity >= 0.0
    size = absolute(transmitted)
    coulomb = size * select(driving, load(part.coulomb[0], width), load(part.coulomb[1], width))
    stribeck = select(driving, load(part.stribeck[0], width), load(part.stribeck[1], width))
    quadratic = select(driving, load(part.quadratic[0], width), load(part.quadratic[1], width))
    rise = size * (stribeck + size * quadratic)
    if part.fades:
        inverse = load(part.inverse_omega_s, width)
        fades = inverse > 0.0
        decay = exponential(-power(absolute(moment.velocity) * inverse, moment.delta))
        coulomb = coulomb + select(fades, rise * decay, 0.0)
        rise = select(fades, 0.0, rise)
    return Present(
        present.tau_c,
        present.tau_s,
        present.inverse_omega_s,
        present.c2,
        present.scale,
        present.coulomb + coulomb,
        present.static + (coulomb + rise),
    )


@inlined
def settle_load(_parts: Any, state: Any, transmitted: Lanes, _step: float, _width: int) -> Lanes:
    """Begin with the transmitted torques, Nm."""
    store(state.load.torque, transmitted)
    store(state.load.slope, 0.0 * transmitted)
    return transmitted


@inlined
def advance_load(parts: Any, state: Any, transmitted: Lanes, step: float, width: int) -> Lanes:
    """Let the loads follow the transmitted torque, Nm, over a step, s: exactly, for a constant torque."""
    before = load(state.load.torque, width)
    change = (transmitted - before) * (1.0 - exponential(-step * load(parts.load.rate, width)))
    store(state.load.torque, before + change)
    store(state.load.slope, change / step)
    return transmitted


LOAD = Part(
    (LoadPart,),
    load_dtype,
    fill_load,
    state=load_state_dtype,
    present=loaded,
    settle=settle_load,
    advance=advance_load,
)
