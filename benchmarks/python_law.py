"""The same drives and control law in plain Python, as a user would write them around another simulator.

Plain floats, because for six motors they are faster than numpy's calls.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from rx90_emulator.loop.setup import Setup


class PythonDrives:
    """Resolvers with their converters, from joint positions to what the controller measures."""

    def __init__(self, setup: Setup, position: Sequence[float]) -> None:
        drives, rates = setup.drives, setup.rates
        self._gear = drives.gear.tolist()
        self._resolution = (2.0 * np.pi / drives.encoder_counts).tolist()
        pole = float(np.exp(-2.0 * np.pi * drives.velocity_bandwidth * rates.period))
        self._period = rates.period
        self._position_gain = 1.0 - pole**2
        self._velocity_gain = (1.0 - pole) ** 2 / rates.period
        self._observer = self._angles(position)
        self.position = self._counts(self._observer)
        self.velocity = [0.0] * 6

    def sample(self, q: Sequence[float]) -> None:
        """Sample the resolvers at joint positions, rad, and move the observer on by a tick."""
        angles = self._angles(q)
        self.position = self._counts(angles)
        for i in range(6):
            predicted = self._observer[i] + self._period * self.velocity[i]
            innovation = angles[i] - predicted
            self._observer[i] = predicted + self._position_gain * innovation
            self.velocity[i] += self._velocity_gain * innovation

    def _angles(self, q: Sequence[float]) -> list[float]:
        turns = [*q[:5], q[4] + q[5]]
        return [gear * turn for gear, turn in zip(self._gear, turns, strict=True)]

    def _counts(self, angles: Sequence[float]) -> list[float]:
        return [round(angle / step) * step for angle, step in zip(angles, self._resolution, strict=True)]


class PythonLaw:
    """The six servo controllers of section 5, motor side."""

    def __init__(self, setup: Setup) -> None:
        record = setup.controller.record(setup.robot, setup.drives, setup.rates)[0]
        names = [name for name in record.dtype.names or () if name != "current_gain"]
        self._constants = {name: record[name].tolist() for name in names}
        self._current_gain = float(record["current_gain"])
        self._velocity_reference = [0.0] * 6
        self._integrator = [0.0] * 6
        self._held = [0.0] * 6
        self._current = [0.0] * 6
        self._limited = [0] * 6

    def position_loop(self, setpoint: Sequence[Sequence[float]], position: Sequence[float]) -> None:
        """Run PI and feed-forward for joint set-points, shape (3, 6), and motor positions, rad."""
        c = self._constants
        for i in range(6):
            gear = c["gear"][i]
            if i == 5:
                reference, speed, acceleration = (gear * (row[4] + row[5]) for row in setpoint)
            else:
                reference, speed, acceleration = (gear * row[i] for row in setpoint)
            error = reference - position[i]
            if error * self._limited[i] <= 0.0:
                bound = c["integrator_limit"][i]
                self._integrator[i] = min(bound, max(-bound, self._integrator[i] + c["integral"][i] * error))
            sign = min(1.0, max(-1.0, speed / c["coulomb_velocity"][i]))
            viscous = c["viscous"][i] * math.copysign(abs(speed) ** c["viscous_exponent"][i], speed)
            forward = c["inertia"][i] * acceleration + c["coulomb"][i] * sign + viscous
            self._held[i] = c["proportional"][i] * error + self._integrator[i] + forward
            self._velocity_reference[i] = c["velocity_weight"][i] * speed

    def velocity_loop(self, velocity: Sequence[float]) -> list[float]:
        """Run D and the current loop for motor velocities, rad/s; return motor torques, Nm."""
        c, torques = self._constants, []
        derivative, constant, peaks, steps = c["derivative"], c["torque_constant"], c["peak_current"], c["current_step"]
        for i in range(6):
            damping = derivative[i] * (self._velocity_reference[i] - velocity[i])
            asked = (self._held[i] + damping) / constant[i]
            peak, step = peaks[i], steps[i]
            self._limited[i] = (asked > peak) - (asked < -peak)
            change = self._current_gain * (min(peak, max(-peak, asked)) - self._current[i])
            self._current[i] += min(step, max(-step, change))
            torques.append(constant[i] * self._current[i])
        return torques
