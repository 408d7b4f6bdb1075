"""Cogging of the motors: a torque by the angle of the motor, for each of the six."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Annotated, Any

import numpy as np

from rx90_common.base.arrays import Array
from rx90_common.base.declared import Declared
from rx90_common.base.entries import LEFT_OUT, REQUIRED, ListOf, Number, Rows
from rx90_common.base.errors import ConfigError
from rx90_common.base.quoting import counted

MOST_TERMS = 8
"""Of the Fourier series."""

_waves = ListOf(
    "Waves in a turn of the motor, one for each row of the others.", "1",
    item=Number("Waves in a turn.", "1", low=0.0, high=1000.0, above=True),
    accepted="a list of numbers", least=1,
)  # fmt: skip


@dataclass(frozen=True)
class Cogging(Declared):
    """The torque sum over k of amplitude[k] cos(harmonic[k] angle + phase[k]) on the motors, motor side.

    It is the slope of an energy, so a turn neither gives nor takes any. The harmonics have shape (n,), none for no
    cogging; amplitudes and phases (n, 6).

    Raises:
        ConfigError: for values that are not finite and series of other lengths.
    """

    name = "cogging"
    about = "Cogging torque of the motors: a Fourier series in the motor's angle; left out: none."

    harmonic: Annotated[Array, _waves, REQUIRED] = field(default_factory=lambda: np.zeros(0))
    amplitude: Annotated[Array, Rows("Amplitudes of the six motors, motor side.", "Nm", count=6), REQUIRED] = field(
        default_factory=lambda: np.zeros((0, 6))
    )
    phase: Annotated[
        Array,
        Rows(
            "Phases of the cosines where the motors are at 0; 0 where they are left out.", "rad",
            count=6, default=LEFT_OUT,
        ),
    ] = field(default_factory=lambda: np.zeros((0, 6)))  # fmt: skip

    def __post_init__(self) -> None:
        super().__post_init__()
        terms = len(self.harmonic)
        if terms > MOST_TERMS:
            raise ConfigError(f"cogging: harmonic has {counted(terms, 'number')}; accepted: up to {MOST_TERMS}")
        for name in ("amplitude", "phase"):
            value = getattr(self, name)
            if np.shape(value) != (terms, 6):
                raise ConfigError(f"cogging: {name} is {value.tolist()}; accepted: numbers of shape {(terms, 6)}")

    @classmethod
    def of_file(cls, content: Mapping[str, Any] | None, **fields: Any) -> Cogging:
        """Return what a block of a drives file says; none for none."""
        phases = {} if content is None else {"phase": ((0.0,) * 6,) * len(content["amplitude"])}
        return super().of_file(content and {**phases, **content}, **fields)

    @property
    def used(self) -> bool:
        """Return whether any motor cogs."""
        return bool(np.any(self.amplitude))
