"""Instructions and functions of signals, the hand, timers, reactions and switches."""

from __future__ import annotations

from typing import Final

from rx90_emulator.vplus.errors import VplusError
from rx90_emulator.vplus.moves import wait_for_end
from rx90_emulator.vplus.operators import truth, whole
from rx90_emulator.vplus.registry import MANY, Waits, function, functions, instruction, instructions
from rx90_emulator.vplus.signals import HAND
from rx90_emulator.vplus.syntax import Line, Reference
from rx90_emulator.vplus.task import Reaction, Task
from rx90_emulator.vplus.values import Value

_LONGEST_WAIT: Final = 86_400.0
_LARGEST_HAND_TIME: Final = 60.0


def _wait_for(task: Task, seconds: float) -> Waits:
    latest = task.cell.time + seconds
    yield from task.until(lambda: task.cell.time >= latest - 1e-9, "time")


def _set_hand(task: Task, line: Line) -> Waits | None:
    """Set the hand when the next motion begins; with I at the end of the word, when this one has ended, and wait."""
    cell = task.cell
    if line.word in HAND:
        task.settings.at_start.append(lambda: cell.signals.set_hand(line.word, cell.time))
        return None
    return _set_hand_now(task, line.word[:-1])


def _set_hand_now(task: Task, state: str) -> Waits:
    yield from wait_for_end(task)
    task.cell.signals.set_hand(state, task.cell.time)
    yield from _wait_for(task, task.settings.hand_time)


instructions({f"{state}{ending}": (0, _set_hand) for state in HAND for ending in ("", "I")})


@instruction("SIGNAL", 1, MANY)
def switch_signals(task: Task, line: Line) -> None:
    """Switch outputs on and, with negative numbers, off."""
    for argument in line.arguments:
        task.cell.signals.switch(whole(task.real(argument)), task.cell.time)


@function("SIG", 1, MANY)
def signals(task: Task, *numbers: Value) -> float:
    """Return whether all signals are as their numbers say."""
    return truth(all(task.cell.signals.is_on(whole(number)) for number in numbers))


@function("BITS", 1, 2)
def bits(task: Task, first: Value, count: Value = 1.0) -> float:
    """Return signals as the bits of a number."""
    numbers = range(min(whole(count), 24))
    return float(sum(2**bit for bit in numbers if task.cell.signals.is_on(whole(first) + bit)))


@instruction("BITS", 1, 2)
def set_bits(task: Task, line: Line) -> None:
    """Switch outputs as the bits of a number."""
    first = whole(task.real(line.arguments[0]))
    count = whole(task.real(task.argument(line, 1), 1.0))
    if line.value is None or not 1 <= count <= 24:
        raise VplusError("Illegal value", "BITS first, count = value, with a count from 1 to 24")
    value = whole(task.value(line.value))
    for bit in range(count):
        task.cell.signals.switch(first + bit if value >> bit & 1 else -first - bit, task.cell.time)


# Time.


@instruction("WAIT", 0, 1)
def wait(task: Task, line: Line) -> Waits:
    """Wait until an expression is true, or for a beat."""
    if not line.arguments:
        yield "the next beat"
        return
    yield from task.until(lambda: task.real(line.arguments[0]) != 0.0, "WAIT")


@instruction("WAIT.EVENT", 0, 2)
def wait_for_event(task: Task, line: Line) -> Waits:
    """Wait for some seconds; events of other tasks there are none."""
    seconds = task.real(task.argument(line, 1), 0.0)
    if not 0.0 <= seconds <= _LONGEST_WAIT:
        raise VplusError("Illegal value", f"{seconds:g} s; accepted: 0 to {_LONGEST_WAIT:g}")
    return _wait_for(task, seconds)


@instruction("TIMER", 1)
def set_timer(task: Task, line: Line) -> None:
    """Set a timer, s."""
    if line.value is None:
        raise VplusError("Missing argument", "TIMER n = seconds")
    task.timers[whole(task.real(line.arguments[0]))] = task.cell.time - task.real(line.value)


functions(
    {
        "TIMER": (1, lambda task, number: task.cell.time - task.timers.get(whole(number), 0.0)),
        "TIME": (0, lambda task: task.cell.time),
    }
)


# Reactions.


@instruction("REACT", 2, 3)
@instruction("REACTI", 2, 3)
def react(task: Task, line: Line) -> None:
    """Call a program when a signal changes; REACTI ends the motion, too."""
    signal = whole(task.real(line.arguments[0]))
    program = task.variable(line.arguments[1]).name
    task.program(program)
    priority = task.real(task.argument(line, 2), 1.0)
    task.reactions[signal] = Reaction(program, priority, line.word == "REACTI", task.cell.signals.is_on(signal))


@instruction("REACTE", 0, 1)
def react_to_errors(task: Task, line: Line) -> None:
    """Call a program when an error occurs."""
    task.on_error = task.variable(line.arguments[0]).name if line.arguments else ""
    if task.on_error:
        task.program(task.on_error)


@instruction("IGNORE", 1, 2)
def ignore(task: Task, line: Line) -> None:
    """React to a signal no more."""
    task.reactions.pop(whole(task.real(line.arguments[0])), None)


@instruction("LOCK", 0, 1)
def lock(task: Task, line: Line) -> None:
    """Let reactions wait up to a priority."""
    task.lock = task.real(task.argument(line, 0), 0.0)


# Switches and parameters.


def _named(task: Task, line: Line) -> list[str]:
    return [task.variable(argument).name.upper() for argument in line.arguments]


@instruction("ENABLE", 1, MANY)
@instruction("DISABLE", 1, MANY)
def set_switches(task: Task, line: Line) -> None:
    """Switch system switches on or off."""
    on = line.word == "ENABLE"
    for name in _named(task, line):
        task.switches[name] = on
    task.settings.switches["CP"] = float(task.switches["CP"])
    task.settings.scaled = task.switches["SCALE.ACCEL"]
    task.settings.dry = task.switches.get("DRY.RUN", False)


@function("SWITCH", 1, trees=True)
def switch(task: Task, name: Reference) -> float:
    """Return whether a system switch is on."""
    return truth(task.switches.get(task.variable(name).name.upper(), False))


@instruction("PARAMETER", 1)
def parameter(task: Task, line: Line) -> None:
    """Set a system parameter; HAND.TIME has an effect here."""
    if line.value is None:
        raise VplusError("Missing argument", "PARAMETER name = value")
    value = task.value(line.value)
    if _named(task, line) == ["HAND.TIME"]:
        if not isinstance(value, float) or not 0.0 <= value <= _LARGEST_HAND_TIME:
            raise VplusError("Illegal value", f"HAND.TIME; accepted: 0 to {_LARGEST_HAND_TIME:g} s")
        task.settings.hand_time = value


for _name in ("ATTACH", "DETACH", "SELECT", "MULTIPLE", "SINGLE", "OVERLAP", "NOOVERLAP", "INTOFF", "INTON"):
    instruction(_name, 0, 2)(lambda _task, _line: None)  # there is one task, and its robot is attached
instructions({"RESET": (0, lambda task, _: task.cell.signals.clear(task.cell.time))})
