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

from typing import Annotated, Any, NamedTuple, TypeAlias

import numpy as np
from pydantic import Field, model_validator

from rx90_common.base.arrays import RecordType, record_type
from rx90_common.base.models import Row, quantity, refusal
from rx90_common.friction.parts.part import (
    FrictionPart,
    Moment,
    Part,
    Present,
    Surroundings,
    scaled,
)
from rx90_common.kernels.compiled import inlined
from rx90_common.kernels.elementary import sine_cosine, sines_cosines
from rx90_common.kernels.lanes import fma, load

MAX_TERMS = 8
"""Of each of both sums."""

_list = Field(strict=False, max_length=MAX_TERMS)
_Waves: TypeAlias = Annotated[tuple[Annotated[float, Field(gt=0.0, le=1000.0)], ...], _list]
_Shares: TypeAlias = Annotated[tuple[Annotated[float, Field(ge=0.0, le=0.99)], ...], _list]
_Phases: TypeAlias = Annotated[Row, Field(max_length=MAX_TERMS)]


class Series(NamedTuple):
    """The Fourier series in one angle: the keys of its harmonics, amplitudes and phases, and their values."""

    name: str
    harmonic: tuple[float, ...]
    amplitude: tuple[float, ...]
    phase: tuple[float, ...]


class RipplePart(FrictionPart):
    """Friction by the angles of joint and motor.

    A Fourier series of the Coulomb and static torque; equations in this module's docstring. There are as many
    amplitudes as harmonics, and as many phases or none, which are 0 then.
    """

    joint_harmonic: Annotated[_Waves, quantity("1", "Waves in a turn of the joint.")] = ()
    joint_amplitude: Annotated[
        _Shares, quantity("1", "Share of Coulomb and static torque, of each wave of the joint.")
    ] = ()
    joint_phase: Annotated[
        _Phases, quantity("rad", "Phase of each cosine where the angle is 0, of the joint.")
    ] = ()
    motor_harmonic: Annotated[_Waves, quantity("1", "Waves in a turn of the motor.")] = ()
    motor_amplitude: Annotated[
        _Shares, quantity("1", "Share of Coulomb and static torque, of each wave of the motor.")
    ] = ()
    motor_phase: Annotated[
        _Phases, quantity("rad", "Phase of each cosine where the angle is 0, of the motor.")
    ] = ()

    @property
    def series(self) -> tuple[Series, Series]:
        """Return the series in the angle of the joint, and in that of the motor."""
        joint = Series("joint", self.joint_harmonic, self.joint_amplitude, self.joint_phase)
        return joint, Series("motor", self.motor_harmonic, self.motor_amplitude, self.motor_phase)

    @model_validator(mode="after")
    def _check_terms(self) -> RipplePart:
        for name, harmonic, amplitude, phase in self.series:
            accepted = f"{len(harmonic)} numbers, as many as {name}_harmonic has"
            if len(amplitude) != len(harmonic):
                raise refusal(f"{name}_amplitude", amplitude, accepted)
            if phase and len(phase) != len(harmonic):
                raise refusal(f"{name}_phase", phase, accepted)
        if not self.joint_harmonic and not self.motor_harmonic:
            raise refusal("joint_harmonic", (), "a harmonic in joint_harmonic or motor_harmonic")
        if self.least_factor <= 0.0:
            name = "joint_amplitude" if self.joint_amplitude else "motor_amplitude"
            total = f"{1.0 - self.least_factor:g}"
            raise refusal(name, total, "amplitudes that sum to less than 1 in both series together")
        return self

    @property
    def least_factor(self) -> float:
        """Return the least number that Coulomb and static torque are multiplied with."""
        return 1.0 - sum((*self.joint_amplitude, *self.motor_amplitude))


def ripple_dtype(width: int) -> RecordType:
    """Return the type of the constants: how many terms there are, and a row for each."""
    rows = (2 * MAX_TERMS, width)
    return record_type(
        terms=np.int64,
        harmonic=rows,  # waves in 2 pi of the element's angle
        cosine=rows,
        sine=rows,
    )


def fill_ripple(record: Any, e: int, part: RipplePart, surroundings: Surroundings) -> None:
    """Write the constants of element e."""
    row = 0
    for series, ratio in zip(part.series, (1.0, surroundings.gear[e]), strict=True):
        phase = series.phase or (0.0,) * len(series.harmonic)
        for k, harmonic in enumerate(series.harmonic):
            sine, cosine = sines_cosines(np.array([phase[k]]))
            record["harmonic"][row, e] = harmonic * ratio
            record["cosine"][row, e] = series.amplitude[k] * cosine[0]
            record["sine"][row, e] = -series.amplitude[k] * sine[0]
            row += 1
    record["terms"] = max(record["terms"], row)


@inlined
def rippled(parts: Any, _state: Any, present: Present, moment: Moment, width: int) -> Present:
    """Scale Coulomb and static torque by the elements' angles, rad."""
    part = parts.ripple
    factor = 0.0 * moment.angle + 1.0
    for k in range(part.terms):
        sine, cosine = sine_cosine(load(part.harmonic[k], width) * moment.angle)
        factor = fma(
            load(part.cosine[k], width), cosine, fma(load(part.sine[k], width), sine, factor)
        )
    return scaled(present, factor)


RIPPLE = Part((RipplePart,), ripple_dtype, fill_ripple, present=rippled)
