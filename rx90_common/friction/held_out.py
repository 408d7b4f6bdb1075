"""Which of several models predicts best what it was not fitted to.

Each model is fitted to all blocks of the data but some, and predicts those. The squared errors of two models are
compared block by block, by the mean of their logarithms' differences over its standard error: so a block with large
errors counts no more than another, and errors that all models share cancel.
"""

from __future__ import annotations

from collections.abc import Hashable, Iterable, Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Generic, TypeVar

import numpy as np

from rx90_common.base.arrays import Array

Model = TypeVar("Model", bound=Hashable)


@dataclass(frozen=True, eq=False)
class HeldOutErrors(Generic[Model]):
    """Errors of models in blocks of data that they were not fitted to.

    Attributes:
        squares: squared error of each of k blocks, noise included, by model, each of shape (k,); one model or more.
    """

    squares: Mapping[Model, Array]

    @cached_property
    def noise(self) -> float:
        """Return the squared error that no model goes below in half of the blocks."""
        return float(np.median(np.min(list(self.squares.values()), axis=0)))

    @cached_property
    def scores(self) -> dict[Model, Array]:
        """Return the logarithms of the squared errors above the noise, each of shape (k,); less is better."""
        return {model: np.log(squares + self.noise) for model, squares in self.squares.items()}

    def best(self, among: Iterable[Model] | None = None) -> Model:
        """Return the model that predicts best, of all or of some."""
        return min(self.scores if among is None else among, key=lambda model: float(self.scores[model].sum()))

    def behind(self, model: Model, rival: Model) -> float:
        """Return by how many standard errors a model predicts worse than a rival; 0 for the rival itself."""
        difference = self.scores[model] - self.scores[rival]
        spread = float(np.std(difference)) * np.sqrt(difference.size)
        return float(difference.sum() / spread) if spread > 0.0 else 0.0
