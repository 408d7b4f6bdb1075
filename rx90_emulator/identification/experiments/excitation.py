"""Plans of excitation runs, one after the other, each for the parameters that the previous ones leave uncertain.

A run is a finite Fourier series of each joint on a common base frequency, periodic and band-limited (Swevers,
Ganseman, Tükel, de Schutter and Van Brussel 1997, "Optimal robot excitation and identification"). Velocity and
acceleration at the ends of a period are zero here, which takes two of a joint's coefficients, so that no ramp is
needed.

The search begins with random series and improves the best of them step by step (L-BFGS). Exceeding a limit is penalised
by its square; the resulting motion is then scaled down until it keeps all limits. Derivatives by the coefficients are
computed from those by position, velocity and acceleration at the samples, so that a step takes the same time for any
number of harmonics.

The information of a run is that of the weighted columns of the identification: base parameters (links, rotors, springs,
offsets), and Coulomb and viscous torque of each friction element. Each joint is weighted by the noise of its torque.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import partial

import numpy as np
from scipy.linalg import null_space
from scipy.optimize import minimize

from rx90_common.base.arrays import Array
from rx90_common.base.errors import IdentificationError
from rx90_common.base.quoting import counted
from rx90_controller.trajectory import TrajectoryPoints
from rx90_emulator.identification.experiments.arms import PlannedArm
from rx90_emulator.identification.experiments.motion import Motion
from rx90_emulator.identification.experiments.plan import Experiment, Kind
from rx90_emulator.identification.experiments.workspace import Workspace
from rx90_emulator.identification.options import ExcitationOptions
from rx90_emulator.identification.rows.rigid import BaseGroups, StandardColumns
from rx90_emulator.loop.setup import Setup

ROWS = 100.0
"""Independent samples of each joint's torque per second."""
_SMOOTH = 0.1  # rad/s, over which the sign of the velocity changes in the search
_DIFFERENCE = 1e-6  # of position and velocity: the columns' derivatives are differences
_FLOOR = 1e-12  # of the squared length of a column: a less excited one counts as not excited
_RANDOM_STARTS = 12  # random motions, the best of which is improved
_SAMPLES_PER_HARMONIC = 16  # samples in a period of the fastest sine: a peak between two is missed by 2 %
_LIMIT_COSTS = (1.0, 50.0)  # of exceeding a limit by its whole size at one sample: at first walls are soft
_MAX_LINE_EVALUATIONS = 50  # of a step: a step into a wall would need thousands
_MIDDLE_SPREAD = 0.3  # of a joint's range, in which the middles of random motions lie around home
_RANGE_MARGIN = 0.02  # rad, to the ends of the joints' ranges, as in the sweeps
_SHARE_MARGIN = 0.02  # of a limit, that a search keeps for the motion between its samples
_CHECK_STEP_S = 0.01  # s between samples at which a motion is checked for the limits
_SEARCH_APPROACH = np.linspace(0.0, 1.0, 12)  # parts of the way from home to the beginning of the series, in the search
_CHECKED_APPROACH = np.linspace(0.0, 1.0, 201)
_SHRINK_FACTOR = 0.85
_BISECTIONS = 5
_MIN_SHRINK = 0.02
_DEFAULT_NOISE_SHARE = 0.01  # of the URDF's effort: deviation of the torque's noise where none is given


def series_basis(harmonics: int, period: float, time: Array) -> Array:
    """Return the columns in which a joint's series is linear: position, velocity and acceleration, shape (3, m, c).

    The first of its c = 2 H - 1 coefficients is the middle of the motion, rad; the others are in rad/s. The motion
    rests at the ends of a period. `basis @ coefficients.T` are the motions of n joints, shape (3, m, n).

    Args:
        harmonics: H, 3 or more.
        period: s.
        time: of the samples, s, shape (m,).
    """
    number = np.arange(1, harmonics + 1)
    omega = 2.0 * math.pi * number / period
    # Speed a cos + b sin: zero at the ends if the sum of a is zero, without acceleration if that of omega b is.
    cosine = null_space(np.ones((1, harmonics)))
    sine = null_space(number[None, :].astype(np.float64))
    c = np.cos(np.outer(time, omega))
    s = np.sin(np.outer(time, omega))
    one = np.ones((len(time), 1))
    return np.stack([
        np.hstack([one, (s / omega) @ cosine, (-c / omega) @ sine]),
        np.hstack([0.0 * one, c @ cosine, s @ sine]),
        np.hstack([0.0 * one, (-s * omega) @ cosine, (c * omega) @ sine]),
    ])  # fmt: skip


class ExcitationPlan:
    """The search for runs of an arm of n joints and n_el elements, and its results.

    Coefficients have shape (n, c), a motion is an array of shape (3, m, n): position rad, velocity rad/s, acceleration
    rad/s² at m samples.

    Args:
        arm: every run starts from its home, on a straight line of the joints.
        options: of the plan.

    Attributes:
        noise: standard deviation of each joint's torque in `ROWS` samples per second, Nm, shape (n,).
        standard: columns of the arm's torque by its P standard parameters.
        base: b groups of them.
        names: of the p = b + 2 n_el parameters to identify.
        workspace: obstacles of the runs.
        speed: share of the joints' speeds that the next run may use.
        information: of all runs for the identification together, shape (p, p).
        experiments: in the order of their recording; one for a validation last.
        coefficients: of their series.
    """

    def __init__(self, arm: PlannedArm, options: ExcitationOptions) -> None:
        self.arm = arm
        self.options = options
        self.home = arm.home
        robot = arm.robot
        n = len(robot.joint_names)
        self.noise = _DEFAULT_NOISE_SHARE * robot.max_effort
        if options.torque_noise is not None:
            self.noise = np.array(options.torque_noise)
            if len(self.noise) != n:
                raise IdentificationError(
                    f"--torque-noise: {counted(len(self.noise), 'value')}; accepted: {n}, one per joint"
                )
        self.standard = StandardColumns(arm.rigid)
        self.base = BaseGroups.of(self.standard)
        self._leading = list(self.base.leading)
        friction = (f"{name}.{part}" for part in ("tau_c", "c2") for name in arm.rigid.element_names)
        self.names: tuple[str, ...] = (*self.base.names, *friction)
        self.workspace = Workspace(robot, options.walls, arm.home)
        self.speed = options.share
        self.information = np.zeros((len(self.names), len(self.names)))
        self.experiments: list[Experiment] = []
        self.coefficients: list[Array] = []
        self.samples = self.basis(
            np.linspace(0.0, options.period, _SAMPLES_PER_HARMONIC * options.harmonics, endpoint=False)
        )
        self._begin = self.basis(np.zeros(1))
        self._reach = 0.5 * (robot.upper - robot.lower) - _RANGE_MARGIN

    def basis(self, time: Array) -> Array:
        """Return the `series_basis` of the runs at times, s, shape (m,)."""
        return series_basis(self.options.harmonics, self.options.period, time)

    def rows(self, standard: Array, velocity: Array, smooth: float = 0.0) -> Array:
        """Return the columns of the parameters, each joint over its noise, shape (m, n, p).

        Args:
            standard: those of the standard parameters, Nm per unit, shape (m, n, P).
            velocity: rad/s, shape (m, n).
            smooth: speed over which the sign changes, rad/s.
        """
        share = self.arm.rigid.element_matrix.T
        inputs = velocity @ self.arm.rigid.element_matrix.T
        sign = np.tanh(inputs / smooth) if smooth else np.sign(inputs)
        friction = [value[:, None, :] * share for value in (sign, inputs)]
        return np.asarray(np.concatenate([standard[:, :, self._leading], *friction], axis=2) / self.noise[:, None])

    def information_of(self, rows: Array) -> Array:
        """Return the information of a run, shape (p, p), by rows, shape (m, n, p), at even samples of a period."""
        stacked = rows.reshape(-1, rows.shape[2])
        return np.asarray(stacked.T @ stacked * (ROWS * (self.options.period * self.options.periods) / len(rows)))

    def best(self, rng: np.random.Generator, step: Callable[[], None]) -> Array:
        """Return the coefficients of the best motion found.

        Args:
            rng: of the random motions.
            step: called after each of the search's steps.
        """
        first = min((one.ravel() for one in self.random_starts(rng)), key=lambda x: self.cost(x)[0])

        def progress(xk: Array) -> None:  # noqa: ARG001 - SciPy's name for it
            step()

        for cost in _LIMIT_COSTS:
            steps = max(1, self.options.steps // len(_LIMIT_COSTS))
            first = minimize(
                partial(self.cost, limit=cost), first, jac=True, method="L-BFGS-B", callback=progress,
                options={"maxiter": steps, "maxls": _MAX_LINE_EVALUATIONS},
            ).x  # fmt: skip
        return self.within(first.reshape(len(self.home), -1))

    def random_starts(self, rng: np.random.Generator) -> list[Array]:
        """Return the coefficients of the random motions that can be scaled down to the limits, one or more."""
        starts = []
        refusals = []
        for _ in range(_RANDOM_STARTS):
            try:
                starts.append(self._shrunk(self.random(rng), self.samples, _SEARCH_APPROACH))
            except IdentificationError as error:
                refusals.append(error)
        if not starts:
            raise refusals[-1]
        return starts

    def random(self, rng: np.random.Generator) -> Array:
        """Return a random motion within ranges, speeds and accelerations, except for those of coupled motors."""
        robot = self.arm.robot
        n = len(self.home)
        coefficients = rng.normal(size=(n, self.samples.shape[2]))
        coefficients[:, 0] = 0.0
        motion = self.samples @ coefficients.T
        shares = self._shares(motion, np.zeros_like(motion[0]))
        center = 0.5 * (robot.lower + robot.upper)
        reach = self._reach
        low = center - reach
        high = center + reach
        middle = self.home + rng.uniform(-_MIDDLE_SPREAD, _MIDDLE_SPREAD, n) * reach
        middle = np.clip(middle, low + 0.2 * reach, high - 0.2 * reach)
        size = np.minimum(middle - low, high - middle) / np.abs(motion[0]).max(axis=0)
        for name in ("speed", "acceleration"):
            size = np.minimum(size, 1.0 / np.abs(shares[name]).max(axis=0))
        coefficients *= size[:, None]
        coefficients[:, 0] = middle
        return coefficients

    def cost(self, x: Array, limit: float = _LIMIT_COSTS[-1]) -> tuple[float, Array]:
        """Return the minimised cost and its derivative by the coefficients, shape (n c,).

        Args:
            x: coefficients, shape (n c,).
            limit: cost of exceeding a limit by its whole size at one sample.
        """
        options = self.options
        coefficients = x.reshape(len(self.home), -1)
        motion = self.samples @ coefficients.T
        standard = self.standard.torque(*motion)
        rows = self.rows(standard, motion[1], _SMOOTH)
        value, by_information = _criterion(options.criterion, self.information + self.information_of(rows))
        penalty, over, over_torque = self._penalty(motion, standard @ self.standard.values())
        by_rows = 2.0 * (ROWS * (options.period * options.periods) / len(rows)) * rows @ by_information
        slopes = self._slopes(motion, standard, by_rows, limit * over_torque)
        by_motion = [own + limit * other for own, other in zip(slopes, over, strict=True)]
        gradient = sum(one.T @ basis for one, basis in zip(by_motion, self.samples, strict=True))
        # The way from home to the beginning of the series.
        begin = self._begin[0, 0]
        way = self.home + _SEARCH_APPROACH[:, None] * (coefficients @ begin - self.home)
        near, by_way = self.workspace.nearness(way, options.clearance)
        gradient += limit * np.outer(_SEARCH_APPROACH @ by_way, begin)
        return value + limit * (penalty + near), np.asarray(gradient).ravel()

    def _slopes(self, motion: Array, standard: Array, by_rows: Array, by_torque: Array) -> Array:
        """Return the derivatives by the motion of a function of smoothed rows and rigid torque, shape (3, m, n)."""
        weighted = by_rows / self.noise[:, None]
        count = len(self._leading)
        by_standard = by_torque[:, :, None] * self.standard.values()
        by_standard[:, :, self._leading] += weighted[:, :, :count]
        now = np.einsum("mnp,mnp->m", by_standard, standard)
        slopes = np.empty_like(motion)
        for kind, joint in np.ndindex(3, motion.shape[2]):
            step = 1.0 if kind == 2 else _DIFFERENCE  # the columns are linear in the acceleration
            moved = motion.copy()
            moved[kind, :, joint] += step
            slopes[kind, :, joint] = (np.einsum("mnp,mnp->m", by_standard, self.standard.torque(*moved)) - now) / step
        elements = self.arm.rigid.element_matrix
        inputs = motion[1] @ elements.T
        coulomb, viscous = (np.einsum("mne,en->me", part, elements) for part in np.split(weighted[:, :, count:], 2, 2))
        sign_slope = 1.0 / (_SMOOTH * np.cosh(np.minimum(np.abs(inputs) / _SMOOTH, 50.0)) ** 2)
        slopes[1] += (coulomb * sign_slope + viscous) @ elements
        return slopes

    def _penalty(self, motion: Array, rigid: Array) -> tuple[float, tuple[Array, Array, Array], Array]:
        """Return the squares of exceeded limits, with derivatives by motion and torque; friction is smooth."""
        arm = self.arm
        robot = self.arm.robot
        share = self.options.share
        friction, by_speed = arm.friction_torque(motion[1], _SMOOTH)
        over = {
            name: np.sign(one) * np.maximum(np.abs(one) - 1.0 + _SHARE_MARGIN, 0.0)
            for name, one in self._shares(motion, rigid + friction).items()
        }
        near, slope = self.workspace.nearness(motion[0], self.options.clearance)
        by_velocity = over["speed"] / robot.max_velocity + over["motor_speed"] / robot.max_velocity @ arm.turns
        carried = over["motor_torque"] / arm.motor_torque @ arm.carries
        by_torque = 2.0 * (over["torque"] / robot.max_effort + carried) / share
        by_motion = (
            2.0 * over["position"] / self._reach + slope,
            2.0 * by_velocity / self.speed + by_torque @ arm.turns.T * by_speed @ arm.turns,
            2.0 * over["acceleration"] / (share * arm.limits.acceleration),
        )
        return sum(float(np.sum(one**2)) for one in over.values()) + near, by_motion, by_torque

    def _shares(self, motion: Array, torque: Array) -> dict[str, Array]:
        return self.arm.limit_shares(motion, torque, self.options.share, self.speed, _RANGE_MARGIN)

    def within(self, coefficients: Array) -> Array:
        """Return the motion, scaled down until it keeps all limits, also between the samples."""
        fine = self.basis(np.arange(0.0, self.options.period, _CHECK_STEP_S))
        return self._shrunk(coefficients, fine, _CHECKED_APPROACH)

    def _shrunk(self, coefficients: Array, basis: Array, way: Array) -> Array:
        """Return the motion, scaled around its middle until it keeps the limits at samples and on parts of the way."""

        def sized(factor: float) -> Array:
            other = coefficients * factor
            other[:, 0] = coefficients[:, 0]
            return other

        low = high = 1.0
        while worst := self._exceeded(sized(low), basis, way):
            low, high = _SHRINK_FACTOR * low, low
            if low < _MIN_SHRINK:
                raise IdentificationError(
                    f"no motion was found that keeps the limits; even of a small one {worst}; accepted: walls farther "
                    "away, less --clearance, more --share, another --seed"
                )
        for _ in range(_BISECTIONS if low < high else 0):
            middle = 0.5 * (low + high)
            low, high = (low, middle) if self._exceeded(sized(middle), basis, way) else (middle, high)
        return sized(low)

    def _exceeded(self, coefficients: Array, basis: Array, way: Array) -> str:
        """Return in words which limit a motion, or the way to it, exceeds most; empty if none."""
        motion = basis @ coefficients.T
        paths = motion[0], self.home + way[:, None] * ((self._begin[0] @ coefficients.T)[0] - self.home)
        for positions in paths:
            for wall, (distance, name) in zip(self.workspace.walls, self.workspace.lowest(positions), strict=True):
                if distance < self.options.clearance:
                    return f"{name} comes as near to {wall.name} as {distance:.3g} m"
        torque = self.arm.rigid.torque(*motion) + self.arm.friction_torque(motion[1])[0]
        shares = {name: np.abs(share).max(axis=0) for name, share in self._shares(motion, torque).items()}
        name = max(shares, key=lambda one: float(shares[one].max()))
        joint = int(np.argmax(shares[name]))
        if not shares[name][joint] <= 1.0:
            of = self.arm.whose(name)[joint]
            return f"the {name.removeprefix('motor_')} of {of} is {shares[name][joint]:.0%} of what is allowed"
        return "the arm touches itself" if any(len(self.workspace.near_itself(one)) for one in paths) else ""

    def trajectory(self, coefficients: Array) -> TrajectoryPoints:
        """Return a run: home, beginning of the series, its periods, home."""
        robot = self.arm.robot
        options = self.options
        speed = min(_APPROACH_SPEED, options.share)
        acceleration = min(_APPROACH_ACCELERATION, options.share)
        way = (robot.max_velocity * speed, float(self.arm.limits.acceleration.min()) * acceleration)
        motion = Motion(self.home)
        motion.move((self._begin[0] @ coefficients.T)[0], *way)
        motion.rest(_REST_S)
        fastest = 2.0 * math.pi * options.harmonics / options.period
        count = math.ceil(options.period * options.periods * fastest / _KNOT_ANGLE)
        # Knots lie on set-points.
        time = np.unique(np.round(np.linspace(0.0, options.period * options.periods, count + 1), 3))
        motion.follow(time[1:], *(self.basis(time) @ coefficients.T)[:, 1:])
        motion.rest(_REST_S)
        motion.move(self.home, *way)
        return motion.points(robot.joint_names)


def _criterion(kind: str, information: Array) -> tuple[float, Array]:
    """Return the minimised criterion and its derivative by the information, shape (p, p).

    `condition`: the logarithm of the condition number of the columns, each of length 1. `d`: the mean logarithm of the
    parameters' deviations, -log det(information) / (2 p).
    """
    p = len(information)
    size = np.sqrt(np.maximum(np.diag(information), 1e-300))
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


_RUN_SPEEDS = (1.0, 0.5, 0.2)  # of the allowed speed, in turn: friction is not linear in it
_VALIDATION_SPEED = 0.7
# shares of the limits on the way from and to home
_APPROACH_SPEED = 0.25
_APPROACH_ACCELERATION = 0.5
_REST_S = 0.3  # s, before and after the series
_KNOT_ANGLE = 0.3  # of the fastest sine between knots, rad: quintics between exact knots miss it by 1e-7 of its size
_INFORMATION_RATE = 100.0  # per second, for the sum of the information
_VALIDATION_SEED = 1_000_000


def plan_excitation(
    arm: Setup | PlannedArm, options: ExcitationOptions, step: Callable[[str], None] = lambda _: None
) -> ExcitationPlan:
    """Plan excitation runs for an arm. The same options give the same plan.

    Args:
        arm: for a setup `PlannedArm.from_setup`.
        options: of the plan.
        step: called with the name of a run after each step of its search, `options.steps` times at most.
    """
    plan = ExcitationPlan(PlannedArm.from_setup(arm) if isinstance(arm, Setup) else arm, options)
    for wall, (distance, name) in zip(options.walls, plan.workspace.lowest(plan.home[None, :]), strict=True):
        if distance < options.clearance:
            raise IdentificationError(
                f"{wall.name}: at home {name} is {distance:.3g} m from it; accepted: {options.clearance:g} m or more "
                "(--clearance), a wall elsewhere, or another --home"
            )

    def add(name: str, kind: Kind, seed: int, speed: float) -> Array:
        plan.speed = options.share * speed
        found = plan.best(np.random.default_rng((options.seed, seed)), partial(step, name))
        plan.experiments.append(Experiment(name, kind, plan.trajectory(found), options.periods))
        plan.coefficients.append(found)
        return found

    time = np.arange(round(options.period * _INFORMATION_RATE)) / _INFORMATION_RATE
    for k in range(options.runs):
        motion = plan.basis(time) @ add(
            f"excitation_{k + 1}", Kind.EXCITATION, k, _RUN_SPEEDS[k % len(_RUN_SPEEDS)]
        ).T  # fmt: skip
        plan.information = plan.information + plan.information_of(plan.rows(plan.standard.torque(*motion), motion[1]))
    if options.validation:
        # as for a first run
        known = plan.information
        plan.information = np.zeros_like(plan.information)
        add("validation", Kind.VALIDATION, _VALIDATION_SEED, _VALIDATION_SPEED)
        plan.information = known
    return plan
