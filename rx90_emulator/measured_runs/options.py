"""Limits for agreement of a simulated run with a measured one, for checks and for --help: nothing slow is imported."""

from __future__ import annotations

from dataclasses import dataclass

from rx90_emulator.identification.options import Tolerances


@dataclass(frozen=True)
class MeasuredTolerances(Tolerances):
    """Limits for agreement of a simulated run with a measured one.

    Attributes:
        torque: RMS difference of a joint's torque over its RMS measured torque.
        total_torque: the same for all joints together.
        position: largest difference of a joint's position, rad.
    """

    torque: float = 0.25
    total_torque: float = 0.1
    position: float = 5e-3
