"""Data of the six servo drives: gear, rotor, torque constant, amplifier, encoder, brake."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import MISSING, dataclass, field, fields
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from rx90_common.base.arrays import Array
from rx90_common.base.config import load_yaml
from rx90_common.base.entries import Integer, Number, Numbers
from rx90_common.base.errors import ConfigError
from rx90_common.base.groups import Group
from rx90_common.description.cogging import COGGING, Cogging
from rx90_common.description.current_sensor import CURRENT_SENSOR, CurrentSensor
from rx90_common.description.elasticity import ELASTICITY, Elasticity
from rx90_common.description.winding import WINDING, Windings
from rx90_common.description.wrist import coupled_inertia

_six = partial(Numbers, count=6, low=0.0)

DRIVES = Group(
    "Drives of an arm with six joints: lists of six values, motor 6 drives joints 5 and 6 together.",
    keys={
        "transmission": Group(
            "Gears and rotors.",
            keys={
                "gear": Numbers(
                    "Motor revolutions per joint revolution; negative where they turn against each other.",
                    count=6, nonzero=True,
                ),
                "rotor_inertia": _six("Rotor inertia seen from the joint (armature).", "kg m^2"),
            },
        ),
        "motor": Group(
            "Motors and amplifiers.",
            keys={
                "torque_constant": _six("Motor torque per current, motor side.", "Nm/A", above=True),
                "peak_current": _six("The most that the amplifier gives.", "A", above=True),
            },
        ),
        "encoder": Group(
            "Encoders of all motors.",
            keys={
                "counts_per_revolution": Integer("Encoder counts per motor revolution.", low=16, high=2**30),
                "velocity_bandwidth": Number(
                    "Bandwidth of the drive's velocity observer.", "Hz", low=0.0, above=True
                ),
            },
        ),
        "brake": Group(
            "Closed brakes, joint side.",
            keys={
                "torque": _six("What the brake holds at most.", "Nm", above=True),
                "stiffness": _six("Stiffness of the closed brake.", "Nm/rad", above=True),
                "damping": _six("Damping of the closed brake.", "Nm s/rad"),
            },
        ),
        "spring": Group(
            "Gravity-compensation springs.",
            keys={"torque": _six("Amplitude k of the torque -k sin(q) on each joint; 0 for none.", "Nm")},
        ),
        "end_stops": Group(
            "Mechanical end stops, joint side.",
            keys={
                "stiffness": _six("Stiffness of the end stops.", "Nm/rad"),
                "damping": _six("Damping of the end stops.", "Nm s/rad"),
            },
        ),
        "elasticity": ELASTICITY,
        "cogging": COGGING,
        "winding": WINDING,
        "current_sensor": CURRENT_SENSOR,
    },
)  # fmt: skip
"""What a drives file holds."""


@dataclass(frozen=True)
class DriveParameters:
    """Six drives; every array has shape (6,), motor 6 drives joints 5 and 6 together.

    Attributes:
        gear: motor revolutions per joint revolution; negative where they turn against each other.
        rotor_inertia: rotor inertia seen from the joint, kg m^2 (armature).
        torque_constant: motor torque per current, motor side, Nm/A.
        peak_current: the most the amplifier gives, A.
        encoder_counts: encoder counts per motor revolution.
        velocity_bandwidth: bandwidth of the drive's velocity observer, Hz.
        brake_torque: what the brake holds at most, joint side, Nm.
        brake_stiffness: stiffness of the closed brake, joint side, Nm/rad.
        brake_damping: damping of the closed brake, joint side, Nm s/rad.
        spring_torque: gravity-compensation springs: torque -k sin(q) on each joint, amplitude k, Nm; 0 for none.
        stop_stiffness: stiffness of the mechanical end stops, Nm/rad.
        stop_damping: damping of the mechanical end stops, Nm s/rad.
        elasticity: between the motors and what they move; rigid if left out.
        cogging: torque by the angle of the motors; none if left out.
        winding: temperatures of the windings; as warm as they are if left out.
        current_sensor: errors of the current sensors; none if left out.
    """

    gear: Array
    rotor_inertia: Array
    torque_constant: Array
    peak_current: Array
    encoder_counts: Array
    velocity_bandwidth: float
    brake_torque: Array
    brake_stiffness: Array
    brake_damping: Array
    spring_torque: Array
    stop_stiffness: Array
    stop_damping: Array
    elasticity: Elasticity = field(default_factory=Elasticity)
    cogging: Cogging = field(default_factory=Cogging)
    winding: Windings = field(default_factory=Windings)
    current_sensor: CurrentSensor = field(default_factory=CurrentSensor)

    def __post_init__(self) -> None:
        for name in (one.name for one in fields(self) if one.default_factory is MISSING):
            value = np.asarray(getattr(self, name))
            accepted, wrong = ("other than 0", value == 0) if name == "gear" else (">= 0", value < 0)
            if not np.all(np.isfinite(value)) or np.any(wrong):
                raise ConfigError(f"{name} is {value.tolist()}; accepted: finite numbers {accepted}")
            shape = () if name == "velocity_bandwidth" else (6,)
            if value.shape != shape:
                raise ConfigError(f"{name} has shape {value.shape}; accepted: {shape}")
        for i in np.flatnonzero(self.elasticity.elastic & (np.asarray(self.rotor_inertia) == 0)):
            raise ConfigError(f"rotor_inertia[{i}] is 0; accepted: a number > 0 where the drive is elastic")
        for name in ("torque_constant", "peak_current", "encoder_counts", "velocity_bandwidth"):
            if np.any(np.asarray(getattr(self, name)) <= 0):
                raise ConfigError(f"{name} is {getattr(self, name)}; accepted: numbers > 0")

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


def load_drives(path: Path) -> DriveParameters:
    """Read a drives file.

    Raises:
        ConfigError: naming file, key, value and accepted range.
    """
    root = load_yaml(path)
    content = DRIVES.read(root)
    try:
        return _parameters(content)
    except ConfigError as error:
        raise ConfigError(f"{root.where('')[:-2]}: {error}") from error


def _parameters(content: Mapping[str, Any]) -> DriveParameters:
    def six(block: str, key: str) -> Array:
        return np.array(content[block][key])

    return DriveParameters(
        gear=six("transmission", "gear"),
        rotor_inertia=six("transmission", "rotor_inertia"),
        torque_constant=six("motor", "torque_constant"),
        peak_current=six("motor", "peak_current"),
        encoder_counts=np.array([content["encoder"]["counts_per_revolution"]] * 6, float),
        velocity_bandwidth=content["encoder"]["velocity_bandwidth"],
        brake_torque=six("brake", "torque"),
        brake_stiffness=six("brake", "stiffness"),
        brake_damping=six("brake", "damping"),
        spring_torque=six("spring", "torque"),
        stop_stiffness=six("end_stops", "stiffness"),
        stop_damping=six("end_stops", "damping"),
        elasticity=Elasticity.of_file(content.get("elasticity")),
        cogging=Cogging.of_file(content.get("cogging")),
        winding=Windings.of_file(content.get("winding")),
        current_sensor=CurrentSensor.of_file(content.get("current_sensor")),
    )
