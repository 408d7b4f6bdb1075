"""The difference of the tip between a perturbation run and the full simulation of the same motion."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from rx90_common.base.arrays import Array
from rx90_common.description.kinematics import forward
from rx90_emulator.loop.result import RunResult
from rx90_emulator.perturbation.model import PerturbationResult


class Agreement(NamedTuple):
    """Distances of the tip from the nominal motion, m, and how far they differ.

    Attributes:
        worst: largest distance, full simulation and perturbation method.
        rms: root mean square distance, likewise.
        difference: largest distance between the two tips at the same time.
    """

    worst: tuple[float, float]
    rms: tuple[float, float]
    difference: float

    @property
    def relative_worst(self) -> float:
        """Return by which share the largest distances differ."""
        return abs(self.worst[1] / self.worst[0] - 1.0)

    @property
    def relative_rms(self) -> float:
        """Return by which share the root mean square distances differ."""
        return abs(self.rms[1] / self.rms[0] - 1.0)

    @property
    def relative_difference(self) -> float:
        """Return the largest distance between the tips, as a share of the largest distance from the motion."""
        return self.difference / self.worst[0]


def agreement(
    full: RunResult, result: PerturbationResult, run: int = 0, begin: float = 0.0, end: float = np.inf
) -> Agreement:
    """Compare a run with the full simulation from `begin` to `end`, s."""
    model = result.model
    window = (model.times >= begin) & (model.times <= end)
    tip = forward(model.setup.robot.chain, full.slow.joint_states[window, 0]).position - model.nominal_tip[window]
    ours = result.tip_deviation[run][window]
    distances = [np.linalg.norm(deviation, axis=1) for deviation in (tip, ours)]
    worst, rms = ([float(norm(d)) for d in distances] for norm in (np.max, _root_mean_square))
    return Agreement((worst[0], worst[1]), (rms[0], rms[1]), float(np.linalg.norm(tip - ours, axis=1).max()))


def _root_mean_square(distance: Array) -> float:
    return float(np.sqrt(np.mean(distance**2)))
