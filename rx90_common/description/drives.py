"""The drives: gears with their coupling, motors, encoders, brakes, springs.

Elasticity, cogging, windings and current sensors are blocks of their own; parts missing in a file are ideal.
"""

from __future__ import annotations

import math
from functools import cached_property
from pathlib import Path
from typing import Annotated, Any, Literal, TypeAlias

import numpy as np
from pydantic import (
    Field,
    SerializerFunctionWrapHandler,
    ValidationInfo,
    field_validator,
    model_serializer,
    model_validator,
)

from rx90_common.base.arrays import Array
from rx90_common.base.models import (
    AnyModel,
    FileModel,
    NotNegative,
    NotZero,
    Positive,
    RowOf,
    as_refusal,
    check_counts,
    quantity,
    read_model,
    refusal,
)
from rx90_common.description.coupling import Coupling

MAX_TERMS = 8
"""Of the Fourier series."""
COPPER = 0.00393
"""Temperature coefficient of copper's resistance at 20 degrees, 1/K (IEC 60028)."""
MOTOR = "motor"
LINK = "link"
_ABSOLUTE_ZERO = -273.15
# rad: a tooth and its gap on a wheel with 12 teeth. Gears of robots have an arc minute, 0.0003 rad, common
# planetary ones half a degree; a larger value is a wrong unit.
_MAX_PLAY = 0.5

_Rows: TypeAlias = Annotated[tuple[RowOf[float], ...], Field(strict=False)]
_Waves: TypeAlias = Annotated[
    tuple[Annotated[float, Field(gt=0.0, le=1000.0)], ...],
    Field(strict=False, max_length=MAX_TERMS),
]
_PositiveOrEndless: TypeAlias = Annotated[float, Field(gt=0.0, allow_inf_nan=True)]
_Play: TypeAlias = Annotated[float, Field(ge=0.0, le=_MAX_PLAY)]
_Degrees: TypeAlias = Annotated[float, Field(ge=_ABSOLUTE_ZERO, le=1000.0)]
_DegreesOrNever: TypeAlias = Annotated[float, Field(ge=_ABSOLUTE_ZERO, allow_inf_nan=True)]


class Cogging(FileModel):
    """Cogging torque of the motors, a Fourier series in the motor's angle: none where it is left out.

    The torque is the sum over k of amplitude[k] cos(harmonic[k] angle + phase[k]), motor side. It is the slope of an
    energy, so a turn neither gives nor takes any.
    """

    harmonic: Annotated[
        _Waves, quantity("1", "Waves in a turn of the motor, one for each row of the others.")
    ]
    amplitude: Annotated[_Rows, quantity("Nm", "Amplitudes of the motors, motor side.")]
    phase: Annotated[
        _Rows,
        quantity(
            "rad", "Phases of the cosines where the motors are at 0; 0 where they are left out."
        ),
        Field(validate_default=True),
    ] = ()

    @field_validator("phase")
    @classmethod
    def _complete_phase(cls, phase: _Rows, info: ValidationInfo) -> _Rows:
        return phase or tuple((0.0,) * len(row) for row in info.data.get("amplitude", ()))

    @model_validator(mode="after")
    def _check_shapes(self) -> Cogging:
        terms = len(self.harmonic)
        motors = len(self.amplitude[0]) if self.amplitude else 0
        for key, rows in (("amplitude", self.amplitude), ("phase", self.phase)):
            if len(rows) != terms or any(len(row) != motors for row in rows):
                raise refusal(key, [list(row) for row in rows], f"{terms} rows of {motors} numbers")
        return self

    @property
    def used(self) -> bool:
        """Return whether any motor cogs."""
        return bool(np.any(self.amplitude))


class CurrentSensor(FileModel):
    """Errors of the amplifiers' current sensors, a value for each: none where the block is left out."""

    offset: Annotated[RowOf[float], quantity("A", "What a sensor shows without a current.")] = (
        0.0,
    )
    noise: Annotated[
        RowOf[NotNegative], quantity("A", "Standard deviation of a sample, one in each base tick.")
    ] = (0.0,)
    resolution: Annotated[
        RowOf[NotNegative], quantity("A", "Step of the converter; 0 for none.")
    ] = (0.0,)
    bandwidth: Annotated[
        Positive,
        quantity(
            "Hz",
            "Bandwidth of the current loop, through which the errors act on the torque.",
        ),
    ]

    @property
    def used(self) -> bool:
        """Return whether any sensor has an error."""
        return any((*self.offset, *self.noise, *self.resolution))


class Windings(FileModel):
    """Windings of the motors, a thermal node each, heated by I^2 R; left out: they stay as warm as they are.

    A resistance of 0 means windings at constant temperature. Between `derating` and `limit` the peak current
    falls linearly.
    """

    resistance: Annotated[
        RowOf[NotNegative],
        quantity("Ohm", "Resistance at the reference temperature; 0 for a constant temperature."),
    ]
    thermal_resistance: Annotated[
        RowOf[_PositiveOrEndless], quantity("K/W", "Between winding and surroundings.")
    ]
    heat_capacity: Annotated[RowOf[_PositiveOrEndless], quantity("J/K", "Of the winding.")]
    ambient: Annotated[_Degrees, quantity("°C", "Temperature of the surroundings.")]
    initial: Annotated[
        _Degrees | None,
        quantity(
            "°C",
            "Temperature of the windings at the start; as warm as the surroundings if left out.",
        ),
        Field(validate_default=True),
    ] = None
    reference: Annotated[_Degrees, quantity("°C", "Temperature at which the resistance holds.")] = (
        20.0
    )
    coefficient: Annotated[
        NotNegative, quantity("1/K", "Rise of the resistance with temperature.", le=0.1)
    ] = COPPER
    derating: Annotated[
        _DegreesOrNever,
        quantity(
            "°C", "Temperature from which on the amplifier limits the current; .inf for never."
        ),
    ]
    limit: Annotated[
        _DegreesOrNever, quantity("°C", "Temperature at which it gives none; .inf for never.")
    ]

    @field_validator("initial")
    @classmethod
    def _complete_initial(cls, initial: float | None, info: ValidationInfo) -> float | None:
        return info.data.get("ambient") if initial is None else initial

    @model_validator(mode="after")
    def _check_temperatures(self) -> Windings:
        if self.used and not self.derating < self.limit:
            raise refusal("derating", self.derating, f"below limit = {self.limit:g} °C")
        warmest = max(self.ambient, self.ambient if self.initial is None else self.initial)
        if self.used and not warmest <= self.derating:
            raise refusal("derating", self.derating, f"at least {warmest:g} °C, as it begins")
        return self

    @property
    def used(self) -> bool:
        """Return whether any winding gets warm."""
        return any(self.resistance)


class Elasticity(FileModel):
    """Elasticity and play of the gears, joint side, a value for each drive; left out: rigid gears.

    A motor that turns with several joints has its elasticity between it and their sum: motor 6 of the RX family's wrist
    between it and q5 + q6. With play the damping acts only where the flanks touch.
    """

    stiffness: Annotated[
        RowOf[_PositiveOrEndless],
        quantity(
            "Nm/rad",
            "Stiffness between the motor, seen through its gear, and what it moves; .inf where that is rigid.",
        ),
    ]
    damping: Annotated[
        RowOf[NotNegative], quantity("Nm s/rad", "Damping beside the stiffness.")
    ] = (0.0,)
    backlash: Annotated[
        RowOf[_Play], quantity("rad", "Play: the way, at the joint, from one flank to the other.")
    ] = (0.0,)
    friction: Annotated[
        Literal["motor", "link"],
        Field(description="The side on which the friction of the joints acts."),
    ] = "motor"

    @model_validator(mode="after")
    def _check_rigid_drives(self) -> Elasticity:
        for key, values in (("damping", self.damping), ("backlash", self.backlash)):
            for i, (stiffness, value) in enumerate(
                zip(self.stiffness, values * len(self.stiffness), strict=False)
            ):
                if value > 0.0 and math.isinf(stiffness):
                    raise refusal(
                        f"{key}[{i}]", value, f"0 for a rigid drive, as stiffness[{i}] is infinite"
                    )
        return self

    @property
    def elastic(self) -> Array:
        """Return which drives are, shape (n,), bool."""
        return np.isfinite(self.stiffness)

    @property
    def used(self) -> bool:
        """Return whether any drive is elastic."""
        return bool(self.elastic.any())


class Transmission(FileModel):
    """Gears and rotors."""

    gear: Annotated[
        RowOf[NotZero],
        quantity(
            "1",
            "Motor revolutions per joint revolution; negative where they turn against each other.",
            path="gear",
        ),
    ]
    rotor_inertia: Annotated[
        RowOf[NotNegative],
        quantity("kg m^2", "Rotor inertia seen from the joint (armature).", path="rotor_inertia"),
    ]
    coupling: Annotated[
        _Rows,
        quantity(
            "1",
            "Turns of each motor (row) for turns of the joints (columns), without the gears; left out: each motor "
            "turns with its own joint, but of six motors the sixth with joints 5 and 6, as in the RX family.",
            path="coupling",
        ),
    ] = ()


class Motors(FileModel):
    """Motors and amplifiers."""

    torque_constant: Annotated[
        RowOf[Positive],
        quantity("Nm/A", "Motor torque per current, motor side.", path="torque_constant"),
    ]
    peak_current: Annotated[
        RowOf[Positive], quantity("A", "The most that the amplifier gives.", path="peak_current")
    ]


class Encoders(FileModel):
    """Encoders of all motors."""

    counts_per_revolution: Annotated[
        int,
        quantity(
            "1", "Encoder counts per motor revolution.", ge=16, le=2**30, path="encoder_counts"
        ),
    ]
    velocity_bandwidth: Annotated[
        Positive,
        quantity("Hz", "Bandwidth of the drive's velocity observer.", path="velocity_bandwidth"),
    ]


class Brakes(FileModel):
    """Closed brakes, joint side."""

    torque: Annotated[
        RowOf[Positive], quantity("Nm", "What the brake holds at most.", path="brake_torque")
    ]
    stiffness: Annotated[
        RowOf[Positive],
        quantity("Nm/rad", "Stiffness of the closed brake.", path="brake_stiffness"),
    ]
    damping: Annotated[
        RowOf[NotNegative],
        quantity("Nm s/rad", "Damping of the closed brake.", path="brake_damping"),
    ]


class Springs(FileModel):
    """Gravity-compensation springs."""

    torque: Annotated[
        RowOf[NotNegative],
        quantity(
            "Nm",
            "Amplitude k of the torque -k sin(q) on each joint; 0 for none.",
            path="spring_torque",
        ),
    ]


class EndStops(FileModel):
    """Mechanical end stops, joint side."""

    stiffness: Annotated[
        RowOf[NotNegative], quantity("Nm/rad", "Stiffness of the end stops.", path="stop_stiffness")
    ]
    damping: Annotated[
        RowOf[NotNegative], quantity("Nm s/rad", "Damping of the end stops.", path="stop_damping")
    ]


RIGID = Elasticity(stiffness=(math.inf,))
NO_COGGING = Cogging(harmonic=(), amplitude=())
COLD = Windings(
    resistance=(0.0,),
    thermal_resistance=(math.inf,),
    heat_capacity=(math.inf,),
    ambient=20.0,
    derating=math.inf,
    limit=math.inf,
)
IDEAL_SENSOR = CurrentSensor(bandwidth=800.0)


class DriveParameters(FileModel):
    """Drives of an arm with 1 to 7 joints: lists of one value for each, or for its motor.

    A coupling lists the joints that each motor turns with. Brakes, springs and end stops are those of the joints.
    Elasticity, cogging, winding and current_sensor are ideal if they are left out; a single value in them applies to
    all. Arrays have shape (n,).
    """

    transmission: Transmission
    motor: Motors
    encoder: Encoders
    brake: Brakes
    spring: Springs
    end_stops: EndStops
    elasticity: Elasticity = Field(default_factory=lambda: RIGID, validate_default=True)
    cogging: Cogging = Field(default_factory=lambda: NO_COGGING)
    winding: Windings = Field(default_factory=lambda: COLD, validate_default=True)
    current_sensor: CurrentSensor = Field(
        default_factory=lambda: IDEAL_SENSOR, validate_default=True
    )

    @field_validator("elasticity", "winding", "current_sensor")
    @classmethod
    def _spread(cls, block: AnyModel, info: ValidationInfo) -> AnyModel:
        """Give each drive the single value of a list."""
        transmission = info.data.get("transmission")
        if transmission is None:
            return block
        count = len(transmission.gear)
        single = {
            key: values * count
            for key, values in block
            if isinstance(values, tuple) and len(values) == 1
        }
        return block.model_copy(update=single)

    @model_validator(mode="after")
    def _check_counts(self) -> DriveParameters:
        joints = len(self.transmission.gear)
        with as_refusal():
            turns = self.turning.turns
        if len(turns) != joints:
            raise refusal(
                "transmission.coupling",
                turns.tolist(),
                f"{joints} rows and columns, as many as gear has numbers",
            )
        check_counts(
            [block for block in self if block[0] != "cogging"], joints, "transmission.gear"
        )
        if any(len(row) != joints for row in self.cogging.amplitude):
            raise refusal(
                "cogging.amplitude",
                self.cogging.amplitude,
                f"rows of {joints} numbers, one for each motor",
            )
        for i in np.flatnonzero(self.elasticity.elastic):
            if self.rotor_inertia[i] == 0.0:
                raise refusal(
                    f"transmission.rotor_inertia[{i}]",
                    0.0,
                    "a number > 0 where the drive is elastic",
                )
        return self

    @model_serializer(mode="wrap")
    def _without_ideal_blocks(self, write: SerializerFunctionWrapHandler) -> dict[str, Any]:
        ideal = [name for name, block in self if name in _OPTIONAL and not block.used]
        return {name: value for name, value in write(self).items() if name not in ideal}

    @cached_property
    def turning(self) -> Coupling:
        """Return which joints each motor turns with."""
        rows = self.transmission.coupling
        return Coupling(np.array(rows)) if rows else Coupling.usual(len(self.transmission.gear))

    @cached_property
    def gear(self) -> Array:
        """Return motor revolutions per joint revolution, negative where they turn against each other."""
        return np.array(self.transmission.gear)

    @cached_property
    def rotor_inertia(self) -> Array:
        """Return the rotors' inertia seen from the joint, kg m^2."""
        return np.array(self.transmission.rotor_inertia)

    @cached_property
    def torque_constant(self) -> Array:
        """Return motor torque per current, motor side, Nm/A."""
        return np.array(self.motor.torque_constant)

    @cached_property
    def peak_current(self) -> Array:
        """Return the most that the amplifiers give, A."""
        return np.array(self.motor.peak_current)

    @property
    def encoder_counts(self) -> int:
        """Return the counts of an encoder per motor revolution."""
        return self.encoder.counts_per_revolution

    @property
    def velocity_bandwidth(self) -> float:
        """Return the bandwidth of the drives' velocity observer, Hz."""
        return self.encoder.velocity_bandwidth

    @cached_property
    def spring_torque(self) -> Array:
        """Return the amplitudes k of the torques -k sin(q) on the joints, Nm."""
        return np.array(self.spring.torque)

    @property
    def peak_torque(self) -> Array:
        """Return the most that each motor gives, motor side, Nm, shape (n,)."""
        return self.torque_constant * self.peak_current

    @property
    def motor_heat(self) -> Array:
        """Return the heat of windings at their reference temperature, W for the square of the torque in Nm, (n,)."""
        return self.winding.resistance / self.torque_constant**2

    @property
    def rotor_matrix(self) -> Array:
        """Return the rotors' share of the mass matrix, kg m^2, shape (n, n)."""
        return self.turning.coupled(self.rotor_inertia)


_OPTIONAL = ("elasticity", "cogging", "winding", "current_sensor")
"""The blocks of what is ideal if it is left out."""


def load_drives(path: Path) -> DriveParameters:
    """Read a drives file."""
    return read_model(DriveParameters, path)
