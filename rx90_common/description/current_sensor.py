"""Current sensors of the amplifiers: offset, noise and resolution of what they report and regulate."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import partial
from typing import Annotated

import numpy as np

from rx90_common.base.arrays import Array
from rx90_common.base.declared import Declared
from rx90_common.base.entries import REQUIRED, Number, Numbers

_six = partial(Numbers, unit="A", count=6)


@dataclass(frozen=True)
class CurrentSensor(Declared):
    """Errors of the six current sensors; every array has shape (6,).

    Raises:
        ConfigError: for values out of range.
    """

    name = "current_sensor"
    about = "Errors of the amplifiers' current sensors; left out: none."

    offset: Annotated[Array, _six("What a sensor shows without a current.")] = field(
        default_factory=lambda: np.zeros(6)
    )
    noise: Annotated[Array, _six("Standard deviation of a sample, one in each base tick.", low=0.0)] = field(
        default_factory=lambda: np.zeros(6)
    )
    resolution: Annotated[Array, _six("Step of the converter; 0 for none.", low=0.0)] = field(
        default_factory=lambda: np.zeros(6)
    )
    bandwidth: Annotated[
        float,
        Number("Bandwidth of the current loop, through which the errors act on the torque.", "Hz", low=0.0, above=True),
        REQUIRED,
    ] = 800.0

    @property
    def used(self) -> bool:
        """Return whether any sensor has an error."""
        return bool(np.any([self.offset, self.noise, self.resolution]))
