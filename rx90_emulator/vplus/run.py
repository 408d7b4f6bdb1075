"""Run a program of V+ on the emulator: its motions, signals and text, with the error of its path."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass

from rx90_emulator.cabinet.arm import ProgrammedArm
from rx90_emulator.cabinet.cell import PERIOD, Cell, Change
from rx90_emulator.cabinet.errors import VplusError
from rx90_emulator.cabinet.record import ProgramRun
from rx90_emulator.loop.setup import Setup
from rx90_emulator.loop.stepped import SteppedLoop
from rx90_emulator.vplus.task import Task
from rx90_emulator.vplus.tree import Memory


@dataclass(frozen=True)
class Options:
    """How a program is run.

    Attributes:
        monitor_speed: percent, above 0 up to 100.
        period: from one planned set-point to the next, s.
        idle: the longest time without a motion, s.
        longest: the longest run, s.
        record_fast: whether the series on base ticks are kept, too.
    """

    monitor_speed: float = 100.0
    period: float = PERIOD
    idle: float = 60.0
    longest: float = 300.0
    record_fast: bool = False


def run_program(
    setup: Setup,
    memory: Memory,
    name: str = "",
    *,
    arguments: Sequence[str] = (),
    inputs: Iterable[Change] = (),
    options: Options | None = None,
    show: Callable[[str, float, bool], None] | None = None,
) -> ProgramRun:
    """Run a program from READY to its end in the closed loop without ROS.

    Args:
        setup: robot, drives, friction, controller, rates.
        memory: programs and data.
        name: of the program; empty for the first one.
        arguments: of the program: numbers, and other words as strings.
        inputs: changes of inputs, in the order of their times.
        options: speeds, periods, limits.
        show: gets what TYPE shows, with its time, s, and whether a line ends behind it.

    Returns:
        What it did, also where an error has stopped it.
    """
    options = options or Options()
    arm = ProgrammedArm(setup)
    loop = SteppedLoop(setup, arm.ready, options.period, record_fast=options.record_fast)
    cell = Cell(arm, loop, inputs, options.period)
    if show is not None:
        cell.show = show
    run = run_in(cell, memory, name, arguments, options)
    if cell.beats:
        run.keep(loop.result())
    return run


def run_in(
    cell: Cell, memory: Memory, name: str, arguments: Sequence[str], options: Options
) -> ProgramRun:
    """Run a program in a cell; as `run_program`, without the series."""
    run = ProgramRun(cell)
    show = cell.show
    begun: list[str] = []

    def collect(text: str, time: float, ends: bool) -> None:
        begun.append(text)
        if ends:
            run.lines.append((time, "".join(begun)))
            begun.clear()
        show(text, time, ends)

    cell.show = collect
    cell.queue.monitor = options.monitor_speed
    try:
        if not memory.programs:
            raise VplusError("Program not executable", "the files have no program")
        task = Task(memory, cell)
        task.call(name or next(iter(memory.programs)), *map(_constant, arguments))
        _execute(task, options)
    except VplusError as error:
        run.error = error
    return run


def _constant(word: str) -> float | str:
    try:
        number = float(word)
    except ValueError:
        return word
    if not math.isfinite(number):
        raise VplusError("Illegal value", f"argument {word}")
    return number


def _execute(task: Task, options: Options) -> None:
    """Run a task until it ends or takes too long."""
    cell = task.cell
    moved = 0.0
    try:
        for what in task.run():
            if not cell.queue.at_end:
                moved = cell.time
            reason = ""
            if cell.time - moved >= options.idle:
                reason = f"no motion for {options.idle:g} s, waiting for {what}"
            elif cell.time >= options.longest:
                reason = f"the run takes more than {options.longest:g} s"
            if reason:
                place = (
                    f" in {task.frame.program.name}, line {task.step.line}" if task.frames else ""
                )
                raise VplusError("Time-out", f"{reason}; stopped{place}")
            cell.advance()
    except VplusError:
        while not cell.queue.at_end and cell.time < options.longest:  # the motion under way ends
            cell.advance()
        raise
