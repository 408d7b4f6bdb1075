"""Options of a comparison with a measured run. Imports nothing slow, for --help."""

from __future__ import annotations

import math
from dataclasses import dataclass

from rx90_common.base.errors import ConfigError


@dataclass(frozen=True)
class MeasuredTolerances:
    """What counts as agreement of a simulated run with a measured one.

    Attributes:
        torque: RMS difference of a joint's torque over its RMS measured torque.
        total_torque: the same of all joints together.
        position: largest difference of a joint's position, rad.
    """

    torque: float = 0.25
    total_torque: float = 0.1
    position: float = 5e-3

    def __post_init__(self) -> None:
        for name, value in vars(self).items():
            if not 0.0 < value < math.inf:
                raise ConfigError(f"{name} is {value}; accepted: a positive number")
