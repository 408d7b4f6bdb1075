"""The drives: gears with their coupling, motors, encoders, brakes, springs.

Elasticity, cogging, windings and current sensors are blocks of their own; parts missing in a file are ideal.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property, partial
from pathlib import Path
from typing import Annotated, Any

import numpy as np

from rx90_common.base.arrays import Array
from rx90_common.base.config import load_yaml
from rx90_common.base.declared import Declared
from rx90_common.base.entries import LEFT_OUT, PER_JOINT, REQUIRED, Integer, ListOf, Number, Numbers, Rows, Text
from rx90_common.base.errors import ConfigError, located
from rx90_common.base.quoting import counted, plain
from rx90_common.description.coupling import Coupling

MAX_TERMS = 8
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
    cogging; amplitudes and phases (n, motors).
    """

    name = "cogging"
    about = "Cogging torque of the motors: a Fourier series in the motor's angle; left out: none."

    harmonic: Annotated[Array, _waves, REQUIRED] = field(default_factory=lambda: np.zeros(0))
    amplitude: Annotated[Array, Rows("Amplitudes of the motors, motor side.", "Nm", count=PER_JOINT), REQUIRED] = field(
        default_factory=lambda: np.zeros((0, 1))
    )
    phase: Annotated[
        Array,
        Rows(
            "Phases of the cosines where the motors are at 0; 0 where they are left out.", "rad",
            count=PER_JOINT, default=LEFT_OUT,
        ),
    ] = field(default_factory=lambda: np.zeros((0, 1)))  # fmt: skip

    def __post_init__(self) -> None:
        super().__post_init__()
        terms = len(self.harmonic)
        if terms > MAX_TERMS:
            raise ConfigError(f"cogging: harmonic has {counted(terms, 'number')}; accepted: up to {MAX_TERMS}")
        shape = terms, np.shape(self.amplitude)[-1]
        for name in ("amplitude", "phase"):
            value = getattr(self, name)
            if np.shape(value) != shape:
                raise ConfigError(f"cogging: {name} is {value.tolist()}; accepted: numbers of shape {shape}")

    @classmethod
    def of_file(cls, content: Mapping[str, Any] | None, **fields: Any) -> Cogging:
        """Return the content of a block of a drives file; none for none."""
        phases = (
            {} if content is None else {"phase": ((0.0,) * len(content["amplitude"][0]),) * len(content["amplitude"])}
        )
        return super().of_file(content and {**phases, **content}, **fields)

    @property
    def used(self) -> bool:
        """Return whether any motor cogs."""
        return bool(np.any(self.amplitude))


_amperes = partial(Numbers, unit="A", count=PER_JOINT)


@dataclass(frozen=True)
class CurrentSensor(Declared):
    """Errors of the current sensors; every array has a value for each."""

    name = "current_sensor"
    about = "Errors of the amplifiers' current sensors; left out: none."

    offset: Annotated[Array, _amperes("What a sensor shows without a current.")] = field(
        default_factory=lambda: np.zeros(1)
    )
    noise: Annotated[Array, _amperes("Standard deviation of a sample, one in each base tick.", low=0.0)] = field(
        default_factory=lambda: np.zeros(1)
    )
    resolution: Annotated[Array, _amperes("Step of the converter; 0 for none.", low=0.0)] = field(
        default_factory=lambda: np.zeros(1)
    )
    bandwidth: Annotated[
        float,
        Number("Bandwidth of the current loop, through which the errors act on the torque.", "Hz", low=0.0, above=True),
        REQUIRED,
    ] = 800.0

    @property
    def used(self) -> bool:
        """Return whether any sensor has an error."""
        return any(bool(np.any(error)) for error in (self.offset, self.noise, self.resolution))


COPPER = 0.00393
"""Temperature coefficient of copper's resistance at 20 degrees, 1/K (IEC 60028)."""
_ABSOLUTE_ZERO = -273.15
_above_0 = partial(Numbers, count=PER_JOINT, low=0.0, above=True)
_cold = Numbers("", count=PER_JOINT, low=0.0)
_isolated = _above_0("", infinite=True)
_degrees = partial(Number, unit="°C", low=_ABSOLUTE_ZERO, high=1000.0)
_never = Number("", low=_ABSOLUTE_ZERO, infinite=True)  # also warmer than any winding: no limit


def _endless() -> Array:
    return np.full(1, math.inf)


@dataclass(frozen=True)
class Windings(Declared):
    """A thermal node in each motor, heated by I^2 R; arrays have a value for each, temperatures in degrees Celsius.

    A resistance of 0 means windings at constant temperature. Between `derating` and `limit` the peak current
    falls linearly.
    """

    name = "winding"
    about = "Windings of the motors, a thermal node each; left out: they stay as warm as they are."

    resistance: Annotated[Array, _above_0("Resistance at the reference temperature.", "Ohm"), _cold, REQUIRED] = field(
        default_factory=lambda: np.zeros(1)
    )
    thermal_resistance: Annotated[Array, _above_0("Between winding and surroundings.", "K/W"), _isolated, REQUIRED] = (
        field(default_factory=_endless)
    )
    heat_capacity: Annotated[Array, _above_0("Of the winding.", "J/K"), _isolated, REQUIRED] = field(
        default_factory=_endless
    )
    ambient: Annotated[float, _degrees("Temperature of the surroundings."), REQUIRED] = 20.0
    initial: Annotated[
        float,
        _degrees(
            "Temperature of the windings at the start; as warm as the surroundings if left out.", default=LEFT_OUT
        ),
    ] = 20.0
    reference: Annotated[float, _degrees("Temperature at which the resistance holds.")] = 20.0
    coefficient: Annotated[float, Number("Rise of the resistance with temperature.", "1/K", low=0.0, high=0.1)] = COPPER
    derating: Annotated[
        float, _degrees("Temperature from which on the amplifier limits the current."), _never, REQUIRED
    ] = math.inf
    limit: Annotated[float, _degrees("Temperature at which it gives none."), _never, REQUIRED] = math.inf

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.used and not self.derating < self.limit:
            raise ConfigError(f"winding: derating is {self.derating:g} °C; accepted: below limit = {self.limit:g} °C")
        if self.used and not max(self.ambient, self.initial) <= self.derating:
            warm = max(self.ambient, self.initial)
            raise ConfigError(
                f"winding: derating is {self.derating:g} °C; accepted: at least {warm:g} °C, as it begins"
            )

    @property
    def used(self) -> bool:
        """Return whether any winding gets warm."""
        return bool(np.any(self.resistance))

    @classmethod
    def of_file(cls, content: Mapping[str, Any] | None, **fields: Any) -> Windings:
        """Return the content of a block of a drives file; cold windings for none."""
        return super().of_file(content and {"initial": content["ambient"], **content}, **fields)


MOTOR = "motor"
LINK = "link"
SIDES = (MOTOR, LINK)
"""Of the elasticity, on which the friction of the joints may act."""

# rad: a tooth and its gap on a wheel with 12 teeth. Gears of robots have an arc minute, 0.0003 rad, common
# planetary ones half a degree; a larger value is a wrong unit.
_MAX_PLAY = 0.5


_rigid_or_soft = _above_0(
    "Stiffness between the motor, seen through its gear, and what it moves; .inf where that is rigid.", "Nm/rad",
    infinite=True,
)  # fmt: skip
_play = Numbers(
    "Play: the way, at the joint, from one flank to the other.", "rad", count=PER_JOINT, low=0.0, high=_MAX_PLAY
)


@dataclass(frozen=True)
class Elasticity(Declared):
    """Between the motors and the links; every array has one value for each drive, joint side.

    A motor that turns with several joints has its elasticity between it and their sum: motor 6 of the RX family's wrist
    between it and q5 + q6. With play the damping acts only where the flanks touch.
    """

    name = "elasticity"
    about = "Elasticity and play of the gears, joint side; left out: rigid gears."

    stiffness: Annotated[Array, _rigid_or_soft, REQUIRED] = field(default_factory=lambda: np.full(1, math.inf))
    damping: Annotated[Array, Numbers("Damping beside the stiffness.", "Nm s/rad", count=PER_JOINT, low=0.0)] = field(
        default_factory=lambda: np.zeros(1)
    )
    backlash: Annotated[Array, _play] = field(default_factory=lambda: np.zeros(1))
    friction_side: Annotated[
        str, Text("The side on which the friction of the joints acts.", choices=SIDES), "friction"
    ] = MOTOR

    def __post_init__(self) -> None:
        super().__post_init__()
        for name, value in self.fitted(len(self.stiffness), "stiffness").__dict__.items():
            if name not in ("damping", "backlash"):
                continue
            for i in np.flatnonzero((value > 0) & np.isinf(self.stiffness)):
                found = f"elasticity: {name}[{i}] is {value[i]:g}, stiffness[{i}] infinite"
                raise ConfigError(f"{found}; accepted: 0 for a rigid drive")

    @property
    def elastic(self) -> Array:
        """Return which drives are, shape (n,), bool."""
        return np.isfinite(self.stiffness)


_six = partial(Numbers, count=PER_JOINT, low=0.0)
_positive = partial(_six, above=True)
_turns = Numbers(
    "Motor revolutions per joint revolution; negative where they turn against each other.",
    count=PER_JOINT,
    nonzero=True,
)
_coupling = Rows(
    "Turns of each motor (row) for turns of the joints (columns), without the gears; left out: each motor turns with "
    "its own joint, but of six motors the sixth with joints 5 and 6, as in the RX family.", "1",
    count=PER_JOINT, default=LEFT_OUT,
)  # fmt: skip
_counts = Integer("Encoder counts per motor revolution.", low=16, high=2**30)
_bandwidth = Number("Bandwidth of the drive's velocity observer.", "Hz", low=0.0, above=True)


@dataclass(frozen=True)
class DriveParameters(Declared):
    """The drives of an arm with 1 to 7 joints, each with a motor; every array has a value for each, shape (n,).

    A coupling lists the joints that each motor turns with. Without one each motor turns with its own joint, except in
    arms of six joints, which have the RX family's wrist: motor 6 drives joints 5 and 6 together. Brakes, springs and
    end stops are those of the joints. Elasticity, cogging, winding and
    current_sensor are ideal if they are left out.
    """

    name = "drives"
    about = "Drives of an arm with 1 to 7 joints: lists of one value for each, or for its motor."
    blocks = {  # noqa: RUF012 - a ClassVar of Declared
        "transmission": "Gears and rotors.",
        "motor": "Motors and amplifiers.",
        "encoder": "Encoders of all motors.",
        "brake": "Closed brakes, joint side.",
        "spring": "Gravity-compensation springs.",
        "end_stops": "Mechanical end stops, joint side.",
    }

    gear: Annotated[Array, _turns, "transmission.gear"]
    rotor_inertia: Annotated[
        Array, _six("Rotor inertia seen from the joint (armature).", "kg m^2"), "transmission.rotor_inertia"
    ]
    torque_constant: Annotated[
        Array, _positive("Motor torque per current, motor side.", "Nm/A"), "motor.torque_constant"
    ]
    peak_current: Annotated[Array, _positive("The most that the amplifier gives.", "A"), "motor.peak_current"]
    encoder_counts: Annotated[Array, _counts, _positive(""), "encoder.counts_per_revolution"]
    velocity_bandwidth: Annotated[float, _bandwidth, "encoder.velocity_bandwidth"]
    brake_torque: Annotated[Array, _positive("What the brake holds at most.", "Nm"), "brake.torque"]
    brake_stiffness: Annotated[Array, _positive("Stiffness of the closed brake.", "Nm/rad"), "brake.stiffness"]
    brake_damping: Annotated[Array, _six("Damping of the closed brake.", "Nm s/rad"), "brake.damping"]
    spring_torque: Annotated[
        Array, _six("Amplitude k of the torque -k sin(q) on each joint; 0 for none.", "Nm"), "spring.torque"
    ]
    stop_stiffness: Annotated[Array, _six("Stiffness of the end stops.", "Nm/rad"), "end_stops.stiffness"]
    stop_damping: Annotated[Array, _six("Damping of the end stops.", "Nm s/rad"), "end_stops.damping"]
    coupling: Annotated[Array, _coupling, "transmission.coupling"] = field(default_factory=lambda: np.zeros((0, 1)))
    elasticity: Elasticity = field(default_factory=Elasticity)
    cogging: Cogging = field(default_factory=Cogging)
    winding: Windings = field(default_factory=Windings)
    current_sensor: CurrentSensor = field(default_factory=CurrentSensor)

    def __post_init__(self) -> None:
        super().__post_init__()
        joints = len(self.gear)
        self.__dict__.update(self.fitted(joints, "gear").__dict__)
        if self.cogging.amplitude.shape[0] and self.cogging.amplitude.shape[1] != joints:
            columns = self.cogging.amplitude.shape[1]
            raise ConfigError(
                f"cogging: amplitude has rows of {counted(columns, 'number')}; accepted: {joints}, as many as gear has"
            )
        if len(self.turning.turns) != joints:
            given = self.coupling.tolist()
            raise ConfigError(f"coupling is {given}; accepted: {joints} rows and columns, as many as gear has numbers")
        for i in np.flatnonzero(self.elasticity.elastic & (np.asarray(self.rotor_inertia) == 0)):
            raise ConfigError(f"rotor_inertia[{i}] is 0; accepted: a number > 0 where the drive is elastic")

    @cached_property
    def turning(self) -> Coupling:
        """Return which joints each motor turns with."""
        return Coupling(np.array(self.coupling)) if len(self.coupling) else Coupling.usual(len(self.gear))

    @property
    def peak_torque(self) -> Array:
        """Return the most that each motor gives, motor side, Nm, shape (n,)."""
        return self.torque_constant * self.peak_current

    @property
    def motor_heat(self) -> Array:
        """Return the heat of windings at their reference temperature, W for the square of the torque in Nm, (n,)."""
        return np.asarray(self.winding.resistance / self.torque_constant**2)

    @property
    def rotor_matrix(self) -> Array:
        """Return the rotors' share of the mass matrix, kg m^2, shape (n, n)."""
        return self.turning.coupled(self.rotor_inertia)


DRIVES = DriveParameters.group()
"""What a drives file holds."""


def load_drives(path: Path) -> DriveParameters:
    """Read a drives file."""
    root = load_yaml(path)
    content = DRIVES.read(root)
    with located(plain(root.file)):
        return DriveParameters.of_file(content)
