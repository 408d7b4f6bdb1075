"""Set-points one by one, sampled in blocks: to sample one alone takes longer than the law."""

from __future__ import annotations

import numpy as np

from rx90_common.base.arrays import Array
from rx90_controller.trajectory import TrajectoryGenerator

_BLOCK = 64


class Lookahead:
    """The set-points of a generator, also of one whose trajectories change in between."""

    def __init__(self, generator: TrajectoryGenerator) -> None:
        self._generator = generator
        self._block = np.zeros((0, 3, 6))
        self._first = 0  # position tick of the first set-point in it
        self._revision = generator.revision

    def at(self, tick: int) -> Array:
        """Return that of a position tick: position rad, velocity rad/s, acceleration rad/s^2, shape (3, 6)."""
        row = tick - self._first
        if self._revision != self._generator.revision or not 0 <= row < len(self._block):
            self._block = self._generator.setpoints(tick, _BLOCK)
            self._first, row = tick, 0
            self._revision = self._generator.revision
        setpoint: Array = self._block[row]
        return setpoint
