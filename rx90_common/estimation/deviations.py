"""Covariance of a fit's parameters that holds for errors of any kind within blocks: a cluster-robust sandwich.

Residuals are seldom white noise: what a model lacks (ripple, load, temperature) lasts for some time or returns with the
motion. So the rows are split into blocks whose errors are independent of each other (plateaus, stretches of time, runs,
ramps), and the covariance is that of the blocks' contributions to the estimate (Liang and Zeger 1986),

    H sum_b (T_b^T r_b) (T_b^T r_b)^T H,   H = (T^T T)^-1,

with the weighted derivatives T_b and residuals r_b of block b. Residuals are smaller than the errors that they stand
for, most of all in blocks that determine much: those of a block are multiplied by (I - T_b H T_b^T)^-1 first, which
makes them the errors of the fit to all other blocks (CR3, the jackknife: Bell and McCaffrey 2002). Their root in its
place (CR2) is unbiased for white noise, but its intervals of 95 % hold 90 to 93 % of values that few blocks determine,
such as the viscous torque. The loss of a row that lies far out grows linearly, so it has no part in T^T T. Few blocks
leave the covariance itself uncertain: deviations are widened from a normal distribution's 95 % quantile to Student's.

A part of a law that was left out is not known to be absent: what it would explain stands in the other parameters. So
their deviations are those of the law with all parts that were tried, linearised at the chosen values.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.stats import norm, t

from rx90_common.base.arrays import Array, Mask
from rx90_common.estimation.elements import FrictionRows, fitted_values
from rx90_common.estimation.fit import Fit
from rx90_common.estimation.law import Law, Part

LEVEL = 0.95
"""Of the intervals that `deviation` times the normal quantile, 1.96, gives."""
LEAST_RESIDUAL_SHARE = 0.05
"""Least eigenvalue of I - T_b H T_b^T: below it the block alone determines a parameter."""
RANK = 1e-12
"""Eigenvalue of the scaled information over the largest, below which a direction is not determined."""
MOST_UNDETERMINED = 1e-6
"""Squared share of undetermined directions in a parameter, above which it is not determined."""

USUAL_RISE = 0.5
"""Deviation of a rise that was left out, over tau_c: published static torques are one to two times Coulomb's."""
USUAL_EXPONENT = 0.5
"""Deviation of log alpha where it was left out: published exponents lie between 0.5 and 1.5."""


@dataclass(frozen=True, eq=False)
class Deviations:
    """How well a fit knows its parameters: the q of x, then the p linear ones.

    Attributes:
        covariance: shape (q + p, q + p); 0 in rows and columns of parameters that are at a bound or not determined.
        determined: whether the rows determine a parameter that is not at a bound, shape (q + p,).
    """

    covariance: Array
    determined: Mask

    @property
    def deviation(self) -> Array:
        """Return standard deviations, shape (q + p,): infinite where a parameter is not determined."""
        return np.where(self.determined, np.sqrt(np.diag(self.covariance)), np.inf)


def deviations(result: Fit) -> Deviations:
    """Return the deviations of a fit's parameters, blocks of rows as in its problem."""
    problem = result.problem
    columns, prior, scale = result.scaled()
    score = np.sqrt(result.weight) * result.residual
    inner = np.where(result.outlying[:, None], 0.0, columns)
    information = inner.T @ inner + prior
    values, vectors = np.linalg.eigh(information)
    known = values > RANK * max(values[-1], 1.0)
    determined = np.sum(vectors[:, ~known] ** 2, axis=1) < MOST_UNDETERMINED
    inverse_root = vectors[:, known] / np.sqrt(values[known])  # H = inverse_root @ inverse_root.T
    middle = inverse_root.T @ prior @ inverse_root
    blocks = np.zeros(len(scale))
    for number in np.unique(problem.block):
        rows = problem.block == number
        part = inner[rows] @ inverse_root
        share, directions = np.linalg.eigh(part.T @ part)
        left = np.maximum(1.0 - share, LEAST_RESIDUAL_SHARE)
        pull = inverse_root.T @ (columns[rows].T @ score[rows])
        pull = directions @ (directions.T @ pull / left)
        middle += np.outer(pull, pull)
        blocks += np.any(columns[rows] != 0.0, axis=0)
    wider = np.array([student_factor(count - 1.0) if count else 1.0 for count in blocks]) / scale
    covariance = inverse_root @ middle @ inverse_root.T * np.outer(wider, wider)
    covariance[~determined] = 0.0
    covariance[:, ~determined] = 0.0
    return Deviations(covariance, determined)


def law_deviations(
    rows: FrictionRows, laws: Sequence[Law], result: Fit, tried: Iterable[Part]
) -> Deviations:
    """Return the deviations of a fit's parameters, with the doubt about parts that were tried and left out.

    Those parts are added where they change nothing: a rise of 0 at the middle of the speeds, exponents of 1. A bristle
    that was left out has no such place. A torque that ends at its bound 0 is not determined, but might be some: it has
    a covariance here.

    Args:
        rows: the equations.
        laws: the chosen ones, with one tau_c for both directions.
        result: their fit.
        tried: parts.
    """
    richest = [replace(law, parts=law.parts | (frozenset(tried) - {Part.BRISTLE})) for law in laws]
    values = []
    chosen = []
    spread = []
    for law, element, known in zip(
        richest, rows.elements, fitted_values(laws, result.x), strict=True
    ):
        middle = np.mean(law.bounds(element.speeds), axis=0)
        usual = {"rise": USUAL_RISE * known["tau_c"] or math.inf, "alpha": USUAL_EXPONENT}
        for name, half in zip(law.names, middle.tolist(), strict=True):
            values.append(known.get(name, half if name == "omega_s" else 0.0))
            chosen.append(name in known)
            spread.append(math.inf if name in known else usual.get(name, math.inf))
    x = np.array(values)
    problem = replace(rows.problem(richest, x), spread=np.array(spread))
    slopes = problem.model(x)[1]
    whole = deviations(
        result._replace(
            problem=problem, x=x, slopes=slopes, at_bound=np.zeros(len(x), dtype=np.bool_)
        )
    )
    places = np.flatnonzero(chosen + [True] * len(result.linear))
    determined = whole.determined[places]
    determined[: len(result.x)] &= ~result.at_bound
    return Deviations(whole.covariance[np.ix_(places, places)], determined)


def student_factor(freedom: float) -> float:
    """Return Student's 97.5 % quantile over the normal one, for at least one degree of freedom."""
    tail = 0.5 + 0.5 * LEVEL
    return float(t.ppf(tail, max(freedom, 1.0)) / norm.ppf(tail))
