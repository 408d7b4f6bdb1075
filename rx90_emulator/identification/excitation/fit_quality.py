"""How well a fit explains the torque at each speed, and what the runs did not determine."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from rx90_common.base.arrays import Array
from rx90_emulator.identification.excitation.covariance import time_blocks
from rx90_emulator.identification.excitation.least_squares import LinearFit
from rx90_emulator.identification.excitation.problem import ExcitationProblem

_BINS = 12  # of speed
_FEWEST = 5  # rows in a bin


@dataclass(frozen=True, eq=False)
class SpeedResiduals:
    """Mean residuals of an element's joint at several speeds of the element, k bins.

    Attributes:
        element: its name.
        velocity: mean in each bin, rad/s, shape (k,).
        residual: mean, Nm, shape (k,).
        deviation: of that mean, from the means of blocks of time, Nm, shape (k,); NaN in a bin of one block.
    """

    element: str
    velocity: Array
    residual: Array
    deviation: Array


def residuals_by_speed(problem: ExcitationProblem, fit: LinearFit) -> tuple[SpeedResiduals, ...]:
    """Return mean residuals over the speed of each element: what its friction curve does not say.

    The joint is the last on which the element acts.
    """
    block = time_blocks(problem)
    result = []
    for e, (name, acts) in enumerate(zip(problem.arm.element_names, problem.arm.element_matrix != 0.0, strict=True)):
        rows = np.flatnonzero(problem.joint == np.flatnonzero(acts)[-1])
        velocity = problem.velocity[rows, e]
        edges = np.quantile(velocity, np.linspace(0.0, 1.0, _BINS + 1)) if len(rows) else np.zeros(_BINS + 1)
        number = np.clip(np.searchsorted(edges, velocity, "right") - 1, 0, _BINS - 1)
        bins = [rows[number == k] for k in range(_BINS) if np.count_nonzero(number == k) >= _FEWEST]
        result.append(
            SpeedResiduals(
                name,
                np.array([problem.velocity[some, e].mean() for some in bins]),
                np.array([fit.residual[some].mean() for some in bins]),
                np.array([_deviation(fit.residual[some], block[some]) for some in bins]),
            )
        )
    return tuple(result)


def _deviation(values: Array, block: Array) -> float:
    means = [float(values[block == k].mean()) for k in np.unique(block).tolist()]
    return float(np.std(means, ddof=1) / np.sqrt(len(means))) if len(means) > 1 else float("nan")


def undetermined(problem: ExcitationProblem, fit: LinearFit) -> tuple[str, ...]:
    """Return the base parameters that these runs do not determine, by name.

    One deviation of such a parameter alone would move torques by more than the torques' own RMS: the data would bear
    any value that an arm may have.

    Args:
        problem: r rows.
        fit: of the base parameters, and of others behind them.
    """
    count = len(problem.names)
    size = float(np.sqrt(np.mean(problem.torque**2)))
    deviation, known = fit.deviation[:count], fit.determined[:count]
    effect = np.where(known, deviation, 0.0) * np.sqrt(np.mean(problem.regressor**2, axis=0))
    bad = ~known | ~(effect < size)
    return tuple(name for name, one in zip(problem.names, bad.tolist(), strict=True) if one)
