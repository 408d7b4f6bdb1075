"""Instructions of control: blocks, jumps, calls."""

from __future__ import annotations

import math

from rx90_emulator.vplus.errors import VplusError
from rx90_emulator.vplus.operators import operate, real, text_of
from rx90_emulator.vplus.program import Step
from rx90_emulator.vplus.registry import CONTROL, Waits, function, functions, instruction, instructions
from rx90_emulator.vplus.syntax import Argument, Expression, Format, Function, Line, Number, Reference, plain_name
from rx90_emulator.vplus.task import Frame, Task
from rx90_emulator.vplus.values import FALSE, TRUE, Table


def _arguments(step: Step) -> tuple[Argument, ...]:
    assert step.instruction is not None
    return step.instruction.arguments


def assign(task: Task, _: Frame, step: Step) -> None:
    """Store the value of an expression."""
    assert step.instruction is not None
    assert step.instruction.value is not None
    target = task.variable(_arguments(step)[0])
    value = task.value(step.instruction.value)
    if not isinstance(value, float | str):
        raise VplusError("Illegal assignment", f"{target.name} = a location; accepted: SET {target.name} = ...")
    task.cell_of(target).store(target.name, value)


def nothing(_task: Task, _frame: Frame, _step: Step) -> None:
    """Go on."""


def leave_branch(_: Task, frame: Frame, step: Step) -> None:
    """Go behind the block, at the end of one of its branches."""
    frame.place = step.end + 1


def begin_if(task: Task, frame: Frame, step: Step) -> None:
    """Go on, or to ELSE or END."""
    if task.real(_arguments(step)[0]) == 0.0:
        frame.place = (step.branches[0] if step.branches else step.end) + 1


def jump_if(task: Task, frame: Frame, step: Step) -> None:
    """Go to a label, or on."""
    if task.real(_arguments(step)[0]) != 0.0:
        jump(task, frame, step)


def jump(_: Task, frame: Frame, step: Step) -> None:
    """Go to a label."""
    label = _arguments(step)[-1]
    assert isinstance(label, Number)
    frame.place = frame.program.labels[int(label.value)]


def begin_for(task: Task, frame: Frame, step: Step) -> None:
    """Set the variable; enter the loop, or go behind it."""
    variable, first, limit, increment = _arguments(step)
    reference = task.variable(variable)
    task.cell_of(reference).store(reference.name, task.real(first))
    frame.loops[frame.place - 1] = (task.real(limit), task.real(increment, 1.0))
    if frame.loops[frame.place - 1][1] == 0.0:
        raise VplusError("Illegal value", "STEP 0")
    _enter_or_leave(task, frame, reference, frame.place - 1)


def _enter_or_leave(task: Task, frame: Frame, variable: Reference, begin: int) -> None:
    limit, increment = frame.loops[begin]
    value = task.real(variable)
    beyond = value > limit if increment > 0.0 else value < limit
    frame.place = frame.program.steps[begin].end + 1 if beyond else begin + 1


def begin_while(task: Task, frame: Frame, step: Step) -> None:
    """Enter the loop, or go behind it."""
    if task.real(_arguments(step)[0]) == 0.0:
        frame.place = step.end + 1


def end_block(task: Task, frame: Frame, step: Step) -> None:
    """Go back to the begin of a loop, or on."""
    begin = frame.program.steps[step.start]
    assert begin.instruction is not None
    if begin.instruction.word == "WHILE":
        frame.place = step.start
    elif begin.instruction.word == "FOR":
        variable = task.variable(begin.instruction.arguments[0])
        if step.start not in frame.loops:
            raise VplusError("Illegal value", "END of a FOR that was not entered")
        task.cell_of(variable).store(variable.name, task.real(variable) + frame.loops[step.start][1])
        _enter_or_leave(task, frame, variable, step.start)


def end_do(task: Task, frame: Frame, step: Step) -> None:
    """Go back, or on."""
    if task.real(_arguments(step)[0]) == 0.0:
        frame.place = step.start + 1


def choose(task: Task, frame: Frame, step: Step) -> None:
    """Go to the first branch that has the value, to ANY, or behind the block."""
    value = task.item(_arguments(step)[0])
    assert not isinstance(value, Format)
    frame.place = step.end + 1
    for place in step.branches:
        branch = frame.program.steps[place].instruction
        assert branch is not None
        offered = (task.item(argument) for argument in branch.arguments)
        if branch.word == "ANY" or any(
            real(operate("==", value, other, task.readings.ignore_case)) != 0.0
            for other in offered
            if not isinstance(other, Format)
        ):
            frame.place = place + 1
            return


def next_turn(_: Task, frame: Frame, step: Step) -> None:
    """Go to the end of a loop, where its next turn begins."""
    frame.place = step.end


def call(task: Task, _: Frame, step: Step) -> None:
    """Call a program."""
    called = _arguments(step)[0]
    assert isinstance(called, Function | Reference)
    task.call(called.name, called.arguments if isinstance(called, Function) else ())


def call_by_string(task: Task, _: Frame, step: Step) -> None:
    """Call the program that a string names."""
    called = _arguments(step)[0]
    assert isinstance(called, Function | Reference)
    name = Reference(called.name) if isinstance(called, Function) else called
    arguments = called.arguments if isinstance(called, Function) else ()
    task.call(plain_name(text_of(task.value(name))), arguments)


def come_back(task: Task, _frame: Frame, _step: Step) -> None:
    """Go back to the program that called this one."""
    task.frames.pop()


CONTROL.update(
    {
        "=": assign,
        "AUTO": nothing,
        "LOCAL": nothing,
        "GLOBAL": nothing,
        "IF THEN": begin_if,
        "IF GOTO": jump_if,
        "ELSE": leave_branch,
        "END": end_block,
        "FOR": begin_for,
        "WHILE": begin_while,
        "DO": nothing,
        "UNTIL": end_do,
        "CASE": choose,
        "VALUE": leave_branch,
        "ANY": leave_branch,
        "GOTO": jump,
        "EXIT": leave_branch,
        "NEXT": next_turn,
        "CALL": call,
        "CALLS": call_by_string,
        "RETURN": come_back,
    }
)


@instruction("RETURNE")
def come_back_from_error(task: Task, _: Line) -> None:
    """Go back from the program that an error called."""
    task.frames.pop()


@instruction("PAUSE")
def pause(task: Task, _: Line) -> Waits:
    """Wait for PROCEED of the monitor; without a monitor the program ends here."""
    task.paused = True
    yield from task.until(lambda: not task.paused, "PROCEED")


@function("DEFINED", 1, trees=True)
def defined(task: Task, argument: Argument) -> float:
    """Return whether a variable has a value."""
    reference = task.variable(argument)
    return TRUE if task.cell_of(reference).value is not None else FALSE


@function("LAST", 1, trees=True)
def last(task: Task, argument: Expression) -> float:
    """Return the highest index in use of an array."""
    table: Table = task.table(task.variable(argument).name)
    return table.last()


functions(
    {
        "TRUE": (0, lambda _: TRUE),
        "FALSE": (0, lambda _: FALSE),
        "ON": (0, lambda _: TRUE),
        "OFF": (0, lambda _: FALSE),
        "PI": (0, lambda _: math.pi),
        "ERROR": (1, lambda task, _: float(task.error)),
    }
)
instructions(
    {
        "STOP": (0, lambda task, _: task.frames.clear()),
        "HALT": (0, lambda task, _: task.frames.clear()),
    }
)
