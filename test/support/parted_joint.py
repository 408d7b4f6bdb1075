"""Seven friction elements with parts along prescribed motions, for the tests of the parts."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from rx90_common.base.arrays import Array
from rx90_common.description.coupling import RX_WRIST
from rx90_common.friction import FrictionElement
from rx90_common.friction.compiled_elements import element_arrays
from rx90_common.friction.parts.step import (
    advance_parts,
    fill_parts,
    parts_dtype,
    parts_energy,
    parts_state_dtype,
    parts_step,
    reset_parts,
    tick_parts,
)
from rx90_common.friction.parts.temperature import add_work, advance_temperatures
from rx90_common.friction.signs import SIGNS
from rx90_common.kernels.compiled import kernel
from rx90_common.kernels.lanes import load, store

Record = NDArray[Any]
SPEED = 5.0  # rad/s up to which `any_element` is passive
GEAR = np.array([100.0, 90.0, 80.0, 60.0, 50.0, 30.0, 30.0])


class Seven(NamedTuple):
    elements: Record
    parts: Record
    states: Record
    z: Array

    @classmethod
    def of(cls, elements: Sequence[FrictionElement], period: float = 2.5e-4, seed: int = 0) -> Seven:
        parts = np.zeros(1, parts_dtype(RX_WRIST.size.elements))
        fill_parts(parts[0], elements, GEAR, period, seed)
        seven = cls(
            element_arrays(elements), parts, np.zeros(1, parts_state_dtype(RX_WRIST.size.elements)), np.zeros(7)
        )
        begin(parts, seven.states, np.zeros(7))
        return seven


@kernel
def begin(parts: Record, states: Record, transmitted: Array) -> None:
    """Let the parts begin with transmitted torques, Nm, shape (7,)."""
    reset_parts(parts[0], states[0], load(transmitted, 7), 7)


@kernel
def follow(seven: Seven, motion: Array, step: float, torque: Array, stored: Array) -> None:
    """Run along angles, velocities and transmitted torques, (n, 3, 7), to mean torques, Nm, and energies, J."""
    elements, parts, state, z = seven.elements[0], seven.parts[0], seven.states[0], seven.z
    for k in range(len(motion)):
        deflection, mean = parts_step(
            elements, parts, state, load(z, 7), load(motion[k, 0], 7), load(motion[k, 1], 7), step, 7
        )
        store(z, deflection)
        store(torque[k], mean)
        energy = parts_energy(elements, parts, state, deflection, 7)
        store(stored[k], energy)
        if parts.temperature.used:
            add_work(state.temperature, mean, load(motion[k, 1], 7), step, 7)
            advance_temperatures(parts.temperature, state.temperature, energy, 0.0 * energy, step, 7)
        advance_parts(parts, state, load(motion[k, 2], 7), step, 7)
        tick_parts(parts, state, load(motion[k, 2], 7), step, 7)


def along(seven: Seven, motion: Array, step: float) -> tuple[Array, Array]:
    """Return torque, Nm, and stored energy, J, along a motion, each of shape (n, 7)."""
    torque, stored = np.empty((2, len(motion), 7))
    follow(seven, np.ascontiguousarray(motion), step, torque, stored)
    return torque, stored


def any_element(rng: np.random.Generator, **parts: Any) -> FrictionElement:
    size = 10.0 ** rng.uniform(-1, 2)
    tau_c = size * rng.uniform(0.6, 1.4, 2)
    tau_s = tau_c * rng.uniform(1.0, 1.8, 2)
    values = {
        "tau_c": dict(zip(SIGNS, tau_c.tolist(), strict=True)),
        "tau_s": dict(zip(SIGNS, tau_s.tolist(), strict=True)),
        "omega_s": rng.uniform(0.01, 0.2),
        "delta": rng.choice([0.7, 1.0, 2.0]).item(),
        "c0": size * 10.0 ** rng.uniform(3, 4),
        "c1": 0.0,
        "c2": size * rng.uniform(0.0, 0.5),
        "alpha": rng.choice([0.6, 1.0, 1.5]).item(),
    }
    element = FrictionElement.of({**values, **parts})
    return element.replaced(c1=0.9 * element.passive_damping(SPEED))


def steady(element: FrictionElement, v: float, load: float = 0.0, warm: float = 0.0, wave: float = 1.0) -> float:
    """Return the torque of steady sliding by the equations of Bittencourt and Gunnarsson, and BAM's quadratic term."""
    sign, part, driving = "positive" if v >= 0 else "negative", element.load, load * v >= 0
    coulomb, static = (element.parameters[f"{name}_{sign}"] for name in ("tau_c", "tau_s"))
    rise, speed, omega_s, viscous = static - coulomb, abs(v), element.omega_s, float(element.viscous_torque(abs(v)))
    if (law := element.temperature) is not None:
        above = min(warm, law.highest) - law.reference
        rise *= 1 + law.static_slope * above
        omega_s *= 1 + law.speed_slope * above
        viscous *= law.viscous_floor + (1 - law.viscous_floor) * np.exp(-above / law.viscous_scale)
    dry = wave * (coulomb + rise * np.exp(-((speed / omega_s) ** element.delta)))
    if part is not None:
        k, s, m = (
            (part.driving, part.stribeck_driving, part.quadratic_driving)
            if driving
            else (part.driven, part.stribeck_driven, part.quadratic_driven)
        )
        fading = np.exp(-((speed / (part.omega_s or omega_s)) ** element.delta))
        dry += k * abs(load) + (s * abs(load) + m * load**2) * fading
    return float(np.sign(v) * (dry + viscous))
