"""Instrumental variables against the bias of noisy closed-loop data (IDIM-IV).

Least squares take the columns for exact. In a closed loop the noise of the measured positions moves the arm, and is in
torque and columns alike: values are biased, however long the run. Janot, Vandanjon and Gautier (2014, "A generic
instrumental variable approach for industrial robot identification", IEEE Transactions on Control Systems Technology)
multiply the equations by the columns of a simulated motion instead, which shares the motion but not the noise, and
repeat that with the new values.

The test of Durbin, Wu and Hausman says whether the two differ by more than chance; if not, least squares are taken,
whose deviations are smaller. They are also taken where no set-points were recorded: a measured path in their place
keeps some of the noise, and where the model does not fit, the test answers to that as well.

The auxiliary simulation of instrumental variables: the identified arm follows what the real one was told to.

Its motion is like the recorded one and has nothing of its noise. The simulated controller is a stated one, for nobody
knows the real one: it compensates weight and velocity terms exactly, and answers an error of position e and velocity
de/dt with the acceleration omega^2 e + 2 omega de/dt. Friction it does not compensate, as in the real loop.

Whether the noise of a closed loop biases an identification: the identified model by instrumental variables, too.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import pinocchio as pin
from scipy.signal import bilinear, butter, lfilter, sosfiltfilt
from scipy.stats import norm

from rx90_common.base.arrays import Array
from rx90_common.base.errors import IdentificationError
from rx90_emulator.identification.excitation.filtering import FilteredRun
from rx90_emulator.identification.excitation.friction.estimates import FittedElement, FrictionSelection
from rx90_emulator.identification.excitation.friction.identify import linear_columns, with_linear
from rx90_emulator.identification.excitation.friction.law import LINEAR, steady_columns
from rx90_emulator.identification.excitation.least_squares import LinearFit, hac, solve
from rx90_emulator.identification.excitation.linear_parameters import Prior
from rx90_emulator.identification.excitation.problem import ExcitationProblem, Motion

_MAX_ROUNDS = 6
_CONVERGED = 0.2  # change of a value in its deviations
_LEVEL = 0.05  # of the test, over all parameters together
_RELEVANT_SD = 0.25  # deviations of the value itself: smaller differences are significant in long runs, and of no use
_WEAK_F = 10.0  # F statistic of the weakest direction, below which instruments are weak (Staiger and Stock 1997)


@dataclass(frozen=True, eq=False)
class InstrumentalComparison:
    """Least squares and instrumental variables.

    Attributes:
        least_squares: the one fit.
        instrumental: the other.
        differences: of the values, instrumental less least squares, in deviations of the difference, shape (q,).
        p_value: chance of the largest of them if least squares have no bias (Bonferroni's bound over q parameters).
        rounds: simulations until the values settled; each round's values are valid estimates.
        settled: whether they did.
        controller: of the simulation.
        biased: whether least squares differ by more than chance, and the instruments carry an answer: they are not
            weak, and the simulated arm followed recorded set-points, which hold nothing of the loop's noise.
        reason: which of both is taken, and why, one sentence.
    """

    least_squares: LinearFit
    instrumental: LinearFit
    differences: Array
    p_value: float
    rounds: int
    settled: bool
    controller: Controller
    biased: bool
    reason: str

    @property
    def taken(self) -> LinearFit:
        """Return the fit that the test speaks for."""
        return self.instrumental if self.biased else self.least_squares


def with_instruments(
    problem: ExcitationProblem,
    columns_of: Callable[[ExcitationProblem], tuple[tuple[str, ...], Array]],
    friction_of: Callable[[Array], Friction],
    *,
    robust: bool = True,
    prior: Prior | None = None,
) -> InstrumentalComparison:
    """Fit the torque by least squares and by instrumental variables, and compare both.

    Args:
        problem: r rows.
        columns_of: names and columns of q parameters, shape (r, q), of which the first b are those of the problem's
            base; called with the problem and with problems of simulated motions.
        friction_of: the elements' friction for q values, for the simulation.
        robust: as in `solve`, for both.
        prior: as in `solve`, for both.
    """
    names, columns = columns_of(problem)
    plain = solve(problem, columns, robust=robust, prior=prior)
    controller = Controller.of(problem.runs)
    motions = ideal_motions(problem, controller)
    fit, rounds, change = plain, 0, math.inf
    while True:
        instruments = columns_of(problem.moved(motions))[1]
        before, fit = fit, solve(problem, columns, robust=robust, prior=prior, instruments=instruments)
        change = _change(before, fit)
        if rounds == _MAX_ROUNDS or (rounds > 0 and change < _CONVERGED):
            break
        rounds += 1
        try:
            motions = simulated_motions(problem, fit.value[: len(problem.names)], friction_of(fit.value), controller)
        except IdentificationError:
            break
    settled = rounds > 0 and change < _CONVERGED
    strength = _strength(problem, columns, instruments, fit)
    differences = _differences(plain, fit)
    p_value = min(1.0, 2.0 * len(differences) * float(norm.sf(np.abs(differences).max())))
    matters = np.abs(fit.value - plain.value) > _RELEVANT_SD * plain.deviation
    differs = strength >= _WEAK_F and p_value < _LEVEL and bool(matters[np.abs(differences).argmax()])
    biased = differs and controller.recorded
    reason = _reason(names, differences, p_value, strength, biased=biased, differs=differs)
    return InstrumentalComparison(plain, fit, differences, p_value, rounds, settled, controller, biased, reason)


def _reason(
    names: tuple[str, ...], differences: Array, p_value: float, strength: float, *, biased: bool, differs: bool
) -> str:
    if strength < _WEAK_F:
        return f"least squares are taken: the instruments are weak (F = {strength:.2g}; from {_WEAK_F:g} on they count)"
    worst = int(np.argmax(np.abs(differences)))
    size = f"{abs(differences[worst]):.1f} deviations of the difference (p = {p_value:.2g})"
    if biased:
        return f"instrumental variables are taken: {names[worst]} by least squares is off by {size}"
    if differs:
        return (
            f"least squares are taken: {names[worst]} differs by {size}, but without recorded set-points a model that "
            "does not fit makes such a difference, too"
        )
    if p_value < _LEVEL:
        return f"least squares are taken: {names[worst]} differs by {size}, less than a quarter of its own deviation"
    return f"least squares are taken, for instrumental variables agree: {names[worst]} differs most, by {size}"


def _change(before: LinearFit, fit: LinearFit) -> float:
    """Return the largest change of a value, in its deviations."""
    known = fit.determined & (fit.deviation > 0.0)
    return float(np.max(np.abs(fit.value - before.value)[known] / fit.deviation[known], initial=0.0))


def _differences(plain: LinearFit, fit: LinearFit) -> Array:
    """Return the differences in their deviations, from the difference of both influences (robust Hausman test)."""
    pairs = zip(fit.influence, plain.influence, strict=True)
    deviation = np.sqrt(np.maximum(np.diag(hac([one - other for one, other in pairs])), 0.0))
    difference = fit.value - plain.value
    known = fit.determined & plain.determined & (deviation > 0.0)
    return np.asarray(np.where(known, difference, 0.0) / np.where(known, deviation, 1.0))


def _strength(problem: ExcitationProblem, columns: Array, instruments: Array, fit: LinearFit) -> float:
    """Return the F statistic of the weakest direction of the instruments.

    r c^2 / (1 - c^2) with the smallest canonical correlation c of both sets of columns, for r rows.
    """
    weight = np.sqrt(fit.weights)[:, None] / fit.sigma[problem.joint][:, None]
    bases = [np.linalg.qr(weight * values[:, fit.determined])[0] for values in (columns, instruments)]
    smallest = min(float(np.linalg.svd(bases[0].T @ bases[1], compute_uv=False)[-1]), 1.0 - 1e-12)
    return len(columns) * smallest**2 / (1.0 - smallest**2)


_MAX_STEP = 2e-3  # s, at most
_REST_SPEED = 1e-3  # rad/s: below, friction is taken as proportional to the velocity
_LOOP_BANDWIDTHS = (3.0, 5.0, 8.0, 12.0, 20.0, 30.0, 50.0)  # Hz, of the controllers that are tried
_PATH_BANDWIDTH_SHARE = 0.25  # bandwidth of a path that stands in for set-points, over that of the torque
_DIVERGED_SPEED = 1e3  # rad/s: no arm is
_MIN_MASS = 1e-6  # kg, of a link of the simulated arm: its other parameters are divided by it

Friction = Callable[[Array], Array]
"""Torque of each element at the elements' velocities, both of shape (n_el,)."""


@dataclass(frozen=True, eq=False)
class Controller:
    """What the simulated arm follows, and how.

    Attributes:
        bandwidth: omega / 2 pi, Hz.
        targets: of each run, positions, rad, shape (m, n).
        recorded: whether all targets are recorded set-points; else measured paths stand in.
    """

    bandwidth: float
    targets: tuple[Array, ...]
    recorded: bool

    @classmethod
    def of(cls, runs: Sequence[FilteredRun]) -> Controller:
        """Take the recorded set-points, where all runs have them, and the bandwidth that leads nearest to the path.

        Without set-points the measured path, low-passed at a quarter of the torque's bandwidth, stands in: most of the
        noise of velocities and accelerations lies above.
        """
        known = [run.reference for run in runs if run.reference is not None]
        recorded = len(known) == len(runs)
        targets = tuple(known) if recorded else tuple(_smooth(run) for run in runs)
        misses = [
            sum(float(np.sum((_followed(target, run.rate, loop) - run.position) ** 2)) for run, target in pairs)
            for loop in _LOOP_BANDWIDTHS
            for pairs in [list(zip(runs, targets, strict=True))]
        ]
        return cls(_LOOP_BANDWIDTHS[int(np.argmin(misses))], targets, recorded)

    def __str__(self) -> str:
        """Return what is followed, and how, in words."""
        what = "the recorded set-points" if self.recorded else "the measured path, low-passed (no set-points)"
        return f"the simulated arm follows {what} with a bandwidth of {self.bandwidth:g} Hz"


def _smooth(run: FilteredRun) -> Array:
    sections = butter(4, _PATH_BANDWIDTH_SHARE * run.bandwidths.torque, fs=run.rate, output="sos")
    return np.asarray(sosfiltfilt(sections, run.position, axis=0))


def _followed(target: Array, rate: float, loop: float) -> Array:
    """Return the path of an arm without friction."""
    omega = 2.0 * math.pi * loop
    top, bottom = bilinear([2.0 * omega, omega**2], [1.0, 2.0 * omega, omega**2], rate)
    return np.asarray(lfilter(top, bottom, target - target[0], axis=0) + target[0])


def ideal_motions(problem: ExcitationProblem, controller: Controller) -> list[Motion]:
    """Return the motion of an arm without friction in each run, which needs no parameters: a start."""
    result = []
    for run, target in zip(problem.runs, controller.targets, strict=True):
        path = _followed(target, run.rate, controller.bandwidth)
        velocity = np.gradient(path, run.time, axis=0)
        result.append((path, velocity, np.gradient(velocity, run.time, axis=0)))
    return result


def simulated_motions(
    problem: ExcitationProblem, parameters: Array, friction: Friction, controller: Controller
) -> list[Motion]:
    """Return the motion of the simulated arm in each run, at the run's samples.

    Args:
        problem: with the arm and the runs.
        parameters: of the base, shape (b,).
        friction: of the elements.
        controller: of the simulation.

    Raises:
        IdentificationError: if the simulation diverges, as with inertias that no arm has.
    """
    model, rotor = _arm(problem, parameters)
    elements = problem.arm.element_matrix
    return [
        _simulated(model, rotor, elements, friction, (target, run, controller.bandwidth))
        for run, target in zip(problem.runs, controller.targets, strict=True)
    ]


def _arm(problem: ExcitationProblem, parameters: Array) -> tuple[Any, Array]:
    """Return a model that moves as the base parameters say, and the rotors' share of its mass matrix.

    Standard parameters are those of the description, the leading ones of each group corrected such that the group has
    the identified value. Single links need not be possible; the mass matrix is that of the base parameters.
    """
    base, n = problem.base, len(problem.arm.names)
    standard = problem.columns.values()
    standard[list(base.leading)] += parameters - base.combination @ standard
    model = problem.arm.model.copy()
    for k, values in enumerate(standard[: 10 * n].reshape(n, 10), 1):
        values[0] = max(values[0], _MIN_MASS)
        model.inertias[k] = pin.Inertia.FromDynamicParameters(values)
    turns = problem.arm.coupling
    return model, turns.T @ np.diag(standard[10 * n : 11 * n]) @ turns


def _simulated(
    model: Any, rotor: Array, elements: Array, friction: Friction, task: tuple[Array, FilteredRun, float]
) -> Motion:
    """Return position, velocity and acceleration of one run.

    The step is implicit in friction and control, so that neither limits it:
    M ((1 + 2 w h + w^2 h^2) v' - v - h (w^2 (q_r - q) + 2 w v_r)) = -h E^T D E v', D the friction over the velocity.
    """
    target, run, bandwidth = task
    omega = 2.0 * math.pi * bandwidth
    count = math.ceil((run.time[-1] - run.time[0]) / _MAX_STEP)
    grid = np.linspace(run.time[0], run.time[-1], count + 1)
    h = float(grid[1] - grid[0])
    path = np.column_stack([np.interp(grid, run.time, column) for column in target.T])
    speed = np.gradient(path, h, axis=0)
    stiff = 1.0 + 2.0 * omega * h + (omega * h) ** 2
    data = model.createData()
    q, v = path[0].copy(), speed[0].copy()
    result = np.zeros((3, count + 1, len(q)))
    result[0, 0], result[1, 0] = q, v
    for k in range(1, count + 1):
        mass = _mass(model, data, q) + rotor
        inputs = elements @ v
        inputs = np.where(np.abs(inputs) < _REST_SPEED, np.where(inputs < 0.0, -_REST_SPEED, _REST_SPEED), inputs)
        damping = (elements.T * (friction(inputs) / inputs)) @ elements
        wanted = v + h * (omega**2 * (path[k] - q) + 2.0 * omega * speed[k])
        after = np.linalg.solve(stiff * mass + h * damping, mass @ wanted)
        if not np.abs(after).max() < _DIVERGED_SPEED:
            raise IdentificationError("the simulation of the identified arm diverges; accepted: positive inertias")
        q = q + h * after
        result[:, k] = q, after, (after - v) / h
        v = after
    at_samples = [np.column_stack([np.interp(run.time, grid, c) for c in values.T]) for values in result]
    return at_samples[0], at_samples[1], at_samples[2]


def _mass(model: Any, data: Any, position: Array) -> Array:
    """Return the links' mass matrix."""
    place = position if model.nq == model.nv else pin.integrate(model, pin.neutral(model), position)
    upper = np.triu(pin.crba(model, data, place))
    return np.asarray(upper + np.triu(upper, 1).T)


_TABLE_STEP = 2e-3  # rad/s, of the table of the simulated friction
_TABLE_END = 30.0  # rad/s, where it ends
_NO_FRICTION = "instrumental variables give an element friction that is not positive"


def check_closed_loop(
    problem: ExcitationProblem, friction: FrictionSelection, prior: Prior | None = None
) -> tuple[InstrumentalComparison, FrictionSelection]:
    """Compare least squares with instrumental variables, all linear parameters free and the friction's shapes kept.

    Args:
        problem: the rows.
        friction: that was selected on them.
        prior: of the base parameters.

    Returns:
        The comparison, and the friction with the values that it speaks for.
    """
    size = len(problem.names)

    def columns_of(other: ExcitationProblem) -> tuple[tuple[str, ...], Array]:
        names, columns = linear_columns(friction, other)
        return other.names + names, np.hstack([other.regressor, columns])

    def law_of(values: Array) -> Callable[[Array], Array]:
        return _steady_law(friction.fitted, linear, values[size:])

    linear = linear_columns(friction, problem)[0]
    found = with_instruments(problem, columns_of, law_of, prior=prior)
    if found.biased and (found.instrumental.value[size:] <= 0.0).any():
        found = replace(found, biased=False, reason=f"least squares are taken: {_NO_FRICTION}")
    if found.biased:
        friction = with_linear(friction, problem, problem.names + linear, found.instrumental)
    return found, friction


def remark(comparison: InstrumentalComparison) -> str:
    """Return in one sentence what the comparison says, and which values are reported."""
    which = "instrumental variables" if comparison.biased else "least squares"
    return f"{comparison.reason}; {comparison.controller}; all values written are by {which}"


def _steady_law(fitted: Sequence[FittedElement], names: Sequence[str], values: Array) -> Callable[[Array], Array]:
    """Return the elements' sliding friction for values of their linear parameters; bristles are left out.

    A simulation asks for it at every step: it is read off a table of speeds.
    """
    known = dict(zip(names, values.tolist(), strict=True))
    linear = np.array([[known.get(f"{one.element}.{name}", 0.0) for name in LINEAR] for one in fitted])
    speeds = np.arange(0.0, _TABLE_END, _TABLE_STEP) + 1e-9  # just above rest, where the sign counts already
    pairs = zip(fitted, linear, strict=True)
    table = np.array([steady_columns(one.shape, speeds)[0] @ row for one, row in pairs])
    element = np.arange(len(fitted))

    def law(velocity: Array) -> Array:
        place = np.minimum(np.abs(velocity) / _TABLE_STEP, len(speeds) - 1.001)
        low = place.astype(np.intp)
        share = place - low
        torque = (1.0 - share) * table[element, low] + share * table[element, low + 1]
        return np.asarray(np.sign(velocity) * torque)

    return law
