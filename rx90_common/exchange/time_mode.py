"""What the simulation latches on `time_mode`: how time is kept, and the rates that both nodes must share."""

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
    """

    mode: str
    rates: Rates

    @property
    def text(self) -> str:
        """Return the text of the message."""
        return f"{self.mode} base_rate={self.rates.base_hz} position_rate={self.rates.position_hz}"

    @classmethod
    def parse(cls, text: str) -> TimeMode:
        """Read the text of a message.

        Raises:
            MessageError: if it is none.
        """
        try:
            mode, base, position = text.split()
            if mode in TIME_MODES and base.startswith("base_rate=") and position.startswith("position_rate="):
                return cls(mode, Rates(int(base.partition("=")[2]), int(position.partition("=")[2])))
        except (ValueError, ConfigError):
            pass
        accepted = f"{', '.join(TIME_MODES)} with rates, as in {_EXAMPLE}"
        raise MessageError(f"{TIME_MODE} says {quoted(text)}; accepted: {accepted}")

    def check(self, rates: Rates) -> None:
        """Compare the simulation's rates with the controller's.

        Raises:
            ExchangeError: naming the first rate that differs, with both values.
        """
        for name, theirs, ours in (
            ("base_rate", self.rates.base_hz, rates.base_hz),
            ("position_rate", self.rates.position_hz, rates.position_hz),
        ):
            if theirs != ours:
                raise ExchangeError(
                    f"{name} is {ours} Hz here and {theirs} Hz in the simulation; accepted: the same in both nodes"
                )
