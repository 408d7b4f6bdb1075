"""The monitor of V+: the dot prompt on a serial line, its commands, and the programs that it runs.

A command is a generator: it yields lines to show, a question (`Ask`), whose answer it gets, or None to wait for a beat.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Generator, Iterator
from pathlib import Path
from typing import Final, TypeAlias

import numpy as np

from rx90_common.base.errors import Rx90Error
from rx90_common.base.quoting import plain
from rx90_emulator.vplus import language  # noqa: F401 - enters the instructions
from rx90_emulator.vplus.cell import Cell
from rx90_emulator.vplus.errors import LoadError, VplusError
from rx90_emulator.vplus.locations import tool_at
from rx90_emulator.vplus.program import Memory, Program, Step, checked_line, load, read
from rx90_emulator.vplus.readings import Readings
from rx90_emulator.vplus.registry import CONTROL
from rx90_emulator.vplus.syntax import Function, Reference, parse_line, plain_name
from rx90_emulator.vplus.task import Frame, Task
from rx90_emulator.vplus.transformations import six_numbers, trans
from rx90_emulator.vplus.values import Joints, Value


class Ask(str):
    """A question; the cursor stays behind it."""

    __slots__ = ()


Dialogue: TypeAlias = Generator["str | None", str, None]
_PLACE: Final = "X/J1      Y/J2      Z/J3      y/J4      p/J5      r/J6"
_NUMBER_COUNT: Final = 6
_FILE = re.compile(r"[\w-]+(\.\w+)?$", re.ASCII)
_LATER: Final = ("TOOL", "BASE", "SIGNAL", "RESET", "PARAMETER", "DISABLE", "TYPE")
"""Instructions that are commands, too."""


def _row(value: Value) -> str:
    numbers = value if isinstance(value, Joints) else six_numbers(np.asarray(value))
    return " ".join(f"{number + 0.0:9.3f}" for number in numbers)


class Monitor:
    """The monitor.

    Args:
        cell: the arm, its signals and the time.
        folder: where LOAD and STORE find files.
        send: shows text on the terminal.

    Attributes:
        memory: programs and variables.
    """

    def __init__(self, cell: Cell, folder: Path, send: Callable[[str], None]) -> None:
        self.memory = Memory()
        self._cell = cell
        self._folder = folder
        self._send = send
        self._task = Task(self.memory, cell, Readings())
        self._direct = Task(self.memory, cell, Readings())
        self._direct.settings = self._task.settings
        self._runs: Iterator[str] | None = None
        self._dialogue: Dialogue | None = None
        self._asks = False
        cell.show = lambda text, _, ends: send(f"{text}\r\n" if ends else text)
        self._commands: dict[str, Callable[[str], Dialogue]] = {
            "DO": self._do,
            "WHERE": self._where,
            "HERE": self._here,
            "POINT": self._point,
            "LISTL": self._list_places,
            "LISTR": self._list_values,
            "LISTS": self._list_values,
            "LISTP": self._list_programs,
            "DIRECTORY": self._directory,
            "SPEED": self._speed,
            "EXECUTE": self._execute,
            "ABORT": self._abort,
            "KILL": self._kill,
            "PROCEED": self._proceed,
            "STATUS": self._status,
            "LOAD": self._load,
            "STORE": self._store,
            "DELETE": self._delete,
            "EDIT": self._edit,
            "ENABLE": self._enable,
            "CALIBRATE": self._nothing,
            "ZERO": self._zero,
        }

    # The terminal.

    def begin(self) -> None:
        """Show the prompt."""
        self._send(".")

    @property
    def is_busy(self) -> bool:
        """Return whether a command runs that takes no line."""
        return self._dialogue is not None and not self._asks

    def take(self, line: str) -> None:
        """Take a line: a command, or the answer to a question."""
        if self._asks:
            self._asks = False
            self._go_on(line)
            return
        self._dialogue = self._command(line.strip())
        self._go_on(None)

    def beat(self) -> None:
        """Let a beat pass: of the program, the command under way and the cell."""
        if self._runs is not None:
            try:
                next(self._runs)
            except StopIteration:
                self._end_program("Program completed")
            except VplusError as error:
                self._end_program(f"{error.message} {error.where}")
        if self.is_busy:
            self._go_on(None)
        try:
            self._cell.advance()
        except Rx90Error as error:
            self._cell.queue.drop()
            self._end_program(f"*Soft envelope error* {error}")

    def _end_program(self, message: str) -> None:
        self._runs = None
        self._send(f"\r\n{message}\r\n.")

    def _go_on(self, answer: str | None) -> None:
        """Go on with a command until it asks, waits or ends."""
        dialogue = self._dialogue
        assert dialogue is not None
        try:
            while True:
                item = dialogue.send(answer)  # type: ignore[arg-type]  # None begins and goes on
                answer = None
                if item is None:
                    return
                self._send(item if isinstance(item, Ask) else f"{item}\r\n")
                if isinstance(item, Ask):
                    self._asks = True
                    return
        except StopIteration:
            pass
        except VplusError as error:
            self._send(f"{error.message} {error.detail}".rstrip() + "\r\n")
        except (Rx90Error, SyntaxError) as error:
            text = str(error)
            self._send(f"{text if text.startswith('*') else f'*{text}*'}\r\n")
        self._dialogue = None
        self._send(".")

    def _command(self, line: str) -> Dialogue:
        word, _, rest = line.partition(" ")
        word = word.upper()
        if not word:
            return
        name = next((name for name in (*self._commands, *_LATER) if name.startswith(word)), "")
        if name in _LATER:
            yield from self._do(f"{name} {rest}")
        elif not name:
            raise SyntaxError("*Unknown command*")
        else:
            yield from self._commands[name](rest.strip())

    # Commands.

    def _nothing(self, _: str) -> Dialogue:
        yield from ()

    def _do(self, text: str) -> Dialogue:
        if not text:
            raise SyntaxError("*Missing argument*")
        line = checked_line(text)
        if line.word in CONTROL and line.word != "=":
            raise SyntaxError("*Illegal monitor command*")
        self._direct.frames = [Frame(Program("do", (), [Step(1, line)]))]
        for _ in self._direct.walk():
            yield None

    def _where(self, _: str) -> Dialogue:
        q = self._cell.drive.position()
        yield "      X         Y         Z         y         p         r       Hand"
        yield f"{_row(tool_at(self._task, q))}     0.000"
        yield "      J1        J2        J3        J4        J5        J6"
        yield _row(self._cell.arm.joints(q))

    def _place(self, name: str, value: Value) -> Dialogue:
        """Show a location, and store what is typed instead, until an empty line."""
        cell = self.memory.variables.cell(plain_name(name))
        while True:
            cell.store(name, value)
            yield _PLACE
            yield _row(value)
            answer = yield Ask("Change? ")
            if not answer.strip():
                return
            numbers = [*(value if isinstance(value, Joints) else six_numbers(np.asarray(value)))]
            for place, part in enumerate(answer.split(",")[:_NUMBER_COUNT]):
                try:
                    numbers[place] = float(part) if part.strip() else numbers[place]
                except ValueError:
                    raise VplusError("Illegal value", plain(part)) from None
            value = Joints(numbers) if isinstance(value, Joints) else trans(*numbers)

    def _name(self, text: str) -> str:
        if not re.fullmatch(r"[$#]?[A-Za-z][\w.]*", text):
            raise VplusError("Illegal value", f"name {plain(text)}")
        return plain_name(text)

    def _here(self, text: str) -> Dialogue:
        name = self._name(text)
        q = self._cell.drive.position()
        yield from self._place(name, self._cell.arm.joints(q) if name[0] == "#" else tool_at(self._task, q))

    def _point(self, text: str) -> Dialogue:
        left, equals, right = text.partition("=")
        name = self._name(left.strip())
        if equals:
            yield from self._do(f"SET {name} = {right}")
        value = self.memory.variables.cell(name).value
        yield from self._place(name, value if value is not None else Joints([0.0] * 6) if name[0] == "#" else np.eye(4))

    def _values(self, text: str, wanted: Callable[[Value], bool]) -> Iterator[tuple[str, Value]]:
        names = [plain_name(part.strip()) for part in text.split(",") if part.strip()]
        for name, value in self.memory.variables.values():
            if wanted(value) and (not names or name.partition("[")[0] in names or name in names):
                yield name, value

    def _list_places(self, text: str) -> Dialogue:
        yield f"          {_PLACE}"
        for name, value in self._values(text, _is_place):
            yield f"{name:<10} {_row(value)}"

    def _list_values(self, text: str) -> Dialogue:
        for name, value in self._values(text, lambda value: isinstance(value, float | str)):
            yield f"{name} = {value:g}" if isinstance(value, float) else f'{name} = "{value}"'

    def _program(self, name: str) -> Program:
        return self._task.program(plain_name(name))

    def _list_programs(self, text: str) -> Dialogue:
        for program in [self._program(text)] if text else self.memory.programs.values():
            yield from _written(program)

    def _directory(self, _: str) -> Dialogue:
        for program in self.memory.programs.values():
            yield f"  .PROGRAM {program.name}({', '.join(program.parameters)})"

    def _speed(self, text: str) -> Dialogue:
        yield from self._do(f"SPEED {text} MONITOR")

    def _execute(self, text: str) -> Dialogue:
        if self._runs is not None:
            raise VplusError("Program task already active")
        match = re.match(r"(?:/C\s*)?(?:\d+\s+)?([^,(]+(?:\(.*\))?)", text, re.IGNORECASE)
        if match is None:
            raise VplusError("Missing argument", "EXECUTE program")
        called = parse_line(f"CALL {match[1]}").arguments[0]
        assert isinstance(called, Function | Reference)
        self._task.frames = []
        self._task.call(called.name, called.arguments if isinstance(called, Function) else ())
        self._task.settings.reset()
        self._runs = self._task.run()
        yield from ()

    def _abort(self, _: str) -> Dialogue:
        if self._runs is None:
            return
        answer = yield Ask("Are you sure (Y/N)? ")
        if answer.strip().upper().startswith("Y"):
            self.abort()

    def abort(self) -> None:
        """End program and motion."""
        self._cell.queue.stop()
        self._task.frames = []
        self._runs = None

    def _kill(self, _: str) -> Dialogue:
        self.abort()
        yield from ()

    def _proceed(self, _: str) -> Dialogue:
        if self._runs is None or not self._task.paused:
            raise VplusError("Program not executable")
        self._task.paused = False
        yield from ()

    def _status(self, _: str) -> Dialogue:
        frames = self._task.frames
        state = "paused" if self._task.paused else "running"
        if self._runs is None or not frames:
            yield "Task 0  idle"
        else:
            yield f"Task 0  {state}  {frames[-1].program.name}  step {frames[-1].place}"

    def _file(self, text: str) -> Path:
        if not _FILE.match(text):
            raise VplusError("Illegal file name", plain(text))
        return self._folder / (text if "." in text else f"{text}.v2")

    def _load(self, text: str) -> Dialogue:
        try:
            loaded = load(self._file(text))
        except LoadError as error:
            for fault in error.faults:
                yield f"*{fault}*"
            return
        for name in loaded.programs:
            yield f".PROGRAM {name}"
        self.memory.programs.update(loaded.programs)
        self.memory.variables.cells.update(loaded.variables.cells)
        self.memory.variables.tables.update(loaded.variables.tables)

    def _store(self, text: str) -> Dialogue:
        left, _, right = text.partition("=")
        names = [part.strip() for part in right.split(",") if part.strip()] or list(self.memory.programs)
        lines = [line for name in names for line in _written(self._program(name))]
        places = [f"{name} {_row(value)}" for name, value in self._values("", _is_place)]
        reals = [f"{name} {value!r}" for name, value in self._values("", lambda value: isinstance(value, float))]
        texts = [f'{name} "{value}"' for name, value in self._values("", lambda value: isinstance(value, str))]
        lines += [".LOCATIONS", *places, ".END", ".REALS", *reals, ".END", ".STRINGS", *texts, ".END"]
        file = self._file(left.strip())
        if file.exists():
            raise VplusError("File already exists", file.name)
        file.write_text("\n".join(lines) + "\n", encoding="latin-1")
        yield from ()

    def _delete(self, text: str) -> Dialogue:
        program = self._program(text)
        answer = yield Ask("Are you sure (Y/N)? ")
        if answer.strip().upper().startswith("Y"):
            del self.memory.programs[program.name]

    def _edit(self, text: str) -> Dialogue:
        name = self._name(text.partition("(")[0].strip())
        present = self.memory.programs.get(name)
        lines = [*_written(present)][1:-1] if present is not None else []
        while True:
            answer = yield Ask(f"{len(lines) + 1:5d} ? ")
            if answer.strip().upper() == "E":
                break
            lines.append(answer)
        parameters = f"({text.partition('(')[2]}" if "(" in text else "()"
        trial = Memory()
        faults = read("\n".join([f".PROGRAM {name}{parameters}", *lines, ".END"]), trial)
        for line, fault in faults:
            yield f"*{fault}* step {line - 1}"
        self.memory.programs.update(trial.programs if not faults else {})

    def _enable(self, text: str) -> Dialogue:
        name = next((name for name in ("POWER", "CP", "DRY.RUN") if name.startswith(text.upper())), text)
        yield from self._do(f"ENABLE {name}")
        yield ""

    def _zero(self, _: str) -> Dialogue:
        answer = yield Ask("Are you sure (Y/N)? ")
        if answer.strip().upper().startswith("Y"):
            self.memory.programs.clear()
            self.memory.variables.cells.clear()
            self.memory.variables.tables.clear()


def _written(program: Program) -> Iterator[str]:
    yield f".PROGRAM {program.name}({', '.join(program.parameters)})"
    yield from program.text
    yield ".END"


def _is_place(value: Value) -> bool:
    return not isinstance(value, float | str)
