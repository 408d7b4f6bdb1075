"""Choose between models by their predictions of held-out blocks of the data.

`leave_out` fits a model without each block in turn and returns the squared errors in that block; `HeldOutErrors`
compares models block by block. Two measures of the difference serve two kinds of data: the logarithm of the
squared errors (`behind`, `refutes`), in which a block with large errors counts no more than another, and the RMS
error over all rows (`gain`). Both are paired: errors that all models share cancel.
"""

from __future__ import annotations

from collections.abc import Callable, Hashable, Iterable, Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Generic, TypeVar

import numpy as np
from scipy import stats

from rx90_common.base.arrays import Array

Model = TypeVar("Model", bound=Hashable)
Block = TypeVar("Block")
Fit = TypeVar("Fit")


def leave_out(
    blocks: Iterable[Block], fit: Callable[[Block], Fit], squares: Callable[[Fit, Block], Array]
) -> tuple[list[Fit], Array]:
    """Return the fits without each of some blocks, and the squared errors of each fit in its held-out block.

    Args:
        blocks: to hold out in turn: numbers of data sets, or groups of them.
        fit: to everything but a block.
        squares: squared errors of a fit in a block, shape (m,): one or several sums, which are compared in pairs.

    Returns:
        The fits; the squared errors of all blocks in their order, shape (k,).
    """
    fits = []
    errors = []
    for block in blocks:
        fits.append(fit(block))
        errors.append(squares(fits[-1], block))
    return fits, np.concatenate(errors)


@dataclass(frozen=True, eq=False)
class HeldOutErrors(Generic[Model]):
    """Errors of models in held-out blocks of data.

    Attributes:
        squares: squared error of each of k blocks, noise included, by model, each of shape (k,); one model or more.
        rows: of data in each block, shape (k,), for `rms` and `gain`; None if each block has one.
        floor: added to the squared errors before their logarithm; None adds the best model's error in the median
            block, so that noise is not compared.
    """

    squares: Mapping[Model, Array]
    rows: Array | None = None
    floor: float | None = None

    @cached_property
    def scores(self) -> dict[Model, Array]:
        """Return the logarithms of the squared errors above the floor, each of shape (k,); less is better."""
        noise = float(np.median(np.min(list(self.squares.values()), axis=0))) if self.floor is None else self.floor
        return {model: np.log(squares + noise) for model, squares in self.squares.items()}

    def best(self, among: Iterable[Model] | None = None) -> Model:
        """Return the model with the least mean logarithm of its errors, of all or of some."""
        return min(self.scores if among is None else among, key=lambda model: float(self.scores[model].sum()))

    def behind(self, model: Model, rival: Model) -> float:
        """Return by how many standard errors a model predicts worse than a rival; 0 for the rival itself."""
        difference = self.scores[model] - self.scores[rival]
        spread = float(np.std(difference)) * np.sqrt(difference.size)
        return float(difference.sum() / spread) if spread > 0.0 else 0.0

    def refutes(self, model: Model, among: Iterable[Model], p: float, share: float) -> Model | None:
        """Return the model of least RMS error among some if it refutes another, else None.

        It does where the other's mean squared error is larger by more than `share` of its own, and the logarithms of
        the squared errors are larger by more than chance gives (paired t-test, one-sided, below `p`).
        """
        best = min(among, key=lambda rival: float(np.mean(self.squares[rival])))
        if float(np.mean(self.squares[model])) <= (1.0 + share) * float(np.mean(self.squares[best])):
            return None
        blocks = self.squares[model].size
        t = self.behind(model, best) * np.sqrt((blocks - 1.0) / blocks)  # with Bessel's correction
        return best if stats.t.sf(t, blocks - 1) < p else None

    def rms(self, model: Model) -> tuple[float, float]:
        """Return the RMS error of a model over all rows, and its standard error by the scatter over the blocks."""
        error, influence = self._influence(model)
        return error, _sum_deviation(influence)

    def gain(self, model: Model, rival: Model) -> tuple[float, float]:
        """Return by how much a model's RMS error is less than a rival's, and its standard error over the blocks."""
        (error, own) = self._influence(model)
        (before, its) = self._influence(rival)
        return before - error, _sum_deviation(its - own)

    def _influence(self, model: Model) -> tuple[float, Array]:
        """Return the RMS error, and the contribution of each block, independent of the others, to its deviation."""
        squares = self.squares[model]
        rows = np.ones(squares.size) if self.rows is None else self.rows
        count = float(rows.sum())
        error = float(np.sqrt(squares.sum() / count))
        return error, (squares - rows * squares.sum() / count) / (2.0 * count * max(error, 1e-300))


def _sum_deviation(parts: Array) -> float:
    """Return the standard deviation of a sum of independent parts with mean 0."""
    return float(np.sqrt(len(parts) / (len(parts) - 1.0) * np.sum(parts**2)))
