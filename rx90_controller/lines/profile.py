"""The trapezoidal velocity profile along a line: even acceleration, constant speed, even deceleration."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from rx90_common.base.arrays import Array
from rx90_common.base.errors import LineError


class PathMotion(NamedTuple):
    """Distance in m, speed in m/s and acceleration in m/s² along the line, each of the shape of the times."""

    distance: Array
    speed: Array
    acceleration: Array


@dataclass(frozen=True)
class TrapezoidalProfile:
    """A motion from rest to rest; a triangle where the line is too short to reach the speed.

    Attributes:
        length: m.
        speed: the speed asked for, m/s.
        acceleration: of both ramps, m/s².
    """

    length: float
    speed: float
    acceleration: float

    def __post_init__(self) -> None:
        for name, unit in (("length", "m"), ("speed", "m/s"), ("acceleration", "m/s^2")):
            value = getattr(self, name)
            if not (math.isfinite(value) and value > 0.0):
                raise LineError(f"the line's {name} is {value:g} {unit}; accepted: a number > 0")

    @property
    def peak_speed(self) -> float:
        """Return the highest speed reached, m/s."""
        return min(self.speed, math.sqrt(self.length * self.acceleration))

    @property
    def ramp_time(self) -> float:
        """Return the duration of one ramp, s."""
        return self.peak_speed / self.acceleration

    @property
    def duration(self) -> float:
        """Return the duration from rest to rest, s."""
        return self.length / self.peak_speed + self.ramp_time

    @property
    def corners(self) -> tuple[float, ...]:
        """Return the times at which the acceleration jumps, s."""
        end, ramp = self.duration, self.ramp_time
        if self.peak_speed < self.speed:
            return (0.0, ramp, end)
        return (0.0, ramp, end - ramp, end)

    def sample(self, times: Array) -> PathMotion:
        """Return the motion at `times`, s, shape (n,): at rest before 0 and after the duration."""
        end, ramp = self.duration, self.ramp_time
        # The second half is measured back from the end, so that it ends exactly at rest.
        late = times > end / 2.0
        t = np.where(late, end - times, times)
        within = t >= 0.0
        t = np.maximum(t, 0.0)
        ramping = t < ramp
        half = self.acceleration * t * t / 2.0
        distance = np.where(ramping, half, self.peak_speed * (t - ramp / 2.0))
        speed = np.where(ramping, self.acceleration * t, self.peak_speed)
        acceleration = np.where(ramping & within, self.acceleration, 0.0)
        return PathMotion(
            np.where(late, self.length - distance, distance),
            speed,
            np.where(late, -acceleration, acceleration),
        )

    def speed_at(self, distance: Array) -> Array:
        """Return the speed in m/s at `distance` m from the start, shape (n,)."""
        to_end = np.minimum(distance, self.length - distance)
        return np.minimum(self.peak_speed, np.sqrt(2.0 * self.acceleration * np.maximum(to_end, 0.0)))
