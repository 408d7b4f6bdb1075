"""What a cross-check still counts as agreement."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Tolerances:
    """What still counts as agreement.

    Attributes:
        torque: RMS difference of a joint's torque as a share of the RMS torque that was recorded.
        worst_torque: largest difference as a share of the largest recorded torque.
        tip: largest distance of the tip positions, m.
    """

    torque: float = 0.05
    worst_torque: float = 0.15
    tip: float = 1e-4
