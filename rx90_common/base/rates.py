"""The base tick and the loops that run on whole multiples of it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from rx90_common.base.errors import ConfigError

NANOSECONDS = 1_000_000_000
TEMPERATURE_HZ = 1
"""Rate at which results have the temperatures of joints and windings, Hz."""


def message_time_ns(time: Any) -> int:
    """Return a builtin_interfaces Time or Duration in ns."""
    return int(time.sec) * NANOSECONDS + int(time.nanosec)


def ticks_per(name: str, base_hz: int, rate_hz: int) -> int:
    """Return how many base ticks make one period of `rate_hz`."""
    if rate_hz <= 0 or base_hz % rate_hz:
        divisors = [d for d in range(1, base_hz + 1) if base_hz % d == 0 and d * 40 >= base_hz]
        raise ConfigError(
            f"{name} is {rate_hz} Hz; accepted: a rate that divides {base_hz} Hz, "
            f"such as {', '.join(str(d) for d in divisors)}"
        )
    return base_hz // rate_hz


_LAST = 2.0**31
"""What a stamp of ROS ends before, s."""


@dataclass(frozen=True)
class Rates:
    """Rates of the loops.

    Attributes:
        base_hz: velocity loop, current loop and plant tick, Hz (4 kHz in the CS7B).
        position_hz: position loop and set-points, Hz (1 kHz in the CS7B).
    """

    base_hz: int = 4000
    position_hz: int = 1000

    def __post_init__(self) -> None:
        if self.base_hz <= 0 or NANOSECONDS % self.base_hz:
            raise ConfigError(
                f"base_rate is {self.base_hz} Hz; accepted: a positive rate whose period is a whole "
                "number of nanoseconds, such as 2000, 4000, 8000 or 10000"
            )
        ticks_per("position_rate", self.base_hz, self.position_hz)

    @property
    def period(self) -> float:
        """Return the base tick in s."""
        return 1.0 / self.base_hz

    @property
    def period_ns(self) -> int:
        """Return the base tick in ns, exact."""
        return NANOSECONDS // self.base_hz

    @property
    def ratio(self) -> int:
        """Return the base ticks in one tick of the position loop."""
        return self.base_hz // self.position_hz

    @property
    def temperature_ticks(self) -> int:
        """Return the base ticks from one row of temperatures to the next."""
        return self.base_hz // TEMPERATURE_HZ

    @property
    def position_period(self) -> float:
        """Return the period of the position loop in s."""
        return 1.0 / self.position_hz

    def ticks_of(self, duration: float) -> int:
        """Return the base ticks of a run of `duration` seconds.

        Raises:
            ConfigError: if it is not finite, shorter than a tick, or beyond the range of stamps.
        """
        if not self.period <= duration <= _LAST:
            raise ConfigError(
                f"duration is {duration} s; accepted: a finite number, at least a tick, {self.period:g} s, "
                f"up to {_LAST:g} s"
            )
        return round(duration * self.base_hz)

    def start_tick(self, start_time: float) -> int:
        """Return the position tick of a start time in s.

        Raises:
            ConfigError: if it is not finite, or beyond the range of stamps.
        """
        if not abs(start_time) <= _LAST:
            raise ConfigError(
                f"start time is {start_time} s; accepted: a finite number up to {_LAST:g} s"
            )
        return round(start_time * self.position_hz)
