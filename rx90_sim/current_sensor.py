"""The amplifiers' current sensors in compiled code: what they report, and what their errors do to the torque.

    reported = resolution round((i + offset + noise) / resolution)

The current loop regulates what is reported, not the current i. The control law's loop of first order, whose current is
the one without errors, then leaves a current that is off by e, which follows the error through the loop's lag:

    i = i_without - e,   e(t + T) = e + (1 - exp(-2 pi bandwidth T)) (reported - i - e)

as equating both loops gives, tick by tick. So an offset does not show in the mean of what a drive reports: it is a
torque that the drive does not know of.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from rx90_common.base.arrays import Array
from rx90_common.description.current_sensor import CurrentSensor
from rx90_common.kernels.compiled import kernel
from rx90_common.kernels.elementary_arrays import exponential_less_one_of
from rx90_common.kernels.random_numbers import GOLDEN, mixed, nearly_normal
from rx90_sim.drives import whole_steps

SENSOR_DTYPE = np.dtype(
    [
        ("used", np.int64),
        ("seed", np.uint64),
        ("offset", np.float64, 6),
        ("noise", np.float64, 6),
        ("resolution", np.float64, 6),
        ("gain", np.float64),  # of the current loop, for a tick
        ("torque_constant", np.float64, 6),
    ],
    align=True,
)
"""Constants, A."""

SENSOR_STATE_DTYPE = np.dtype(
    [
        ("counter", np.uint64, 6),
        ("error", np.float64, 6),  # by how much the current is less than without errors, A
        ("torque", np.float64, 6),  # reported, motor side, Nm
    ],
    align=True,
)

_STREAM = np.uint64(1 << 32)
"""The sequences of the sensors begin away from those of the friction."""


def fill_sensor(record: Any, sensor: CurrentSensor, torque_constant: Array, period: float, seed: int) -> None:
    """Write the constants for a tick of `period`, s."""
    record["used"] = sensor.used
    if sensor.used:
        record["seed"], record["torque_constant"] = seed, torque_constant
        record["gain"] = -exponential_less_one_of(-2.0 * math.pi * sensor.bandwidth * period)
        for name in ("offset", "noise", "resolution"):
            record[name] = getattr(sensor, name)


@kernel
def reset_sensors(sensor: Any, state: Any) -> None:
    """Begin without a current, with random numbers that are always the same for a seed."""
    for i in range(6):
        state.counter[i] = mixed(sensor.seed + mixed(_STREAM + np.uint64(i)))
        state.error[i] = 0.0
        _measure(sensor, state, i, 0.0)


@kernel
def sense_currents(sensor: Any, state: Any, torque: Array, powered: bool) -> None:
    """Take the errors off motor torques, Nm, shape (6,), and write what is reported of them."""
    for i in range(6):
        if powered:
            torque[i] -= sensor.torque_constant[i] * state.error[i]
        current = torque[i] / sensor.torque_constant[i]
        reported = _measure(sensor, state, i, current)
        state.error[i] += sensor.gain * (reported - current - state.error[i])


@kernel
def _measure(sensor: Any, state: Any, motor: int, current: float) -> float:
    state.counter[motor] += GOLDEN
    shown: float = current + sensor.offset[motor] + sensor.noise[motor] * nearly_normal(mixed(state.counter[motor]))
    if sensor.resolution[motor] > 0.0:
        shown = whole_steps(shown, sensor.resolution[motor])
    state.torque[motor] = sensor.torque_constant[motor] * shown
    return shown
