"""Digital signals: outputs from 1, inputs from 1001, software signals from 2001, the hand's from 3001."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Final, NamedTuple

from rx90_common.base.config import read_yaml
from rx90_common.base.errors import ConfigError
from rx90_common.base.quoting import plain, quoted
from rx90_emulator.vplus.errors import VplusError

INPUTS: Final = range(1001, 2001)
_OUTPUTS: Final = (range(1, 1001), range(2001, 3001), range(3001, 4001))
HAND: Final = {"OPEN": (3001, -3002), "CLOSE": (-3001, 3002), "RELAX": (-3001, -3002)}
"""Signals of the hand in each of its states."""


class Change(NamedTuple):
    """A signal that went on or off at a simulated time, s."""

    time: float
    signal: int
    on: bool


@dataclass
class Signals:
    """Signals over time.

    Attributes:
        planned: inputs that will change, in the order of their times.
        changes: of outputs, in their order.
    """

    planned: list[Change] = field(default_factory=list)
    changes: list[Change] = field(default_factory=list)
    _on: set[int] = field(default_factory=set)

    def advance(self, time: float) -> None:
        """Let inputs change that are due at a simulated time, s."""
        while self.planned and self.planned[0].time <= time:
            change = self.planned.pop(0)
            self.receive(change.signal, change.on)

    def receive(self, signal: int, on: bool) -> None:
        """Set an input."""
        if on:
            self._on.add(signal)
        else:
            self._on.discard(signal)

    def is_on(self, signal: int) -> bool:
        """Return whether a signal is as its number says: on, or off for a negative number.

        Raises:
            VplusError: if there is no such signal.
        """
        if not any(abs(signal) in numbers for numbers in (INPUTS, *_OUTPUTS)):
            raise VplusError("Illegal digital signal", str(signal))
        return (abs(signal) in self._on) == (signal > 0)

    def switch(self, signal: int, time: float) -> None:
        """Switch an output on, or off for a negative number.

        Raises:
            VplusError: if it is no output.
        """
        if not any(abs(signal) in numbers for numbers in _OUTPUTS):
            raise VplusError("Illegal digital signal", str(signal))
        if not self.is_on(signal):
            self.receive(abs(signal), signal > 0)
            self.changes.append(Change(time, abs(signal), signal > 0))

    def set_hand(self, state: str, time: float) -> None:
        """Open, close or relax the hand."""
        for signal in HAND[state]:
            self.switch(signal, time)

    def outputs(self) -> set[int]:
        """Return the outputs that are on."""
        return self._on - set(INPUTS)

    def clear(self, time: float) -> None:
        """Switch all outputs off."""
        for signal in sorted(self.outputs()):
            self.switch(-signal, time)


def load_inputs(file: Path) -> list[Change]:
    """Read the times at which inputs change: `1001: 1.0`, or `1001: [1.0, 2.5]` for on and off in turns.

    Raises:
        ConfigError: naming the value and what is accepted.
    """
    changes: list[Change] = []
    for key, value in read_yaml(file, "a mapping from inputs to times, s").items():
        times = value if isinstance(value, list) else [value]
        numbers = [time for time in times if isinstance(time, int | float) and not isinstance(time, bool)]
        signal = int(key) if str(key).isdigit() else 0
        if signal not in INPUTS or len(numbers) != len(times) or not _increasing(numbers):
            raise ConfigError(
                f"{plain(file)}: {quoted(key)}: {quoted(value)}; accepted: an input from {INPUTS[0]} to {INPUTS[-1]}, "
                "and times >= 0 at which it goes on, off and so on, s, increasing"
            )
        changes += [Change(float(time), signal, turn % 2 == 0) for turn, time in enumerate(numbers)]
    return sorted(changes)


def _increasing(numbers: Iterable[float]) -> bool:
    before = -1e-9
    for number in numbers:
        if not before < number < 1e9:
            return False
        before = number
    return True
