"""Data of the six servo drives: gear, rotor, torque constant, amplifier, encoder, brake."""

from __future__ import annotations

from dataclasses import dataclass, fields
from pathlib import Path

import numpy as np

from rx90_common.base.arrays import Array
from rx90_common.base.config import Section, load_yaml
from rx90_common.base.errors import ConfigError
from rx90_common.description.wrist import coupled_inertia


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

    def __post_init__(self) -> None:
        for field in fields(self):
            value = np.asarray(getattr(self, field.name))
            accepted, wrong = ("other than 0", value == 0) if field.name == "gear" else (">= 0", value < 0)
            if not np.all(np.isfinite(value)) or np.any(wrong):
                raise ConfigError(f"{field.name} is {value.tolist()}; accepted: finite numbers {accepted}")
            shape = () if field.name == "velocity_bandwidth" else (6,)
            if value.shape != shape:
                raise ConfigError(f"{field.name} has shape {value.shape}; accepted: {shape}")
        for name in ("torque_constant", "peak_current", "encoder_counts", "velocity_bandwidth"):
            if np.any(np.asarray(getattr(self, name)) <= 0):
                raise ConfigError(f"{name} is {getattr(self, name)}; accepted: numbers > 0")

    @property
    def peak_torque(self) -> Array:
        """Return the most that each motor gives, motor side, Nm, shape (6,)."""
        return self.torque_constant * self.peak_current

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

    def six(block: str, key: str, low: float = 0.0, *, above: bool = True) -> Array:
        return np.array(sections[block].numbers(key, 6, low, above=above))

    blocks = ("transmission", "motor", "encoder", "brake", "spring", "end_stops")
    sections = {name: root.section(name) for name in blocks}
    parameters = DriveParameters(
        gear=_gears(sections["transmission"]),
        rotor_inertia=six("transmission", "rotor_inertia", above=False),
        torque_constant=six("motor", "torque_constant"),
        peak_current=six("motor", "peak_current"),
        encoder_counts=np.array([sections["encoder"].integer("counts_per_revolution", 16, 2**30)] * 6, float),
        velocity_bandwidth=sections["encoder"].number("velocity_bandwidth", 0.0, above=True),
        brake_torque=six("brake", "torque"),
        brake_stiffness=six("brake", "stiffness"),
        brake_damping=six("brake", "damping", above=False),
        spring_torque=six("spring", "torque", above=False),
        stop_stiffness=six("end_stops", "stiffness", above=False),
        stop_damping=six("end_stops", "damping", above=False),
    )
    for section in (*sections.values(), root):
        section.finish()
    return parameters


def _gears(section: Section) -> Array:
    gears = section.numbers("gear", 6)
    for i, gear in enumerate(gears):
        if gear == 0.0:
            section.refuse(f"gear[{i}]", gear, "6 numbers, each a finite number other than 0")
    return np.array(gears)
