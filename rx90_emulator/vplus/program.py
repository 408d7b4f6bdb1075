"""Files of V+: programs and data, read and checked before anything runs."""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Final

from rx90_common.base.errors import ConfigError
from rx90_common.base.quoting import plain, quoted
from rx90_emulator.vplus import transformations
from rx90_emulator.vplus.errors import LoadError
from rx90_emulator.vplus.registry import CONTROL, FUNCTIONS, INSTRUCTIONS, REFUSED, RESERVED, Arity
from rx90_emulator.vplus.syntax import Function, Line, Number, Reference, nodes, parse_line, plain_name
from rx90_emulator.vplus.values import Cell, Joints, Scope, Value

SUFFIXES: Final = (".v2", ".pg", ".lc", ".rv", ".st")
_MOST_FAULTS = 20
_LARGEST_LABEL = 65535
_LARGEST_FILE = 20_000_000
_HEADER = re.compile(r"\.PROGRAM\s+([a-z][\w.]*)\s*(?:\(([^)]*)\))?\s*$", re.IGNORECASE | re.ASCII)
_PARAMETER = re.compile(r"([$#]?[a-z][\w.]*)\s*(\[[\s,]*\])?$", re.IGNORECASE | re.ASCII)
_LABELLED = re.compile(r"(\d+)(?:\s+(.*))?$", re.ASCII)
_CODE = re.compile(r'(?:"[^"]*"|[^";])*')
_DATUM = re.compile(r"([$#]?[a-z][\w.]*)\s*(?:\[([\d,\s]*)\])?\s+(.+)$", re.IGNORECASE | re.ASCII)
_LOOPS = ("FOR", "WHILE", "DO")
_OPENED = {"IF THEN": "IF", "FOR": "FOR", "WHILE": "WHILE", "DO": "DO", "CASE": "CASE"}


@dataclass
class Step:
    """A line of a program.

    Attributes:
        line: of the file.
        instruction: None for a blank one.
        start: of the block that it belongs to, the number of the step that opens it; -1 for none.
        end: of that block, or of the loop that it leaves or goes on with.
        branches: of a block, in their order: ELSE, or each VALUE and ANY.
    """

    line: int
    instruction: Line | None
    start: int = -1
    end: int = -1
    branches: list[int] = field(default_factory=list)


@dataclass
class Program:
    """A program.

    Attributes:
        name: in lower case, as it counts.
        parameters: names of its arguments.
        steps: its lines.
        labels: numbers of steps by their label.
        automatic: names that are new at each call.
        local: the scope of its LOCAL variables.
        own: their names.
        text: its lines as they stand in the file.
    """

    name: str
    parameters: tuple[str, ...]
    steps: list[Step] = field(default_factory=list)
    labels: dict[int, int] = field(default_factory=dict)
    automatic: set[str] = field(default_factory=set)
    local: Scope = field(default_factory=Scope)
    own: set[str] = field(default_factory=set)
    text: list[str] = field(default_factory=list)


@dataclass
class Memory:
    """Programs and global variables, as the controller has them in its memory."""

    programs: dict[str, Program] = field(default_factory=dict)
    variables: Scope = field(default_factory=Scope)


def load(place: Path) -> Memory:
    """Read a file, or all files of V+ in a folder.

    Raises:
        ConfigError: for what cannot be read.
        LoadError: naming every fault with file and line.
    """
    memory = Memory()
    faults: list[str] = []
    for file in _files(place):
        try:
            if file.stat().st_size > _LARGEST_FILE:
                raise ConfigError(f"{plain(file)}: more than {_LARGEST_FILE:,} bytes; accepted: a file of V+")
            content = file.read_text(encoding="latin-1")
        except OSError as error:
            raise ConfigError(f"{plain(file)}: {error.strerror}; accepted: a file of V+") from error
        faults += [f"{plain(file)}:{line}: {fault}" for line, fault in read(content, memory)]
    faults += [f"{plain(place)}: {fault}" for fault in _calls(memory)]
    if faults:
        raise LoadError([*faults[:_MOST_FAULTS], *(["further faults"] if len(faults) > _MOST_FAULTS else [])])
    return memory


def _files(place: Path) -> list[Path]:
    if not place.is_dir():
        return [place]
    found = sorted(file for file in place.iterdir() if file.suffix.lower() in SUFFIXES)
    if not found:
        raise ConfigError(f"{plain(place)}: no file of V+; accepted: {', '.join(SUFFIXES)}")
    return found


def read(content: str, memory: Memory) -> list[tuple[int, str]]:
    """Add the programs and data of a file to the memory; return its faults with their lines."""
    reader = _Reader(memory)
    for number, text in enumerate(content.replace("\f", "\n").replace("\r", "").replace("\x1a", "").split("\n"), 1):
        reader.take(number, _CODE.match(text.strip())[0].strip(), text)  # type: ignore[index]  # matches nothing, too
    reader.finish(number)
    return sorted(reader.faults)


class _Reader:
    """Takes the lines of a file one after the other."""

    def __init__(self, memory: Memory) -> None:
        self.memory = memory
        self.faults: list[tuple[int, str]] = []
        self.program: Program | None = None
        self.section = ""
        self.began = 0

    def fault(self, line: int, text: str) -> None:
        self.faults.append((line, text))

    def take(self, line: int, code: str, text: str) -> None:
        head = code.split(maxsplit=1)[0].upper() if code.startswith(".") else ""
        if head == ".PROGRAM":
            self.close(line, "a program without .END")
            self.open_program(line, code)
        elif head == ".END":
            if not self.section:
                self.fault(line, ".END without a program")
            self.close(line, "")
        elif head in (".LOCATIONS", ".REALS", ".STRINGS"):
            self.close(line, "a section without .END")
            self.section = head
        elif self.program is not None:
            self.program.text.append(text)
            self.take_step(line, code)
        elif self.section and code:
            self.take_datum(line, code)
        elif code:
            self.fault(line, f"{quoted(code[:30])} stands outside of a program; accepted: .PROGRAM name(...)")

    def finish(self, line: int) -> None:
        self.close(line, "a program without .END")

    def open_program(self, line: int, code: str) -> None:
        self.section = "program"
        self.began = line
        header = _HEADER.match(code)
        if header is None:
            self.fault(line, f"{quoted(code[:60])}; accepted: .PROGRAM name(argument, ...)")
            self.program = Program("", ())
            return
        parameters = [part.strip() for part in (header[2] or "").split(",") if part.strip()]
        matches = [_PARAMETER.match(part) for part in parameters]
        for part, match in zip(parameters, matches, strict=True):
            if match is None:
                self.fault(line, f"argument {quoted(part)}; accepted: a name, with [] for an array")
        names = tuple(plain_name(match[1]) for match in matches if match is not None)
        self.program = Program(plain_name(header[1]), names)
        if self.program.name in self.memory.programs:
            self.fault(line, f"program {self.program.name} stands twice")

    def close(self, line: int, missing: str) -> None:
        if self.section and missing:
            self.fault(line, f"{missing}; it began in line {self.began}")
        if self.program is not None:
            self.faults += _resolve(self.program)
            if self.program.name:
                self.memory.programs[self.program.name] = self.program
        self.program = None
        self.section = ""

    def take_step(self, line: int, code: str) -> None:
        program = self.program
        assert program is not None
        labelled = _LABELLED.match(code)
        if labelled is not None:
            label = int(labelled[1][:9])
            code = labelled[2] or ""
            if label > _LARGEST_LABEL:
                self.fault(line, f"label {label}; accepted: 0 to {_LARGEST_LABEL}")
            if label in program.labels:
                self.fault(line, f"label {label} stands twice")
            program.labels[label] = len(program.steps)
        instruction = None
        if code:
            try:
                instruction = checked_line(code)
                self.declare(instruction)
            except SyntaxError as error:
                self.fault(line, f"{quoted(code[:60])}: {error}")
        program.steps.append(Step(line, instruction))

    def declare(self, instruction: Line) -> None:
        if instruction.word not in ("AUTO", "LOCAL", "GLOBAL"):
            return
        program = self.program
        assert program is not None
        done = [step.instruction.word for step in program.steps if step.instruction is not None]
        if any(word not in ("AUTO", "LOCAL", "GLOBAL") for word in done):
            raise SyntaxError("stands behind an executable line; accepted: before it")
        names = {part.name for part in instruction.arguments if isinstance(part, Reference)}
        if instruction.word == "AUTO":
            program.automatic |= names
        elif instruction.word == "LOCAL":
            program.own |= names

    def take_datum(self, line: int, code: str) -> None:
        match = _DATUM.match(code)
        try:
            if match is None:
                raise ValueError("accepted: a name and its value")
            name = plain_name(match[1])
            value = _datum(self.section, name, match[3])
            scope = self.memory.variables
            index = match[2]
            cell: Cell
            if index is None:
                cell = scope.cell(name)
            else:
                cell = scope.table(name).cell(name, tuple(int(part) for part in index.split(",")))
            cell.value = value
        except Exception as error:  # of numbers and indices alike
            self.fault(line, f"{quoted(code[:60])}: {error}")


def _datum(section: str, name: str, text: str) -> Value:
    if section == ".STRINGS":
        if name[0] != "$" or len(text) < 2 or text[0] != '"' or text[-1] != '"':
            raise ValueError('accepted: $name "text"')
        return text[1:-1]
    numbers = [float(part) for part in text.split()]
    if not all(abs(number) < 1e30 for number in numbers):
        raise ValueError("accepted: finite numbers")
    wanted = 1 if section == ".REALS" else 6
    if len(numbers) != wanted:
        raise ValueError(f"{len(numbers)} numbers; accepted: {wanted}")
    if section == ".REALS":
        return numbers[0]
    return Joints(numbers) if name[0] == "#" else transformations.trans(*numbers)


def checked_line(code: str) -> Line:
    """Return the instruction in a line, with names and numbers of arguments checked.

    Raises:
        SyntaxError: saying what is accepted.
    """
    word = code.split(maxsplit=1)[0].upper()
    if word in REFUSED:
        raise SyntaxError(f"{word} is not there: {REFUSED[word]}")
    instruction = parse_line(code)
    _check(instruction)
    return instruction


def _check(instruction: Line) -> None:
    word = instruction.word
    if word == "=" and isinstance(target := instruction.arguments[0], Reference) and target.name.upper() in RESERVED:
        raise SyntaxError(f"{target.name} is a reserved word")
    arity = INSTRUCTIONS[word].arity if word in INSTRUCTIONS else None
    if arity is None and word not in CONTROL:
        raise SyntaxError("*Unknown instruction*")
    if arity is not None:
        _check_count(word, len(instruction.arguments), arity)
    called = instruction.arguments[0] if word in ("CALL", "CALLS") else None
    for node in nodes((instruction.arguments, instruction.value, instruction.unit)):
        if isinstance(node, Function) and node is not called:
            function = FUNCTIONS.get(node.name.upper())
            if function is None:
                raise SyntaxError(f"*Undefined program or variable name* {node.name}(")
            _check_count(node.name.upper(), len(node.arguments), function.arity)


def _check_count(name: str, given: int, arity: Arity) -> None:
    least, most = arity
    if not least <= given <= most:
        accepted = str(least) if least == most else f"{least} to {most}"
        raise SyntaxError(f"{name} has {given} arguments; accepted: {accepted}")


def _resolve(program: Program) -> Iterator[tuple[int, str]]:
    """Find the ends of blocks and the targets of jumps; yield faults with their lines."""
    blocks: list[tuple[str, int]] = []
    leaving: list[tuple[Step, int]] = []
    for place, step in enumerate(program.steps):
        word = step.instruction.word if step.instruction is not None else ""
        if word in _OPENED:
            blocks.append((_OPENED[word], place))
        elif word in ("END", "UNTIL", "ELSE", "VALUE", "ANY"):
            fits = {"END": ("IF", "FOR", "WHILE", "CASE"), "UNTIL": ("DO",), "ELSE": ("IF",)}.get(word, ("CASE",))
            if not blocks or blocks[-1][0] not in fits:
                yield step.line, f"{word} without {' or '.join(fits)}"
                continue
            start = blocks[-1][1]
            step.start = start
            if word in ("END", "UNTIL"):
                blocks.pop()
                for inner in (program.steps[start], step, *(program.steps[k] for k in program.steps[start].branches)):
                    inner.end = place
            else:
                program.steps[start].branches.append(place)
        elif word in ("EXIT", "NEXT"):
            loops = [start for kind, start in blocks if kind in _LOOPS]
            count = _whole(step, 1)
            if not 1 <= count <= len(loops):
                yield step.line, f"{word} {count} within {len(loops)} loops"
                continue
            leaving.append((step, loops[-count]))
        elif word in ("GOTO", "IF GOTO") and _whole(step, -1) not in program.labels:
            yield step.line, f"there is no label {_whole(step, -1)}"
    for kind, start in blocks:
        yield program.steps[start].line, f"{kind} without END"
    for step, start in leaving:
        step.end = program.steps[start].end


def _whole(step: Step, missing: int) -> int:
    """Return the whole number that an instruction ends with: a label, or how many loops."""
    assert step.instruction is not None
    last = step.instruction.arguments[-1] if step.instruction.arguments else None
    return int(last.value) if isinstance(last, Number) else missing


def _calls(memory: Memory) -> Iterable[str]:
    """Yield the faults of calls with more arguments than the program has."""
    for program in memory.programs.values():
        for step in program.steps:
            if step.instruction is None or step.instruction.word != "CALL":
                continue
            called = step.instruction.arguments[0]
            if not isinstance(called, Function) or called.name not in memory.programs:
                continue
            most = len(memory.programs[called.name].parameters)
            if len(called.arguments) > most:
                given = len(called.arguments)
                yield f"line {step.line}: {called.name} is called with {given} arguments; accepted: up to {most}"
