"""Instrumental variables against the bias of noisy closed-loop data (IDIM-IV).

Least squares take the columns for exact. In a closed loop the noise of the measured positions moves the arm, and is in
torque and columns alike: values are biased, however long the run. Janot, Vandanjon and Gautier (2014, "A generic
instrumental variable approach for industrial robot identification", IEEE Transactions on Control Systems Technology)
multiply the equations by the columns of a simulated motion instead, which shares the motion but not the noise, and
repeat that with the new values.

The test of Durbin, Wu and Hausman says whether the two differ by more than chance; if not, least squares are taken,
whose deviations are smaller. They are also taken where no set-points were recorded: a measured path in their place
keeps some of the noise, and where the model does not fit, the test answers to that as well.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy.stats import norm

from rx90_common.base.arrays import Array
from rx90_common.base.errors import IdentificationError
from rx90_emulator.identification.excitation.auxiliary import Controller, Friction, ideal_motions, simulated_motions
from rx90_emulator.identification.excitation.covariance import hac
from rx90_emulator.identification.excitation.least_squares import LinearFit, solve
from rx90_emulator.identification.excitation.prior import Prior
from rx90_emulator.identification.excitation.problem import ExcitationProblem

_ROUNDS = 6
_CONVERGED = 0.2  # change of a value in its deviations
_LEVEL = 0.05  # of the test, over all parameters together
_MATTERS = 0.25  # deviations of the value itself: smaller differences are significant in long runs, and of no use
_WEAK = 10.0  # F statistic of the weakest direction, below which instruments are weak (Staiger and Stock 1997)


@dataclass(frozen=True, eq=False)
class InstrumentalComparison:
    """Least squares and instrumental variables.

    Attributes:
        least_squares: the one fit.
        instrumental: the other.
        differences: of the values, instrumental less least squares, in deviations of the difference, shape (q,).
        p_value: chance of the largest of them if least squares have no bias (Bonferroni's bound over q parameters).
        strength: F statistic of the weakest direction of the instruments: r c^2 / (1 - c^2) with their smallest
            canonical correlation c with the columns, for r rows.
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
    strength: float
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
        if rounds == _ROUNDS or (rounds > 0 and change < _CONVERGED):
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
    matters = np.abs(fit.value - plain.value) > _MATTERS * plain.deviation
    differs = strength >= _WEAK and p_value < _LEVEL and bool(matters[np.abs(differences).argmax()])
    biased = differs and controller.recorded
    reason = _reason(names, differences, p_value, strength, biased=biased, differs=differs)
    return InstrumentalComparison(
        plain, fit, differences, p_value, strength, rounds, settled, controller, biased, reason
    )


def _reason(
    names: tuple[str, ...], differences: Array, p_value: float, strength: float, *, biased: bool, differs: bool
) -> str:
    if strength < _WEAK:
        return f"least squares are taken: the instruments are weak (F = {strength:.2g}; from {_WEAK:g} on they count)"
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
    """Return the F statistic of the smallest canonical correlation of both sets of columns."""
    weight = np.sqrt(fit.weights)[:, None] / fit.sigma[problem.joint][:, None]
    bases = [np.linalg.qr(weight * values[:, fit.determined])[0] for values in (columns, instruments)]
    smallest = min(float(np.linalg.svd(bases[0].T @ bases[1], compute_uv=False)[-1]), 1.0 - 1e-12)
    return len(columns) * smallest**2 / (1.0 - smallest**2)
