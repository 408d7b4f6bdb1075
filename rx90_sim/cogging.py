"""Cogging of the motors in compiled code: the mean torque over a step.

    torque = sum of a_k cos(h_k angle + p_k)

is the slope of an energy. What acts over a step is the mean along the way of the motor, the difference of that energy
over the way: each wave's torque at the middle of the way times sin(h way / 2) / (h way / 2). So no energy is gained or
lost where a step covers much of a wave, and a wave that passes in less than two steps is not aliased into a slow one.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from rx90_common.base.arrays import Array
from rx90_common.description.cogging import MOST_TERMS, Cogging
from rx90_common.description.wrist import to_motor
from rx90_common.kernels.compiled import inlined, kernel
from rx90_common.kernels.elementary import sine_cosine
from rx90_common.kernels.elementary_arrays import sines_cosines
from rx90_common.kernels.lanes import Lanes, absolute, fma, load, select, store

COGGING_DTYPE = np.dtype(
    [
        ("terms", np.int64),
        ("harmonic", np.float64, MOST_TERMS),
        ("cosine", np.float64, (MOST_TERMS, 6)),  # Nm, joint side
        ("sine", np.float64, (MOST_TERMS, 6)),
    ],
    align=True,
)
"""Constants: torque = cosine cos(h angle) - sine sin(h angle)."""

COGGING_STATE_DTYPE = np.dtype(
    [("angle", np.float64, 6), ("speed", np.float64, 6), ("torque", np.float64, 6)],  # of the motors; joint side, Nm
    align=True,
)
"""Workspace."""

_SMALL = 1e-2  # rad; below it the series of sin(x) / x is exact to rounding, and 0 is not divided by


def fill_cogging(record: Any, cogging: Cogging, gear: Array) -> None:
    """Write the constants, with torques as seen through the gears."""
    terms = len(cogging.harmonic)
    record["terms"] = terms
    record["harmonic"][:terms] = cogging.harmonic
    if terms:
        sine, cosine = sines_cosines(cogging.phase)
        record["cosine"][:terms] = gear * cogging.amplitude * cosine
        record["sine"][:terms] = gear * cogging.amplitude * sine


@inlined
def _mean_of_wave(half: Lanes) -> Lanes:
    """Return sin(half) / half, the mean of a wave over its value in the middle of a way of 2 half, rad."""
    small = absolute(half) < _SMALL
    sine, _ = sine_cosine(half)
    square = half * half
    return select(small, fma(square, fma(square, 1.0 / 120.0, -1.0 / 6.0), 1.0), sine / half)


@kernel
def add_cogging(plant: Any, state: Any, angle: Array, velocity: Array, torque: Array, step: float) -> None:
    """Add the mean cogging over a step to torques of the six joints.

    Args:
        plant: constants, PLANT_DTYPE.
        state: state, STATE_DTYPE.
        angle: of the joints as the motors have them, rad, in the middle of the step, shape (6,).
        velocity: the same, rad/s; mean over the step.
        torque: Nm, shape (6,).
        step: s.
    """
    motors, cogging = state.cogging, plant.cogging
    to_motor(plant.gear, angle, motors.angle)
    to_motor(plant.gear, velocity, motors.speed)
    turned, half = load(motors.angle, 6), 0.5 * step * load(motors.speed, 6)
    total = 0.0 * turned
    for k in range(cogging.terms):
        harmonic = cogging.harmonic[k]
        sine, cosine = sine_cosine(harmonic * turned)
        wave = load(cogging.cosine[k], 6) * cosine - load(cogging.sine[k], 6) * sine
        total = total + wave * _mean_of_wave(harmonic * half)
    store(motors.torque, total)
    for i in range(6):
        torque[i] += motors.torque[i]
    torque[4] += motors.torque[5]  # motor 6 turns with joints 5 and 6
