"""Files of V+: programs and data, read and checked before anything runs, line by line with the grammar."""

from __future__ import annotations

from collections.abc import Iterator
from functools import cache
from io import StringIO
from operator import neg
from pathlib import Path
from typing import Any

from lark import Lark, Transformer, v_args
from lark import Tree as Rule
from lark.exceptions import LarkError, UnexpectedInput

from rx90_common.base.errors import ConfigError, warn_caller
from rx90_common.base.quoting import plain, quoted
from rx90_common.base.text_lines import read_bytes
from rx90_emulator.cabinet.arm import Joints
from rx90_emulator.cabinet.errors import VplusError
from rx90_emulator.cabinet.locations import trans
from rx90_emulator.vplus.functions import FUNCTIONS, number_of
from rx90_emulator.vplus.instructions import INSTRUCTIONS, REFUSED
from rx90_emulator.vplus.tree import (
    Entry,
    Function,
    Memory,
    Program,
    Readings,
    Reference,
    Step,
    Tree,
)
from rx90_emulator.vplus.values import (
    Format,
    LoadError,
    Variable,
    bounded,
    element,
    plain_name,
)

SUFFIXES = (".v2", ".pg", ".lc", ".rv", ".st")
_LONGEST_LINE = 255
_LARGEST_LABEL = 65535
_LARGEST_FILE = 20_000_000
_LOCATION = 6
_RESERVED = "TO BY OF STEP THEN DO AND OR XOR NOT MOD COM ALWAYS LAST POS DX DY DZ BELOW"
_DECLARATIONS = ("AUTO", "LOCAL", "GLOBAL")
_LOOPS = ("FOR", "WHILE", "DO")
_INSIDE = {
    "IF_THEN": ("ELSE", "END"),
    "CASE": ("VALUE", "ANY", "END"),
    "FOR": ("END",),
    "WHILE": ("END",),
    "DO": ("UNTIL",),
}
"""What may stand in the level of a block, its end last."""


# Lines.


def _checked(
    table: dict[str, Entry], word: str, arguments: tuple[Tree, ...], unknown: str
) -> tuple[str, Entry, tuple[Tree, ...]]:
    """Return word, entry and arguments of an instruction or a function, if a table has it with so many."""
    word = word.upper()
    entry = table.get(word)
    if entry is None:
        reason = REFUSED.get(word.rstrip("()="))
        raise SyntaxError(f"{word} is not there: {reason}" if reason else unknown)
    entry.check(word, len(arguments))
    return word, entry, arguments


def _function(word: str, *arguments: Tree) -> Function:
    unknown = f"*Undefined program or variable name* {word}("
    return Function(*_checked(FUNCTIONS, word, arguments, unknown))


def _step(word: str, *arguments: Tree, modifiers: tuple[str, ...] = ()) -> Step:
    return Step(*_checked(INSTRUCTIONS, word, arguments, "*Unknown instruction*"), modifiers)


@v_args(inline=True)
class _Builder(Transformer[Any]):
    """Makes the trees, rule by rule of the grammar."""

    def number(self, token: str) -> Any:
        return bounded(ord(token[1]) if token[0] == "'" else number_of(token))

    integer = float
    negative = neg

    def text(self, token: str) -> str:
        return str(token[1:-1])

    def format(self, token: str) -> Format:
        return Format(token[1:].upper())

    def modifier(self, token: str) -> str:
        return token.upper()

    def program(self, name: str) -> str:
        return plain_name(name)

    def parts(self, *parts: Tree) -> tuple[Tree, ...]:
        return parts

    def reference(self, name: str, index: Any) -> Tree:
        entry = FUNCTIONS.get(name.upper())
        is_function = index is None and entry is not None and not entry.kinds
        return _function(name) if is_function else Reference(plain_name(name), index)

    def function(self, name: str, *arguments: Tree) -> Tree:
        return _function(name, *arguments)

    def operation(self, left: Tree, sign: str, right: Tree) -> Tree:
        return _function(sign, left, right)

    def prefixed(self, sign: str, operand: Tree) -> Tree:
        return _function(sign, 0.0, operand) if sign in "+-" else _function(sign, operand)

    def assignment(self, target: Any, value: Tree) -> Step:
        if isinstance(target, Function) or target.name.upper() in _RESERVED.split():
            raise SyntaxError(f"{target.name.lower()} is a reserved word")
        return _step("=", value, target)

    def command(self, word: str, arguments: Any, *modifiers: str) -> Step:
        return _step(word, *(arguments or ()), modifiers=modifiers)

    def setting(self, word: str, *parts: Tree) -> Step:
        return _step(f"{word}=", parts[-1], *parts[:-1])

    def unit_command(self, word: str, unit: Any, *arguments: Tree) -> Step:
        return _step(f"{word}()", (unit or [None])[0], *arguments)

    def declaration(self, word: str, _: str, *names: Reference) -> Step:
        return _step(word, *(name.name for name in names))

    def step(self, label: str | None, step: Any = None) -> tuple[int, Step]:
        if isinstance(step, Rule):  # an instruction of control: its word is in the name of the rule
            parts: list[Any] = step.children
            step = _step(str(step.data).strip("_"), *parts)
        return int(label[:9]) if label else -1, step or Step()

    def place(self, name: str, index: Any) -> Reference:
        return Reference(plain_name(name), index)

    def header(self, name: str, *parameters: Reference) -> Program:
        names = tuple(parameter.name for parameter in parameters)
        return Program(name, names, automatic=set(names))

    def datum(self, place: Reference, *parts: Any) -> tuple[Reference, Any]:
        if place.name.upper() in FUNCTIONS:
            raise SyntaxError(f"{place.name} is a reserved word")
        if len(parts) == 1:
            return place, parts[0]
        if len(parts) != _LOCATION:
            raise SyntaxError(f"{len(parts)} numbers; accepted: 1, or {_LOCATION} of a location")
        return place, Joints(parts) if place.name[0] == "#" else trans(*parts)


@cache
def _parser(reading: str) -> Lark:
    grammar = Path(__file__).with_name("grammar.lark").read_text(encoding="utf-8")
    starts = ["step", "header", "datum", "place"]
    grammar += f"\n?expression: {reading}\n"
    return Lark(
        grammar, parser="lalr", start=starts, maybe_placeholders=True, transformer=_Builder()
    )


def parse(text: str, start: str, logic_first: bool = True) -> Any:
    """Return what a line has: of a `step` its label and instruction, of a `header`, a `datum`, or its `place`.

    Raises:
        SyntaxError: saying what the line has and where.
    """
    if len(text) > _LONGEST_LINE:
        raise SyntaxError(f"a line of {len(text)} characters; accepted: up to {_LONGEST_LINE}")
    try:
        return _parser("logic_first" if logic_first else "relations_first").parse(text, start=start)
    except UnexpectedInput as error:
        left = "" if "$END" in str(error).partition("\n")[0] else text[error.column - 1 :][:20]
        raise SyntaxError(
            f"{left!r} is not expected" if left.strip() else "the line ends too early"
        ) from None
    except (LarkError, VplusError) as error:
        raise SyntaxError(str(error)) from None


def parse_line(text: str) -> Step:
    """Return the instruction in a line without a label.

    Raises:
        SyntaxError: saying what the line has and where, also if it has no instruction.
    """
    label, step = parse(text, "step")
    if label >= 0 or not step.word:
        raise SyntaxError("*Missing argument*")
    return step  # type: ignore[no-any-return]  # of the parser


def global_variable(memory: Memory, place: Reference) -> Variable:
    """Return a global variable or an element of an array, made on first use; its index is of numbers."""
    index = tuple(int(part) for part in place.index or () if part is not None)  # type: ignore[arg-type]
    return element(memory.variables.setdefault(place.name, {}), place.name, index)


# Files.


def load_programs(place: Path | str, readings: Readings | None = None) -> Memory:
    """Read a file of V+, or all of them in a folder, and warn of what depends on a reading.

    Raises:
        ConfigError: for what cannot be read.
        LoadError: naming every fault with file and line.
    """
    memory = Memory(readings or Readings())
    faults: list[str] = []
    warnings: list[str] = []
    for file in _files(Path(place)):
        content = read_bytes(file, _LARGEST_FILE).decode("latin-1")
        reader = read(content, memory)
        faults += [f"{plain(file)}:{line}: {fault}" for line, fault in reader.faults]
        warnings += [f"{plain(file)}:{line}: {warning}" for line, warning in reader.warnings]
    faults += [f"{plain(place)}: {fault}" for fault in _call_faults(memory)]
    if faults:
        raise LoadError(faults)
    warn_caller(warnings)
    return memory


def _files(place: Path) -> list[Path]:
    if not place.is_dir():
        return [place]
    files = sorted(file for file in place.iterdir() if file.suffix.lower() in SUFFIXES)
    if not files:
        raise ConfigError(f"{plain(place)}: no file of V+; accepted: {', '.join(SUFFIXES)}")
    return files


def read(content: str, memory: Memory) -> Reader:
    """Add the programs and data of a file to the memory; return its reader with faults and warnings."""
    reader = Reader(memory)
    lines = StringIO(content.replace("\f", "\n").replace("\x1a", ""), newline=None)
    for reader.line, text in enumerate(lines, 1):
        try:
            reader.take(text.rstrip("\n"))
        except (SyntaxError, VplusError, RecursionError) as error:
            reader.note(f"{quoted(text.strip()[:60])}: {error}")
    reader.close(".END")
    return reader


class Reader:
    """Takes the lines of a file one after the other.

    Args:
        memory: where programs and data go.

    Attributes:
        line: number of the present one.
        faults: with their lines.
        warnings: of lines whose meaning depends on a reading.
    """

    def __init__(self, memory: Memory) -> None:
        self.memory = memory
        self.line = 0
        self.faults: list[tuple[int, str]] = []
        self.warnings: list[tuple[int, str]] = []
        self._program: Program | None = None
        self._section = ""

    def note(self, fault: str) -> None:
        """Note a fault of the present line."""
        self.faults.append((self.line, fault))

    def take(self, text: str) -> None:
        """Take a line.

        Raises:
            SyntaxError: saying what it has.
        """
        code = text.strip()
        head = code.partition(" ")[0].upper()
        if head.startswith(".END"):
            if not self._section:
                self.note(".END without a program")
            self._finish()
        elif head in (".PROGRAM", ".LOCATIONS", ".REALS", ".STRINGS"):
            self.close(head)
            self._section = head
            if head == ".PROGRAM":
                self._program = Program()
                self._program = parse(code, "header")
                if self._program.name in self.memory.programs:
                    self.note(f"program {self._program.name} stands twice")
        elif self._program is not None:
            self._program.text.append(text)
            self._take_step(self._program, code)
        elif code and code[0] != ";":
            if not self._section:
                raise SyntaxError("outside of a program; accepted: .PROGRAM name(...)")
            place, value = parse(code, "datum")
            global_variable(self.memory, place).store(value)

    def close(self, head: str) -> None:
        """End what has no .END of its own, with a fault."""
        if self._section:
            self.note(f"{head} in {self._section}: its .END is missing")
        self._finish()

    def _finish(self) -> None:
        if self._program is not None:
            self.faults += _resolve(self._program)
            if self._program.name:
                self.memory.programs[self._program.name] = self._program
        self._program = None
        self._section = ""

    def _take_step(self, program: Program, code: str) -> None:
        place = len(program.steps)
        program.steps.append(Step(_opening(code), line=self.line))
        logic_first = self.memory.readings.logic_before_relations
        label, step = parse(code, "step", logic_first)
        if label >= 0:
            if label > _LARGEST_LABEL or label in program.labels:
                self.note(f"label {label}; accepted: each once, 0 to {_LARGEST_LABEL}")
            program.labels[label] = place
        if step.word in _DECLARATIONS and any(
            earlier.word not in ("", *_DECLARATIONS) for earlier in program.steps
        ):
            self.note(f"{step.word} stands behind an executable line")
        if step.word == "AUTO":
            program.automatic.update(step.arguments)
        if step.word == "LOCAL":
            program.local.update((name, {}) for name in step.arguments)
        if parse(code, "step", not logic_first) != (label, step):
            reading = "read by logic_before_relations (docs/reference/vplus.md)"
            self.warnings.append(
                (self.line, f"a comparison beside AND, OR or XOR without brackets; {reading}")
            )
        step.line = self.line
        program.steps[place] = step


def _opening(code: str) -> str:
    """Return the word of a line that opens a block, even if the line is faulty: its END is no fault."""
    words = [*code.upper().split(), ""]
    word = "IF_THEN" if words[0] == "IF" and words[-2] == "THEN" else words[0]
    return word if word in _INSIDE else ""


def _resolve(program: Program) -> Iterator[tuple[int, str]]:
    """Find the targets of jumps; yield faults with their lines."""
    steps = program.steps
    blocks: list[int] = []
    for place, step in enumerate(steps):
        step.target = place + 1
        number = step.arguments[-1:]
        if step.word in _INSIDE:
            blocks.append(place)
        elif step.word in ("ELSE", "VALUE", "ANY", "END", "UNTIL"):
            if not blocks or step.word not in _INSIDE[steps[blocks[-1]].word]:
                yield step.line, f"{step.word} without its block"
                continue
            steps[blocks[-1]].branches.append(place)
            if step.word in ("END", "UNTIL"):
                _close(steps, blocks.pop(), place)
        elif step.word in ("EXIT", "NEXT"):
            loops = [start for start in blocks if steps[start].word in _LOOPS]
            count = int(number[0] or 1)
            if not 1 <= count <= len(loops):
                yield step.line, f"{step.word} {count} within {len(loops)} loops"
                continue
            steps[loops[-count]].branches.append(place)
        elif step.word in ("GOTO", "IF_GOTO"):
            if number[0] not in program.labels:
                yield step.line, f"there is no label {number[0]:g}"
            step.target = program.labels.get(int(number[0]), 0)
    for start in blocks:
        word = steps[start].word
        yield steps[start].line, f"{word.partition('_')[0]} without {_INSIDE[word][-1]}"


def _close(steps: list[Step], start: int, end: int) -> None:
    """Set the targets of the steps of a block."""
    opening = steps[start]
    opening.target = end + 1
    for place in opening.branches:
        steps[place].target = end if steps[place].word == "NEXT" else end + 1
        if steps[place].word == "ELSE":
            opening.target = place + 1
    if opening.word in _LOOPS:
        steps[end].target = start if opening.word == "WHILE" else start + 1


def _call_faults(memory: Memory) -> Iterator[str]:
    """Yield the faults of calls with more arguments than the program has."""
    for program in memory.programs.values():
        for step in program.steps:
            name, *given = step.arguments if step.word == "CALL" else [""]
            called = memory.programs.get(name)
            if called is not None and len(given) > len(called.parameters):
                accepted = f"accepted: up to {len(called.parameters)}"
                yield f"line {step.line}: {called.name} is called with {len(given)} arguments; {accepted}"
