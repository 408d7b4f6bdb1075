"""Plans of excitation runs: one after the other, each for what those before it have left uncertain.

A run is a finite Fourier series of each joint on a common base frequency, periodic and band-limited (Swevers,
Ganseman, Tükel, de Schutter and Van Brussel 1997, "Optimal robot excitation and identification"). Velocity and
acceleration at the ends of a period are zero here, which takes two of a joint's coefficients, so that no ramp is
needed.

Its search begins with random series and improves the best of them step by step (L-BFGS). What exceeds a limit costs its
square; the motion that comes out is then shrunk until it keeps all of them. Derivatives by the coefficients go through
those by position, velocity and acceleration at the samples, so that a step costs the same for any number of harmonics.

What a run tells is the information of the weighted columns that the identification fits: base parameters (links,
rotors, springs, offsets), and Coulomb and viscous torque of each friction element. Each joint is weighted by the noise
of its torque.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property, partial
from typing import TypeAlias

import numpy as np
from scipy.linalg import null_space
from scipy.optimize import minimize

from rx90_common.base.arrays import Array
from rx90_common.base.errors import IdentificationError
from rx90_common.exchange.topics import MOTOR_NAMES
from rx90_controller.trajectory import TrajectoryPoints
from rx90_emulator.identification.arm import RigidArm
from rx90_emulator.identification.excitation.problem import BaseGroups, StandardColumns
from rx90_emulator.identification.experiments.limits import (
    CARRIES,
    TURNS,
    friction_torque,
    limit_shares,
    motor_torque_limit,
)
from rx90_emulator.identification.experiments.motion import Motion
from rx90_emulator.identification.experiments.options import ExcitationOptions
from rx90_emulator.identification.experiments.plan import Experiment, Kind, Poses
from rx90_emulator.identification.experiments.workspace import Workspace
from rx90_emulator.loop.setup import Setup

ROWS = 100.0
"""Independent samples of each joint's torque per second."""
_SMOOTH = 0.1  # rad/s, over which the sign of the velocity changes for the search
_DIFFERENCE = 1e-6  # of position and velocity: the columns' derivatives are differences
_FLOOR = 1e-12  # of the squared length of a column: what is excited less counts as not excited

JointMotion: TypeAlias = tuple[Array, Array, Array]
"""Position, velocity and acceleration, each of shape (m, n)."""


@dataclass(frozen=True, eq=False)
class ExcitationColumns:
    """The columns of an arm's torque that `rx90_identify --excitation` fits.

    Attributes:
        arm: n joints and n_el elements.
        standard: of the P standard parameters.
        base: b groups of them.
        noise: standard deviation of each joint's torque in `ROWS` samples per second, Nm, shape (n,).
    """

    arm: RigidArm
    standard: StandardColumns
    base: BaseGroups
    noise: Array

    @property
    def names(self) -> tuple[str, ...]:
        """Return the names of p = b + 2 n_el parameters."""
        friction = [f"{name}.{part}" for part in ("tau_c", "c2") for name in self.arm.element_names]
        return (*self.base.names, *friction)

    def rows(self, standard: Array, velocity: Array, smooth: float = 0.0) -> Array:
        """Return the columns, each joint over its noise, shape (m, n, p).

        Args:
            standard: of the standard parameters, Nm per unit, shape (m, n, P).
            velocity: rad/s, shape (m, n).
            smooth: speed over which the sign changes, rad/s.
        """
        share, inputs = self.arm.element_matrix.T, velocity @ self.arm.element_matrix.T
        sign = np.tanh(inputs / smooth) if smooth else np.sign(inputs)
        friction = [value[:, None, :] * share for value in (sign, inputs)]
        rows = np.concatenate([standard[:, :, list(self.base.leading)], *friction], axis=2)
        return np.asarray(rows / self.noise[:, None])

    def slopes(self, motion: JointMotion, standard: Array, by_rows: Array, by_torque: Array) -> JointMotion:
        """Return the derivatives by the motion of a function of smoothed rows and rigid torque, each of shape (m, n).

        Args:
            motion: m samples.
            standard: of the standard parameters there, shape (m, n, P).
            by_rows: derivative of the function by the rows, shape (m, n, p).
            by_torque: by the rigid torque, 1/Nm, shape (m, n).
        """
        weighted, count = by_rows / self.noise[:, None], len(self.base.leading)
        by_standard = by_torque[:, :, None] * self.standard.values()
        by_standard[:, :, list(self.base.leading)] += weighted[:, :, :count]
        now = np.einsum("mnp,mnp->m", by_standard, standard)
        slopes = [np.empty_like(one) for one in motion]
        for kind, slope in enumerate(slopes):
            step = 1.0 if kind == 2 else _DIFFERENCE  # the columns are linear in the acceleration
            for joint in range(slope.shape[1]):
                moved = [one.copy() for one in motion]
                moved[kind][:, joint] += step
                other = self.standard.torque(*moved)
                slope[:, joint] = (np.einsum("mnp,mnp->m", by_standard, other) - now) / step
        elements = self.arm.element_matrix
        inputs, n_el = motion[1] @ elements.T, len(elements)
        coulomb, viscous = (
            np.einsum("mne,en->me", part, elements)
            for part in (weighted[:, :, count : count + n_el], weighted[:, :, count + n_el :])
        )
        sign_slope = 1.0 / (_SMOOTH * np.cosh(np.minimum(np.abs(inputs) / _SMOOTH, 50.0)) ** 2)
        return slopes[0], slopes[1] + (coulomb * sign_slope + viscous) @ elements, slopes[2]


def _information(rows: Array, duration: float) -> Array:
    """Return what rows of a motion, shape (m, n, p), that represent a duration, s, tell, shape (p, p)."""
    flat = rows.reshape(-1, rows.shape[2])
    return np.asarray(flat.T @ flat * (ROWS * duration / len(rows)))


def _criterion(kind: str, information: Array) -> tuple[float, Array]:
    """Return what is to be minimised and its derivative by the information, shape (p, p).

    `condition`: the logarithm of the condition number of the columns, each of length 1. `d`: the mean logarithm of the
    parameters' deviations, -log det(information) / (2 p).
    """
    p, size = len(information), np.sqrt(np.maximum(np.diag(information), 1e-300))
    scaled = information / np.outer(size, size) + _FLOOR * np.eye(p)
    if kind == "d":
        factor = np.linalg.cholesky(scaled)
        value = -np.sum(np.log(np.diag(factor) * size)) / p
        return float(value), -np.linalg.inv(scaled) / np.outer(size, size) / (2.0 * p)
    values, vectors = np.linalg.eigh(scaled)
    ends = vectors[:, [-1, 0]] / np.sqrt(values[[-1, 0]])
    slope = 0.5 * (np.outer(ends[:, 0], ends[:, 0]) - np.outer(ends[:, 1], ends[:, 1]))
    derivative = slope / np.outer(size, size)
    derivative[np.diag_indices(p)] -= np.sum(slope * scaled, axis=1) / size**2
    return float(0.5 * np.log(values[-1] / values[0])), derivative


class SeriesBasis:
    """Fourier series that rest at the ends of a period, at sample times: linear in c = 2 H - 1 coefficients a joint.

    The first coefficient is the middle of the motion, rad; the others are in rad/s.

    Args:
        harmonics: H, 3 or more.
        period: s.
        time: of the samples, s, shape (m,).
    """

    def __init__(self, harmonics: int, period: float, time: Array) -> None:
        self.count = 2 * harmonics - 1
        self._series = harmonics, period
        number = np.arange(1, harmonics + 1)
        omega = 2.0 * math.pi * number / period
        # Speed a cos + b sin: at rest where the sum of a is zero, without acceleration where that of omega b is.
        cosine, sine = null_space(np.ones((1, harmonics))), null_space(number[None, :].astype(np.float64))
        c, s = np.cos(np.outer(time, omega)), np.sin(np.outer(time, omega))
        middle = np.ones((len(time), 1))
        self.position = np.hstack([middle, (s / omega) @ cosine, (-c / omega) @ sine])
        self.velocity = np.hstack([0.0 * middle, c @ cosine, s @ sine])
        self.acceleration = np.hstack([0.0 * middle, (-s * omega) @ cosine, (c * omega) @ sine])

    def motion(self, coefficients: Array) -> JointMotion:
        """Return position, velocity and acceleration, each of shape (m, n), for coefficients of shape (n, c)."""
        transposed = coefficients.T
        return self.position @ transposed, self.velocity @ transposed, self.acceleration @ transposed

    def at(self, time: Array) -> SeriesBasis:
        """Return the same motions at other times, s."""
        return SeriesBasis(*self._series, time)


_RANDOM_STARTS = 12  # random motions, the best of which is improved
_SAMPLES_PER_HARMONIC = 16  # samples in a period of the fastest sine: a peak between two is missed by 2 %
_LIMIT_COSTS = (1.0, 50.0)  # of exceeding a limit by its whole size at one sample: at first walls are soft
_MAX_LINE_EVALUATIONS = 50  # evaluations of a step at most: a step into a wall costs thousands
_MIDDLE_SPREAD = 0.3  # of a joint's range, in which the middles of random motions lie around home
_RANGE_MARGIN = 0.02  # rad, to the joints' ranges, as the sweeps keep
_SHARE_MARGIN = 0.02  # of a limit that a search leaves for what lies between its samples
_CHECK_STEP_S = 0.01  # s between samples at which a motion is held against the limits
_SEARCH_APPROACH = np.linspace(0.0, 1.0, 12)  # of the way from home to the begin of the series, in the search
_CHECKED_APPROACH = np.linspace(0.0, 1.0, 201)
_SHRINK_FACTOR, _BISECTIONS, _MIN_SHRINK = 0.85, 5, 0.02
_DEFAULT_NOISE_SHARE = 0.01  # of the URDF's effort: deviation of the torque's noise where none is given


@dataclass(frozen=True, eq=False)
class RunSearch:
    """The search for a run.

    Attributes:
        setup: the robot.
        options: of the plan.
        home: where the arm comes from, on a straight line of the joints, rad, shape (n,).
        columns: whose parameters the run is to tell.
        workspace: what it keeps away from.
        speed: share of the joints' speeds that it may use.
        before: information of the runs before it, shape (p, p).
    """

    setup: Setup
    options: ExcitationOptions
    home: Array
    columns: ExcitationColumns
    workspace: Workspace
    speed: float
    before: Array

    @classmethod
    def of(cls, setup: Setup, options: ExcitationOptions, home: Array) -> RunSearch:
        """Return the search for a first run that may use the full speed.

        Raises:
            IdentificationError: for a number of noises that is not the joints'.
        """
        n, noise = len(setup.robot.joint_names), _DEFAULT_NOISE_SHARE * setup.robot.max_effort
        if options.torque_noise is not None:
            noise = np.array(options.torque_noise)
            if len(noise) != n:
                raise IdentificationError(f"--torque-noise: {len(noise)} values; accepted: {n}, one per joint")
        arm = RigidArm.from_setup(setup)
        standard = StandardColumns(arm)
        columns = ExcitationColumns(arm, standard, BaseGroups.of(standard), noise)
        nothing = np.zeros((len(columns.names), len(columns.names)))
        workspace = Workspace(setup.robot, options.walls, home)
        return cls(setup, options, home, columns, workspace, options.share, nothing)

    @cached_property
    def basis(self) -> SeriesBasis:
        """Return the motions at the samples of the search."""
        harmonics, period = self.options.harmonics, self.options.period
        count = _SAMPLES_PER_HARMONIC * harmonics
        return SeriesBasis(harmonics, period, np.linspace(0.0, period, count, endpoint=False))

    @cached_property
    def _start(self) -> SeriesBasis:
        return self.basis.at(np.zeros(1))

    def begin(self, coefficients: Array) -> Array:
        """Return where a series begins, rad, shape (n,)."""
        return np.asarray(self._start.motion(coefficients)[0][0])

    @property
    def duration(self) -> float:
        """Return how long the periods of the run take, s."""
        return self.options.period * self.options.periods

    def best(self, rng: np.random.Generator, step: Callable[[], None]) -> Array:
        """Return the coefficients of the best motion that was found, shape (n, c).

        Args:
            rng: of the random motions.
            step: called after each of the search's steps.

        Raises:
            IdentificationError: if it cannot be made small enough for the limits.
        """
        first = min((one.ravel() for one in self.random_starts(rng)), key=lambda x: self.cost(x)[0])

        def progress(xk: Array) -> None:  # noqa: ARG001 - SciPy's name for it
            step()

        for cost in _LIMIT_COSTS:
            steps = max(1, self.options.steps // len(_LIMIT_COSTS))
            found = minimize(
                partial(self.cost, limit=cost), first, jac=True, method="L-BFGS-B", callback=progress,
                options={"maxiter": steps, "maxls": _MAX_LINE_EVALUATIONS},
            )  # fmt: skip
            first = found.x
        return self.within(first.reshape(len(self.home), -1))

    def random_starts(self, rng: np.random.Generator) -> list[Array]:
        """Return the coefficients of the random motions that can be made small enough, one or more, shape (n, c) each.

        Raises:
            IdentificationError: if none can.
        """
        starts, refusal = [], None
        for _ in range(_RANDOM_STARTS):
            try:
                starts.append(self._shrunk(self.random(rng), self.basis, _SEARCH_APPROACH))
            except IdentificationError as error:
                refusal = error
        if refusal is not None and not starts:
            raise refusal
        return starts

    def random(self, rng: np.random.Generator) -> Array:
        """Return a random motion that keeps ranges, speeds and accelerations, but for those of coupled motors."""
        robot, n = self.setup.robot, len(self.home)
        center, reach = 0.5 * (robot.lower + robot.upper), self._reach
        coefficients = rng.normal(size=(n, self.basis.count))
        coefficients[:, 0] = 0.0
        motion = self.basis.motion(coefficients)
        shares = self._shares(motion, np.zeros_like(motion[0]))
        low, high = center - reach, center + reach
        middle = self.home + rng.uniform(-_MIDDLE_SPREAD, _MIDDLE_SPREAD, n) * reach
        middle = np.clip(middle, low + 0.2 * reach, high - 0.2 * reach)
        room = np.minimum(middle - low, high - middle)
        size = np.stack([
            room / np.abs(motion[0]).max(axis=0),
            *(1.0 / np.abs(shares[name]).max(axis=0) for name in ("speed", "acceleration")),
        ]).min(axis=0)  # fmt: skip
        coefficients *= size[:, None]
        coefficients[:, 0] = middle
        return coefficients

    def cost(self, x: Array, limit: float = _LIMIT_COSTS[-1]) -> tuple[float, Array]:
        """Return what is minimised and its derivative by the coefficients, shape (n c,).

        Args:
            x: coefficients, shape (n c,).
            limit: cost of exceeding a limit by its whole size at one sample.
        """
        columns, basis = self.columns, self.basis
        coefficients = x.reshape(len(self.home), basis.count)
        motion = basis.motion(coefficients)
        standard = columns.standard.torque(*motion)
        rows, factor = columns.rows(standard, motion[1], _SMOOTH), ROWS * self.duration / len(motion[0])
        value, by_information = _criterion(self.options.criterion, self.before + _information(rows, self.duration))
        penalty, over, over_torque = self._penalty(motion, standard @ columns.standard.values())
        slopes = columns.slopes(motion, standard, 2.0 * factor * rows @ by_information, limit * over_torque)
        position, velocity, acceleration = (own + limit * other for own, other in zip(slopes, over, strict=True))
        gradient = position.T @ basis.position + velocity.T @ basis.velocity + acceleration.T @ basis.acceleration
        # The way from home to the begin.
        begin = self._start.position[0]
        way = self.home + _SEARCH_APPROACH[:, None] * (coefficients @ begin - self.home)
        near, by_way = self.workspace.nearness(way, self.options.clearance)
        gradient += limit * np.outer(_SEARCH_APPROACH @ by_way, begin)
        return value + limit * (penalty + near), gradient.ravel()

    @property
    def _reach(self) -> Array:
        """Return how far each joint may go from the middle of its range, rad, shape (n,)."""
        return np.asarray(0.5 * (self.setup.robot.upper - self.setup.robot.lower) - _RANGE_MARGIN)

    def _shares(self, motion: JointMotion, torque: Array) -> dict[str, Array]:
        return limit_shares(self.setup, motion, torque, self.options.share, self.speed, _RANGE_MARGIN)

    def _penalty(self, motion: JointMotion, rigid: Array) -> tuple[float, JointMotion, Array]:
        """Return the squares of what exceeds limits, with derivatives by motion and torque; friction is smooth."""
        robot, controller, share = self.setup.robot, self.setup.controller, self.options.share
        friction, by_speed = friction_torque(self.setup, motion[1], _SMOOTH)
        over = {
            name: np.sign(one) * np.maximum(np.abs(one) - 1.0 + _SHARE_MARGIN, 0.0)
            for name, one in self._shares(motion, rigid + friction).items()
        }
        value = sum(float(np.sum(one**2)) for one in over.values())
        near, slope = self.workspace.nearness(motion[0], self.options.clearance)
        by_velocity = over["speed"] / robot.max_velocity + over["motor_speed"] / robot.max_velocity @ TURNS
        carried = over["motor_torque"] / motor_torque_limit(self.setup) @ CARRIES
        by_torque = 2.0 * (over["torque"] / robot.max_effort + carried) / share
        by_friction = by_torque @ TURNS.T * by_speed @ TURNS
        by_motion = (
            2.0 * over["position"] / self._reach + slope,
            2.0 * by_velocity / self.speed + by_friction,
            2.0 * over["acceleration"] / (share * controller.max_acceleration),
        )
        return value + near, by_motion, by_torque

    def within(self, coefficients: Array) -> Array:
        """Return the motion, shrunk until it keeps all limits between the samples, too.

        Raises:
            IdentificationError: if it does not even where it is small.
        """
        fine = self.basis.at(np.arange(0.0, self.options.period, _CHECK_STEP_S))
        return self._shrunk(coefficients, fine, _CHECKED_APPROACH)

    def _shrunk(self, coefficients: Array, basis: SeriesBasis, way: Array) -> Array:
        """Return the motion, shrunk around its middle until it keeps the limits at samples and on parts of the way."""

        def sized(factor: float) -> Array:
            other = coefficients * factor
            other[:, 0] = coefficients[:, 0]
            return other

        def exceeded(factor: float) -> str:
            return self._exceeded(sized(factor), basis, way)

        if not exceeded(1.0):
            return sized(1.0)
        low, high = 1.0, 1.0
        while worst := exceeded(low):
            low, high = _SHRINK_FACTOR * low, low
            if low < _MIN_SHRINK:
                raise IdentificationError(
                    f"no motion was found that keeps the limits; even of a small one {worst}; accepted: walls farther "
                    "away, less --clearance, more --share, another --seed"
                )
        for _ in range(_BISECTIONS):
            middle = 0.5 * (low + high)
            low, high = (low, middle) if exceeded(middle) else (middle, high)
        return sized(low)

    def _exceeded(self, coefficients: Array, basis: SeriesBasis, way: Array) -> str:
        """Return in words which limit a motion, or the way to it, exceeds most; empty where none."""
        motion = basis.motion(coefficients)
        ramp = self.home + way[:, None] * (self.begin(coefficients) - self.home)
        for positions in (motion[0], ramp):
            for wall, (distance, name) in zip(self.workspace.walls, self.workspace.lowest(positions), strict=True):
                if distance < self.options.clearance:
                    return f"{name} comes as near to {wall.name} as {distance:.3g} m"
        torque = self.columns.arm.torque(*motion) + friction_torque(self.setup, motion[1])[0]
        shares = {name: np.abs(share).max(axis=0) for name, share in self._shares(motion, torque).items()}
        name = max(shares, key=lambda one: float(shares[one].max()))
        joint = int(np.argmax(shares[name]))
        if not shares[name][joint] <= 1.0:
            whose = (MOTOR_NAMES if name.startswith("motor") else self.setup.robot.joint_names)[joint]
            return f"the {name.removeprefix('motor_')} of {whose} is {shares[name][joint]:.0%} of what is allowed"
        touches = any(len(self.workspace.near_itself(positions)) for positions in (motion[0], ramp))
        return "the arm touches itself" if touches else ""


_RUN_SPEEDS = (1.0, 0.5, 0.2)  # of the allowed speed, in turn: friction is not linear in it
_VALIDATION_SPEED = 0.7
_APPROACH_SPEED, _APPROACH_ACCELERATION = 0.25, 0.5  # shares of the limits on the way from and to home
_REST_S = 0.3  # s, before and after the series
_KNOT_ANGLE = 0.3  # of the fastest sine between knots, rad: quintics between exact knots miss it by 1e-7 of its size
_INFORMATION_RATE = 100.0  # per second, at which the information is summed up
_VALIDATION_SEED = 1_000_000


@dataclass(frozen=True, eq=False)
class ExcitationPlan:
    """A series of runs and what they tell.

    Attributes:
        search: robot, options, columns and workspace; `before` is the information of the runs that the identification
            uses, together.
        experiments: in the order of their recording; one for a validation last.
        coefficients: of their series, shape (n, c) each.
    """

    search: RunSearch
    experiments: tuple[Experiment, ...]
    coefficients: tuple[Array, ...]


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
    home = np.array(Poses.of(setup).home)
    search = RunSearch.of(setup, options, home)
    for wall, (distance, name) in zip(options.walls, search.workspace.lowest(home[None, :]), strict=True):
        if distance < options.clearance:
            raise IdentificationError(
                f"{wall.name}: at home {name} is {distance:.3g} m from it; accepted: {options.clearance:g} m or more "
                "(--clearance), a wall elsewhere, or another home in --poses"
            )
    nothing = search.before
    runs = [(f"excitation_{k + 1}", Kind.EXCITATION, k, _RUN_SPEEDS[k % len(_RUN_SPEEDS)]) for k in range(options.runs)]
    if options.validation:
        runs.append(("validation", Kind.VALIDATION, _VALIDATION_SEED, _VALIDATION_SPEED))
    experiments, found = [], []
    for name, kind, number, speed in runs:
        own = replace(search, speed=options.share * speed)
        if kind is Kind.VALIDATION:
            own = replace(own, before=nothing)
        coefficients = own.best(np.random.default_rng((options.seed, number)), partial(step, name))
        experiments.append(Experiment(name, kind, _trajectory(search, coefficients), options.periods))
        found.append(coefficients)
        if kind is Kind.EXCITATION:
            time = np.arange(round(options.period * _INFORMATION_RATE)) / _INFORMATION_RATE
            motion = search.basis.at(time).motion(coefficients)
            rows = search.columns.rows(search.columns.standard.torque(*motion), motion[1])
            search = replace(search, before=search.before + _information(rows, search.duration))
    return ExcitationPlan(search, tuple(experiments), tuple(found))


def _trajectory(search: RunSearch, coefficients: Array) -> TrajectoryPoints:
    """Return a run: home, begin of the series, its periods, home."""
    robot, controller, options = search.setup.robot, search.setup.controller, search.options
    speed, acceleration = min(_APPROACH_SPEED, options.share), min(_APPROACH_ACCELERATION, options.share)
    way = (robot.max_velocity * speed, float(controller.max_acceleration.min()) * acceleration)
    motion = Motion(search.home)
    motion.move(search.begin(coefficients), *way)
    motion.rest(_REST_S)
    fastest = 2.0 * math.pi * options.harmonics / options.period
    count = math.ceil(options.period * options.periods * fastest / _KNOT_ANGLE)
    # Knots lie on set-points.
    time = np.unique(np.round(np.linspace(0.0, options.period * options.periods, count + 1), 3))
    position, velocity, acceleration_at = search.basis.at(time).motion(coefficients)
    motion.follow(time[1:], position[1:], velocity[1:], acceleration_at[1:])
    motion.rest(_REST_S)
    motion.move(search.home, *way)
    return motion.points(robot.joint_names)
