"""Plans of excitation runs: one after the other, each for what those before it have left uncertain.

A run is a finite Fourier series of each joint on a common base frequency, periodic and band-limited (Swevers,
Ganseman, Tükel, de Schutter and Van Brussel 1997, "Optimal robot excitation and identification"). Velocity and
acceleration at the ends of a period are zero here, which takes two of a joint's coefficients, so that no ramp is
needed.

Its search begins with random series and improves the best of them step by step (L-BFGS). What exceeds a limit costs its
square; the motion that comes out is then shrunk until it keeps all of them. Derivatives by the coefficients go through
those by position, velocity and acceleration at the samples, so that a step costs the same for any number of harmonics.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property, partial

import numpy as np
from scipy.linalg import null_space
from scipy.optimize import minimize

from rx90_common.base.arrays import Array
from rx90_common.base.errors import IdentificationError
from rx90_emulator.identification.experiments.excitation.information import (
    ROWS,
    ExcitationColumns,
    InformationSlope,
    criterion,
)
from rx90_emulator.identification.experiments.excitation.limits import MotionLimits, Workspace
from rx90_emulator.identification.experiments.excitation.options import Criterion, ExcitationOptions
from rx90_emulator.identification.experiments.motion import Motion
from rx90_emulator.identification.experiments.plan import Experiment, Kind, Poses
from rx90_emulator.loop.setup import Setup

_KNOT_ANGLE = 0.3  # of the fastest sine between knots, rad: quintics between exact knots miss it by 1e-7 of its size


@dataclass(frozen=True, eq=False)
class SeriesBasis:
    """Motions of given harmonics at sample times, linear in c = 2 H - 1 coefficients of each joint.

    The first coefficient is the middle of the motion, rad; the others are in rad/s.

    Attributes:
        harmonics: H, 3 or more.
        period: s.
        time: of the samples, s, shape (m,).
    """

    harmonics: int
    period: float
    time: Array

    @property
    def count(self) -> int:
        """Return c."""
        return 2 * self.harmonics - 1

    @cached_property
    def matrices(self) -> tuple[Array, Array, Array]:
        """Return position, velocity and acceleration per coefficient, each of shape (m, c)."""
        number = np.arange(1, self.harmonics + 1)
        omega = 2.0 * math.pi * number / self.period
        # Speed a cos + b sin: at rest where the sum of a is zero, without acceleration where that of omega b is.
        cosine, sine = null_space(np.ones((1, self.harmonics))), null_space(number[None, :].astype(np.float64))
        c, s = np.cos(np.outer(self.time, omega)), np.sin(np.outer(self.time, omega))
        middle = np.ones((len(self.time), 1))
        position = np.hstack([middle, (s / omega) @ cosine, (-c / omega) @ sine])
        velocity = np.hstack([0.0 * middle, c @ cosine, s @ sine])
        acceleration = np.hstack([0.0 * middle, (-s * omega) @ cosine, (c * omega) @ sine])
        return position, velocity, acceleration

    def motion(self, coefficients: Array) -> tuple[Array, Array, Array]:
        """Return position, velocity and acceleration, each of shape (m, n), for coefficients of shape (n, c)."""
        position, velocity, acceleration = (matrix @ coefficients.T for matrix in self.matrices)
        return position, velocity, acceleration

    def gradient(self, position: Array, velocity: Array, acceleration: Array) -> Array:
        """Return derivatives by the coefficients, shape (n, c), from those by the motion, each of shape (m, n)."""
        p, v, a = self.matrices
        return np.asarray(position.T @ p + velocity.T @ v + acceleration.T @ a)

    def at(self, time: Array) -> SeriesBasis:
        """Return the same motions at other times, s."""
        return SeriesBasis(self.harmonics, self.period, time)


@dataclass(frozen=True, eq=False)
class FourierSeries:
    """A motion of n joints.

    Attributes:
        harmonics: H.
        period: s.
        coefficients: of `SeriesBasis`, shape (n, 2 H - 1).
    """

    harmonics: int
    period: float
    coefficients: Array

    def at(self, time: Array) -> tuple[Array, Array, Array]:
        """Return position, velocity and acceleration at times, each of shape (m, n)."""
        return SeriesBasis(self.harmonics, self.period, time).motion(self.coefficients)

    def shrunk(self, factor: float) -> FourierSeries:
        """Return the motion with another size around the same middle."""
        coefficients = self.coefficients * factor
        coefficients[:, 0] = self.coefficients[:, 0]
        return FourierSeries(self.harmonics, self.period, coefficients)

    def add_to(self, motion: Motion, periods: int) -> None:
        """Let a motion that rests where the series begins follow it for some periods."""
        fastest = 2.0 * math.pi * self.harmonics / self.period
        count = math.ceil(self.period * periods * fastest / _KNOT_ANGLE)
        # Knots lie on set-points.
        time = np.unique(np.round(np.linspace(0.0, self.period * periods, count + 1), 3))
        position, velocity, acceleration = self.at(time)
        motion.follow(time[1:], position[1:], velocity[1:], acceleration[1:])


_RANDOM_STARTS = 12  # random motions, the best of which is improved
_SAMPLES_PER_HARMONIC = 16  # samples in a period of the fastest sine: a peak between two is missed by 2 %
_LIMIT_COSTS = (1.0, 50.0)  # of exceeding a limit by its whole size at one sample: at first walls are soft
_MAX_LINE_EVALUATIONS = 50  # evaluations of a step at most: a step into a wall costs thousands
_MIDDLE_SPREAD = 0.3  # of a joint's range, in which the middles of random motions lie around home
_CHECK_STEP_S = 0.01  # s between samples at which a motion is held against the limits
_SEARCH_APPROACH = np.linspace(0.0, 1.0, 12)  # of the way from home to the begin of the series, in the search
_CHECKED_APPROACH = np.linspace(0.0, 1.0, 201)
_SHRINK_FACTOR, _BISECTIONS, _MIN_SHRINK = 0.85, 5, 0.02


@dataclass(frozen=True, eq=False)
class RunSearch:
    """The search for a run.

    Attributes:
        columns: whose parameters the run is to tell.
        limits: that it keeps.
        home: where the arm comes from, on a straight line of the joints, rad, shape (n,).
        kind: what is optimised.
        basis: of the motions, at the samples of the search.
        duration: of the run, s.
        before: information of the runs before it, shape (p, p).
    """

    columns: ExcitationColumns
    limits: MotionLimits
    home: Array
    kind: Criterion
    basis: SeriesBasis
    duration: float
    before: Array

    @staticmethod
    def samples(harmonics: int, period: float) -> SeriesBasis:
        """Return the motions at the samples of a search."""
        count = _SAMPLES_PER_HARMONIC * harmonics
        return SeriesBasis(harmonics, period, np.linspace(0.0, period, count, endpoint=False))

    def best(self, rng: np.random.Generator, steps: int, step: Callable[[], None]) -> FourierSeries:
        """Return the best motion that was found.

        Args:
            rng: of the random motions.
            steps: of the search, at most.
            step: called after each.

        Raises:
            IdentificationError: if it cannot be made small enough for the limits.
        """
        first = min(random_starts(self, rng), key=lambda x: self.cost(x)[0])

        def progress(xk: Array) -> None:  # noqa: ARG001 - SciPy's name for it
            step()

        for cost in _LIMIT_COSTS:
            found = minimize(
                partial(self.cost, limit=cost),
                first,
                jac=True,
                method="L-BFGS-B",
                callback=progress,
                options={"maxiter": max(1, steps // len(_LIMIT_COSTS)), "maxls": _MAX_LINE_EVALUATIONS},
            )
            first = found.x
        return self.within(self._series(first))

    def random(self, rng: np.random.Generator) -> FourierSeries:
        """Return a random motion that keeps ranges, speeds and accelerations, but for those of coupled motors."""
        n, limits = len(self.home), self.limits
        coefficients = rng.normal(size=(n, self.basis.count))
        coefficients[:, 0] = 0.0
        motion = self.basis.motion(coefficients)
        shares = limits.shares(motion, np.zeros_like(motion[0]))
        low, high = limits.middle - limits.reach, limits.middle + limits.reach
        middle = self.home + rng.uniform(-_MIDDLE_SPREAD, _MIDDLE_SPREAD, n) * limits.reach
        middle = np.clip(middle, low + 0.2 * limits.reach, high - 0.2 * limits.reach)
        room = np.minimum(middle - low, high - middle)
        size = np.stack([
            room / np.abs(motion[0]).max(axis=0),
            *(1.0 / np.abs(shares[name]).max(axis=0) for name in ("speed", "acceleration")),
        ]).min(axis=0)  # fmt: skip
        coefficients *= size[:, None]
        coefficients[:, 0] = middle
        return self._series(coefficients)

    def cost(self, x: Array, limit: float = _LIMIT_COSTS[-1]) -> tuple[float, Array]:
        """Return what is minimised and its derivative by the coefficients, shape (n c,).

        Args:
            x: coefficients, shape (n c,).
            limit: cost of exceeding a limit by its whole size at one sample.
        """
        coefficients = x.reshape(len(self.home), self.basis.count)
        motion = self.basis.motion(coefficients)
        slope = InformationSlope.of(self.columns, motion)
        rows, factor = slope.rows, ROWS * self.duration / len(motion[0])
        flat = rows.reshape(-1, rows.shape[2])
        value, by_information = criterion(self.kind, self.before + factor * (flat.T @ flat))
        parameters = self.columns.standard.values()
        penalty, over = self.limits.penalty(motion, slope.standard @ parameters)
        by_motion = slope.by_motion(2.0 * factor * rows @ by_information, limit * over.torque, parameters)
        gradient = self.basis.gradient(
            by_motion[0] + limit * over.position,
            by_motion[1] + limit * over.velocity,
            by_motion[2] + limit * over.acceleration,
        )
        near, by_start = self._ramp(coefficients)
        gradient += limit * by_start
        return value + limit * (penalty + near), gradient.ravel()

    def within(self, series: FourierSeries) -> FourierSeries:
        """Return the motion, shrunk until it keeps all limits between the samples, too.

        Raises:
            IdentificationError: if it does not even where it is small.
        """
        fine = self.basis.at(np.arange(0.0, series.period, _CHECK_STEP_S))
        return self.shrunk(series, fine, _CHECKED_APPROACH)

    def shrunk(self, series: FourierSeries, basis: SeriesBasis, way: Array) -> FourierSeries:
        """Return the motion, shrunk until it keeps the limits at a basis' samples and on parts of the way to it."""
        if self._keeps(series, basis, way):
            return series
        low, high = 1.0, 1.0
        while not self._keeps(series.shrunk(low), basis, way):
            low, high = _SHRINK_FACTOR * low, low
            if low < _MIN_SHRINK:
                motion = basis.motion(series.shrunk(low).coefficients)
                worst = self.limits.worst(motion, self.columns.arm.torque(*motion))
                raise IdentificationError(
                    f"no motion was found that keeps the limits; even of a small one {worst}; accepted: walls farther "
                    "away, less --clearance, more --share, another --seed"
                )
        for _ in range(_BISECTIONS):
            middle = 0.5 * (low + high)
            low, high = (middle, high) if self._keeps(series.shrunk(middle), basis, way) else (low, middle)
        return series.shrunk(low)

    def _keeps(self, series: FourierSeries, basis: SeriesBasis, way: Array) -> bool:
        motion = basis.motion(series.coefficients)
        start = series.at(np.zeros(1))[0][0]
        ramp = self.home + way[:, None] * (start - self.home)
        return self.limits.clear(ramp) and self.limits.kept(motion, self.columns.arm.torque(*motion))

    def _series(self, x: Array) -> FourierSeries:
        shape = len(self.home), self.basis.count
        return FourierSeries(self.basis.harmonics, self.basis.period, np.array(x).reshape(shape))

    def _ramp(self, coefficients: Array) -> tuple[float, Array]:
        """Return what the way from home to the begin costs, and its derivative by the coefficients, shape (n, c)."""
        begin = self.basis.at(np.zeros(1)).matrices[0][0]
        way = self.home + _SEARCH_APPROACH[:, None] * (coefficients @ begin - self.home)
        value, slope = self.limits.nearness(way)
        return value, np.outer(_SEARCH_APPROACH @ slope, begin)


def random_starts(search: RunSearch, rng: np.random.Generator) -> list[Array]:
    """Return the coefficients, shape (n c,), of the random motions that can be made small enough, one or more.

    Raises:
        IdentificationError: if none can.
    """
    starts, refusal = [], None
    for _ in range(_RANDOM_STARTS):
        try:
            starts.append(search.shrunk(search.random(rng), search.basis, _SEARCH_APPROACH).coefficients.ravel())
        except IdentificationError as error:
            refusal = error
    if refusal is not None and not starts:
        raise refusal
    return starts


_RUN_SPEEDS = (1.0, 0.5, 0.2)  # of the allowed speed, in turn: friction is not linear in it
_VALIDATION_SPEED = 0.7
_APPROACH_SPEED, _APPROACH_ACCELERATION = 0.25, 0.5  # shares of the limits on the way from and to home
_REST_S = 0.3  # s, before and after the series
_INFORMATION_RATE = 100.0  # per second, at which the information is summed up
_DEFAULT_NOISE_SHARE = 0.01  # of the URDF's effort: deviation of the torque's noise where none is given
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
        information = _information(columns, run.series, search.duration)
        search = replace(search, before=search.before + information)
        runs.append(run)
    if options.validation:
        alone = replace(search, before=np.zeros((count, count)))
        runs.append(_run(alone, "validation", Kind.VALIDATION, _VALIDATION_SEED, options, step))
    return ExcitationPlan(setup, options, columns, workspace, tuple(runs), search.before)


def _run(
    search: RunSearch, name: str, kind: Kind, number: int, options: ExcitationOptions, step: Callable[[str], None]
) -> PlannedRun:
    speed = _VALIDATION_SPEED if kind is Kind.VALIDATION else _RUN_SPEEDS[number % len(_RUN_SPEEDS)]
    own = replace(search, limits=replace(search.limits, speed=options.share * speed))
    rng = np.random.default_rng((options.seed, number))
    series = own.best(rng, options.steps, lambda: step(name))
    robot, controller = search.limits.setup.robot, search.limits.setup.controller
    motion = Motion(search.home)
    speed, acceleration = min(_APPROACH_SPEED, options.share), min(_APPROACH_ACCELERATION, options.share)
    way = (robot.max_velocity * speed, float(controller.max_acceleration.min()) * acceleration)
    motion.move(series.at(np.zeros(1))[0][0], *way)
    motion.rest(_REST_S)
    series.add_to(motion, options.periods)
    motion.rest(_REST_S)
    motion.move(search.home, *way)
    return PlannedRun(Experiment(name, kind, motion.points(robot.joint_names), options.periods), series)


def _information(columns: ExcitationColumns, series: FourierSeries, duration: float) -> Array:
    time = np.arange(round(series.period * _INFORMATION_RATE)) / _INFORMATION_RATE
    return columns.information(series.at(time), duration)


def _home(setup: Setup) -> Array:
    assert setup.files is not None
    poses = Poses.load(setup.files.required("poses"))
    poses.check(setup.robot)
    return np.array(poses.home)


def _noise(setup: Setup, options: ExcitationOptions) -> Array:
    n = len(setup.robot.joint_names)
    if options.torque_noise is None:
        return np.asarray(_DEFAULT_NOISE_SHARE * setup.robot.max_effort)
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
