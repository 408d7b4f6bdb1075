"""The tables of instructions and functions, which the modules fill that define them."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from typing import Any, Final, TypeAlias, TypeVar

Arity: TypeAlias = tuple[int, int]
"""The least and the most arguments."""
MANY: Final = 255
Waits: TypeAlias = Iterator[str]
"""What an instruction waits for, in a word, once in each beat."""
Action = TypeVar("Action", bound=Callable[..., Any])


@dataclass(frozen=True)
class Instruction:
    """An instruction: what it does for a task and a line; it yields while it waits, or returns None."""

    arity: Arity
    run: Callable[..., Waits | None]


@dataclass(frozen=True)
class Function:
    """A function: its value for a task and arguments, which are trees for some functions, and else values."""

    arity: Arity
    value: Callable[..., Any]
    takes_trees: bool


INSTRUCTIONS: dict[str, Instruction] = {}
FUNCTIONS: dict[str, Function] = {}

REFUSED: Final = {
    **dict.fromkeys(("VPICTURE", "VLOCATE", "VFEATURE", "VSHOW", "VTRAIN", "VDISPLAY"), "vision is not emulated"),
    **dict.fromkeys(("ALTER", "ALTON", "ALTOFF"), "ALTER needs a licensed option"),
    **dict.fromkeys(("FORCE.READ", "FORCE.MODE", "FORCE.FRAME", "FORCE.OFFSET"), "force sensing is not emulated"),
    **dict.fromkeys(("FOPEN", "FOPENR", "FOPENW", "FCLOSE", "READ", "WRITE", "FSET"), "no files or lines are emulated"),
    **dict.fromkeys(("EXECUTE", "ABORT", "KILL"), "one task is emulated"),
    **dict.fromkeys(("MOVEF", "MOVESF"), "they belong to other arms"),
    **dict.fromkeys(("DEVICE", "SETDEVICE", "DDCMP"), "no devices are emulated"),
}
"""Instructions that are not there, and why."""

CONTROL: dict[str, Callable[..., None]] = {}
"""Instructions of control, which change the step that is next: for a task, the frame of its program, and the step."""

_RESERVED: Final = """
IF THEN ELSE END FOR TO STEP WHILE DO UNTIL CASE OF VALUE ANY GOTO EXIT NEXT CALL CALLS RETURN BY AND OR XOR NOT MOD COM
BAND BOR BXOR ALWAYS MMPS IPS MONITOR TRUE FALSE ON OFF PI HERE DEST NULL LAST POS TIME DX DY DZ BELOW
"""
RESERVED: Final = frozenset(_RESERVED.split())
"""Names that no variable may have."""


def instruction(name: str, least: int = 0, most: int | None = None) -> Callable[[Action], Action]:
    """Return a decorator that enters an instruction with so many arguments."""

    def enter(run: Action) -> Action:
        INSTRUCTIONS[name] = Instruction((least, least if most is None else most), run)
        return run

    return enter


def function(name: str, least: int = 0, most: int | None = None, *, trees: bool = False) -> Callable[[Action], Action]:
    """Return a decorator that enters a function with so many arguments."""

    def enter(value: Action) -> Action:
        FUNCTIONS[name] = Function((least, least if most is None else most), value, trees)
        return value

    return enter


def functions(table: Mapping[str, tuple[int, Callable[..., Any]]]) -> None:
    """Enter functions with so many arguments each, which get the task first."""
    for name, (count, value) in table.items():
        function(name, count)(value)


def instructions(table: Mapping[str, tuple[int, Callable[..., Waits | None]]]) -> None:
    """Enter instructions with so many arguments each."""
    for name, (count, run) in table.items():
        instruction(name, count)(run)
