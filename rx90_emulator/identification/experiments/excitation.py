"""One optimised excitation run, and a random one of another motion for the validation.

A run is a finite Fourier series of each joint on a common base frequency, periodic and band-limited (Swevers,
Ganseman, Tükel, de Schutter and Van Brussel 1997, "Optimal robot excitation and identification"). It begins and ends at
home, at rest and without acceleration, which takes two of a joint's coefficients. The series is played at three tempos,
because friction is not linear in the speed.

The search begins with the best of random series and improves it step by step (L-BFGS), so that the determinant of the
information on the parameters grows: base parameters of links and rotors, offsets, and Coulomb and viscous torque of
each friction element, each joint weighted by its largest torque. Exceeding a limit is penalised by its square; the
resulting motion is then scaled down until it keeps all limits.
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
from rx90_common.base.quoting import listed
from rx90_common.description.workspace import Workspace
from rx90_controller.trajectory.motion import Motion
from rx90_emulator.identification.experiments.arms import PlannedArm
from rx90_emulator.identification.experiments.options import ExcitationOptions
from rx90_emulator.identification.experiments.plan import Experiment, Kind
from rx90_emulator.identification.rows.rigid import BaseGroups, StandardColumns

_VALIDATION_TEMPO = 0.75
_SMOOTH = 0.1  # rad/s, over which the sign of the velocity changes in the search
# rad and rad/s: derivatives are differences; distances of shapes are right to 1e-6 m
_DIFFERENCE = 1e-4
_RIDGE = 1e-9  # of the squared length of a column: a less excited one counts as not excited
_LEAST_ROOM = 0.05  # rad, of a random motion about a home at the end of a joint's range
_RANDOM_STARTS = 12  # random series, the best of which is improved
# samples in a period of the fastest sine: a peak between two is missed by 2 %
_SAMPLES_PER_HARMONIC = 16
# samples from one computed distance to the next: distances are smooth, and take longest
_SPATIAL_STRIDE = 4
# of exceeding a limit by its whole size at one sample: at first walls are soft
_LIMIT_COSTS = (1.0, 50.0)
_MAX_LINE_EVALUATIONS = 50  # of a step: a step into a wall would need thousands
_MARGIN = 0.02  # of a limit, that a search keeps for the motion between its samples
_CHECK_STEP_S = 0.01  # s between samples at which a motion is checked for the limits
_SHRINK = 0.95
_LEAST_SIZE = 0.02
_KNOT_ANGLE = 0.3  # of the fastest sine between knots, rad: quintics between exact knots miss it by 1e-7 of its size
_REST_S = 0.3  # s, after the series


def series_basis(harmonics: int, period: float, time: Array) -> Array:
    """Return the columns in which a joint's series is linear: position, velocity and acceleration, shape (3, m, c).

    Its c = 2 H - 2 coefficients are in rad/s. `basis @ coefficients.T` are the motions of n joints, shape (3, m, n).

    Args:
        harmonics: H, 3 or more.
        period: s.
        time: of the samples, s, shape (m,).
    """
    number = np.arange(1.0, harmonics + 1.0)
    omega = 2.0 * math.pi * number / period
    # Speed a cos + b sin: zero at the ends if the sum of a is zero, without acceleration if that of omega b is.
    cosine = null_space(np.ones((1, harmonics)))
    sine = null_space(number[None, :])
    c = np.cos(np.outer(time, omega))
    s = np.sin(np.outer(time, omega))
    return np.stack([
        np.hstack([(s / omega) @ cosine, ((1.0 - c) / omega) @ sine]),
        np.hstack([c @ cosine, s @ sine]),
        np.hstack([(-s * omega) @ cosine, (c * omega) @ sine]),
    ])  # fmt: skip


class ExcitationSearch:
    """The search for a run of an arm of n joints.

    Coefficients have shape (n, c), a motion is an array of shape (3, m, n): position rad, velocity rad/s, acceleration
    rad/s² at m samples.

    Args:
        arm: every run starts from its home.
        options: of the plan.

    Attributes:
        workspace: obstacles of the runs.
        samples: the series' basis at the samples of the search, shape (3, m, c).
    """

    def __init__(self, arm: PlannedArm, options: ExcitationOptions) -> None:
        self.arm = arm
        self.options = options
        self.workspace = Workspace(arm.robot, options.walls, arm.home, options.clearance)
        count = _SAMPLES_PER_HARMONIC * options.harmonics
        self.samples = self.basis(np.linspace(0.0, options.period, count, endpoint=False))
        self._columns = StandardColumns(arm.rigid)
        self._leading = list(BaseGroups.of(self._columns).leading)

    def basis(self, time: Array) -> Array:
        """Return the `series_basis` of the runs at times, s, shape (m,)."""
        return series_basis(self.options.harmonics, self.options.period, time)

    def motion(self, coefficients: Array, basis: Array) -> Array:
        """Return the motion of a series with a basis."""
        motion = basis @ coefficients.T
        motion[0] += self.arm.home
        return motion

    def rows(self, motion: Array) -> Array:
        """Return the columns of p parameters along a motion, each joint's over its largest torque, shape (m, n, p).

        The parameters are the base parameters, and Coulomb and viscous torque of each friction element.
        """
        elements = self.arm.rigid.element_matrix
        inputs = (motion[1] @ elements.T)[:, None]
        friction = [np.tanh(inputs / _SMOOTH) * elements.T, inputs * elements.T]
        columns = np.concatenate(
            [self._columns.torque(*motion)[:, :, self._leading], *friction], axis=2
        )
        return columns / self.arm.robot.max_effort[:, None]

    def best(self, rng: np.random.Generator, step: Callable[[], object]) -> Array:
        """Return the coefficients of the best motion found; `step` is called after each of the search's steps."""
        best = self.random(rng).ravel()

        def show(xk: Array) -> None:  # noqa: ARG001 - SciPy's name for it
            step()

        for limit_cost in _LIMIT_COSTS:
            best = minimize(
                partial(self.cost, limit_cost=limit_cost),
                best,
                jac=True,
                method="L-BFGS-B",
                callback=show,
                options={
                    "maxiter": self.options.steps // len(_LIMIT_COSTS),
                    "maxls": _MAX_LINE_EVALUATIONS,
                },
            ).x
        return self.within(best.reshape(len(self.arm.home), -1))

    def random(self, rng: np.random.Generator) -> Array:
        """Return the best of random motions within ranges, speeds and accelerations of the joints, each by itself."""
        arm = self.arm
        room = np.minimum(arm.robot.upper - arm.home, arm.home - arm.robot.lower)
        share = self.options.share
        most = np.stack([
            np.maximum(room, _LEAST_ROOM), share * arm.robot.max_velocity, share * arm.limits.acceleration
        ])  # fmt: skip
        starts = []
        for _ in range(_RANDOM_STARTS):
            coefficients = rng.normal(size=(len(arm.home), self.samples.shape[2]))
            size = np.min(most / np.abs(self.samples @ coefficients.T).max(axis=1), axis=0)
            starts.append(coefficients * size[:, None])
        return min(starts, key=lambda coefficients: self.cost(coefficients.ravel())[0])

    def cost(self, x: Array, limit_cost: float = _LIMIT_COSTS[-1]) -> tuple[float, Array]:
        """Return the minimised cost and its derivative by the coefficients, shape (n c,).

        Args:
            x: coefficients, shape (n c,).
            limit_cost: cost of exceeding a limit by its whole size at one sample.
        """
        motion = self.motion(x.reshape(len(self.arm.home), -1), self.samples)
        rows = self.rows(motion)
        value, by_rows = _mean_deviation(rows)
        penalty = self._penalty(motion)
        nearness = np.zeros(len(rows))
        nearness[::_SPATIAL_STRIDE] = self.workspace.nearness(motion[0, ::_SPATIAL_STRIDE])
        near = np.flatnonzero(nearness)
        by_motion = np.empty_like(motion)
        for kind, joint in np.ndindex(3, motion.shape[2]):
            moved = motion.copy()
            moved[kind, :, joint] += _DIFFERENCE
            change = np.einsum("mnp,mnp->m", by_rows, self.rows(moved) - rows)
            change += limit_cost * (self._penalty(moved) - penalty)
            if kind == 0:
                change[near] += limit_cost * (
                    self.workspace.nearness(moved[0, near]) - nearness[near]
                )
            by_motion[kind, :, joint] = change / _DIFFERENCE
        gradient = np.einsum("kmn,kmc->nc", by_motion, self.samples)
        return value + limit_cost * float(np.sum(penalty + nearness)), np.asarray(gradient).ravel()

    def _excess(self, motion: Array) -> dict[str, Array]:
        """Return by how much of its size each limit is exceeded, negative within, shape (m, n) each."""
        shares = self.arm.shares(motion, self.arm.rigid.torque(*motion))
        return {
            name: share / (1.0 if name == "position" else self.options.share) - 1.0
            for name, share in shares.items()
        }

    def _penalty(self, motion: Array) -> Array:
        over = np.maximum(np.stack(list(self._excess(motion).values())) + _MARGIN, 0.0)
        return np.asarray(np.sum(over**2, axis=(0, 2)))

    def within(self, coefficients: Array) -> Array:
        """Return the motion, scaled down until it keeps all limits, also between the samples."""
        fine = self.basis(np.arange(0.0, self.options.period, _CHECK_STEP_S))
        size = 1.0
        while exceeded := self._exceeded(self.motion(size * coefficients, fine)):
            size *= _SHRINK
            if size < _LEAST_SIZE:
                raise IdentificationError(
                    f"no motion was found that keeps the limits; even of a small one {exceeded}; accepted: walls "
                    "farther away, less --clearance, more --share, another --home"
                )
        return size * coefficients

    def _exceeded(self, motion: Array) -> str:
        """Return in words which limit a motion exceeds; empty if none."""
        for name, excess in self._excess(motion).items():
            joint = int(np.argmax(excess.max(axis=0)))
            if excess[:, joint].max() > 0.0:
                return f"the {name} of {self.arm.names_of(name)[joint]} is {1.0 + excess.max():.0%} of what is allowed"
        room = self.workspace.distances(motion[0]).min(axis=0) - self.workspace.least
        return (
            f"{self.workspace.pairs[int(np.argmin(room))]} is too near"
            if np.any(room < 0.0)
            else ""
        )

    def run(self, coefficients: Array, name: str, tempo: float, periods: int) -> Experiment:
        """Return a run: periods of the series at a tempo, and a rest."""
        period = self.options.period / tempo
        motion = Motion(self.arm.home)
        count = math.ceil(2.0 * math.pi * self.options.harmonics * periods / _KNOT_ANGLE)
        # Knots lie on set-points.
        time = np.unique(np.round(np.linspace(0.0, period * periods, count + 1), 3))[1:]
        position, velocity, acceleration = self.motion(coefficients, self.basis(time * tempo))
        motion.follow(time, position, tempo * velocity, tempo**2 * acceleration)
        motion.rest(_REST_S)
        kind = Kind.VALIDATION if name == "validation" else Kind.EXCITATION
        return Experiment(name, kind, motion.points(self.arm.robot.joint_names), periods)


def _mean_deviation(rows: Array) -> tuple[float, Array]:
    """Return the mean logarithm of the parameters' deviations, -log det(information) / (2 p), and its derivative."""
    information = np.einsum("mnp,mnq->pq", rows, rows)
    size = np.sqrt(np.diag(information))
    p = len(size)
    scaled = information / np.outer(size, size) + _RIDGE * np.eye(p)
    value = -np.linalg.slogdet(scaled)[1] / (2.0 * p) - np.mean(np.log(size))
    return float(value), -rows @ (np.linalg.inv(scaled) / np.outer(size, size)) / p


def plan_excitation(
    arm: PlannedArm, options: ExcitationOptions, step: Callable[[], object] = lambda: None
) -> tuple[tuple[Experiment, ...], list[str]]:
    """Plan excitation runs for an arm, the last one for a validation. The same options give the same plan.

    Args:
        arm: of the runs.
        options: of the plan.
        step: called after each step of the search.

    Returns:
        The runs, and sentences on what they excite and what was left out.
    """
    search = ExcitationSearch(arm, options)
    best = search.best(np.random.default_rng(options.seed), step)
    plan = [
        search.run(best, f"excitation_{k}", tempo, periods)
        for k, (tempo, periods) in enumerate(options.tempos, 1)
    ]
    unseen = search.within(search.random(np.random.default_rng((options.seed, 1))))
    plan.append(search.run(unseen, "validation", _VALIDATION_TEMPO, 1))
    columns = np.concatenate(search.rows(search.motion(best, search.samples)))
    condition = np.linalg.cond(columns / np.linalg.norm(columns, axis=0))
    remarks = [*arm.remarks, f"condition number of {columns.shape[1]} columns: {condition:.3g}"]
    if search.workspace.meshes:
        remarks.append(
            f"meshes do not count for collisions: those of {listed(search.workspace.meshes)}"
        )
    if search.workspace.uncounted:
        remarks.append(
            f"too near to each other at home to count: {listed(search.workspace.uncounted)}"
        )
    return tuple(plan), remarks
