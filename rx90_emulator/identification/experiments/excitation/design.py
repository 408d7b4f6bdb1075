"""Plans of excitation runs: one after the other, each for what those before it have left uncertain."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from rx90_common.base.arrays import Array
from rx90_common.base.errors import IdentificationError
from rx90_emulator.identification.experiments.excitation.information import ExcitationColumns
from rx90_emulator.identification.experiments.excitation.limits import MotionLimits
from rx90_emulator.identification.experiments.excitation.options import ExcitationOptions
from rx90_emulator.identification.experiments.excitation.search import RunSearch
from rx90_emulator.identification.experiments.excitation.series import FourierSeries
from rx90_emulator.identification.experiments.excitation.workspace import Workspace
from rx90_emulator.identification.experiments.motion import Motion
from rx90_emulator.identification.experiments.plan import Experiment, Kind
from rx90_emulator.identification.experiments.poses import Poses
from rx90_emulator.loop.setup import Setup

_SPEEDS = (1.0, 0.5, 0.2)  # of the allowed speed, in turn: friction is not linear in it
_VALIDATION_SPEED = 0.7
_APPROACH_SPEED, _APPROACH_ACCELERATION = 0.25, 0.5  # shares of the limits on the way from and to home
_REST = 0.3  # s, before and after the series
_SAMPLES = 100.0  # per second, at which the information is summed up
_NOISE = 0.01  # of the URDF's effort: deviation of the torque's noise where none is given
_VALIDATION_SEED = 1_000_000


@dataclass(frozen=True, eq=False)
class PlannedRun:
    """A run: home, begin of the series, its periods, home."""

    experiment: Experiment
    series: FourierSeries


@dataclass(frozen=True, eq=False)
class ExcitationPlan:
    """A series of runs and what they tell.

    Attributes:
        setup: the robot.
        options: of the plan.
        columns: of the parameters.
        workspace: what the runs keep away from.
        runs: in the order of their recording; one for a validation last.
        information: of the runs that the identification uses, together, shape (p, p).
    """

    setup: Setup
    options: ExcitationOptions
    columns: ExcitationColumns
    workspace: Workspace
    runs: tuple[PlannedRun, ...]
    information: Array

    @property
    def experiments(self) -> tuple[Experiment, ...]:
        """Return what engine and nodes run."""
        return tuple(run.experiment for run in self.runs)


def plan_excitation(
    setup: Setup, options: ExcitationOptions, step: Callable[[str], None] = lambda _: None
) -> ExcitationPlan:
    """Plan excitation runs for an arm. The same options give the same plan.

    Args:
        setup: robot, drives and controller, read from files, of which one holds the home pose.
        options: what can be chosen.
        step: called with the name of a run after each step of its search, `options.steps` times at most.

    Raises:
        IdentificationError: if home is beyond a limit, or no motion is found within the limits.
        ConfigError: if the robot has no poses.
    """
    if setup.files is None:
        raise IdentificationError("the setup was not read from files; accepted: one of load_setup")
    home = _home(setup)
    columns = ExcitationColumns.of(setup, _noise(setup, options))
    workspace = Workspace.of(setup.robot, options.walls, home)
    _check_home(workspace, home, options)
    limits = MotionLimits(setup, workspace, options.clearance, options.share, options.share)
    count = len(columns.names)
    search = RunSearch(
        columns,
        limits,
        home,
        options.criterion,
        RunSearch.samples(options.harmonics, options.period),
        options.period * options.periods,
        np.zeros((count, count)),
    )
    runs = []
    for number in range(options.runs):
        name = f"excitation_{number + 1}"
        run = _run(search, name, Kind.EXCITATION, number, options, step)
        told = _information(columns, run.series, search.duration)
        search = replace(search, before=search.before + told)
        runs.append(run)
    if options.validation:
        alone = replace(search, before=np.zeros((count, count)))
        runs.append(_run(alone, "validation", Kind.VALIDATION, _VALIDATION_SEED, options, step))
    return ExcitationPlan(setup, options, columns, workspace, tuple(runs), search.before)


def _run(
    search: RunSearch, name: str, kind: Kind, number: int, options: ExcitationOptions, step: Callable[[str], None]
) -> PlannedRun:
    speed = _VALIDATION_SPEED if kind is Kind.VALIDATION else _SPEEDS[number % len(_SPEEDS)]
    own = replace(search, limits=replace(search.limits, speed=options.share * speed))
    rng = np.random.default_rng((options.seed, number))
    series = own.best(rng, options.steps, lambda: step(name))
    robot, controller = search.limits.setup.robot, search.limits.setup.controller
    motion = Motion(search.home)
    speed, acceleration = min(_APPROACH_SPEED, options.share), min(_APPROACH_ACCELERATION, options.share)
    way = (robot.max_velocity * speed, float(controller.max_acceleration.min()) * acceleration)
    motion.move(series.at(np.zeros(1))[0][0], *way)
    motion.rest(_REST)
    series.add_to(motion, options.periods)
    motion.rest(_REST)
    motion.move(search.home, *way)
    return PlannedRun(Experiment(name, kind, motion.points(robot.joint_names), options.periods), series)


def _information(columns: ExcitationColumns, series: FourierSeries, duration: float) -> Array:
    time = np.arange(round(series.period * _SAMPLES)) / _SAMPLES
    return columns.information(series.at(time), duration)


def _home(setup: Setup) -> Array:
    assert setup.files is not None
    poses = Poses.load(setup.files.required("poses"))
    poses.check(setup.robot)
    return np.array(poses.home)


def _noise(setup: Setup, options: ExcitationOptions) -> Array:
    n = len(setup.robot.joint_names)
    if options.torque_noise is None:
        return np.asarray(_NOISE * setup.robot.max_effort)
    if len(options.torque_noise) != n:
        raise IdentificationError(f"--torque-noise: {len(options.torque_noise)} values; accepted: {n}, one per joint")
    return np.array(options.torque_noise)


def _check_home(workspace: Workspace, home: Array, options: ExcitationOptions) -> None:
    """Refuse walls that the arm is too near to where every run begins and ends."""
    for wall, (distance, name) in zip(options.walls, workspace.lowest(home[None, :]), strict=True):
        if distance < options.clearance:
            raise IdentificationError(
                f"{wall.name}: at home {name} is {distance:.3g} m from it; accepted: {options.clearance:g} m or more "
                "(--clearance), a wall elsewhere, or another home in --poses"
            )
