"""Instructions that show text, or ask for some."""

from __future__ import annotations

from rx90_emulator.vplus.registry import MANY, instruction
from rx90_emulator.vplus.syntax import Line
from rx90_emulator.vplus.task import Task
from rx90_emulator.vplus.text import number_of, written


@instruction("TYPE", 0, MANY)
def show(task: Task, line: Line) -> None:
    """Show items."""
    items = [task.item(argument) for argument in line.arguments if argument is not None]
    text, ends = written(items, task.readings.format_persists)
    task.cell.show(text, task.cell.time, ends)


@instruction("PROMPT", 1, MANY)
def ask(task: Task, line: Line) -> None:
    """Ask for a line, and store the numbers or the text of it."""
    question = task.item(line.arguments[0])
    answer = task.cell.ask(str(question))
    parts = answer.split(",")
    for place, argument in enumerate(line.arguments[1:]):
        target = task.variable(argument)
        part = parts[place] if place < len(parts) else ""
        value = answer if target.name[0] == "$" else number_of(task, part)
        task.cell_of(target).store(target.name, value)
