"""Compare models by their errors in held-out blocks of the data; errors that all models share cancel."""

from __future__ import annotations

from collections.abc import Hashable, Mapping
from dataclasses import dataclass
from typing import Generic, TypeVar

import numpy as np

from rx90_common.base.arrays import Array

Model = TypeVar("Model", bound=Hashable)


@dataclass(frozen=True, eq=False)
class HeldOutErrors(Generic[Model]):
    """Errors of models in held-out blocks of data.

    Attributes:
        squares: squared error of each of k blocks, noise included, by model, each of shape (k,); one model or more.
        rows: of data in each block, shape (k,).
    """

    squares: Mapping[Model, Array]
    rows: Array

    def rms(self, model: Model) -> tuple[float, float]:
        """Return the RMS error of a model over all rows, and its standard error by the scatter over the blocks."""
        error, influence = self._influence(model)
        return error, _sum_deviation(influence)

    def gain(self, model: Model, rival: Model) -> tuple[float, float]:
        """Return by how much a model's RMS error is less than a rival's, and its standard error over the blocks."""
        error, influence = self._influence(model)
        rival_error, rival_influence = self._influence(rival)
        return rival_error - error, _sum_deviation(rival_influence - influence)

    def _influence(self, model: Model) -> tuple[float, Array]:
        """Return the RMS error, and the contribution of each block, independent of the others, to its deviation."""
        squares = self.squares[model]
        count = float(self.rows.sum())
        error = float(np.sqrt(squares.sum() / count))
        return error, (squares - self.rows * squares.sum() / count) / (2.0 * count * max(error, 1e-300))


def _sum_deviation(parts: Array) -> float:
    """Return the standard deviation of a sum of independent parts with mean 0."""
    return float(np.sqrt(len(parts) / (len(parts) - 1.0) * np.sum(parts**2)))
