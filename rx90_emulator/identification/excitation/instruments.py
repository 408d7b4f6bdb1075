"""Instrumental variables against the bias of noisy closed-loop data (IDIM-IV).

Least squares take the columns for exact. In a closed loop the noise of the measured positions moves the arm, and is in
torque and columns alike: values are biased, however long the run. Janot, Vandanjon and Gautier (2014, "A generic
instrumental variable approach for industrial robot identification", IEEE Transactions on Control Systems Technology)
multiply the equations by the columns of a simulated motion instead, which shares the motion but not the noise, and
repeat that with the new values.

The test of Durbin, Wu and Hausman says whether the two differ by more than chance; if not, least squares are taken,
whose deviations are smaller.
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

_ROUNDS = 10
_CONVERGED = 0.05  # change of a value in its deviations
_LEVEL = 0.05  # of the test, over all parameters together
_WEAK = 0.1  # smallest canonical correlation of instruments and columns that still determines values


@dataclass(frozen=True, eq=False)
class InstrumentalComparison:
    """Least squares and instrumental variables.

    Attributes:
        least_squares: the one fit.
        instrumental: the other.
        differences: of the values, instrumental less least squares, in deviations of the difference, shape (q,).
        p_value: chance of the largest of them if least squares have no bias (Bonferroni's bound over q parameters).
        strength: smallest canonical correlation of instruments and columns.
        rounds: simulations until the values settled.
        settled: whether they did.
        controller: of the simulation.
        biased: whether least squares differ by more than chance, and the instruments carry an answer.
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
    worst = int(np.argmax(np.abs(differences)))
    p_value = min(1.0, 2.0 * len(differences) * float(norm.sf(abs(differences[worst]))))
    biased, reason = _verdict(names[worst], float(differences[worst]), p_value, strength, settled=settled)
    return InstrumentalComparison(
        plain, fit, differences, p_value, strength, rounds, settled, controller, biased, reason
    )


def _verdict(name: str, difference: float, p_value: float, strength: float, *, settled: bool) -> tuple[bool, str]:
    if strength < _WEAK:
        return False, f"least squares are taken: the instruments tell too little (correlation {strength:.2g})"
    if not settled:
        return False, f"least squares are taken: instrumental variables did not settle in {_ROUNDS} rounds"
    found = f"{name} differs most, by {abs(difference):.1f} deviations of the difference (p = {p_value:.2g})"
    if p_value < _LEVEL:
        return True, f"instrumental variables are taken, for least squares are biased: {found}"
    return False, f"least squares are taken, for instrumental variables agree with them: {found}"


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
    """Return the smallest canonical correlation of both sets of columns, over what the rows determine."""
    weight = np.sqrt(fit.weights)[:, None] / fit.sigma[problem.joint][:, None]
    bases = [np.linalg.qr(weight * values[:, fit.determined])[0] for values in (columns, instruments)]
    return float(np.linalg.svd(bases[0].T @ bases[1], compute_uv=False)[-1])
