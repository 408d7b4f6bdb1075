"""A plan made ready to run: files read, paths checked, the line planned once."""

from __future__ import annotations

import platform
from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np

from rx90_common.base.arrays import Array
from rx90_common.base.errors import ConfigError, SweepError
from rx90_common.base.sources import ROOT, sources_hash, with_imports
from rx90_common.base.versions import versions
from rx90_common.description.kinematics import path_error
from rx90_common.description.provenance import provenance_of
from rx90_common.description.tip import tip_position
from rx90_controller.lines.task import LineTask, load_task
from rx90_controller.trajectory import TrajectoryPoints
from rx90_emulator.loop.application import apply
from rx90_emulator.loop.catalogue import Catalogue, Value
from rx90_emulator.loop.closed_loop import run_commands
from rx90_emulator.loop.line import plan_line
from rx90_emulator.loop.result import MotionCommand, RunResult
from rx90_emulator.loop.setup import Setup
from rx90_emulator.sweep.plan import SweepPlan, plan_hash
from rx90_emulator.sweep.runs import RunDescription, RunList

PLANNED_LINES = 64
RUN_COLUMNS = ("index", "block", "seed", "error")
"""Columns of the results beside parameters and metrics."""


@dataclass(frozen=True)
class Metric:
    """One number of a run.

    Attributes:
        name: of its column.
        unit: SI.
        meaning: a sentence.
        whole: whether it is a whole number.
    """

    name: str
    unit: str
    meaning: str
    whole: bool = False


def metrics_of(joints: Sequence[str], elements: Sequence[str]) -> tuple[Metric, ...]:
    """Return the metrics for six joints and seven friction elements, in the order of `measure`."""
    motors = [f"motor_{i + 1}" for i in range(len(joints))]
    return (
        Metric("path_error_worst", "m", "largest distance of the tip from the line"),
        Metric("path_error_rms", "m", "root mean square distance of the tip from the line"),
        *(Metric(f"tracking_error_worst_{j}", "rad", "largest position error the controller saw") for j in joints),
        *(Metric(f"tracking_error_rms_{j}", "rad", "root mean square position error") for j in joints),
        *(Metric(f"velocity_peak_{j}", "rad/s", "largest joint speed") for j in joints),
        *(Metric(f"drive_torque_peak_{j}", "Nm", "largest torque of the drives at the joint") for j in joints),
        *(Metric(f"friction_work_{e}", "J", "work done against the friction element") for e in elements),
        *(
            Metric(f"saturated_ticks_{m}", "1", "base ticks of the whole run at the motor's limit", whole=True)
            for m in motors
        ),
    )


def measure(task: LineTask, result: RunResult) -> tuple[float | int, ...]:
    """Return the metrics of a run of `task`."""
    rows = _window(task, result.times)
    slow = result.slow
    tip = tip_position(result.setup.robot.chain, slow.joint_states[rows, 0])
    path = path_error(tip, np.array(task.start), np.array(task.end)).perpendicular
    error = slow.tracking_error[rows, 0]
    power = slow.friction_states[rows, 1] * slow.friction_states[rows, 2]
    work = (result.setup.rates.position_period * (power[1:] + power[:-1]) / 2.0).sum(axis=0)
    return (
        float(path.max()),
        _rms(path),
        *np.abs(error).max(axis=0).tolist(),
        *map(_rms, error.T),
        *np.abs(slow.joint_states[rows, 1]).max(axis=0).tolist(),
        *np.abs(slow.joint_states[rows, 2]).max(axis=0).tolist(),
        *work.tolist(),
        *result.saturated.tolist(),
    )


def _window(task: LineTask, times: Array) -> slice:
    begin, end = task.counted
    first, last = np.searchsorted(times, begin), np.searchsorted(times, end, side="right")
    return slice(int(first), int(last))


def _rms(values: Array) -> float:
    return float(np.sqrt(np.mean(np.square(values))))


class RunOutcome(NamedTuple):
    """What came of a run: its metrics, or the error that ended it."""

    run: RunDescription
    metrics: tuple[float | int, ...] | None
    error: str | None


class Sweep:
    """A plan over the files that it names.

    It can be sent to other processes and machines, which then need none of the files.

    Attributes:
        plan: what was asked for.
        setup: the base of every run.
        task: its task.
        runs: the runs, by their index.
        metrics: what is measured, in the order of `RunOutcome.metrics`.
        description: what decides the results, as data for JSON.
        identity: hash of the description.
        versions: of the interpreter and the libraries.
        sources: hash of the emulator's sources.
        provenance: what the files of the robot say of where their numbers come from.
    """

    def __init__(self, plan: SweepPlan) -> None:
        """Read the files and check the plan against them.

        Raises:
            ConfigError, LineError: naming file or parameter, value and what is accepted.
        """
        self.plan = plan
        self.description = plan.description()
        self.identity = plan_hash(self.description)
        self.versions = versions()
        self.sources = run_hash()
        self.setup = Setup.load(plan.base.files, plan.base.rates)
        self.task = load_task(plan.base.files.required("task"))
        self.provenance = provenance_of(plan.base.files)
        self.metrics: tuple[Metric, ...] = metrics_of(self.setup.robot.joint_names, self.setup.friction.names)
        self.runs = RunList(plan, Catalogue(self.setup, self.task))
        self._check_names()
        self._prepare()

    def __len__(self) -> int:
        return len(self.runs)

    def _check_names(self) -> None:
        taken = {*RUN_COLUMNS, *(metric.name for metric in self.metrics)}
        for column in self.runs.columns:
            if column.title in taken:
                raise ConfigError(f"a parameter has the name '{column.title}' of a result; accepted: another name")
            taken.add(column.title)

    def __getstate__(self) -> dict[str, Any]:
        return {name: value for name, value in self.__dict__.items() if name != "_motion"}

    def __setstate__(self, state: dict[str, Any]) -> None:
        self.__dict__.update(state)
        self._prepare()

    def _prepare(self) -> None:
        # A sweep changes masses and inertias, never the kinematics: the task alone decides the line.
        @lru_cache(maxsize=PLANNED_LINES)
        def motion(task: LineTask) -> TrajectoryPoints:
            return plan_line(self.setup, task).points

        self._motion = motion

    def warm_up(self) -> None:
        """Compile, or load, every kernel that a run calls, and plan the line of the task.

        Raises:
            LineError: if the arm cannot travel the line of the plan's own task.
        """
        period = self.setup.rates.position_period
        self._follow(self.setup, self._motion(self.task), period)

    def simulate(self, index: int) -> RunResult:
        """Run one run through the closed loop and return all of it.

        Raises:
            SweepError: if there is no such run.
            Rx90Error: whatever ends it.
        """
        return self._simulate(self.runs.describe(index))[1]

    def _simulate(self, run: RunDescription) -> tuple[LineTask, RunResult]:
        setup, task = apply(self.setup, self.task, self.runs.changes(run))
        points = self._motion(task)
        return task, self._follow(setup, points, float(points.times[-1]))

    def _follow(self, setup: Setup, points: TrajectoryPoints, duration: float) -> RunResult:
        commands, substeps = (MotionCommand(0, points),), self.plan.base.substeps
        return run_commands(setup, commands, points.position[0], duration, substeps=substeps)

    def run(self, index: int) -> RunOutcome:
        """Run one run and measure it; an error is an outcome too, one that nobody thought of as well."""
        run = self.runs.describe(index)
        try:
            with np.errstate(all="ignore"):  # a diverging run says so itself
                return RunOutcome(run, measure(*self._simulate(run)), None)
        except Exception as error:  # the sweep goes on whatever a value has led to
            return RunOutcome(run, None, " ".join(f"{type(error).__name__}: {error}".split()))

    def values(self, run: RunDescription) -> tuple[Value | None, ...]:
        """Return a run's value for each of `runs.columns`; None where its block leaves it as in the files."""
        given = dict(run.values)
        return tuple(given.get(column.name) for column in self.runs.columns)

    def check_sources(self) -> None:
        """Check that this process runs the sources that the sweep was made with.

        Raises:
            SweepError: if not; the results would not belong together.
        """
        here = run_hash()
        if here != self.sources:
            raise SweepError(f"{platform.node()} runs other sources of the emulator ({here}); accepted: {self.sources}")


def run_hash() -> str:
    """Return a hash of all sources that take part in a run."""
    return sources_hash(with_imports([ROOT / "rx90_emulator/sweep/sweep.py"]))
