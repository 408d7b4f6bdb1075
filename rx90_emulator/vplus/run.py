"""Run a program of V+ on the emulator: its motions, signals and text, with the error of its path."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, NamedTuple

import numpy as np
from pydantic import Field

from rx90_common.base.arrays import Array
from rx90_common.base.errors import DivergenceError, SupervisionError, warn_caller
from rx90_common.base.models import Model
from rx90_common.description.kinematics import polyline_error, tip_position
from rx90_emulator.loop.result import RunResult
from rx90_emulator.loop.setup import Setup
from rx90_emulator.vplus import language  # noqa: F401 - enters the instructions
from rx90_emulator.vplus.arm import ProgrammedArm
from rx90_emulator.vplus.cell import PERIOD, Cell, Engine
from rx90_emulator.vplus.errors import VplusError
from rx90_emulator.vplus.motion import Motion, MotionQueue
from rx90_emulator.vplus.operators import bounded
from rx90_emulator.vplus.program import Memory, load
from rx90_emulator.vplus.readings import LOGIC, RELATIONS, Readings
from rx90_emulator.vplus.signals import Change, Signals
from rx90_emulator.vplus.syntax import Number, Operation, Text, nodes, plain_name
from rx90_emulator.vplus.task import Task

_SHORTEST_STEP = 1e-7  # m, of the tool between set-points of a path
_SETTLING = 0.1  # s, after a motion, that its path error counts


class Options(Model):
    """How a program is run."""

    monitor_speed: Annotated[float, Field(gt=0.0, le=100.0, description="Monitor speed, percent.")] = 100.0
    period: Annotated[float, Field(gt=0.0, description="From one planned set-point to the next, s.")] = PERIOD
    idle: Annotated[float, Field(gt=0.0, description="The longest time without a motion, s.")] = 60.0
    longest: Annotated[float, Field(gt=0.0, description="The longest run, s.")] = 300.0
    readings: Readings = Readings()
    record_fast: bool = False


class MotionRow(NamedTuple):
    """A row of the table of motions.

    Attributes:
        where: program and line.
        kind: the instruction.
        begin: simulated time, s.
        end: likewise.
        asked: the time that it takes alone, from rest to rest, at a monitor speed of 100 %, s.
        error: largest distance of the tool from the path of its set-points, mm.
    """

    where: str
    kind: str
    begin: float
    end: float
    asked: float
    error: float


@dataclass(eq=False)
class ProgramRun:
    """What a program did.

    Attributes:
        result: the series of the run; None if no time passed.
        motions: the motions, in their order.
        changes: of outputs.
        lines: what TYPE showed, with times, s.
        joints: joint values at the end, degrees.
        set_joints: those of the set-points.
        time: simulated time, s.
        error: what stopped it; None if it ran to its end.
    """

    result: RunResult | None
    motions: list[Motion]
    arm: ProgrammedArm
    changes: list[Change] = field(default_factory=list)
    lines: list[tuple[float, str]] = field(default_factory=list)
    joints: tuple[float, ...] = ()
    set_joints: tuple[float, ...] = ()
    time: float = 0.0
    error: VplusError | None = None

    def table(self) -> list[MotionRow]:
        """Return the table of motions."""
        return [
            MotionRow(
                motion.where, motion.kind, motion.began, motion.ended, motion.profile.duration, self._error(motion)
            )
            for motion in self.motions
        ]

    def paths(self, motion: Motion) -> tuple[Array, Array]:
        """Return the tool's places by set-points and by measurement during a motion, m, shape (n, 3)."""
        if self.result is None or math.isnan(motion.ended):
            return np.empty((0, 3)), np.empty((0, 3))
        later = [other.began for other in self.motions if other.began >= motion.ended]
        end = min([motion.ended + _SETTLING, *later])
        period = self.result.setup.rates.position_period
        rows = slice(round(motion.began / period), round(end / period))
        chain = self.arm.chain_to(motion.tool)
        slow = self.result.slow
        return tip_position(chain, slow.reference[rows, 0]), tip_position(chain, slow.joint_states[rows, 0])

    def _error(self, motion: Motion) -> float:
        asked, measured = self.paths(motion)
        if not len(asked):
            return math.nan
        steps = np.linalg.norm(np.diff(asked, axis=0), axis=1)
        corners = asked[np.concatenate([[True], steps > _SHORTEST_STEP])]
        if len(corners) < 2:
            return 1e3 * float(np.linalg.norm(measured - asked, axis=1).max())
        near = np.cumsum(np.concatenate([[0], steps > _SHORTEST_STEP]))
        return 1e3 * float(polyline_error(measured, corners, near).perpendicular.max())


def reading_warnings(memory: Memory) -> list[str]:
    """Return a warning for each line whose meaning depends on how operators bind."""
    warnings = []
    for program in memory.programs.values():
        for step in program.steps:
            for node in nodes(step.instruction):
                if isinstance(node, Operation) and {*LOGIC} & {*node.operators} and {*RELATIONS} & {*node.operators}:
                    warnings.append(
                        f"line {step.line} of {program.name}: a comparison beside AND, OR or XOR without brackets; "
                        "read by logic_before_relations (docs/reference/vplus.md)"
                    )
    return warnings


def load_programs(place: Path | str) -> Memory:
    """Read a file of V+ or a folder of them, and warn of what depends on a reading.

    Raises:
        LoadError: naming every fault of the files.
    """
    memory = load(Path(place))
    warn_caller(reading_warnings(memory))
    return memory


def run_program(
    setup: Setup,
    memory: Memory,
    name: str = "",
    *,
    arguments: Sequence[str] = (),
    inputs: Sequence[Change] = (),
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
    engine = Engine(setup, arm.ready, options.period, record_fast=options.record_fast)
    cell = Cell(arm, engine, MotionQueue(arm, arm.ready), options.period, Signals([*inputs]))
    run = run_in(cell, memory, name, arguments, options, show)
    if cell.beats:
        run.result = engine.result()
    return run


def run_in(
    cell: Cell,
    memory: Memory,
    name: str,
    arguments: Sequence[str],
    options: Options,
    show: Callable[[str, float, bool], None] | None = None,
) -> ProgramRun:
    """Run a program in a cell; as `run_program`, without the series."""
    cell.queue.monitor = options.monitor_speed
    run = ProgramRun(None, cell.queue.done, cell.arm, cell.signals.changes)
    begun = [""]

    def collect(text: str, time: float, ends: bool) -> None:
        begun[0] += text
        if ends:
            run.lines.append((time, begun[0]))
            begun[0] = ""
        if show is not None:
            show(text, time, ends)

    cell.show = collect
    task = Task(memory, cell, options.readings)
    try:
        _execute(task, _first(memory, name), arguments, options)
    except VplusError as error:
        run.error = error
    run.time = cell.time
    run.joints = cell.arm.joints(cell.drive.position())
    run.set_joints = cell.arm.joints(cell.queue.destination)
    return run


def _first(memory: Memory, name: str) -> str:
    if name:
        return plain_name(name)
    if not memory.programs:
        raise VplusError("Program not executable", "the files have no program")
    return next(iter(memory.programs))


def _constant(word: str) -> Number | Text:
    try:
        return Number(bounded(float(word)))
    except ValueError:
        return Text(word)


def _execute(task: Task, name: str, arguments: Sequence[str], options: Options) -> None:
    """Run a task until it ends or takes too long."""
    task.call(name, tuple(_constant(word) for word in arguments))
    cell = task.cell
    moved = 0.0
    try:
        for what in task.run():
            if not cell.queue.at_end:
                moved = cell.time
            if cell.time - moved >= options.idle:
                raise _too_long(task, f"no motion for {options.idle:g} s, waiting for {what}")
            if cell.time >= options.longest:
                raise _too_long(task, f"the run takes more than {options.longest:g} s")
            _beat(cell)
    except VplusError:
        while not cell.queue.at_end and cell.time < options.longest:  # the motion under way ends
            _beat(cell)
        raise


def _beat(cell: Cell) -> None:
    try:
        cell.advance()
    except (SupervisionError, DivergenceError) as error:
        cell.queue.drop()
        raise VplusError("Soft envelope error", f"at {cell.time:.3f} s: {error}") from error


def _too_long(task: Task, what: str) -> VplusError:
    where = f"in {task.frame_of().program.name}, line {task.line}" if task.frames else "at the end"
    return VplusError("Time-out", f"{what}; stopped {where}")
