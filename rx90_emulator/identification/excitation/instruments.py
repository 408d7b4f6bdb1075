"""Instrumental variables against the bias of noisy closed-loop data (IDIM-IV).

Least squares treat the columns as exact. In a closed loop the noise of the measured positions moves the arm, and is
contained in torque and columns alike: values are biased, however long the run. Janot, Vandanjon and Gautier (2014, "A
generic instrumental variable approach for industrial robot identification", IEEE Transactions on Control Systems
Technology) multiply the equations by the columns of a simulated motion instead, which has the same motion but not the
noise, and repeat that with the new values.

The test of Durbin, Wu and Hausman decides whether the two differ by more than chance; if not, least squares are used,
whose deviations are smaller. They are also used if no set-points were recorded: a measured path in their place contains
some of the noise, and where the model does not fit, the test reacts to that as well.

In the simulation the identified arm follows the commands of the real one. The simulated controller is an assumed one,
because the real one is not known: it compensates weight and velocity terms exactly, and answers an error of position e
and velocity de/dt with the acceleration omega^2 e + 2 omega de/dt. It does not compensate friction, as in the real
loop.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import pinocchio as pin
from scipy.signal import bilinear, lfilter
from scipy.stats import norm

from rx90_common.base.arrays import Array
from rx90_common.base.errors import IdentificationError
from rx90_emulator.identification.arm import RigidArm
from rx90_emulator.identification.excitation.filtering import FilteredRun
from rx90_emulator.identification.excitation.fit import LinearFit, hac, solve
from rx90_emulator.identification.excitation.friction import (
    FrictionSelection,
    linear_columns,
    steady_columns,
    with_linear,
)
from rx90_emulator.identification.excitation.law import LINEAR
from rx90_emulator.identification.excitation.problem import ExcitationProblem, Motion, Prior

_MAX_ROUNDS = 6
_CONVERGED = 0.2  # change of a value in its deviations
_LEVEL = 0.05  # of the test, over all parameters together
_RELEVANT_SD = 0.25  # least relevant difference in deviations: in long runs smaller ones are significant, too
_WEAK_F = 10.0  # F statistic of the weakest direction, below which instruments are weak (Staiger and Stock 1997)


@dataclass(frozen=True, eq=False)
class InstrumentalComparison:
    """Least squares and instrumental variables.

    Attributes:
        least_squares: the fit by least squares.
        instrumental: the fit by instrumental variables.
        biased: whether least squares differ by more than chance, and the instruments are trustworthy: they are not
            weak, the simulated arm followed recorded set-points, which contain no noise of the loop, and they give each
            element positive friction.
        reason: which of both is used, and why, one sentence.
        controller: in words, the controller and the reference of the simulated arm.
    """

    least_squares: LinearFit
    instrumental: LinearFit
    biased: bool
    reason: str
    controller: str

    @property
    def remark(self) -> str:
        """Return in one sentence the result of the comparison, and which values are reported."""
        which = "instrumental variables" if self.biased else "least squares"
        return f"{self.reason}; {self.controller}; all values written are by {which}"


def check_closed_loop(
    problem: ExcitationProblem, friction: FrictionSelection, prior: Prior | None = None
) -> tuple[InstrumentalComparison, FrictionSelection]:
    """Compare least squares with instrumental variables for all linear parameters, with fixed shapes of the friction.

    Args:
        problem: r rows.
        friction: selected on these rows.
        prior: of the base parameters.

    Returns:
        The comparison, and the friction with the values of the fit that is used.
    """
    size, (linear, own) = len(problem.names), linear_columns(friction, problem)
    names, columns = problem.names + linear, np.hstack([problem.regressor, own])
    plain = solve(problem, columns, prior=prior)
    known = [run.reference for run in problem.runs if run.reference is not None]
    recorded = len(known) == len(problem.runs)
    # Most of the noise of velocities and accelerations lies above the band of a path that replaces set-points.
    paths = [run.smooth(run.position, _PATH_BANDWIDTH_SHARE * run.bandwidths.torque) for run in problem.runs]
    targets = known if recorded else paths
    pairs = list(zip(targets, problem.runs, strict=True))
    # The controller whose motion is nearest to the path.
    bandwidth = min(_LOOP_BANDWIDTHS, key=lambda loop: sum(
        float(np.sum((_followed(target, run.rate, loop) - run.position) ** 2)) for target, run in pairs))  # fmt: skip
    motions = [_ideal(target, run, bandwidth) for target, run in pairs]
    fit, rounds = plain, 0
    while True:
        other = problem.moved(motions)
        instruments = np.hstack([other.regressor, linear_columns(friction, other)[1]])
        before, fit = fit, solve(problem, columns, prior=prior, instruments=instruments)
        determined = fit.determined & (fit.deviation > 0.0)
        change = np.max(np.abs(fit.value - before.value)[determined] / fit.deviation[determined], initial=0.0)
        if rounds == _MAX_ROUNDS or (rounds > 0 and change < _CONVERGED):
            break
        rounds += 1
        law = _steady_law(friction, linear, fit.value[size:])
        try:
            arm = _arm(problem, fit.value[:size])
            motions = [_simulated(arm, law, target, run, bandwidth) for target, run in pairs]
        except IdentificationError:
            break
    biased, reason = _hausman_test(names, plain, fit, _strength(problem, columns, instruments, fit), recorded=recorded)
    if biased and (fit.value[size:] <= 0.0).any():
        biased = False
        reason = "least squares are taken: instrumental variables give an element friction that is not positive"
    what = "the recorded set-points" if recorded else "the measured path, low-passed (no set-points)"
    controller = f"the simulated arm follows {what} with a bandwidth of {bandwidth:g} Hz"
    found = InstrumentalComparison(plain, fit, biased, reason, controller)
    return found, with_linear(friction, problem, names, fit) if biased else friction


def _hausman_test(
    names: tuple[str, ...], plain: LinearFit, fit: LinearFit, strength: float, *, recorded: bool
) -> tuple[bool, str]:
    """Return whether least squares are biased, and which of both fits is used and why (robust Hausman test).

    The deviation of the difference follows from the difference of both influences; the largest ratio of a difference to
    its deviation is compared with Bonferroni's bound over all parameters.
    """
    if strength < _WEAK_F:
        reason = f"the instruments are weak (F = {strength:.2g}; from {_WEAK_F:g} on they count)"
        return False, f"least squares are taken: {reason}"
    pairs = zip(fit.influence, plain.influence, strict=True)
    deviation = np.sqrt(np.maximum(np.diag(hac([one - other for one, other in pairs])), 0.0))
    known = fit.determined & plain.determined & (deviation > 0.0)
    sizes = np.abs(np.where(known, fit.value - plain.value, 0.0) / np.where(known, deviation, 1.0))
    worst = int(np.argmax(sizes))
    p_value = min(1.0, 2.0 * len(sizes) * float(norm.sf(sizes[worst])))
    size = f"{sizes[worst]:.1f} deviations of the difference (p = {p_value:.2g})"
    if p_value >= _LEVEL:
        agree = f"instrumental variables agree: {names[worst]} differs most, by {size}"
        return False, f"least squares are taken, for {agree}"
    if abs(fit.value[worst] - plain.value[worst]) <= _RELEVANT_SD * plain.deviation[worst]:
        less = "less than a quarter of its own deviation"
        return False, f"least squares are taken: {names[worst]} differs by {size}, {less}"
    if not recorded:
        return False, (
            f"least squares are taken: {names[worst]} differs by {size}, but without recorded set-points a model that "
            "does not fit makes such a difference, too"
        )
    return True, f"instrumental variables are taken: {names[worst]} by least squares is off by {size}"


def _strength(problem: ExcitationProblem, columns: Array, instruments: Array, fit: LinearFit) -> float:
    """Return the F statistic of the weakest direction of the instruments.

    r c^2 / (1 - c^2) with the smallest canonical correlation c of both sets of columns, for r rows.
    """
    weight = np.sqrt(fit.weights)[:, None] / fit.sigma[problem.joint][:, None]
    bases = [np.linalg.qr(weight * values[:, fit.determined])[0] for values in (columns, instruments)]
    smallest = min(float(np.linalg.svd(bases[0].T @ bases[1], compute_uv=False)[-1]), 1.0 - 1e-12)
    return len(columns) * smallest**2 / (1.0 - smallest**2)


_MAX_STEP = 2e-3  # s
_REST_SPEED = 1e-3  # rad/s, below which friction is taken as proportional to the velocity
_LOOP_BANDWIDTHS = (3.0, 5.0, 8.0, 12.0, 20.0, 30.0, 50.0)  # Hz, of the controllers that are tried
_PATH_BANDWIDTH_SHARE = 0.25  # bandwidth of a path that replaces set-points, over that of the torque
_DIVERGED_SPEED = 1e3  # rad/s: no arm is so fast
_MIN_MASS = 1e-6  # kg, of a link of the simulated arm: its other parameters are divided by it
_TABLE_STEP = 2e-3  # rad/s, of the table of the simulated friction
_TABLE_END = 30.0  # rad/s, where it ends

Friction = Callable[[Array], Array]
"""Torque of each element at the elements' velocities, both of shape (n_el,)."""


def _followed(target: Array, rate: float, loop: float) -> Array:
    """Return the path of an arm without friction."""
    omega = 2.0 * math.pi * loop
    top, bottom = bilinear([2.0 * omega, omega**2], [1.0, 2.0 * omega, omega**2], rate)
    return np.asarray(lfilter(top, bottom, target - target[0], axis=0) + target[0])


def _ideal(target: Array, run: FilteredRun, bandwidth: float) -> Motion:
    """Return the motion of an arm without friction in a run: a start that needs no parameters."""
    path = _followed(target, run.rate, bandwidth)
    velocity = np.gradient(path, run.time, axis=0)
    return path, velocity, np.gradient(velocity, run.time, axis=0)


def _steady_law(friction: FrictionSelection, names: tuple[str, ...], values: Array) -> Friction:
    """Return the elements' sliding friction for values of their linear parameters, without bristles.

    A simulation evaluates it at every step, so it is interpolated in a table of speeds.
    """
    known = dict(zip(names, values.tolist(), strict=True))
    speeds = np.arange(0.0, _TABLE_END, _TABLE_STEP) + 1e-9  # just above rest, where the sign is defined
    table = np.array([
        steady_columns(one.shape, speeds)[0] @ [known.get(f"{one.element}.{name}", 0.0) for name in LINEAR]
        for one in friction.fitted
    ])  # fmt: skip
    element = np.arange(len(table))

    def law(velocity: Array) -> Array:
        place = np.minimum(np.abs(velocity) / _TABLE_STEP, len(speeds) - 1.001)
        low = place.astype(np.intp)
        share = place - low
        torque = (1.0 - share) * table[element, low] + share * table[element, low + 1]
        return np.asarray(np.sign(velocity) * torque)

    return law


def _arm(problem: ExcitationProblem, parameters: Array) -> RigidArm:
    """Return an arm whose torques are those of the base parameters.

    Standard parameters are those of the description, with the leading one of each group corrected such that the group
    has the identified value. Single links need not be physical; the mass matrix is that of the base parameters.
    """
    base, n = problem.base, len(problem.arm.names)
    standard = problem.columns.values()
    standard[list(base.leading)] += parameters - base.combination @ standard
    masses = standard[: 10 * n : 10]
    np.maximum(masses, _MIN_MASS, out=masses)
    return problem.arm.with_bodies(standard[: 10 * n], standard[10 * n : 11 * n])


def _simulated(arm: RigidArm, friction: Friction, target: Array, run: FilteredRun, bandwidth: float) -> Motion:
    """Return position, velocity and acceleration of one run, at its samples.

    The step is implicit in friction and control, so that neither limits its length:
    M ((1 + 2 w h + w^2 h^2) v' - v - h (w^2 (q_r - q) + 2 w v_r)) = -h E^T D E v', D the friction over the velocity.

    Raises:
        IdentificationError: if the simulation diverges, as with inertias that no arm has.
    """
    model, elements, omega = arm.model, arm.element_matrix, 2.0 * math.pi * bandwidth
    count = math.ceil((run.time[-1] - run.time[0]) / _MAX_STEP)
    grid = np.linspace(run.time[0], run.time[-1], count + 1)
    h = float(grid[1] - grid[0])
    path = np.column_stack([np.interp(grid, run.time, column) for column in target.T])
    speed = np.gradient(path, h, axis=0)
    stiff = 1.0 + 2.0 * omega * h + (omega * h) ** 2
    data, turning = model.createData(), model.nq == model.nv
    q, v = path[0].copy(), speed[0].copy()
    result = np.zeros((3, count + 1, len(q)))
    result[0, 0], result[1, 0] = q, v
    for k in range(1, count + 1):
        upper = np.triu(pin.crba(model, data, q if turning else pin.integrate(model, pin.neutral(model), q)))
        mass = upper + np.triu(upper, 1).T + arm.rotor
        inputs = elements @ v
        inputs = np.where(np.abs(inputs) < _REST_SPEED, np.where(inputs < 0.0, -_REST_SPEED, _REST_SPEED), inputs)
        damping = (elements.T * (friction(inputs) / inputs)) @ elements
        reference = v + h * (omega**2 * (path[k] - q) + 2.0 * omega * speed[k])
        after = np.linalg.solve(stiff * mass + h * damping, mass @ reference)
        if not np.abs(after).max() < _DIVERGED_SPEED:
            raise IdentificationError("the simulation of the identified arm diverges; accepted: positive inertias")
        q = q + h * after
        result[:, k] = q, after, (after - v) / h
        v = after
    position, velocity, acceleration = (
        np.column_stack([np.interp(run.time, grid, column) for column in values.T]) for values in result
    )
    return position, velocity, acceleration
