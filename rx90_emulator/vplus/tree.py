"""What programs are made of: readings, trees of lines, steps, programs, and the memory that holds them."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any, TypeAlias

from pydantic import PositiveFloat

from rx90_common.base.models import Model
from rx90_emulator.vplus.values import Format, Scope


class Readings(Model):
    """How uncertain parts of V+ are read: every choice stands here, with the more likely reading as its default.

    Attributes:
        logic_before_relations: AND binds as *, OR and XOR as +, all before comparisons; if not, comparisons before them
            all.
        drive_obeys_program_speed: the program's SPEED scales DRIVE, too; if not, the monitor speed alone does.
        base_moves_robot: BASE says where the robot stands in the world; if not, where the world is seen from.
        format_persists: a format of TYPE holds for all items after it; if not, for the next one.
        ignore_case: comparisons of strings ignore upper and lower case.
        step_time: time that the processor takes for a step, s.
    """

    logic_before_relations: bool = True
    drive_obeys_program_speed: bool = False
    base_moves_robot: bool = True
    format_persists: bool = True
    ignore_case: bool = True
    step_time: PositiveFloat = 40e-6


@dataclass(eq=False)
class Entry:
    """An instruction or a function in its table.

    Attributes:
        kinds: of its arguments (see `Task.taken`); `?` behind one that may be left out, `*` behind one that may come
            any number of times.
        action: what an instruction does to a task, with what it waits for; a function's value.
    """

    kinds: list[str]
    action: Callable[..., Any]

    def check(self, word: str, given: int) -> None:
        """Check how many arguments are given.

        Raises:
            SyntaxError: saying which are accepted.
        """
        least = sum(kind[-1] not in "?*" for kind in self.kinds)
        has_more = "*" in "".join(self.kinds)
        if given < least or (given > len(self.kinds) and not has_more):
            raise SyntaxError(
                f"{word} has {given} arguments; accepted: {' '.join(self.kinds) or 'none'}"
            )


_NOTHING = Entry([], lambda _: None)


def entries(actions: dict[str, Callable[..., Any]]) -> dict[str, Entry]:
    """Return a table of instructions or functions.

    Args:
        actions: by the words that have one, two blanks, and the kinds of its arguments; they get the task before these.
    """
    table = {}
    for line, action in actions.items():
        words, _, arguments = line.partition("  ")
        for word in words.split():
            table[word] = Entry(arguments.split(), action)
    return table


@dataclass(frozen=True)
class Reference:
    """A variable, an element of an array, or a whole array.

    Attributes:
        name: in lower case, cut to the length that counts.
        index: None for a plain variable; one expression for each dimension, None where it is left out.
    """

    name: str
    index: tuple[Tree, ...] | None = None


@dataclass(frozen=True)
class Function:
    """A function or an operator with its arguments."""

    name: str
    entry: Entry
    arguments: tuple[Tree, ...]


Tree: TypeAlias = float | str | Format | Reference | Function | None
"""An expression, a format, or None for an argument that is left out."""


@dataclass
class Step:
    """A line of a program.

    Attributes:
        word: of the instruction in upper case, empty for a blank line; with `=` behind it where a value is set, with
            `()` where a unit stands in brackets.
        entry: what it does.
        arguments: in their order; a value that is set, or a unit, comes first.
        modifiers: such as ALWAYS.
        line: of the file.
        target: number of the step to which it jumps.
        branches: of a block, in their order: the steps that belong to it.
    """

    word: str = ""
    entry: Entry = _NOTHING
    arguments: tuple[Any, ...] = ()
    modifiers: tuple[str, ...] = ()
    line: int = 1
    target: int = 0
    branches: list[int] = field(default_factory=list)


@dataclass
class Program:
    """A program.

    Attributes:
        name: in lower case, as it counts.
        parameters: names of its arguments.
        steps: its lines.
        labels: numbers of steps by their label.
        automatic: names that are new at each call, with those of the arguments.
        local: variables that are its own and stay between calls.
        text: its lines as they stand in the file.
    """

    name: str = ""
    parameters: tuple[str, ...] = ()
    steps: list[Step] = field(default_factory=list)
    labels: dict[int, int] = field(default_factory=dict)
    automatic: set[str] = field(default_factory=set)
    local: Scope = field(default_factory=dict)
    text: list[str] = field(default_factory=list)


@dataclass
class Memory:
    """Programs and global variables, as the controller has them in its memory, and how programs are read."""

    readings: Readings = field(default_factory=Readings)
    programs: dict[str, Program] = field(default_factory=dict)
    variables: Scope = field(default_factory=dict)
