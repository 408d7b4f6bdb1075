"""Parts of the bring-up check: points of each board, questions to a person, comparisons, a torque that ends."""

from __future__ import annotations

import math
import os
import select
import sys
import textwrap
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import asdict, dataclass, field, replace
from typing import Any, NamedTuple

from friction_bench.experiment.session import armed, refuse_fault
from friction_bench.rig.client import RigClient, Sample
from friction_bench.rig.messages import PROCESSORS, Command, RigError, fault_text
from friction_bench.rig.rig_file import CODES
from rx90_common.base.quoting import one_line, quoted

INDENT = "   "
WIDTH = 100
"""Of the texts, characters."""
LONGEST_HOLD = 30.0
"""Time for which a torque is applied while a person measures, s: a stalled motor and its stage get hot."""


class Board(NamedTuple):
    """What a drawing of docs/howto/rig_build.md lets one measure; the tests compute the figures from its parts.

    Attributes:
        name: of the board, in words.
        enable: where the enable is measured.
        off, on: voltage there with the stage off and on, V.
        set_point: voltage of VSET at DAC code 255, V.
        sense: where the measured current is a voltage.
        gain: of it, V/A.
        directions: lines of a stage for torque of both signs, and whether each is high forward; else backward.
    """

    name: str
    enable: str
    off: float
    on: float
    set_point: float
    sense: str
    gain: float
    directions: Mapping[str, bool]

    def current(self, code: float) -> float:
        """Return the motor's current at a DAC code, A."""
        return self.set_point / self.gain * code / CODES


_LINES = {"FORWARD (behind U6)": True, "BACKWARD (behind U6)": False}
BOARDS = {
    "8051": Board("the source's board", "STAGE_OFF (U1 pin 14)", 2.76, 0.0, 4.0, "VSENSE (output of U4C)", 0.9, _LINES),
    "nano": Board(
        "the board of today", "AWAKE (U2 nSLEEP)", 0.0, 5.0, 3.0, "VIP (U2 IPROPI)", 0.675, {"PH (U2)": True}
    ),
}
"""By the words of --board."""
BIPOLAR_BOARDS = {**BOARDS, "8051": BOARDS["8051"]._replace(off=2.87)}
"""With a stage for torque of both signs: on the source's board the enable feeds two bases."""
HIGH = 5.0
"""Of a direction line, V."""
OF_PROCESSOR = {"mcs51": "8051", "avr": "nano"}
"""The board that carries a processor, unless --board names another."""


@dataclass(frozen=True)
class Comparison:
    """A quantity: expected value, tolerance, and measured value; None if it was not measured."""

    name: str
    unit: str
    expected: float
    tolerance: float
    found: float | None = None

    @property
    def good(self) -> bool:
        """Return whether the measured value is as expected."""
        return self.found is not None and abs(self.found - self.expected) <= self.tolerance

    @property
    def expectation(self) -> str:
        """Return the expected value in words."""
        return f"{self.name}: expected {self.expected:.4g} ± {self.tolerance:.2g} {self.unit}"

    def __str__(self) -> str:
        """Return the comparison as a line."""
        if self.found is None:
            return f"{self.expectation}, not measured"
        return f"{self.expectation}, found {self.found:.4g}: {'ok' if self.good else 'WRONG'}"


@dataclass
class StepResult:
    """The results of a step: quantities, faults in words, and observations that nobody made."""

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
            {**asdict(one), "found": "not measured" if one.found is None else one.found, "as_expected": one.good}
            for one in self.quantities
        ]
        return {
            "step": self.title, "verdict": self.verdict, "quantities": rows, "faults": self.faults,
            "left_out": self.left_out,
        }  # fmt: skip


class Terminal:
    """The person at standard input, or a file with a line for each question."""

    def __init__(self) -> None:
        self._read, self._ended = b"", sys.stdin is None
        self._echo = sys.stdin is None or not sys.stdin.isatty()

    def answer(self, question: str, meanwhile: Callable[[], object]) -> str | None:
        """Return the line that answers a question, stripped, None if nobody is there.

        The answer from a file is printed, as a terminal shows typed text. `meanwhile` keeps the rig alive: it is called
        every few hundredths of a second.
        """
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


class SkippedError(Exception):
    """A step that the person does not want, or that nobody is there for."""


class Dialogue:
    """A rig, the person who operates it, and the results of the steps.

    Args:
        client: of the rig, before or after its greeting.
        person: who operates the rig.
        board: one of BOARDS; by default the one of the processor that sends the greeting.

    Attributes:
        results: of the steps so far; comparisons are added to the last one.
    """

    def __init__(self, client: RigClient, person: Terminal, board: str | None = None) -> None:
        self.client, self.rig, self.person = client, client.rig, person
        self.results: list[StepResult] = []
        self._name = board
        self._until = float("inf")

    @property
    def board(self) -> Board:
        """Return the board's figures."""
        return (BIPOLAR_BOARDS if self.rig.bipolar else BOARDS)[self._name or "8051"]

    def _say(self, text: str) -> None:
        print(textwrap.fill(text, WIDTH, initial_indent=INDENT, subsequent_indent=INDENT), flush=True)

    def _listen(self, ticks: int) -> list[Sample]:
        """Return so many readings; raise RigFaultError if a fault bit is set among them."""
        samples: list[Sample] = []
        while len(samples) < ticks:
            samples += self._pump()
        return samples

    def _pump(self) -> list[Sample]:
        samples = self.client.pump()
        for sample in samples:
            refuse_fault(sample)
        if self.client.port.now() > self._until:
            self._until = float("inf")
            self.client.request(Command.TORQUE, *self.client.torque_values(0))
            print(flush=True)  # ends the line of the question
            self._say(f"the torque is off again after {LONGEST_HOLD:g} s")
        return samples

    def _greet(self) -> None:
        """Begin a step with a rig that is disarmed and has no fault latched by the step before."""
        client = self.client
        processor = client.connect().processor
        if self._name is None and processor < len(PROCESSORS):
            self._name = OF_PROCESSOR.get(PROCESSORS[processor])
        while client.last is None:
            client.pump()
        if client.last.report.fault:
            self._say(f"A fault was latched and is cleared: {fault_text(client.last.report.fault)}.")
        client.clear()

    def _ask(self, question: str) -> str:
        """Return the answer, which may be empty; skip the step where nobody is there."""
        answer = self.person.answer(question, self._pump)
        if answer is None:
            raise SkippedError("nobody answered; the rest of the step was left out")
        return answer

    def _ready(self, question: str) -> None:
        """Wait until the person confirms the preparation; skip the step if they do not."""
        while (answer := self._ask(f"{question} [Enter, or s skips the step]").lower()) != "":
            if answer == "s":
                raise SkippedError("skipped")
            self._say(f"{quoted(answer)}; accepted: Enter, or s")

    def _fault(self, text: str) -> None:
        self.results[-1].faults.append(text)

    def _compare(self, name: str, unit: str, expected: float, tolerance: float, found: float) -> None:
        self.results[-1].quantities.append(comparison := Comparison(name, unit, expected, tolerance, found))
        self._say(str(comparison))

    def _measure(self, name: str, unit: str, expected: float, tolerance: float) -> None:
        """Have a quantity measured; Enter leaves it out."""
        comparison = Comparison(name, unit, expected, tolerance)
        quantities = self.results[-1].quantities
        quantities.append(comparison)
        while answer := self._ask(f"{comparison.expectation} [{unit}, or Enter: not measured]"):
            try:
                found = float(answer.replace(",", ".").removesuffix(unit))
            except ValueError:
                found = math.nan
            if not math.isfinite(found):
                self._say(f"{quoted(answer)}; accepted: a number of {unit}, or Enter")
                continue
            quantities[-1] = replace(comparison, found=found)
            if not quantities[-1].good:
                self._say(str(quantities[-1]))
            return

    @contextmanager
    def _stage_on(self, code: int = 0) -> Iterator[None]:
        """Hold a code within the block, at most LONGEST_HOLD; whatever ends the block takes the torque away."""
        with armed(self.client):
            if code:
                self._put(code)
                self._until = self.client.port.now() + LONGEST_HOLD
            try:
                yield
                self.client.request(Command.STOP)
            finally:
                self._until = float("inf")

    def _put(self, code: int) -> None:
        """Put a code on the DAC, below 0 for backward; the rig must report it with its sign."""
        self.client.request(Command.TORQUE, *self.client.torque_values(code))
        assert self.client.last is not None
        reported = self.client.last.report.dac
        if reported != code:
            raise RigError(f"sent was code {code}, the rig reports {reported}: not the shipped firmware")
