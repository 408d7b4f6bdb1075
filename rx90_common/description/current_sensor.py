"""Current sensors of the amplifiers: offset, noise and resolution of what they report and regulate."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import partial
from typing import Any

import numpy as np

from rx90_common.base.arrays import Array
from rx90_common.base.entries import LEFT_OUT, Number, Numbers
from rx90_common.base.errors import ConfigError
from rx90_common.base.groups import Group

_six = partial(Numbers, unit="A", count=6, default=(0.0,) * 6)

CURRENT_SENSOR = Group(
    "Errors of the amplifiers' current sensors; left out: none.",
    keys={
        "offset": _six("What a sensor shows without a current."),
        "noise": _six("Standard deviation of a sample, one in each base tick.", low=0.0),
        "resolution": _six("Step of the converter; 0 for none.", low=0.0),
        "bandwidth": Number(
            "Bandwidth of the current loop, through which the errors act on the torque.", "Hz", low=0.0, above=True,
        ),
    },
    default=LEFT_OUT,
)  # fmt: skip
"""What a drives file may hold of them."""


@dataclass(frozen=True)
class CurrentSensor:
    """Errors of the six current sensors; every array has shape (6,), A.

    Attributes:
        offset: what a sensor shows without a current.
        noise: standard deviation of a sample.
        resolution: step of the converter, 0 for none.
        bandwidth: of the current loop, which takes the errors for current, Hz.

    Raises:
        ConfigError: for values out of range.
    """

    offset: Array = field(default_factory=lambda: np.zeros(6))
    noise: Array = field(default_factory=lambda: np.zeros(6))
    resolution: Array = field(default_factory=lambda: np.zeros(6))
    bandwidth: float = 800.0

    def __post_init__(self) -> None:
        for name in ("offset", "noise", "resolution"):
            value = np.asarray(getattr(self, name))
            good = np.isfinite(value) if name == "offset" else np.isfinite(value) & (value >= 0)
            if value.shape != (6,) or not np.all(good):
                accepted = "6 finite numbers" + ("" if name == "offset" else " >= 0")
                raise ConfigError(f"current_sensor: {name} is {value.tolist()}; accepted: {accepted}")
        if not 0.0 < self.bandwidth < np.inf:
            raise ConfigError(f"current_sensor: bandwidth is {self.bandwidth} Hz; accepted: a finite number > 0")

    @property
    def used(self) -> bool:
        """Return whether any sensor has an error."""
        return bool(np.any([self.offset, self.noise, self.resolution]))

    @classmethod
    def of_file(cls, block: Mapping[str, Any] | None) -> CurrentSensor:
        """Return what a block of a drives file says, checked by CURRENT_SENSOR; none without errors for none."""
        if block is None:
            return cls()
        offset, noise, resolution = (np.array(block[name]) for name in ("offset", "noise", "resolution"))
        return cls(offset, noise, resolution, block["bandwidth"])
