"""How well a fit explains the torque at each speed, and what the runs did not determine."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.stats import t as student

from rx90_common.base.arrays import Array, Index
from rx90_emulator.identification.excitation.covariance import time_blocks
from rx90_emulator.identification.excitation.least_squares import LinearFit
from rx90_emulator.identification.excitation.problem import ExcitationProblem

_BINS = 12  # of speed
_FEWEST = 5  # rows in a bin
_LEVEL = 0.05  # chance of a false misfit, over all bins together


@dataclass(frozen=True, eq=False)
class SpeedResiduals:
    """Mean residuals of an element's joint at several speeds of the element, k bins.

    Attributes:
        element: its name.
        velocity: mean in each bin, rad/s, shape (k,).
        residual: mean, Nm, shape (k,).
        deviation: of that mean, from the means of blocks of time, Nm, shape (k,); NaN in a bin of one block.
        blocks: how many of them, shape (k,).
    """

    element: str
    velocity: Array
    residual: Array
    deviation: Array
    blocks: Index


def residuals_by_speed(problem: ExcitationProblem, residual: Array) -> tuple[SpeedResiduals, ...]:
    """Return mean residuals over the speed of each element: what its friction curve does not say.

    The joint is the last on which the element acts. Reversals are left out.

    Args:
        problem: r rows.
        residual: recorded less predicted torque, Nm, shape (r,).
    """
    block = time_blocks(problem)
    result = []
    for e, (name, acts) in enumerate(zip(problem.arm.element_names, problem.arm.element_matrix != 0.0, strict=True)):
        rows = np.flatnonzero((problem.joint == np.flatnonzero(acts)[-1]) & ~problem.reversal)
        velocity = problem.velocity[rows, e]
        edges = np.quantile(velocity, np.linspace(0.0, 1.0, _BINS + 1)) if len(rows) else np.zeros(_BINS + 1)
        number = np.clip(np.searchsorted(edges, velocity, "right") - 1, 0, _BINS - 1)
        bins = [rows[number == k] for k in range(_BINS) if np.count_nonzero(number == k) >= _FEWEST]
        result.append(
            SpeedResiduals(
                name,
                np.array([problem.velocity[some, e].mean() for some in bins]),
                np.array([residual[some].mean() for some in bins]),
                np.array([_deviation(residual[some], block[some]) for some in bins]),
                np.array([len(np.unique(block[some])) for some in bins], dtype=np.intp),
            )
        )
    return tuple(result)


def misfits(speeds: Sequence[SpeedResiduals]) -> list[str]:
    """Return, in words, each element's largest mean residual that is more than chance (5 % over all bins together)."""
    found = []
    tests = sum(len(one.residual) for one in speeds)
    for one in speeds:
        with np.errstate(invalid="ignore", divide="ignore"):
            size = np.nan_to_num(np.abs(one.residual) / one.deviation, posinf=0.0)
        limit = np.array([student.ppf(1.0 - 0.5 * _LEVEL / tests, max(k - 1, 1)) for k in one.blocks.tolist()])
        clear = np.flatnonzero(size > limit)
        if len(clear):
            worst = clear[np.argmax(np.abs(one.residual[clear]))]
            found.append(
                f"the torque of {one.element} is off by {one.residual[worst]:.3g} +- {one.deviation[worst]:.2g} Nm at "
                f"{one.velocity[worst]:.3g} rad/s"
            )
    return found


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
