"""The monitor of V+: the dot prompt on a serial line, its commands, and the programs that it runs.

The monitor is a dialogue, a generator: it yields lines to show, a question (`Ask`) whose answer it gets, or None to
wait for a beat. The dot is its question for the next command.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Generator
from functools import partial
from pathlib import Path
from typing import Any, Final, TypeAlias

from pinocchio import SE3

from rx90_common.base.errors import Rx90Error
from rx90_common.base.quoting import plain
from rx90_common.exchange.pacing import Pacer
from rx90_common.process.files import write_all
from rx90_common.process.lines import DeviceLine
from rx90_emulator.cabinet.arm import Joints
from rx90_emulator.cabinet.cell import Cell
from rx90_emulator.cabinet.errors import VplusError
from rx90_emulator.cabinet.locations import six_numbers, trans
from rx90_emulator.vplus.instructions import CONTROL, typed_numbers
from rx90_emulator.vplus.program import global_variable, load_programs, parse, parse_line, read
from rx90_emulator.vplus.task import OF_EXECUTE, Frame, Task, Waits
from rx90_emulator.vplus.tree import Memory, Program
from rx90_emulator.vplus.values import LoadError, Variable, bounded


class Ask(str):
    """A question; the cursor stays behind it."""

    __slots__ = ()


_DOT = Ask(".")
Dialogue: TypeAlias = Generator["str | None", str, Any]
Command: TypeAlias = Callable[["Monitor", str], "Dialogue | None"]
_PLACES = (SE3, Joints)
_COLUMNS = "X/J1      Y/J2      Z/J3      y/J4      p/J5      r/J6"
_FILE = re.compile(r"[\w-]+(\.\w+)?", re.ASCII)
_CALLED = re.compile(r"(?:/C\s*)?(?:\d\s+)?([^,(]+(?:\(.*\))?)\s*(?:,\s*(-?\d+).*)?", re.IGNORECASE)
_LONGEST_LINE = 1000
_MOST_BYTES = 4096
"""In a beat, and of output before programs wait."""
_LATEST = 0.3
"""Time that is made up for, s; a machine that is slower than that is slower than the wall clock."""
_INTERRUPT = 3
_ENDS = "\r\n", "\n\r"
"""Of a line, as pairs; half a pair is one, too."""
_BITS = 10
"""Of a byte on a line with 8 data bits, no parity and a stop bit."""


class Monitor:
    """The monitor.

    Args:
        cell: the arm, its signals and the time.
        folder: where LOAD and STORE find files.

    Attributes:
        output: what the terminal shall show; who takes it away removes it. While it is long, programs wait.
        memory: programs and global variables.
        task: what runs programs and single instructions.
        program: the program that runs; None if none does.
        call: its name and arguments, until it is through.
        cycles: that are left of it; negative for no end.
    """

    def __init__(self, cell: Cell, folder: Path) -> None:
        self.output = bytearray()
        self.folder = folder
        self.memory = Memory()
        self.task = Task(self.memory, cell)
        self.program: Waits | None = None
        self.call: tuple[Any, ...] = ()
        self.cycles = 0
        self._reads = False
        self._typed = ""
        self._before = ""
        self._lines: list[str] = []
        cell.show = lambda text, _, ends: self._send(f"{text}\r\n" if ends else text)
        cell.ask = self._ask
        for reading in (True, False):
            parse("", "step", reading)  # once takes long: later the arm would wait
        self._begin()

    @property
    def is_busy(self) -> bool:
        """Return whether a command runs that takes no line."""
        return self._question is None

    def greet(self) -> None:
        """Begin anew with a client who has just come: show the question that is open."""
        self._typed = ""
        self.output.clear()
        self._send(self._question or "")

    def _send(self, text: str) -> None:
        self.output.extend(text.encode("latin-1", "replace"))

    def _begin(self) -> None:
        """Show the dot."""
        self._dialogue = self._commands()
        self._question: Ask | None = None
        self._go_on(None)

    def receive(self, data: bytes) -> None:
        """Take bytes from the terminal: make lines of them, and do what they say."""
        for character in data.decode("latin-1"):
            if self._before + character in _ENDS:
                self._before = ""
                continue
            self._before = character
            if ord(character) == _INTERRUPT:
                self._take_lines()
                self._interrupt()
            elif character in "\r\n":
                self._lines.append(self._typed)
                self._typed = ""
            elif character in "\b\x7f":
                self._typed = self._typed[:-1]
            elif len(self._typed) < _LONGEST_LINE:
                self._typed += character
        self._take_lines()

    def _interrupt(self) -> None:
        """End the program, a command with its question, what has been typed and what was to be shown."""
        self.abort()
        self._lines = []
        self._typed = ""
        self.output.clear()
        self._send("\r\n")
        self._dialogue.close()
        self._begin()

    def _take_lines(self) -> None:
        """Take lines as commands and answers; a program with a unit has all of them, between its READs, too."""
        while self._lines and not (self.is_busy or self._program_has_line):
            self._go_on(self._line())

    @property
    def _program_has_line(self) -> bool:
        """Return whether a program has what is typed."""
        return self.program is not None and (self._reads or bool(self.task.units))

    def _line(self) -> str:
        line = self._lines.pop(0)
        self._send(f"{line}\r\n")
        return line

    def _ask(self, question: str) -> str | None:
        """Return the line that a program waits for, None while there is none."""
        self._send(question)
        self._reads = not self._lines
        return None if self._reads else self._line()

    def beat(self) -> None:
        """Let a beat pass: of the program, the command under way and the cell."""
        self._reads = False
        try:
            if self.program is not None and len(self.output) < _MOST_BYTES:
                next(self.program)
        except StopIteration:
            self.call = ()
            self._end("Program completed")
        except VplusError as error:
            self._end(f"{error.message} {error.where}")
        if self.is_busy:
            self._go_on(None)
        cell = self.task.cell
        try:
            cell.advance()
        except VplusError as error:
            self._end(f"{error.message} {error.detail}")
        except Rx90Error as error:  # of running nodes, which may come back
            self._end(f"*{error}*")
        self._take_lines()

    def rounds(self) -> Waits:
        """Run the program for the cycles that are left, from where it is."""
        while self.cycles and not self.task.halted:
            if not self.task.frames:
                self.task.call(*self.call)
            if not self.task.frame.program.steps:
                yield "the processor"  # for a program that is empty, time would stand still
            yield from self.task.run()
            self.cycles -= 1

    def abort(self) -> None:
        """End program and motion; PROCEED goes on with the program."""
        self.task.queue.stop()
        self.program = None

    def _end(self, message: str) -> None:
        self.program = None
        self._send(f"\r\n{message}\r\n{self._question or ''}")

    def _go_on(self, answer: str | None) -> None:
        """Go on with the dialogue until it asks or waits."""
        item = self._dialogue.send(answer)  # type: ignore[arg-type]  # None begins and goes on
        while item is not None and not isinstance(item, Ask):
            self._send(f"{item}\r\n")
            item = next(self._dialogue)
        self._question = item
        self._send(item or "")

    def _commands(self) -> Dialogue:
        """Ask for commands, and carry them out."""
        while True:
            line = yield _DOT
            try:
                yield from self._command(line.strip())
            except VplusError as error:
                yield f"{error.message} {error.detail}".rstrip()
            except RecursionError:
                yield "*Expression too complex*"
            except (Rx90Error, SyntaxError) as error:
                yield f"*{str(error).strip('*')}*"

    def _command(self, line: str) -> Dialogue:
        word, _, text = line.partition(" ")
        commands = [command for name, command in COMMANDS.items() if name.startswith(word.upper())]
        if not commands:
            raise SyntaxError("Unknown command")
        if isinstance(commands[0], str):
            yield from _do(self, commands[0].format(text))
        elif word:
            yield from commands[0](self, text.strip()) or ()


# Commands.


def _do(monitor: Monitor, text: str) -> Dialogue:
    task = monitor.task
    step = parse_line(text)
    if step.word in CONTROL:
        raise SyntaxError("Illegal monitor command")
    _check_idle(monitor)
    depth = len(task.frames)
    task.frames.append(Frame(Program("do", steps=[step])))
    lock = task.lock
    task.lock = math.inf  # what the program reacts to waits until it goes on
    try:
        for _ in task.walk(depth):
            yield None
    finally:
        del task.frames[depth:]
        task.lock = lock


def _check_idle(monitor: Monitor) -> None:
    if monitor.program is not None:
        raise VplusError("Program task already active")


def _where(monitor: Monitor, _: str) -> Dialogue:
    q = monitor.task.cell.drive.position()
    yield "      X         Y         Z         y         p         r       Hand"
    yield f"{_text(monitor.task.tool_at(q))}     0.000"
    yield "      J1        J2        J3        J4        J5        J6"
    yield _text(monitor.task.arm.joints(q))


def _text(value: Any) -> str:
    if isinstance(value, float):
        return repr(value)
    if isinstance(value, str):
        return f'"{value}"'
    return " ".join(f"{number + 0.0:9.3f}" for number in six_numbers(value))


def _here(monitor: Monitor, text: str) -> Dialogue:
    parse(text, "place")  # before anything is stored
    yield from _do(monitor, "BREAK")
    yield from _do(monitor, f"HERE {text}")
    yield from _point(monitor, text)


def _point(monitor: Monitor, text: str) -> Dialogue:
    """Show a location, and store what is typed instead, until an empty line."""
    name, equals, _ = text.partition("=")
    variable = global_variable(monitor.memory, parse(name, "place"))
    if equals:
        yield from _do(monitor, f"SET {text}")
    if variable.value is None:
        variable.store(Joints([0.0] * 6) if name[0] == "#" else SE3.Identity())
    while True:
        place = monitor.task.taken("location", variable.value)  # type: ignore[arg-type]  # a value is a tree of its own
        yield _COLUMNS
        yield _text(place)
        answer = yield Ask("Change? ")
        if not answer.strip():
            return
        typed = [*typed_numbers(answer), *[""] * 6]
        try:
            numbers: list[Any] = [
                bounded(float(new)) if new.strip() else old
                for old, new in zip(six_numbers(place), typed, strict=False)
            ]
        except ValueError:
            raise VplusError("Illegal value", plain(answer)) from None
        variable.store(Joints(numbers) if name[0] == "#" else trans(*numbers))


def _variables(monitor: Monitor, text: str, kinds: Any) -> list[Variable]:
    """Return variables of some types, of all names or those in a text."""
    tables = monitor.memory.variables
    names = text.lower().replace(",", " ").split() or sorted(tables)
    variables = [variable for name in names for _, variable in sorted(tables.get(name, {}).items())]
    return [variable for variable in variables if isinstance(variable.value, kinds)]


def _list_places(monitor: Monitor, text: str) -> Dialogue:
    yield f"          {_COLUMNS}"
    for variable in _variables(monitor, text, _PLACES):
        yield f"{variable.name:<10} {_text(variable.value)}"


def _list_values(monitor: Monitor, text: str, kind: type) -> Dialogue:
    for variable in _variables(monitor, text, kind):
        yield f"{variable.name} = {_text(variable.value)}"


def _listing(program: Program) -> list[str]:
    return [f".PROGRAM {program.name}({', '.join(program.parameters)})", *program.text, ".END"]


def _programs(monitor: Monitor, text: str) -> list[Program]:
    names = text.replace(",", " ").split() or monitor.memory.programs
    return [monitor.task.program(name) for name in names]


def _list_programs(monitor: Monitor, text: str) -> Dialogue:
    for program in _programs(monitor, text):
        yield from _listing(program)


def _directory(monitor: Monitor, _: str) -> Dialogue:
    for program in _programs(monitor, ""):
        yield f"  {_listing(program)[0]}"


def _execute(monitor: Monitor, text: str) -> None:
    match = _CALLED.fullmatch(text)
    if match is None:
        raise VplusError("Missing argument", "EXECUTE program")
    _check_idle(monitor)
    task = monitor.task
    call = parse_line(f"CALL {match[1]}").arguments
    monitor.call = ()
    monitor.cycles = int(match[2] or 1)
    task.frames = []
    task.halted = False
    task.units = set()
    task.reactions = {}
    task.lock = 0.0
    task.always.update(OF_EXECUTE)
    task.call(*call)
    monitor.call = call
    monitor.program = monitor.rounds()


def _proceed(monitor: Monitor, _: str) -> None:
    _check_idle(monitor)
    if not monitor.task.frames:
        raise VplusError("Program not executable")
    monitor.program = monitor.rounds()


def _retry(monitor: Monitor, text: str) -> None:
    """Go on with the step that was interrupted."""
    _proceed(monitor, text)
    monitor.task.frame.place -= monitor.task.has_begun


def _sure() -> Dialogue:
    answer = yield Ask("Are you sure (Y/N)? ")
    return answer.strip().upper().startswith("Y")


def _abort(monitor: Monitor, _: str) -> Dialogue:
    if monitor.program is not None and (yield from _sure()):
        monitor.abort()


def _kill(monitor: Monitor, _: str) -> None:
    monitor.abort()
    monitor.call = ()
    monitor.task.frames = []


def _status(monitor: Monitor, _: str) -> Dialogue:
    if not monitor.call:
        yield "Task 0  idle"
        return
    state = "running" if monitor.program is not None else "stopped"
    frames = monitor.task.frames
    place = monitor.call[0]
    if frames:
        step = frames[-1].place + (not monitor.task.has_begun)
        place = f"{frames[-1].program.name}  step {step}"
    yield f"Task 0  {state}  {place}"


def _file(monitor: Monitor, text: str) -> Path:
    if not _FILE.fullmatch(text):
        raise VplusError("Illegal file name", plain(text))
    return monitor.folder / (text if "." in text else f"{text}.v2")


def _load(monitor: Monitor, text: str) -> Dialogue:
    try:
        loaded = load_programs(_file(monitor, text))
    except LoadError as error:
        yield from (f"*{fault}*" for fault in error.faults)
        return
    yield from (f".PROGRAM {name}" for name in loaded.programs)
    monitor.memory.programs.update(loaded.programs)
    monitor.memory.variables.update(loaded.variables)


def _store(monitor: Monitor, text: str) -> None:
    name, _, names = text.partition("=")
    lines = [line for program in _programs(monitor, names) for line in _listing(program)]
    for section, kinds in ((".LOCATIONS", _PLACES), (".REALS", float), (".STRINGS", str)):
        data = [
            f"{variable.name} {_text(variable.value)}"
            for variable in _variables(monitor, "", kinds)
        ]
        lines += [section, *data, ".END"]
    file = _file(monitor, name.strip())
    if file.exists():
        raise VplusError("File already exists", file.name)
    write_all({file: "\n".join([*lines, ""]).encode("latin-1")})


def _delete(monitor: Monitor, text: str) -> Dialogue:
    programs = _programs(monitor, text)
    if (yield from _sure()):
        for program in programs:
            del monitor.memory.programs[program.name]


def _zero(monitor: Monitor, _: str) -> Dialogue:
    if (yield from _sure()):
        monitor.memory.programs.clear()
        monitor.memory.variables.clear()


def _edit(monitor: Monitor, text: str) -> Dialogue:
    programs = monitor.memory.programs
    present = programs.get(parse(f".PROGRAM {text}", "header").name)
    lines = [*present.text] if present is not None else []
    while True:
        answer = yield Ask(f"{len(lines) + 1:5d} ? ")
        if answer.strip().upper() == "E":
            break
        lines.append(answer)
    head = text if "(" in text or present is None else _listing(present)[0].partition(" ")[2]
    trial = Memory()
    reader = read("\n".join([f".PROGRAM {head}", *lines, ".END"]), trial)
    for line, fault in reader.faults:
        yield f"*{fault.replace('*', '')}* step {line - 1}"
    if not reader.faults:
        programs.update(trial.programs)


def _speed(monitor: Monitor, text: str) -> None:
    """Set the monitor speed, also of a program that runs."""
    speed, *_ = parse_line(f"SPEED {text}").arguments
    monitor.task.queue.monitor = min(monitor.task.taken("percent", speed), 100.0)


def _switch(monitor: Monitor, text: str, word: str) -> Dialogue:
    """Switch what begins as was typed on or off; without power, program and motion end."""
    known = [name for name in ("POWER", "CP", "DRY.RUN") if text and name.startswith(text.upper())]
    name = [*known, text][0]
    on = word == "ENABLE"
    if name != "POWER":
        yield from _do(monitor, f"{word} {name}")
    else:  # also while a program runs
        if not on:
            monitor.abort()
        while on and monitor.task.queue.stopping:
            yield None
        monitor.task.cell.power(on)
    if on:
        yield ""


COMMANDS: Final[dict[str, str | Command]] = {
    "DO": _do,
    "WHERE": _where,
    "HERE": _here,
    "POINT": _point,
    "LISTL": _list_places,
    "LISTR": partial(_list_values, kind=float),
    "LISTS": partial(_list_values, kind=str),
    "LISTP": _list_programs,
    "DIRECTORY": _directory,
    "EXECUTE": _execute,
    "ABORT": _abort,
    "KILL": _kill,
    "PROCEED": _proceed,
    "RETRY": _retry,
    "STATUS": _status,
    "LOAD": _load,
    "STORE": _store,
    "DELETE": _delete,
    "EDIT": _edit,
    "ENABLE": partial(_switch, word="ENABLE"),
    "DISABLE": partial(_switch, word="DISABLE"),
    "CALIBRATE": "BREAK",
    "ZERO": _zero,
    "SPEED": _speed,
    "PANIC": lambda monitor, _: monitor.abort(),
    **{word: f"{word} {{}}" for word in ("TOOL", "BASE", "SIGNAL", "RESET", "PARAMETER", "TYPE")},
}
"""Commands, of which the first fits that begins as what was typed; a text is an instruction."""


# The line.


def serve(cell: Cell, folder: Path, line: DeviceLine, baud: int | None, *, waits: bool) -> None:
    """Serve the monitor until an interrupt.

    Args:
        cell: the arm, its signals and the time.
        folder: where LOAD and STORE find files.
        line: to the client.
        baud: pace of the line, bits a second; None for no pace.
        waits: whether the time of the cell waits for the wall clock here; that of running nodes does so by itself.
    """
    monitor = Monitor(cell, folder)
    rate = _MOST_BYTES if baud is None else cell.period * baud / _BITS
    pacer = Pacer(cell.period, float(waits), forgiven=_LATEST)
    room = 0.0  # of bytes each way, with what is left of the beat before
    while True:
        pacer.wait()
        if line.has_new_client():
            monitor.greet()
        room = room % 1.0 + rate
        most = int(room)
        if most:
            monitor.receive(line.read(most))
        monitor.beat()
        del monitor.output[: line.write(monitor.output[:most])]
