"""The drives in compiled code: cogging of the motors, heat of the windings, errors of current sensors, resolvers.

**Cogging.** torque = sum of a_k cos(h_k angle + p_k) is the derivative of an energy. A step applies the mean torque
over the motor's motion in it, the difference of that energy divided by the motion: each wave's torque at the middle of
the motion times sin(h motion / 2) / (h motion / 2). So no energy is gained or lost if a step covers much of a wave, and
a wave that passes in less than two steps is not aliased into a slow one.

**Windings.** C dT/dt = R I^2 (1 + a (T - T_r)) - (T - T_a) / R_th is linear in T if the current I is constant, as it is
within a tick, and is advanced exactly. Above the temperature `derating` the peak current falls linearly and is 0 at
`limit`: servo amplifiers reduce their current before they switch off, so that a motor that is too warm still brakes. If
the arm then cannot follow its set-points, the controller's supervision switches off.

**Current sensors.** reported = resolution round((i + offset + noise) / resolution). The current loop regulates the
reported current, not the actual one i. The control law's loop of first order computes the current without sensor
errors;
the actual current differs from it by e, which follows the error with the loop's lag:

    i = i_without - e,   e(t + T) = e + (1 - exp(-2 pi bandwidth T)) (reported - i - e)

which results tick by tick from equating both loops. So an offset does not appear in the mean of the reported current:
it is a torque that the drive cannot measure.

**Resolvers** have a tracking converter. It rounds the position to its counts, but its velocity is the analog signal
inside the tracking loop (Analog Devices, data sheet of the AD2S83: it replaces a tachogenerator), so counts do not
appear in it. If it followed the counts, it would jump by 1.05 mrad/s for one count of joint 2, to which the velocity
loop would respond with 6.3 Nm.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from rx90_common.base.arrays import Array, Record, RecordType, record_type
from rx90_common.description.coupling import add_drive_torques, to_motor
from rx90_common.description.drives import MAX_TERMS, Cogging, CurrentSensor, Windings
from rx90_common.friction.bristle import decay
from rx90_common.kernels.compiled import inlined, kernel
from rx90_common.kernels.elementary import (
    GOLDEN,
    WHOLE,
    exponential_less_one_of,
    mixed,
    nearly_normal,
    sine_cosine,
    sines_cosines,
)
from rx90_common.kernels.lanes import Lanes, Number, absolute, fma, load, select, size, store

# rad; below it the series of sin(x) / x is exact to rounding, and 0 is not divided by
_SMALL = 1e-2
_STREAM = np.uint64(1 << 32)  # the sequences of the sensors begin away from those of the friction


def cogging_dtype(motors: int) -> RecordType:
    """Return the type of the constants: torque = cosine cos(h angle) - sine sin(h angle)."""
    waves = (MAX_TERMS, motors)
    return record_type(
        terms=np.int64,
        harmonic=MAX_TERMS,
        cosine=waves,  # Nm, joint side
        sine=waves,
    )


def cogging_state_dtype(motors: int) -> RecordType:
    """Return the type of the workspace: of the motors; torques joint side, Nm."""
    return record_type(angle=motors, speed=motors, torque=motors)


def fill_cogging(record: Any, cogging: Cogging, gear: Array) -> None:
    """Write the constants, with torques converted to the joints by the gears."""
    terms = len(cogging.harmonic)
    record["terms"] = terms
    record["harmonic"][:terms] = cogging.harmonic
    if terms:
        amplitude = np.array(cogging.amplitude)
        sine, cosine = sines_cosines(np.array(cogging.phase))
        record["cosine"][:terms] = gear * amplitude * cosine
        record["sine"][:terms] = gear * amplitude * sine


@inlined
def _mean_of_wave(half: Lanes) -> Lanes:
    """Return sin(half) / half, the mean of a wave over its value in the middle of a way of 2 half, rad."""
    small = absolute(half) < _SMALL
    sine, _ = sine_cosine(half)
    square = half * half
    return select(small, fma(square, fma(square, 1.0 / 120.0, -1.0 / 6.0), 1.0), sine / half)


@kernel
def add_cogging(
    plant: Any, state: Any, angle: Array, velocity: Array, torque: Array, step: float
) -> None:
    """Add the mean cogging over a step to torques of the joints.

    Args:
        plant: constants, `plant_dtype`.
        state: state, `state_dtype`.
        angle: of the joints as the motors have them, rad, in the middle of the step, shape (n,).
        velocity: the same, rad/s; mean over the step.
        torque: Nm, shape (n,).
        step: s.
    """
    motors = state.cogging
    cogging = plant.cogging
    to_motor(plant.gear, angle, motors.angle)
    to_motor(plant.gear, velocity, motors.speed)
    n = size(motors.angle)
    position = load(motors.angle, n)
    half = 0.5 * step * load(motors.speed, n)
    total = 0.0 * position
    for k in range(cogging.terms):
        harmonic = cogging.harmonic[k]
        sine, cosine = sine_cosine(harmonic * position)
        wave = load(cogging.cosine[k], n) * cosine - load(cogging.sine[k], n) * sine
        total = total + wave * _mean_of_wave(harmonic * half)
    store(motors.torque, total)
    add_drive_torques(plant.gear, motors.torque, torque)


def winding_dtype(motors: int) -> RecordType:
    """Return the type of the constants, motor side."""
    return record_type(
        used=np.int64,
        heat=motors,  # of the square of the torque at the reference temperature, K/s / Nm^2
        coefficient=(),
        reference=(),
        cooling=motors,  # 1/s
        ambient=(),
        initial=(),
        limit=(),
        slope=(),  # share of the peak current for each degree below the limit
    )


def fill_windings(record: Any, windings: Windings, torque_constant: Array) -> None:
    """Write the constants."""
    record["used"] = windings.used
    record["initial"] = windings.initial
    if windings.used:
        capacity = np.array(windings.heat_capacity)
        record["heat"] = windings.resistance / (capacity * torque_constant * torque_constant)
        record["cooling"] = 1.0 / (capacity * windings.thermal_resistance)
        record["slope"] = 1.0 / (windings.limit - windings.derating)
        for name in ("coefficient", "reference", "ambient", "limit"):
            record[name] = getattr(windings, name)


@kernel
def current_share(winding: Any, temperature: float) -> float:
    """Return the share of its peak current that an amplifier gives a winding of a temperature, degrees Celsius."""
    share: float = winding.slope * (winding.limit - temperature)
    return min(1.0, max(0.0, share))


@inlined
def relative_resistance(winding: Any, temperature: Lanes) -> Lanes:
    """Return the resistance of windings at their temperatures, degrees Celsius, over that at the reference."""
    resistance: Lanes = 1.0 + winding.coefficient * (temperature - winding.reference)
    return resistance


@kernel
def warm_windings(winding: Any, torque: Array, temperature: Array, duration: float) -> None:
    """Advance the temperatures, degrees Celsius, shape (n,), over a time, s, of constant torques, Nm, shape (n,)."""
    n = size(winding.heat)
    pushed = load(torque, n)
    before = load(temperature, n)
    heat = load(winding.heat, n) * pushed * pushed
    cooling = load(winding.cooling, n)
    rate = heat * relative_resistance(winding, before) - cooling * (before - winding.ambient)
    mean, _ = decay(duration * (cooling - heat * winding.coefficient))
    store(temperature, before + duration * rate * mean)


def current_shares(plant: Record, temperature: Array) -> Array:
    """Return the share of its peak current that each amplifier gives its winding, 1 where it is not too warm.

    Args:
        plant: constants, shape (1,), `plant_dtype`.
        temperature: of the windings, degrees Celsius, shape (n,).
    """
    winding = plant["winding"][0]
    return np.array(
        [current_share(winding, float(one)) if winding["used"] else 1.0 for one in temperature]
    )


def warm_motors(plant: Record, temperature: Array) -> str:
    """Return in words which amplifiers give less than their peak current; '' if none; arguments as above."""
    pairs = enumerate(zip(temperature, current_shares(plant, temperature), strict=True), 1)
    return ", ".join(
        f"motor_{k} at {warm:.1f} °C has {math.floor(100.0 * share)} % of its peak current"
        for k, (warm, share) in pairs
        if share < 1.0
    )


@inlined
def whole_steps(value: Number, step: Number) -> Number:
    """Return the output of a converter: the value rounded to whole multiples of its `step`, in the value's unit."""
    # Adding and subtracting a number whose last bit has the value 1 rounds to a whole number, half to even.
    whole = (value / step + WHOLE) - WHOLE
    return whole * step


def sensor_dtype(motors: int) -> RecordType:
    """Return the type of the constants, A."""
    return record_type(
        used=np.int64,
        seed=np.uint64,
        offset=motors,
        noise=motors,
        resolution=motors,
        gain=(),  # of the current loop, for a tick
        torque_constant=motors,
    )


def sensor_state_dtype(motors: int) -> RecordType:
    """Return the type of the state."""
    return record_type(
        ("counter", np.uint64, (motors,)),
        error=motors,  # by how much the current is less than without errors, A
        torque=motors,  # reported, motor side, Nm
    )


def fill_sensor(
    record: Any, sensor: CurrentSensor, torque_constant: Array, period: float, seed: int
) -> None:
    """Write the constants for a tick of `period`, s."""
    record["used"] = sensor.used
    if sensor.used:
        record["seed"] = seed
        record["torque_constant"] = torque_constant
        record["gain"] = -exponential_less_one_of(-2.0 * math.pi * sensor.bandwidth * period)
        for name in ("offset", "noise", "resolution"):
            record[name] = getattr(sensor, name)


@kernel
def reset_sensors(sensor: Any, state: Any) -> None:
    """Begin without a current, with random numbers that are always the same for a seed."""
    for i in range(size(state.error)):
        state.counter[i] = mixed(sensor.seed + mixed(_STREAM + np.uint64(i)))
        state.error[i] = 0.0
        _measure(sensor, state, i, 0.0)


@kernel
def sense_currents(sensor: Any, state: Any, torque: Array, powered: bool) -> None:
    """Subtract the current errors from motor torques, Nm, shape (n,), and write the reported torques."""
    for i in range(size(state.error)):
        if powered:
            torque[i] -= sensor.torque_constant[i] * state.error[i]
        current = torque[i] / sensor.torque_constant[i]
        reported = _measure(sensor, state, i, current)
        state.error[i] += sensor.gain * (reported - current - state.error[i])


@kernel
def _measure(sensor: Any, state: Any, motor: int, current: float) -> float:
    state.counter[motor] += GOLDEN
    shown: float = (
        current
        + sensor.offset[motor]
        + sensor.noise[motor] * nearly_normal(mixed(state.counter[motor]))
    )
    if sensor.resolution[motor] > 0.0:
        shown = whole_steps(shown, sensor.resolution[motor])
    state.torque[motor] = sensor.torque_constant[motor] * shown
    return shown
