"""Position: Coulomb and static torque with a Fourier series in joint angle and motor angle.

    tau_c (1 + r), tau_s (1 + r)
    r = sum a_i cos(h_i q + p_i) + sum a_j cos(h_j n q + p_j)

with the element's angle q and, in the second sum, the motor's n q with the gear ratio n. Harmonic drives have most of
it at two waves for each turn of the motor (Tuttle and Seering 1996, A nonlinear model of a harmonic drive gear
transmission), spur gears at tooth mesh, bearings and seals at one wave for each turn of the joint. For the sixth
element, which turns with joint 6 alone, n q is the turn of motor 6 while joint 5 is at rest.

The amplitudes sum to less than 1, so the sliding torque stays positive and the part only takes power; passive_damping
of the element is that of its least sliding torque, (1 - sum of the amplitudes) times.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from typing import Annotated, Any

import numpy as np

from rx90_common.base.entries import ListOf, Number
from rx90_common.base.errors import ConfigError
from rx90_common.base.quoting import counted
from rx90_common.friction.parts.part import FrictionPart
from rx90_common.kernels.compiled import inlined
from rx90_common.kernels.elementary import sine_cosine, sines_cosines
from rx90_common.kernels.lanes import Lanes, fma, load

ANGLES = ("joint", "motor")
MAX_TERMS = 8
"""Of each of both sums."""


def _numbers(about: str, unit: str = "1", **limits: Any) -> ListOf:
    accepted = f"a list of up to {MAX_TERMS} numbers"
    return ListOf(about, unit, item=Number(about, unit, **limits), accepted=accepted)


_waves = partial(_numbers, low=0.0, high=1000.0, above=True)
_shares = partial(_numbers, low=0.0, high=0.99)


@dataclass(frozen=True)
class RipplePart(FrictionPart):
    """A Fourier series of the Coulomb and static torque; equations in this module's docstring.

    There are as many amplitudes as harmonics, and as many phases or none, which are 0 then.
    """

    name = "ripple"
    about = "Friction by the angles of joint and motor."

    joint_harmonic: Annotated[tuple[float, ...], _waves("Waves in a turn of the joint.")] = ()
    joint_amplitude: Annotated[
        tuple[float, ...], _shares("Share of Coulomb and static torque, of each wave of the joint.")
    ] = ()
    joint_phase: Annotated[
        tuple[float, ...], _numbers("Phase of each cosine where the angle is 0, of the joint.", "rad")
    ] = ()
    motor_harmonic: Annotated[tuple[float, ...], _waves("Waves in a turn of the motor.")] = ()
    motor_amplitude: Annotated[
        tuple[float, ...], _shares("Share of Coulomb and static torque, of each wave of the motor.")
    ] = ()
    motor_phase: Annotated[
        tuple[float, ...], _numbers("Phase of each cosine where the angle is 0, of the motor.", "rad")
    ] = ()

    def __post_init__(self) -> None:
        super().__post_init__()
        for angle in ANGLES:
            terms = len(getattr(self, f"{angle}_harmonic"))
            if terms > MAX_TERMS:
                raise ConfigError(
                    f"ripple: {angle}_harmonic has {counted(terms, 'number')}; accepted: up to {MAX_TERMS}"
                )
            for what, accepted in (("amplitude", (terms,)), ("phase", (terms, 0))):
                count = len(getattr(self, f"{angle}_{what}"))
                if count not in accepted:
                    raise ConfigError(f"ripple: {angle}_{what} has {counted(count, 'number')}; accepted: {terms}, "
                                      f"as {angle}_harmonic has")  # fmt: skip
        if not self.joint_harmonic and not self.motor_harmonic:
            raise ConfigError("ripple: no harmonic; accepted: one or more in joint_harmonic or motor_harmonic")
        if self.least_factor <= 0.0:
            total = sum((*self.joint_amplitude, *self.motor_amplitude))
            raise ConfigError(f"ripple: the amplitudes sum to {total:g}; accepted: less than 1")

    @property
    def least_factor(self) -> float:
        """Return the least number that Coulomb and static torque are multiplied with."""
        return 1.0 - sum((*self.joint_amplitude, *self.motor_amplitude))


def ripple_dtype(width: int) -> np.dtype[np.void]:
    """Return the type of the constants: how many terms there are, and a row for each."""
    rows = (len(ANGLES) * MAX_TERMS, width)
    return np.dtype(
        [
            ("terms", np.int64),
            ("harmonic", np.float64, rows),  # waves in 2 pi of the element's angle
            ("cosine", np.float64, rows),
            ("sine", np.float64, rows),
        ],
        align=True,
    )


def fill_ripple(record: Any, parts: Sequence[RipplePart | None], gear: Sequence[float]) -> None:
    """Write the constants, an element for each of `parts`, with its gear ratio."""
    most = 0
    for i, part in enumerate(parts):
        if part is None:
            continue
        row = 0
        for angle, ratio in zip(ANGLES, (1.0, gear[i]), strict=True):
            harmonic = getattr(part, f"{angle}_harmonic")
            amplitude = getattr(part, f"{angle}_amplitude")
            phase = getattr(part, f"{angle}_phase") or (0.0,) * len(harmonic)
            for k in range(len(harmonic)):
                sine, cosine = sines_cosines(np.array([phase[k]]))
                record["harmonic"][row, i] = harmonic[k] * ratio
                record["cosine"][row, i] = amplitude[k] * cosine[0]
                record["sine"][row, i] = -amplitude[k] * sine[0]
                row += 1
        most = max(most, row)
    record["terms"] = most


@inlined
def ripple_factor(part: Any, angle: Lanes, width: int) -> Lanes:
    """Return the number that Coulomb and static torque are multiplied with at the elements' angles, rad."""
    factor = 0.0 * angle + 1.0
    for k in range(part.terms):
        sine, cosine = sine_cosine(load(part.harmonic[k], width) * angle)
        factor = fma(load(part.cosine[k], width), cosine, fma(load(part.sine[k], width), sine, factor))
    return factor
