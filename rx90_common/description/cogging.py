"""Cogging of the motors: a torque by the angle of the motor, for each of the six."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from rx90_common.base.arrays import Array
from rx90_common.base.entries import LEFT_OUT, ListOf, Number, Rows
from rx90_common.base.errors import ConfigError
from rx90_common.base.groups import Group
from rx90_common.base.quoting import counted

MOST_TERMS = 8
"""Of the Fourier series."""

COGGING = Group(
    "Cogging torque of the motors: a Fourier series in the motor's angle; left out: none.",
    keys={
        "harmonic": ListOf(
            "Waves in a turn of the motor, one for each row of the others.", "1",
            item=Number("Waves in a turn.", "1", low=0.0, high=1000.0, above=True),
            accepted="a list of numbers", least=1,
        ),
        "amplitude": Rows("Amplitudes of the six motors, motor side.", "Nm", count=6),
        "phase": Rows(
            "Phases of the cosines where the motors are at 0; 0 where they are left out.", "rad",
            count=6, default=LEFT_OUT,
        ),
    },
    default=LEFT_OUT,
)  # fmt: skip
"""What a drives file may hold of it."""


@dataclass(frozen=True)
class Cogging:
    """The torque sum over k of amplitude[k] cos(harmonic[k] angle + phase[k]) on the motors, motor side.

    It is the slope of an energy, so a turn neither gives nor takes any.

    Attributes:
        harmonic: waves in a turn, 1, shape (n,); none for no cogging.
        amplitude: Nm, shape (n, 6).
        phase: rad, shape (n, 6).

    Raises:
        ConfigError: for values that are not finite and series of other lengths.
    """

    harmonic: Array = field(default_factory=lambda: np.zeros(0))
    amplitude: Array = field(default_factory=lambda: np.zeros((0, 6)))
    phase: Array = field(default_factory=lambda: np.zeros((0, 6)))

    def __post_init__(self) -> None:
        terms = np.asarray(self.harmonic).shape[0]
        if terms > MOST_TERMS:
            raise ConfigError(f"cogging: harmonic has {counted(terms, 'number')}; accepted: up to {MOST_TERMS}")
        for name, shape in (("harmonic", (terms,)), ("amplitude", (terms, 6)), ("phase", (terms, 6))):
            value = np.asarray(getattr(self, name))
            if value.shape != shape or not np.all(np.isfinite(value)):
                raise ConfigError(f"cogging: {name} is {value.tolist()}; accepted: finite numbers of shape {shape}")
        if not np.all(np.asarray(self.harmonic) > 0):
            raise ConfigError(f"cogging: harmonic is {np.asarray(self.harmonic).tolist()}; accepted: numbers > 0")

    @property
    def used(self) -> bool:
        """Return whether any motor cogs."""
        return bool(np.any(self.amplitude))

    @classmethod
    def of_file(cls, block: Mapping[str, Any] | None) -> Cogging:
        """Return what a block of a drives file says, checked by COGGING; none for none."""
        if block is None:
            return cls()
        amplitude = np.array(block["amplitude"], dtype=np.float64)
        phase = np.array(block.get("phase", np.zeros_like(amplitude)), dtype=np.float64)
        return cls(np.array(block["harmonic"], dtype=np.float64), amplitude, phase)
