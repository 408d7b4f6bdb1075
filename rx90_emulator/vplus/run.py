"""Run a program of V+ on the emulator: its motions, signals and text, with the error of its path."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import NamedTuple

import numpy as np

from rx90_common.base.arrays import Array
from rx90_common.description.kinematics import tip_position
from rx90_controller.lines.task import SETTLING
from rx90_emulator.loop.line import followed_accuracy
from rx90_emulator.loop.result import RunResult
from rx90_emulator.loop.setup import Setup
from rx90_emulator.vplus.cell import PERIOD, Cell, Change, Engine
from rx90_emulator.vplus.motion import Motion
from rx90_emulator.vplus.task import Task
from rx90_emulator.vplus.tree import Memory
from rx90_emulator.vplus.values import VplusError


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


class Track(NamedTuple):
    """Where the arm was during a motion.

    Attributes:
        times: s, shape (n,).
        asked: the tool by the set-points, m, shape (n, 3).
        measured: likewise.
    """

    times: Array
    asked: Array
    measured: Array


@dataclass(eq=False)
class ProgramRun:
    """What a program did.

    Attributes:
        cell: where it ran.
        lines: what TYPE showed, with times, s.
        result: the series of the run; None if no time passed, or on running nodes.
        tracks: of the motions, in their order; none without series.
        error: what stopped it; None if it ran to its end.
    """

    cell: Cell
    lines: list[tuple[float, str]] = field(default_factory=list)
    result: RunResult | None = None
    tracks: list[Track] = field(default_factory=list)
    error: VplusError | None = None

    @property
    def motions(self) -> list[Motion]:
        """Return the motions, in their order."""
        return self.cell.queue.done

    def keep(self, result: RunResult) -> None:
        """Take the series of the run, and find where the arm was during each motion."""
        self.result = result
        begins = [motion.began for motion in self.motions]
        period = result.setup.rates.position_period
        for motion in self.motions:
            ended = self.cell.time if math.isnan(motion.ended) else motion.ended
            end = min([ended + SETTLING, *(time for time in begins if time >= ended)])
            rows = slice(round(motion.began / period), round(end / period))
            times = result.times[rows]
            robot = self.cell.arm.with_tool(motion.tool)
            angles = [
                series[rows, 0] for series in (result.slow.reference, result.slow.joint_states)
            ]
            accuracy = followed_accuracy(robot, times, angles[1], times, angles[0])
            motion.error = 1e3 * accuracy.worst if len(accuracy.times) else math.nan
            track = Track(times, *(tip_position(robot.chain, q) for q in angles))
            self.tracks.append(track)
            if not math.isnan(motion.settled):
                end = min(round((ended - motion.began) / period), len(times) - 1)
                motion.nulled = 1e3 * math.dist(track.asked[end], track.measured[end])


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
    engine = Engine(setup, options.period, record_fast=options.record_fast)
    cell = Cell(setup, engine, inputs, options.period)
    if show is not None:
        cell.show = show
    run = run_in(cell, memory, name, arguments, options)
    if cell.beats:
        run.keep(engine.result())
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


# What is told of a run.


_TIMES = ["begin s", "end s", "taken s", "alone s", "null s"]
_COLUMNS = ["line", "motion", *_TIMES, "error mm", "null mm", "joints in degrees"]


def table(run: ProgramRun) -> list[list[str]]:
    """Return the table of motions; null: how long it took behind the last set-point, how far it was off then."""
    rows = [[*_COLUMNS]]
    for motion in run.motions:
        taken = motion.ended - motion.began
        nulling = motion.settled - motion.ended
        times = (motion.began, motion.ended, taken, motion.profile.duration, nulling)
        figures = [f"{time:.3f}" for time in times]
        figures += [f"{way:.4f}" for way in (motion.error, motion.nulled)]
        ends = [
            " ".join(f"{joint:.1f}" for joint in run.cell.arm.joints(q))
            for q in (motion.start, motion.end)
        ]
        shown = [figure.replace("nan", "-") for figure in figures]
        rows.append([motion.where, motion.kind, *shown, " -> ".join(ends)])
    return rows


def page(run: ProgramRun, name: str) -> str:
    """Return a page on a run."""
    from rx90_common.report.charts import chart
    from rx90_common.report.page import render_page
    from rx90_common.report.style import COLOURS

    speed = chart("", "time, s", "speed of the set-points, mm/s")
    distance = chart("", "time, s", "off the set-point, mm")
    for times, asked, measured in run.tracks:
        rates = np.linalg.norm(np.diff(asked, axis=0), axis=1) / np.diff(times)
        speed.line(times[1:], 1e3 * rates, color=COLOURS[0])
        distance.line(times, 1e3 * np.linalg.norm(measured - asked, axis=1), color=COLOURS[1])
    return render_page(
        __package__ or "",
        "program.html.j2",
        run=run,
        name=name,
        plots=[speed, distance],
        table=table(run),
    )


def draw(run: ProgramRun, file: Path) -> None:
    """Write a picture: where the tool went, seen from above and from the side, by set-points and by measurement."""
    from rx90_common.report.picture import picture
    from rx90_common.report.style import COLOURS

    with picture(file) as figure:
        for panel, up in zip(figure.subplots(1, 2), (1, 2), strict=True):
            for _, *places in run.tracks:
                for place, colour, style in zip(places, COLOURS, "-:", strict=False):
                    panel.plot(1e3 * place[:, 0], 1e3 * place[:, up], color=colour, linestyle=style)
            panel.set(
                xlabel="x, mm", ylabel=f"{'xyz'[up]}, mm", title="set-points solid, measured dotted"
            )
            panel.set_aspect("equal", adjustable="datalim")
