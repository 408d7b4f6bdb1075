"""A sweep ready to run, with its files read, its paths checked and its line planned once; and the metrics of a run."""

from __future__ import annotations

import platform
from collections.abc import Callable, Sequence
from typing import NamedTuple, TypeVar

import numpy as np

from rx90_common.base.arrays import Array, rms
from rx90_common.base.errors import ConfigError, SweepError
from rx90_common.base.share import project_files, sources_hash, versions
from rx90_common.description.kinematics import forward, tip_position
from rx90_common.description.robot import RobotModel
from rx90_common.description.robot_files import provenance_of
from rx90_controller.lines.task import LineTask, TipTask
from rx90_controller.paths.path import Path
from rx90_controller.trajectory import TrajectoryGenerator, TrajectoryPoints
from rx90_emulator.loop.closed_loop import setpoints_of, simulate_commands
from rx90_emulator.loop.line import plan_path, turned_by
from rx90_emulator.loop.parameters import Catalogue, apply
from rx90_emulator.loop.path_file import load_motion
from rx90_emulator.loop.result import MotionCommand, RunResult
from rx90_emulator.loop.setup import Setup
from rx90_emulator.sweep.plan import SweepPlan, plan_hash
from rx90_emulator.sweep.runs import RunDescription, RunList

PLANNED_LINES = 64
# position ticks: the orientation costs as much as all else; its peak is 0.2 % less
_ORIENTATION_STRIDE = 10
_KEPT_SETPOINTS = 4
_Key = TypeVar("_Key")
_Kept = TypeVar("_Kept")
RUN_COLUMNS = ("index", "block", "seed", "error")
"""Columns of the results beside parameters and metrics."""


class Metric(NamedTuple):
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
    """Return the metrics for joints and friction elements, in the order of `measure`."""
    of_joints = (
        ("tracking_error_worst", "rad", "largest position error the controller saw"),
        ("tracking_error_rms", "rad", "root mean square position error"),
        ("velocity_peak", "rad/s", "largest joint speed"),
        ("drive_torque_peak", "Nm", "largest torque of the drives at the joint"),
    )
    about = "base ticks of the whole run at the motor's limit"
    return (
        Metric("path_error_worst", "m", "largest distance of the tip from the path"),
        Metric("path_error_rms", "m", "root mean square distance of the tip from the path"),
        Metric(
            "along_track_worst",
            "m",
            "largest distance of the tip from its set-point along the path",
        ),
        Metric(
            "orientation_worst",
            "rad",
            "largest angle of the tool from its orientation there, every 10 ticks",
        ),
        *(Metric(f"{name}_{j}", unit, what) for name, unit, what in of_joints for j in joints),
        *(
            Metric(f"friction_work_{e}", "J", "work done against the friction element")
            for e in elements
        ),
        *(
            Metric(f"saturated_ticks_motor_{i + 1}", "1", about, whole=True)
            for i in range(len(joints))
        ),
    )


def measure(task: TipTask, result: RunResult) -> tuple[float | int, ...]:
    """Return the metrics of a run of `task`."""
    begin, end = task.counted
    first = int(np.searchsorted(result.times, begin))
    rows = slice(first, int(np.searchsorted(result.times, end, side="right")))
    slow = result.slow
    joints = slow.joint_states[rows]
    error = slow.tracking_error[rows, 0]
    power = slow.friction_states[rows, 1] * slow.friction_states[rows, 2]
    work = result.setup.rates.position_period * (power.sum(axis=0) - 0.5 * (power[0] + power[-1]))
    return (
        *_path_errors(task, result.setup.robot, joints[:, 0], result.times[rows]),
        *_peaks(error), *map(rms, error.T),
        *_peaks(joints[:, 1]), *_peaks(joints[:, 2]), *work.tolist(), *result.saturated.tolist(),
    )  # fmt: skip


def _path_errors(
    task: TipTask, robot: RobotModel, position: Array, times: Array
) -> tuple[float, ...]:
    asked = task.profile().sample(times - task.rest_before).distance
    error = task.error(tip_position(robot.chain, position), asked)
    few = slice(None, None, _ORIENTATION_STRIDE)
    there = task.poses(np.clip(error.along[few], 0.0, task.length))
    turned = turned_by(robot, forward(robot.chain, position[few]), there)
    across = error.perpendicular
    return (
        float(across.max()),
        rms(across),
        float(np.abs(error.along - asked).max()),
        float(turned.max()),
    )


def _peaks(values: Array) -> list[float]:
    """Return the largest absolute value of each column."""
    peaks: list[float] = np.maximum(values.max(axis=0), -values.min(axis=0)).tolist()
    return peaks


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
        files = plan.base.files
        self.setup = Setup.load(files, plan.base.rates)
        self.task = load_motion(files.required("task"))
        self.description = plan.description()
        self.identity = plan_hash(self.description)
        self.versions = versions()
        self.sources = run_hash()
        self.provenance = provenance_of(files)
        self.metrics = metrics_of(self.setup.robot.joint_names, self.setup.friction.names)
        self.runs = RunList(plan, Catalogue(self.setup, self.task))
        taken = {*RUN_COLUMNS, *(metric.name for metric in self.metrics)}
        for column in self.runs.columns:
            if column.title in taken:
                raise ConfigError(
                    f"a parameter has the name '{column.title}' of a result; accepted: another name"
                )
            taken.add(column.title)
        self._motions: dict[LineTask | Path, tuple[TrajectoryPoints, LineTask | Path]] = {}
        self._setpoints: dict[tuple[object, ...], Array] = {}

    def __len__(self) -> int:
        return len(self.runs)

    def _motion(self, task: LineTask | Path) -> tuple[TrajectoryPoints, LineTask | Path]:
        """Return points of the motion, and the task as it is travelled: paths as slowly as the joints ask for."""

        def plan() -> tuple[TrajectoryPoints, LineTask | Path]:
            planned = plan_path(self.setup, task)
            return planned.points, planned.task if isinstance(planned.task, Path) else task

        # A sweep changes masses and inertias, never the kinematics: the task alone decides the line.
        return _remembered(self._motions, task, PLANNED_LINES, plan)

    def warm_up(self) -> None:
        """Compile, or load, every kernel that a run calls, and plan the line of the task.

        Raises:
            LineError: if the arm cannot travel the line of the plan's own task.
        """
        self._follow(self.setup, self.task, self.setup.rates.position_period)

    def simulate(self, index: int) -> RunResult:
        """Run one run through the closed loop and return all of it.

        Raises:
            SweepError: if there is no such run.
            Rx90Error: whatever ends it.
        """
        return self._follow(
            *apply(self.setup, self.task, self.runs.changes(self.runs.describe(index)))
        )

    def _follow(
        self, setup: Setup, task: LineTask | Path, duration: float | None = None
    ) -> RunResult:
        points, _ = self._motion(task)

        def sample(
            generator: TrajectoryGenerator, commands: Sequence[MotionCommand], count: int
        ) -> Array:
            """Return set-points, which runs of the same task, limits and start share."""
            limits = (np.asarray(value).tobytes() for value in vars(generator.limits).values())
            key = task, count, generator.setpoints(0).tobytes(), *limits
            return _remembered(
                self._setpoints,
                key,
                _KEPT_SETPOINTS,
                lambda: setpoints_of(generator, commands, count),
            )

        end = float(points.times[-1]) if duration is None else duration
        return simulate_commands(
            setup, (MotionCommand(0, points),), points.position[0], end, substeps=self.plan.base.substeps, warn=False,
            sample=sample,
        )  # fmt: skip

    def run(self, index: int) -> RunOutcome:
        """Run one run and measure it; an error is an outcome too, one that nobody thought of as well."""
        run = self.runs.describe(index)
        try:
            with np.errstate(all="ignore"):  # a diverging run says so itself
                setup, task = apply(self.setup, self.task, self.runs.changes(run))
                return RunOutcome(
                    run, measure(self._motion(task)[1], self._follow(setup, task)), None
                )
        except Exception as error:  # the sweep goes on whatever a value has led to
            return RunOutcome(run, None, " ".join(f"{type(error).__name__}: {error}".split()))

    def check_sources(self) -> None:
        """Check that this process runs the sources that the sweep was made with.

        Raises:
            SweepError: if not; the results would not belong together.
        """
        here = run_hash()
        if here != self.sources:
            raise SweepError(
                f"{platform.node()} runs other sources of the emulator ({here}); accepted: {self.sources}"
            )


def _remembered(kept: dict[_Key, _Kept], key: _Key, most: int, make: Callable[[], _Kept]) -> _Kept:
    """Return what belongs to a key, made once; of more keys than `most` the newest are kept."""
    if key not in kept:
        if len(kept) == most:
            del kept[next(iter(kept))]
        kept[key] = make()
    return kept[key]


def run_hash() -> str:
    """Return a hash of all sources of the project."""
    return sources_hash(project_files())
