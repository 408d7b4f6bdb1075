"""The interpreter: a task walks through the steps of programs, on the clock of the cell.

`Task.run` is a generator. It yields what it waits for, in a word, once in each beat that it waits, and whoever runs it
lets a beat of the cell pass then.
"""

from __future__ import annotations

import random
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from typing import Final

from rx90_common.base.arrays import Array
from rx90_emulator.vplus.cell import Cell
from rx90_emulator.vplus.errors import VplusError
from rx90_emulator.vplus.operators import bounded_text, location, operate, prefix, real
from rx90_emulator.vplus.program import Memory, Program
from rx90_emulator.vplus.readings import Readings
from rx90_emulator.vplus.registry import CONTROL, FUNCTIONS, INSTRUCTIONS
from rx90_emulator.vplus.settings import Settings
from rx90_emulator.vplus.syntax import (
    Argument,
    Compound,
    Expression,
    Format,
    Function,
    Line,
    Number,
    Operation,
    Prefixed,
    Reference,
    Text,
)
from rx90_emulator.vplus.values import Cell as Variable
from rx90_emulator.vplus.values import Scope, Table, Value

DEEPEST: Final = 1000
"""Calls within each other."""


@dataclass
class Frame:
    """A program that runs.

    Attributes:
        program: its steps.
        place: number of the next step.
        scope: its arguments and AUTO variables.
        loops: limit and step of its FOR loops, by their first step.
    """

    program: Program
    place: int = 0
    scope: Scope = field(default_factory=Scope)
    loops: dict[int, tuple[float, float]] = field(default_factory=dict)


@dataclass
class Reaction:
    """A program that a signal calls.

    Attributes:
        program: its name.
        priority: above that of what runs, or it waits.
        stops: whether it ends the motion under way.
        was: how the signal was, or None.
    """

    program: str
    priority: float
    stops: bool
    was: bool = False


class Task:
    """A task: programs on their way, and what they have set.

    Args:
        memory: programs and global variables.
        cell: the arm, its signals and the time.
        readings: how uncertain parts of the language are read.

    Attributes:
        settings: speeds and switches of motions.
        timers: the time at which each TIMER was 0, s.
        reactions: by signal.
        lock: priority up to which reactions wait.
        on_error: the program that an error calls; empty for none.
        error: number of the newest error.
        lot: the source of RANDOM.
    """

    def __init__(self, memory: Memory, cell: Cell, readings: Readings) -> None:
        self.memory = memory
        self.cell = cell
        self.readings = readings
        self.settings = Settings()
        self.timers: dict[int, float] = {}
        self.reactions: dict[int, Reaction] = {}
        self.lock = 0.0
        self.on_error = ""
        self.error = 0
        self.lot = random.Random(0)
        self.paused = False
        self.switches = dict.fromkeys(("POWER", "CP", "ROBOT", "MESSAGES", "SCALE.ACCEL", "UPPER"), True)
        self.frames: list[Frame] = []
        self.line = 0
        self._levels = readings.levels()
        self._budget = self._steps_in_a_beat()

    def _steps_in_a_beat(self) -> int:
        return max(round(self.cell.period / self.readings.step_time), 1)

    # Programs.

    def program(self, name: str) -> Program:
        """Return a program.

        Raises:
            VplusError: if there is none of this name.
        """
        if name not in self.memory.programs:
            raise VplusError("Undefined program or variable name", name)
        return self.memory.programs[name]

    def call(self, name: str, arguments: tuple[Argument, ...] = ()) -> None:
        """Go on in another program, which gets variables by reference and expressions by value.

        Raises:
            VplusError: if there is none, for arguments that it does not take, and for too many calls in each other.
        """
        program = self.program(name)
        if len(arguments) > len(program.parameters):
            raise VplusError("Illegal value", f"{len(arguments)} arguments of {name}")
        if len(self.frames) >= DEEPEST:
            raise VplusError("Not enough program stack space", f"{DEEPEST} calls within each other")
        frame = Frame(program)
        for parameter, argument in zip(program.parameters, arguments, strict=False):
            self._bind(frame.scope, parameter, argument)
        self.frames.append(frame)

    def _bind(self, scope: Scope, parameter: str, argument: Argument) -> None:
        if argument is None:
            return
        if isinstance(argument, Format):
            raise VplusError("Illegal value", f"a format /{argument.text} as an argument")
        if isinstance(argument, Reference) and argument.index is not None and not any(argument.index):
            scope.tables[parameter] = self.table(argument.name)
        elif isinstance(argument, Reference) and not self._is_function(argument):
            scope.cells[parameter] = self.cell_of(argument)
        else:
            scope.cell(parameter).store(parameter, self.value(argument))

    def frame_of(self) -> Frame:
        """Return the program that runs."""
        return self.frames[-1]

    def run(self) -> Iterator[str]:
        """Run until the programs are through; yield what is waited for, once in each beat.

        Raises:
            VplusError: naming program, step and line.
        """
        yield from self.walk()
        yield from self.until(lambda: self.cell.queue.at_end, "the end of the motion")

    def walk(self) -> Iterator[str]:
        """Run until the programs are through, and a motion may be under way."""
        return self._run(0)

    def _run(self, depth: int) -> Iterator[str]:
        """Run until only so many programs are on their way."""
        while len(self.frames) > depth:
            frame = self.frames[-1]
            if frame.place >= len(frame.program.steps):
                self.frames.pop()
                continue
            step = frame.program.steps[frame.place]
            self.line = step.line
            frame.place += 1
            if step.instruction is None:
                continue
            if self._budget <= 0:
                yield "the processor"
                self._budget = self._steps_in_a_beat()
            self._budget -= 1
            try:
                word = step.instruction.word
                if word in INSTRUCTIONS:
                    waits = INSTRUCTIONS[word].run(self, step.instruction)
                    if waits is not None:
                        yield from waits
                else:
                    CONTROL[word](self, frame, step)
                if self.reactions:
                    yield from self._react()
            except RecursionError:
                raise self._located(VplusError("Expression too complex"), frame) from None
            except VplusError as error:
                self.error = error.number
                if not self.on_error or error.where:
                    raise self._located(error, frame) from None
                routine = self.on_error
                self.on_error = ""
                self.call(routine)

    def _located(self, error: VplusError, frame: Frame) -> VplusError:
        if not error.where:
            error.where = f"Program task 0 stopped at {frame.program.name}, step {frame.place}, line {self.line}"
        return error

    def until(self, condition: Callable[[], bool], what: str) -> Iterator[str]:
        """Wait until a condition holds, and react to signals meanwhile."""
        while not condition():
            yield what
            if self.reactions:
                yield from self._react()

    def _react(self) -> Iterator[str]:
        """Call the programs of signals that have changed, if their priority lets them."""
        for signal, reaction in [*self.reactions.items()]:
            now = self.cell.signals.is_on(signal)
            due = now and not reaction.was
            if due and reaction.priority <= self.lock:
                continue  # later
            reaction.was = now
            if due:
                if reaction.stops:
                    self.cell.queue.stop()
                before = self.lock
                self.lock = reaction.priority
                depth = len(self.frames)
                self.call(reaction.program)
                yield from self._run(depth)
                self.lock = before

    # Variables.

    def _scope(self, name: str) -> Scope:
        if self.frames:
            frame = self.frames[-1]
            if name in frame.program.automatic or name in frame.program.parameters:
                return frame.scope
            if name in frame.program.own:
                return frame.program.local
        return self.memory.variables

    def table(self, name: str) -> Table:
        """Return an array."""
        return self._scope(name).table(name)

    def cell_of(self, reference: Reference) -> Variable:
        """Return a variable or an element of an array."""
        if reference.index is None:
            return self._scope(reference.name).cell(reference.name)
        index = tuple(0 if part is None else int(real(self.value(part))) for part in reference.index)
        return self.table(reference.name).cell(reference.name, index)

    # Values.

    def value(self, tree: Expression) -> Value:
        """Return the value of an expression.

        Raises:
            VplusError: if it has none.
        """
        if isinstance(tree, Number | Text):
            return tree.value
        if isinstance(tree, Reference):
            return self._of_reference(tree)
        if isinstance(tree, Function):
            return self._of_function(tree.name.upper(), tree.arguments)
        if isinstance(tree, Prefixed):
            return prefix(tree.operator, self.value(tree.operand))
        if isinstance(tree, Compound):
            return self._compound(tree)
        return self._of_operation(tree)

    def _is_function(self, reference: Reference) -> bool:
        name = reference.name.upper()
        return reference.index is None and name in FUNCTIONS and FUNCTIONS[name].arity[0] == 0

    def _of_reference(self, reference: Reference) -> Value:
        if self._is_function(reference):
            return self._of_function(reference.name.upper(), ())
        value = self.cell_of(reference).value
        if value is None:
            raise VplusError("Undefined value", reference.name)
        return value

    def _of_function(self, name: str, arguments: tuple[Argument, ...]) -> Value:
        function = FUNCTIONS.get(name)
        if function is None:
            raise VplusError("Undefined program or variable name", name.lower())
        if function.takes_trees:
            result: Value = function.value(self, *arguments)
        else:
            result = function.value(self, *(self.item(argument) for argument in arguments))
        return result

    def item(self, argument: Argument) -> Value | Format:
        """Return the value of an argument, or the format that it is.

        Raises:
            VplusError: if it is left out.
        """
        if argument is None:
            raise VplusError("Missing argument")
        return argument if isinstance(argument, Format) else self.value(argument)

    def real(self, argument: Argument, missing: float | None = None) -> float:
        """Return a real argument, or what stands for one that is left out.

        Raises:
            VplusError: if it is none.
        """
        if argument is None and missing is not None:
            return missing
        item = self.item(argument)
        if isinstance(item, Format):
            raise VplusError("Illegal value", f"a format /{item.text}")
        return real(item)

    def _compound(self, tree: Compound) -> Array:
        whole: Array | None = None
        for part in tree.parts:
            place = location(self.value(part))
            whole = place if whole is None else whole @ place
        assert whole is not None
        return whole

    def _of_operation(self, tree: Operation) -> Value:
        """Return the value of operands in a row: the operators that bind most go first."""
        values = [self.value(operand) for operand in tree.operands]
        signs = list(tree.operators)
        for level in self._levels:
            place = 0
            while place < len(signs):
                if signs[place] in level:
                    both = operate(signs[place], values[place], values[place + 1], self.readings.ignore_case)
                    values[place : place + 2] = [both]
                    del signs[place]
                else:
                    place += 1
        result = values[0]
        return bounded_text(result) if isinstance(result, str) else result

    def argument(self, line: Line, place: int) -> Argument:
        """Return an argument of an instruction, None if it is left out."""
        return line.arguments[place] if place < len(line.arguments) else None

    def variable(self, argument: Argument) -> Reference:
        """Return the variable that an argument must be.

        Raises:
            VplusError: if it is an expression.
        """
        if not isinstance(argument, Reference):
            raise VplusError("Illegal value", "an expression; accepted: a variable")
        return argument
