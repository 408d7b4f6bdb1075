"""What the simulation latches on `time_mode`: how time is kept, and the rates and the robot that both nodes share."""

from __future__ import annotations

from dataclasses import dataclass

from rx90_common.base.errors import ConfigError, ExchangeError, MessageError
from rx90_common.base.quoting import quoted
from rx90_common.base.rates import Rates
from rx90_common.exchange.topics import TIME_MODE, TIME_MODES

_EXAMPLE = "lock_step base_rate=4000 position_rate=1000"


@dataclass(frozen=True)
class TimeMode:
    """How time is kept.

    Attributes:
        mode: one of TIME_MODES.
        rates: of the simulation.
        robot: name of its robot; None where the text says none.
    """

    mode: str
    rates: Rates
    robot: str | None = None

    @property
    def text(self) -> str:
        """Return the text of the message."""
        text = f"{self.mode} base_rate={self.rates.base_hz} position_rate={self.rates.position_hz}"
        return text if self.robot is None else f"{text} robot={self.robot}"

    @classmethod
    def parse(cls, text: str) -> TimeMode:
        """Read the text of a message.

        Raises:
            MessageError: if it is none.
        """
        try:
            about, named, robot = text.partition(" robot=")
            mode, base, position = about.split()
            if mode in TIME_MODES and base.startswith("base_rate=") and position.startswith("position_rate="):
                rates = Rates(int(base.partition("=")[2]), int(position.partition("=")[2]))
                return cls(mode, rates, robot if named else None)
        except (ValueError, ConfigError):
            pass
        accepted = f"{', '.join(TIME_MODES)} with rates, as in {_EXAMPLE}"
        raise MessageError(f"{TIME_MODE} says {quoted(text)}; accepted: {accepted}")

    def check(self, rates: Rates, robot: str) -> None:
        """Compare the simulation's rates and robot with the controller's.

        Raises:
            ExchangeError: naming what differs first, with both values.
        """
        for name, theirs, ours in (
            ("base_rate", self.rates.base_hz, rates.base_hz),
            ("position_rate", self.rates.position_hz, rates.position_hz),
        ):
            if theirs != ours:
                raise ExchangeError(
                    f"{name} is {ours} Hz here and {theirs} Hz in the simulation; accepted: the same in both nodes"
                )
        if self.robot not in (None, robot):
            raise ExchangeError(
                f"the robot is {quoted(robot)} here and {quoted(self.robot)} in the simulation; accepted: the same in "
                "both nodes, by their parameters robot or urdf"
            )
