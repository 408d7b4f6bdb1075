"""The interpreter: a task walks through the steps of programs, on the clock of the cell.

`Task.run` is a generator. It yields what it waits for, in a word, once in each beat that it waits, and whoever runs it
lets a beat of the cell pass then.
"""

from __future__ import annotations

import math
import random
from collections import ChainMap
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from typing import Any, Final, TypeAlias

import numpy as np
from pinocchio import SE3

from rx90_common.base.arrays import Array
from rx90_emulator.cabinet.arm import Joints
from rx90_emulator.cabinet.cell import Cell
from rx90_emulator.cabinet.errors import VplusError
from rx90_emulator.vplus.tree import Function, Memory, Program, Reference, Step, Tree
from rx90_emulator.vplus.values import (
    KINDS,
    Scope,
    Table,
    Value,
    Variable,
    bounded,
    element,
    plain_name,
)

Waits: TypeAlias = Iterator[str]
"""What is waited for, in a word, once in each beat."""
_DEEPEST = 1000
"""Calls within each other."""
_TYPES: Final[dict[str, Any]] = {
    "text": str,
    "name": str,
    "place": SE3,
    "location": (SE3, Joints),
    "plain": (float, str),
    "folded": (float, str),
    "any": object,
}
"""Types of the values that kinds of arguments stand for; all others are reals."""
_SAID = {"truth": "real", "degrees": "real", "bits": "integer", "folded": "real or string"}
"""What messages say in place of a kind."""
_RANGES = {"percent": (0.001, 1000.0), "seconds": (0.0, 86_400.0), "joint": (1.0, 6.0)}
_CONVERSIONS: Final[dict[str, Callable[[Any], Any]]] = {
    "integer": int,
    "joint": int,
    "truth": bool,
    "degrees": math.radians,
    "bits": lambda number: (int(number) + (1 << 23)) % (1 << 24) - (1 << 23),
}
OF_EXECUTE = {
    "SPEED": 100.0,
    "ROTARY": 100.0,
    "DURATION": 0.0,
    "CP": 1.0,
    "NULL": 1.0,
    "FINE": 100.0,
}
"""What EXECUTE sets for all motions."""


@dataclass
class Frame:
    """A program that runs.

    Attributes:
        program: its steps.
        scope: its arguments and AUTO variables.
        place: number of the next step.
        loops: of FOR loops, by the step behind them: what begins the next turn, and returns whether there is one.
    """

    program: Program
    scope: Scope = field(default_factory=dict)
    place: int = 0
    loops: dict[int, Callable[[], bool]] = field(default_factory=dict)


@dataclass
class Reaction:
    """A program that a signal calls.

    Attributes:
        program: its name.
        priority: above that of what runs, or it waits.
        stops: whether it ends the motion under way.
        was: how the signal was.
    """

    program: str
    priority: float
    stops: bool
    was: bool


class Task:
    """A task: programs on their way, and what they have set.

    Args:
        memory: programs and global variables.
        cell: the arm, its signals and the time.

    Attributes:
        always: SPEED and ROTARY (percent), DURATION (s), CP, NULL, FINE (percent), UP, DOWN (percent) and SMOOTH of the
            ramps, for all motions.
        next: likewise, for the next motion: what was set for it alone, or for all.
        at_start: what the next motion does when it begins.
        wanted: of whether LEFTY, BELOW and FLIP, what was asked for, by their places among these.
        tool: from the flange.
        base: where the robot stands.
        hand_time: s that the hand takes.
        timers: the time at which each TIMER was 0, s.
        reactions: by signal.
        lock: priority up to which reactions wait.
        on_error: the program that an error calls; empty for none.
        error: number of the newest error.
        lot: the source of RANDOM.
        halted: whether HALT has ended the program for good.
        units: that the program has; what is typed goes to it while it has one.
        frames: the programs within each other.
        step: the newest step.
        has_begun: whether it has; if not, it waits for the processor.
    """

    def __init__(self, memory: Memory, cell: Cell) -> None:
        self.memory = memory
        self.readings = memory.readings
        self.cell = cell
        self.arm = cell.arm
        self.queue = cell.queue
        self.always = {**OF_EXECUTE, "UP": 100.0, "DOWN": 100.0, "SMOOTH": 0.0}
        self.next = ChainMap({}, self.always)
        self.at_start: list[Callable[[], None]] = []
        self.wanted: dict[int, bool] = {}
        self.tool = SE3.Identity()
        self.base = SE3.Identity()
        self.hand_time = 0.05
        self.timers: dict[int, float] = {}
        self.reactions: dict[int, Reaction] = {}
        self.lock = 0.0
        self.on_error = ""
        self.error = 0
        self.lot = random.Random(0)
        self.halted = False
        self.units: set[float] = set()
        self.frames: list[Frame] = []
        self.step = Step()
        self.has_begun = False
        self._steps = 0

    # Programs.

    @property
    def frame(self) -> Frame:
        """Return the program that runs."""
        return self.frames[-1]

    def program(self, name: str) -> Program:
        """Return a program.

        Raises:
            VplusError: if there is none of this name.
        """
        program = self.memory.programs.get(plain_name(name))
        if program is None:
            raise VplusError("Undefined program or variable name", name)
        return program

    def call(self, name: str, *arguments: Tree) -> None:
        """Go on in another program, which gets variables by reference and expressions by value.

        Raises:
            VplusError: if there is none, for arguments that it does not take, and for too many calls in each other.
        """
        program = self.program(name)
        if len(arguments) > len(program.parameters):
            raise VplusError("Illegal value", f"{len(arguments)} arguments of {name}")
        if len(self.frames) >= _DEEPEST:
            raise VplusError(
                "Not enough program stack space", f"{_DEEPEST} calls within each other"
            )
        scope: Scope = {name: {} for name in program.automatic}
        for parameter, argument in zip(program.parameters, arguments, strict=False):
            if isinstance(argument, Reference):
                whole = set(argument.index or ()) == {None}
                scope[parameter] = self.table(argument) if whole else {(): self.variable(argument)}
            elif argument is not None:
                element(scope[parameter], parameter).store(self.value(argument))
        self.frames.append(Frame(program, scope))

    def jump(self, condition: bool = True) -> None:
        """Go on at the target of the step, if a condition holds."""
        if condition:
            self.frame.place = self.step.target

    def run(self) -> Waits:
        """Run until the programs are through; yield what is waited for, once in each beat.

        Raises:
            VplusError: naming program, step and line.
        """
        yield from self.walk()
        yield from self.motion_end()

    def walk(self, depth: int = 0) -> Waits:
        """Run until only so many programs are on their way; a motion may be under way then."""
        while len(self.frames) > depth:
            frame = self.frame
            if frame.place >= len(frame.program.steps):
                self.frames.pop()
                continue
            self.step = frame.program.steps[frame.place]
            self.has_begun = False
            self._steps += 1
            if self._steps * self.readings.step_time >= self.cell.period:
                self._steps = 0
                yield "the processor"
            self.has_begun = True
            frame.place += 1
            try:
                values = self.values(self.step)
                yield from self.step.entry.action(self, *values) or ()
                yield from self._react()
            except (VplusError, RecursionError) as error:
                self._fail(error, frame)

    def _fail(self, error: VplusError | RecursionError, frame: Frame) -> None:
        """Call the program that an error calls, or end with the error."""
        if isinstance(error, RecursionError):
            error = VplusError("Expression too complex")
        self.error = error.number
        if error.where or not self.on_error:
            place = f"{frame.program.name}, step {frame.place}, line {self.step.line}"
            error.where = error.where or f"Program task 0 stopped at {place}"
            raise error from None
        routine = self.on_error
        self.on_error = ""
        self.call(routine)

    def motion_end(self) -> Waits:
        """Wait until no motion runs or waits."""
        return self.until(lambda: self.queue.at_end, "the end of the motion")

    def until(self, condition: Callable[[], bool], what: str) -> Waits:
        """Wait until a condition holds, and react to signals meanwhile."""
        while not condition():
            yield what
            yield from self._react()

    def _react(self) -> Waits:
        """Call the programs of signals that have changed, if their priority lets them."""
        for signal, reaction in [*self.reactions.items()]:
            now = self.cell.is_on(signal)
            due = now and not reaction.was
            if due and reaction.priority <= self.lock:
                continue  # later
            reaction.was = now
            if due:
                if reaction.stops:
                    self.queue.stop()
                before = self.step, self.lock
                self.lock = reaction.priority
                depth = len(self.frames)
                self.call(reaction.program)
                try:
                    yield from self.walk(depth)
                finally:
                    self.step, self.lock = before

    # Variables and values.

    def table(self, tree: Tree) -> Table:
        """Return an array or, with the index () alone, a plain variable.

        Raises:
            VplusError: if the tree is an expression.
        """
        if not isinstance(tree, Reference):
            raise VplusError("Illegal value", "an expression; accepted: a variable")
        for frame in self.frames[-1:]:
            for scope in (frame.scope, frame.program.local):
                if tree.name in scope:
                    return scope[tree.name]
        return self.memory.variables.setdefault(tree.name, {})

    def variable(self, tree: Tree, further: int = 0) -> Variable:
        """Return a variable or an element of an array, or the element so many indices further."""
        table = self.table(tree)
        index = [self.taken("integer", part or 0.0) for part in tree.index or ()]  # type: ignore[union-attr]
        if index:
            index[-1] += further
        return element(table, tree.name, tuple(index))  # type: ignore[union-attr]

    def value(self, tree: Tree) -> Value:
        """Return the value of an expression.

        Raises:
            VplusError: if it has none.
        """
        if isinstance(tree, Function):
            return self._of_function(tree)
        if isinstance(tree, Reference):
            value = self.variable(tree).value
            if value is None:
                raise VplusError("Undefined value", tree.name)
            return value
        if tree is None:
            raise VplusError("Missing argument")
        return tree

    def _of_function(self, tree: Function) -> Value:
        values = self.values(tree)
        try:
            return bounded(tree.entry.action(self, *values))
        except ZeroDivisionError:
            text = "Division by zero"
        except OverflowError:
            text = "Arithmetic overflow"
        except (ValueError, TypeError):
            text = "Illegal value"
        raise VplusError(
            text,
            f"{tree.name} of {', '.join(str(value) for value in values if np.isscalar(value))}",
        )

    def values(self, called: Step | Function) -> list[Any]:
        """Return what an action gets for arguments, up to the last that is given; the last kind may come many times."""
        kinds = called.entry.kinds
        repeated = [*kinds, *kinds[-1:] * len(called.arguments)]
        values = [self.taken(*pair) for pair in zip(repeated, called.arguments, strict=False)]
        while values and values[-1] is None:
            values.pop()
        return values

    def taken(self, kind: str, argument: Tree) -> Any:
        """Return what an action gets for an argument: the value of a kind.

        Args:
            kind: `real`, `integer`, `bits` (an integer of 24 bits with sign), `truth`, `degrees` (becomes rad),
                `percent`, `seconds`, `joint`, `text`, `place` (a transformation), `location` (that or a precision
                point), `plain` (a real or a string), `folded` (the same, as comparisons see it), `variable` (itself),
                `name` (in upper case), `tree` (no value), `any`; with `?` or `*` behind it.
            argument: None where it is left out.

        Raises:
            VplusError: if it is of another kind.
        """
        name = kind.rstrip("?*")
        if name == "tree" or (argument is None and kind.endswith("?")):
            return argument
        if name == "variable":
            return self.variable(argument)
        if name == "name" and isinstance(argument, Reference | Function):
            return argument.name.upper()
        value: Any = self.value(argument)
        if not isinstance(value, _TYPES.get(name, float)):
            accepted = _SAID.get(name, name)
            raise VplusError("Illegal value", f"a {KINDS[type(value)]}; accepted: a {accepted}")
        low, high = _RANGES.get(name, (None, None))
        if low is not None and not low <= value <= high:
            raise VplusError("Illegal value", f"{value:g} {name}; accepted: {low:g} to {high:g}")
        if name == "folded" and isinstance(value, str) and self.readings.ignore_case:
            return value.upper()
        convert = _CONVERSIONS.get(name)
        return value if convert is None else convert(value)

    # Where the tool is.

    @property
    def _stand(self) -> SE3:
        """Return where the robot stands in the world."""
        return self.base if self.readings.base_moves_robot else self.base.inverse()

    def tool_at(self, q: Array) -> SE3:
        """Return where the tool is in the world at joint angles, rad, shape (6,)."""
        return self._stand * self.arm.flange(q) * self.tool

    def solve(self, place: SE3, *, keep: bool = False) -> Array:
        """Return the joint angles, rad, shape (6,), at which the tool is at a place in the world.

        Args:
            place: mm.
            keep: whether the configuration stays what it is at the end of the newest motion.

        Raises:
            VplusError: if there are none.
        """
        parts = self.arm.configuration(self.queue.destination)
        if not keep:
            parts = [self.wanted.get(part, present) for part, present in enumerate(parts)]
        flange = self._stand.inverse() * place * self.tool.inverse()
        return self.arm.solve_target(flange, parts, self.queue.destination)
