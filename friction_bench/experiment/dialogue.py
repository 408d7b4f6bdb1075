"""What the steps of the bring-up check are made of: questions to a person, comparisons, and a torque that goes away."""

from __future__ import annotations

import math
import textwrap
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace

from friction_bench.experiment.findings import (
    BIPOLAR_BOARDS,
    BOARDS,
    INDENT,
    OF_PROCESSOR,
    Board,
    Comparison,
    Person,
    StepResult,
)
from friction_bench.experiment.session import armed, refuse_fault
from friction_bench.rig.client import RigClient, Sample
from friction_bench.rig.messages import PROCESSORS, Command, RigError, fault_text
from rx90_common.base.quoting import quoted

WIDTH = 100
"""Of the texts, characters."""
LONGEST_HOLD = 30.0
"""For which a torque stands while a person measures, s: a stalled motor and its stage get hot."""


class SkippedError(Exception):
    """A step that the person does not want, or that nobody is there for."""


class Dialogue:
    """A rig, the person at it, and what the steps found.

    Args:
        client: of the rig, which need not have been greeted.
        person: at the rig.
        board: one of BOARDS; by default the one of the processor that greets.

    Attributes:
        results: of the steps so far; what is compared belongs to the last one.
    """

    def __init__(self, client: RigClient, person: Person, board: str | None = None) -> None:
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
        """Return so many readings; raise what a fault bit among them says."""
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
            print(flush=True)  # the question stands in the line
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
        """Wait until the person is ready for what the question names; skip the step where they are not."""
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
