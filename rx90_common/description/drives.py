"""Data of the six servo drives: gear, rotor, torque constant, amplifier, encoder, brake."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Annotated

import numpy as np

from rx90_common.base.arrays import Array
from rx90_common.base.config import load_yaml
from rx90_common.base.declared import Declared
from rx90_common.base.entries import Integer, Number, Numbers
from rx90_common.base.errors import ConfigError
from rx90_common.description.cogging import Cogging
from rx90_common.description.current_sensor import CurrentSensor
from rx90_common.description.elasticity import Elasticity
from rx90_common.description.winding import Windings
from rx90_common.description.wrist import coupled_inertia

_six = partial(Numbers, count=6, low=0.0)
_positive = partial(_six, above=True)
_turns = Numbers(
    "Motor revolutions per joint revolution; negative where they turn against each other.", count=6, nonzero=True
)
_counts = Integer("Encoder counts per motor revolution.", low=16, high=2**30)
_bandwidth = Number("Bandwidth of the drive's velocity observer.", "Hz", low=0.0, above=True)


@dataclass(frozen=True)
class DriveParameters(Declared):
    """Six drives; every array has shape (6,), motor 6 drives joints 5 and 6 together.

    Brakes, springs and end stops are those of the joints. What is left out of elasticity, cogging, winding and
    current_sensor is ideal.
    """

    name = "drives"
    about = "Drives of an arm with six joints: lists of six values, motor 6 drives joints 5 and 6 together."
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
    elasticity: Elasticity = field(default_factory=Elasticity)
    cogging: Cogging = field(default_factory=Cogging)
    winding: Windings = field(default_factory=Windings)
    current_sensor: CurrentSensor = field(default_factory=CurrentSensor)

    def __post_init__(self) -> None:
        super().__post_init__()
        for i in np.flatnonzero(self.elasticity.elastic & (np.asarray(self.rotor_inertia) == 0)):
            raise ConfigError(f"rotor_inertia[{i}] is 0; accepted: a number > 0 where the drive is elastic")

    @property
    def peak_torque(self) -> Array:
        """Return the most that each motor gives, motor side, Nm, shape (6,)."""
        return self.torque_constant * self.peak_current

    @property
    def motor_heat(self) -> Array:
        """Return the heat of windings at their reference temperature, W for the square of the torque in Nm, (6,)."""
        return np.asarray(self.winding.resistance / self.torque_constant**2)

    @property
    def rotor_matrix(self) -> Array:
        """Return the rotors' share of the mass matrix, kg m^2, shape (6, 6)."""
        return coupled_inertia(self.rotor_inertia)


DRIVES = DriveParameters.group()
"""What a drives file holds."""


def load_drives(path: Path) -> DriveParameters:
    """Read a drives file.

    Raises:
        ConfigError: naming file, key, value and accepted range.
    """
    root = load_yaml(path)
    content = DRIVES.read(root)
    try:
        return DriveParameters.of_file(content)
    except ConfigError as error:
        raise ConfigError(f"{root.where('')[:-2]}: {error}") from error
