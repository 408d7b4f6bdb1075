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

from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from typing import Annotated, Any, Final

import numpy as np

from rx90_common.base.entries import Number
from rx90_common.base.errors import ConfigError
from rx90_common.friction.parts.part import MIN_SPEED, FrictionPart
from rx90_common.kernels.compiled import inlined
from rx90_common.kernels.elementary import exponential, power
from rx90_common.kernels.lanes import Lanes, absolute, load, select, store

DIRECTIONS = ("driving", "driven")
"""Of the power flow, in the order in which everything keeps them."""

RELAX_TIME = 1e-3
"""Time constant with which the friction follows the load, unless a file gives another, s."""

LARGEST_COEFFICIENT: Final = 0.95
"""Largest Coulomb torque over load torque: below 1 the loop above is stable."""

_coefficient = partial(Number, unit="1", low=0.0, high=LARGEST_COEFFICIENT)
_quadratic = partial(Number, unit="1/Nm", low=0.0, high=1.0)


@dataclass(frozen=True)
class LoadPart(FrictionPart):
    """Friction that grows with the transmitted torque; equations in this module's docstring."""

    name = "load"
    about = "Friction by the torque that the joint transmits."

    driving: Annotated[
        float, _coefficient("Share of the load torque by which friction grows where the motor moves the link.")
    ]
    driven: Annotated[float, _coefficient("The same where the link moves the motor.")]
    stribeck_driving: Annotated[float, _coefficient("Share by which static torque grows beyond driving.")] = 0.0
    stribeck_driven: Annotated[float, _coefficient("Share by which static torque grows beyond driven.")] = 0.0
    quadratic_driving: Annotated[
        float, _quadratic("Growth of static torque by the square of the load torque, driving.")
    ] = 0.0
    quadratic_driven: Annotated[
        float, _quadratic("Growth of static torque by the square of the load torque, driven.")
    ] = 0.0
    omega_s: Annotated[
        float, Number("Stribeck velocity of the load's share; 0: that of the element.", "rad/s", low=0.0, high=1e6)
    ] = 0.0
    relax_time: Annotated[
        float,
        Number(
            "Time in which friction follows the load, at least the plant's step.", "s", low=0.0, high=1.0, above=True
        ),
    ] = RELAX_TIME

    def __post_init__(self) -> None:
        super().__post_init__()
        if 0.0 < self.omega_s < MIN_SPEED:
            raise ConfigError(
                f"load: omega_s is {self.omega_s:g} rad/s; accepted: 0 for that of the element, or a number in "
                f"[{MIN_SPEED:g}, 1e+06]"
            )


def load_dtype(width: int) -> np.dtype[np.void]:
    """Return the type of the constants: a row for each of DIRECTIONS; the rate is 0 where the part is off."""
    rows = (len(DIRECTIONS), width)
    return np.dtype(
        [
            ("fades", np.int64),  # 1 if any load's share has a Stribeck velocity of its own
            ("coulomb", np.float64, rows),
            ("stribeck", np.float64, rows),
            ("quadratic", np.float64, rows),
            ("inverse_omega_s", np.float64, (width,)),  # 0 for the element's
            ("rate", np.float64, (width,)),
        ],
        align=True,
    )


def fill_load(record: Any, parts: Sequence[LoadPart | None]) -> None:
    """Write the constants, an element for each of `parts`."""
    for i, part in enumerate(parts):
        if part is not None:
            for row, direction in enumerate(DIRECTIONS):
                record["coulomb"][row, i] = getattr(part, direction)
                record["stribeck"][row, i] = getattr(part, f"stribeck_{direction}")
                record["quadratic"][row, i] = getattr(part, f"quadratic_{direction}")
            if part.omega_s > 0.0:
                record["fades"] = 1
                record["inverse_omega_s"][i] = 1.0 / part.omega_s
            record["rate"][i] = 1.0 / part.relax_time


@inlined
def load_torques(part: Any, transmitted: Lanes, velocity: Lanes, delta: Lanes, width: int) -> tuple[Lanes, Lanes]:
    """Return the increase of Coulomb and static torque, Nm, by a load, Nm, at a velocity, rad/s.

    A share with a Stribeck velocity of its own counts as Coulomb torque, as large as it is at this velocity.
    """
    driving = transmitted * velocity >= 0.0
    size = absolute(transmitted)
    coulomb = size * select(driving, load(part.coulomb[0], width), load(part.coulomb[1], width))
    stribeck = select(driving, load(part.stribeck[0], width), load(part.stribeck[1], width))
    quadratic = select(driving, load(part.quadratic[0], width), load(part.quadratic[1], width))
    rise = size * (stribeck + size * quadratic)
    if part.fades:
        inverse = load(part.inverse_omega_s, width)
        own = inverse > 0.0
        coulomb = coulomb + select(own, rise * exponential(-power(absolute(velocity) * inverse, delta)), 0.0)
        rise = select(own, 0.0, rise)
    return coulomb, coulomb + rise


@inlined
def advance_load(part: Any, state: Any, transmitted: Lanes, step: float, width: int) -> None:
    """Let the loads follow the transmitted torque, Nm, over a step, s: exactly, for a constant torque."""
    before = load(state.load, width)
    change = (transmitted - before) * (1.0 - exponential(-step * load(part.rate, width)))
    store(state.load, before + change)
    store(state.load_slope, change / step)
