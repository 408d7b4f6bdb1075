"""What the bring-up check compares: the points of each board, quantities found there, and who finds them."""

from __future__ import annotations

import os
import select
import sys
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any, NamedTuple, Protocol

from friction_bench.rig.rig_file import CODES
from rx90_common.base.quoting import one_line

INDENT = "   "


class Board(NamedTuple):
    """What a drawing of docs/howto/rig_build.md lets one measure; the tests compute the figures from its parts.

    Attributes:
        name: of the board, in words.
        enable: where the enable is measured.
        off, on: voltage there with the stage off and on, V.
        set_point: voltage of VSET at DAC code 255, V.
        sense: where the measured current is a voltage.
        gain: of it, V/A.
        adc: voltage at ADC code 255, V.
        directions: lines of a stage for torque of both signs, and whether each is high forward; else backward.
    """

    name: str
    enable: str
    off: float
    on: float
    set_point: float
    sense: str
    gain: float
    adc: float
    directions: Mapping[str, bool]

    def current(self, code: float) -> float:
        """Return the motor's current at a DAC code, A."""
        return self.set_point / self.gain * code / CODES


_LINES = {"FORWARD (behind U6)": True, "BACKWARD (behind U6)": False}
BOARDS = {
    "8051": Board(
        "the source's board", "STAGE_OFF (U1 pin 14)", 2.76, 0.0, 4.0, "VSENSE (output of U4C)", 0.9, 5.001, _LINES
    ),
    "nano": Board(
        "the board of today", "AWAKE (U2 nSLEEP)", 0.0, 5.0, 3.0, "VIP (U2 IPROPI)", 0.675, 4.98, {"PH (U2)": True}
    ),
}
"""By the words of --board."""
BIPOLAR_BOARDS = {**BOARDS, "8051": BOARDS["8051"]._replace(off=2.87)}
"""With a stage for torque of both signs: on the source's board the enable feeds two bases."""
HIGH = 5.0
"""Of a direction line, V."""
OF_PROCESSOR = {"mcs51": "8051", "avr": "nano"}
"""The board that a processor stands on, unless --board says otherwise."""


@dataclass(frozen=True)
class Comparison:
    """One quantity: what is expected, by how much it may differ, and what was found; None where it was not measured."""

    name: str
    unit: str
    expected: float
    tolerance: float
    found: float | None = None

    @property
    def good(self) -> bool:
        """Return whether what was found is as expected."""
        return self.found is not None and abs(self.found - self.expected) <= self.tolerance

    @property
    def expectation(self) -> str:
        """Return in words what is expected."""
        return f"{self.name}: expected {self.expected:.4g} ± {self.tolerance:.2g} {self.unit}"

    def __str__(self) -> str:
        """Return the comparison as a line."""
        if self.found is None:
            return f"{self.expectation}, not measured"
        return f"{self.expectation}, found {self.found:.4g}: {'ok' if self.good else 'WRONG'}"


@dataclass
class StepResult:
    """What a step found: quantities, faults in words, and what nobody did or saw."""

    title: str
    quantities: list[Comparison] = field(default_factory=list)
    faults: list[str] = field(default_factory=list)
    left_out: list[str] = field(default_factory=list)

    @property
    def verdict(self) -> str:
        """Return passed, incomplete or failed."""
        if self.faults or any(one.found is not None and not one.good for one in self.quantities):
            return "failed"
        return "incomplete" if self.left_out or any(one.found is None for one in self.quantities) else "passed"

    @property
    def reasons(self) -> list[str]:
        """Return in words why the step is not passed."""
        return [*self.faults, *(str(one) for one in self.quantities if not one.good), *self.left_out]

    @property
    def document(self) -> dict[str, Any]:
        """Return the result as plain data."""
        rows = [
            {"name": one.name, "unit": one.unit, "expected": one.expected, "tolerance": one.tolerance,
             "found": "not measured" if one.found is None else one.found, "as_expected": one.good}
            for one in self.quantities
        ]  # fmt: skip
        return {
            "step": self.title, "verdict": self.verdict, "quantities": rows, "faults": self.faults,
            "left_out": self.left_out,
        }  # fmt: skip


class Person(Protocol):
    """Who reads the steps, turns the shaft and measures."""

    def answer(self, question: str, meanwhile: Callable[[], object]) -> str | None:
        """Return the line that answers a question, without blanks around it, None if nobody is there.

        `meanwhile` keeps the rig alive: it is called every few hundredths of a second and must not be left out.
        """


class Terminal:
    """The person at standard input, or a file with a line for each question."""

    def __init__(self) -> None:
        self._read, self._ended = b"", sys.stdin is None
        self._echo = sys.stdin is None or not sys.stdin.isatty()

    def answer(self, question: str, meanwhile: Callable[[], object]) -> str | None:
        """Ask and wait; a file's answer is printed, as a terminal shows what is typed."""
        print(f"{INDENT}{question}: ", end="", flush=True)
        while b"\n" not in self._read and not self._ended:
            # The descriptor itself: lines in the buffer of sys.stdin would not wake the wait up.
            if select.select([sys.stdin], [], [], 0.0)[0]:
                data = os.read(sys.stdin.fileno(), 4096)
                self._read, self._ended = self._read + data, not data
            else:
                meanwhile()
        line, newline, self._read = self._read.partition(b"\n")
        text = line.decode(errors="replace").strip() if line or newline else None
        if self._echo or text is None:
            print("(nobody answers)" if text is None else one_line(text), flush=True)
        return text
