"""How well a simulated run agrees with a measured one: figures for each joint, and the verdict."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from rx90_common.base.arrays import Array, Mask
from rx90_emulator.identification.excitation.filtering import Bandwidths
from rx90_emulator.identification.records.record import BagSource
from rx90_emulator.measured.options import MeasuredTolerances


@dataclass(frozen=True, eq=False)
class MeasuredComparison:
    """A measured run and the simulated one along the same set-points, both through the same low-pass.

    Attributes:
        names: of the six joints.
        robot: name of the simulated robot.
        source: the measured bag.
        time: by the bag's stamps, s, shape (k,).
        torque: measured drive torque at the joints, Nm, shape (k, 6).
        simulated_torque: Nm, shape (k, 6).
        position: measured, rad, shape (k, 6).
        simulated_position: rad, shape (k, 6).
        compared: where a joint's torque is compared: not at rest, where it depends on what happened before,
            shape (k, 6).
        lag: by how much the simulated motion was later than the measured one, s; it is taken out of the series.
        bandwidths: of the set-points, and of torques and positions here.
        setpoints: where the set-points come from, in words.
        saturated: share of the time in which each motor was at its limit in the simulation, shape (6,).
        remarks: what else there is to say, a sentence each.
        tolerances: what counts as agreement.
    """

    names: tuple[str, ...]
    robot: str
    source: BagSource
    time: Array
    torque: Array
    simulated_torque: Array
    position: Array
    simulated_position: Array
    compared: Mask
    lag: float
    bandwidths: Bandwidths
    setpoints: str
    saturated: Array
    remarks: tuple[str, ...]
    tolerances: MeasuredTolerances

    @property
    def torque_rms(self) -> Array:
        """Return the RMS torque difference where a joint moves, Nm, shape (6,); NaN for a joint at rest."""
        return self._rms(self.simulated_torque - self.torque)

    @property
    def torque_worst(self) -> Array:
        """Return the largest torque difference where a joint moves, Nm, shape (6,); NaN for a joint at rest."""
        return self._largest(self.simulated_torque - self.torque)

    @property
    def torque_share(self) -> Array:
        """Return the RMS difference over the RMS measured torque, shape (6,)."""
        return np.asarray(self.torque_rms / self._rms(self.torque))

    @property
    def worst_share(self) -> Array:
        """Return the largest difference over the largest measured torque, shape (6,)."""
        return np.asarray(self.torque_worst / self._largest(self.torque))

    @property
    def compared_share(self) -> Array:
        """Return the share of the time in which a joint's torque is compared, shape (6,)."""
        return np.asarray(self.compared.mean(axis=0))

    @property
    def total_share(self) -> float:
        """Return the RMS difference of all joints over their RMS measured torque."""
        difference = np.where(self.compared, self.simulated_torque - self.torque, 0.0)
        return float(np.linalg.norm(difference) / np.linalg.norm(np.where(self.compared, self.torque, 0.0)))

    @property
    def position_rms(self) -> Array:
        """Return the RMS position difference, rad, shape (6,)."""
        return np.asarray(np.sqrt(np.mean((self.simulated_position - self.position) ** 2, axis=0)))

    @property
    def position_worst(self) -> Array:
        """Return the largest position difference, rad, shape (6,)."""
        return np.asarray(np.abs(self.simulated_position - self.position).max(axis=0))

    @property
    def passed(self) -> bool:
        """Return whether torques, of each joint that moves and of all together, and positions agree."""
        limits, share = self.tolerances, self.torque_share
        torque = bool((share[np.isfinite(share)] <= limits.torque).all()) and self.total_share <= limits.total_torque
        return torque and bool((self.position_worst <= limits.position).all())

    def _rms(self, values: Array) -> Array:
        count = self.compared.sum(axis=0)
        total = np.where(self.compared, values, 0.0) ** 2
        return np.asarray(np.sqrt(total.sum(axis=0) / np.where(count, count, np.nan)))

    def _largest(self, values: Array) -> Array:
        there = self.compared.any(axis=0)
        return np.where(there, np.where(self.compared, np.abs(values), 0.0).max(axis=0), np.nan)
