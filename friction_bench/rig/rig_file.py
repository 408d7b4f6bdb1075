"""The rig file: scales, limits and default ramps of a rig, and the plant of an emulated one."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

from friction_bench.protocol.errors import RigInputError
from friction_bench.protocol.messages import HelloReply
from friction_bench.rig.plant import JointFriction, PlantParameters
from rx90_common.base.config import load_yaml
from rx90_common.base.entries import LEFT_OUT, Integer, Number, Numbers, Switch
from rx90_common.base.groups import Group, Variants
from rx90_common.base.section import Section
from rx90_common.friction.element import ELEMENT, FrictionElement
from rx90_common.friction.friction_file import read_element
from rx90_common.friction.friction_set import refuse_parts

CODES = 255
"""Highest code of both converters."""
RAMP_FRACTION = 256
"""The firmware's ramp counts in 1/256 of a DAC code per tick."""
MAX_RAMP_STEP = 0x1000
TRAVEL_UNIT = 256


_least_0 = partial(Number, low=0.0)
_positive = partial(Number, low=0.0, above=True)

_EMULATION = Group(
    "The plant of an emulated rig; a rig without it cannot be emulated.",
    keys={
        "motor": Group(
            "The motor.",
            keys={
                "torque_constant": _positive("Torque per current.", "Nm/A"),
                "resistance": _positive("Resistance of the winding.", "ohm"),
                "supply": _positive("Supply voltage.", "V"),
                "rotor_inertia": _positive("Rotor inertia, motor side.", "kg m^2"),
            },
        ),
        "amplifier": Group(
            "The amplifier.",
            keys={
                "gain_error": _least_0("Relative standard deviation of the gain, drawn once per rig.", "1", high=0.2),
                "torque_noise": _least_0("Standard deviation of 1 ms means of the torque.", "Nm"),
                "adc_noise": _least_0("Standard deviation of a reading.", "Nm"),
            },
        ),
        "load_inertia": _least_0("Inertia of the load shaft alone, load side.", "kg m^2"),
        "joint_inertia": _least_0("Inertia that the joint adds, load side.", "kg m^2"),
        "motor_friction": Group(
            "Friction of motor, brushes, gear and bearings, motor side.",
            keys={
                "coulomb": _least_0("Coulomb friction.", "Nm"),
                "viscous": _positive("Viscous friction.", "Nm s/rad"),
            },
        ),
        "joint_friction": Variants(
            "Friction of the joint, load side.",
            key="model",
            groups={
                "coulomb_viscous": Group(
                    "Coulomb and viscous friction.",
                    keys={
                        "coulomb": _least_0("Coulomb friction.", "Nm"),
                        "viscous": _least_0("Viscous friction.", "Nm s/rad"),
                    },
                ),
                "lugre": Group("A LuGre element.", keys={"lugre": ELEMENT}),
            },
        ),
    },
    default=LEFT_OUT,
)

RIG = Group(
    "A friction rig: scales, limits and default ramps; motor side unless a key says load.",
    keys={
        "counts_per_revolution": Integer("Encoder counts per turn of the motor.", low=1, high=65535),
        "counts_down": Switch(
            "Whether the counts go down when the motor turns back; a firmware built with COUNTS_DOWN does that.",
            default=False,
        ),
        "tick_us": Integer("Period of the firmware's reports.", "us", low=1000, high=65535),
        "baud": Integer("Rate of the serial line.", "baud", low=1200, high=1_000_000),
        "gear": Group(
            "The gear.",
            keys={
                "ratio": _positive("Motor turns per turn of the load shaft.", "1"),
                "efficiency": _positive("Efficiency.", "1", high=1.0),
                "efficiency_uncertainty": _least_0("Standard uncertainty of the efficiency.", "1", high=0.5),
            },
        ),
        "torque": Group(
            "Scales of the torque; those of the converters are built into the firmware, too.",
            keys={
                "dac_full_scale": _positive("Commanded torque at code 255.", "Nm"),
                "adc_full_scale": _positive("Measured torque at code 255.", "Nm"),
                "scale_uncertainty": _least_0("Relative standard uncertainty of the torque scale.", "1", high=0.5),
            },
        ),
        "limits": Group(
            "What stops the rig.",
            keys={
                "load_travel": _positive("Turns of the load shaft that one arming allows.", "1"),
                "speed": _positive("Highest speed of the motor.", "rad/s"),
            },
        ),
        "ramps": Group(
            "The ramps that are run by default.",
            keys={
                "slopes": Numbers("Two slopes.", "Nm/s", count=2, low=0.0, high=10.0, above=True),
                "end_torque": _positive("End torque without the joint.", "Nm"),
                "end_torque_loaded": _positive("End torque with the joint.", "Nm"),
                "repeats": Integer("Ramps of each slope.", low=1, high=1000),
            },
        ),
        "emulation": _EMULATION,
    },
)
"""What a rig file holds."""


@dataclass(frozen=True)
class RampPlan:
    """Ramps to run: slopes Nm/s, end torques Nm (motor side), repeats of each slope."""

    slopes: tuple[float, ...]
    end_torque: float
    end_torque_loaded: float
    repeats: int

    def end(self, loaded: bool) -> float:
        """Return the end torque under this load, Nm."""
        return self.end_torque_loaded if loaded else self.end_torque

    def duration(self, loaded: bool) -> float:
        """Return the time of all ramps under this load, s."""
        return self.repeats * sum(self.end(loaded) / slope for slope in self.slopes)


@dataclass(frozen=True)
class Rig:
    """A rig as its file describes it; torques in Nm and speeds in rad/s on the motor's side.

    Attributes:
        counts_per_revolution: encoder counts per turn of the motor.
        counts_down: they go down when it turns back.
        tick: period of the reports, s.
        efficiency_uncertainty: standard uncertainty of the gear's efficiency.
        scale_uncertainty: relative standard uncertainty of the torque scale.
        load_travel: turns of the load shaft that one arming allows.
        ramps: those to run by default.
        plant: of an emulated rig, None without one.
    """

    file: Path
    counts_per_revolution: int
    counts_down: bool
    tick: float
    baud: int
    gear_ratio: float
    gear_efficiency: float
    efficiency_uncertainty: float
    dac_full_scale: float
    adc_full_scale: float
    scale_uncertainty: float
    load_travel: float
    speed_limit: float
    ramps: RampPlan
    plant: PlantParameters | None

    @property
    def firmware_figures(self) -> dict[str, int]:
        """Return the figures that the firmware of an emulated rig is built for, where they are not the shipped ones."""
        if not self.counts_down:
            return {}
        return {"COUNTS_PER_REV": self.counts_per_revolution, "COUNTS_DOWN": 1, "MAX_SPEED": self.limit_codes()[1]}

    @property
    def joint_step(self) -> float:
        """Return what one count stands for at the joint, rad."""
        return math.tau / self.counts_per_revolution / self.gear_ratio

    @property
    def joint_scale(self) -> float:
        """Return the torque at the joint for 1 Nm of the motor that drives it."""
        return self.gear_ratio * self.gear_efficiency

    def torque(self, dac_code: float) -> float:
        """Return the commanded torque, Nm, of a DAC code."""
        return dac_code * self.dac_full_scale / CODES

    def measured_torque(self, adc_code: float) -> float:
        """Return the torque, Nm, that an ADC code stands for."""
        return adc_code * self.adc_full_scale / CODES

    def end_code(self, torque: float) -> int:
        """Return the DAC code nearest to `torque`, Nm."""
        return round(torque / self.dac_full_scale * CODES)

    def ramp_step(self, slope: float) -> int:
        """Return the firmware's ramp step nearest to `slope`, Nm/s.

        Raises:
            RigInputError: if the firmware cannot run that slope.
        """
        unit = self.slope_of_step(1)
        step = round(slope / unit) if math.isfinite(slope) else 0
        if not 1 <= step <= MAX_RAMP_STEP:
            raise RigInputError(f"slope {slope:g} Nm/s; accepted: {unit:.2g} to {MAX_RAMP_STEP * unit:.3g} Nm/s")
        return step

    def slope_of_step(self, step: int) -> float:
        """Return the slope, Nm/s, that the firmware runs for a ramp step."""
        return self.torque(step / RAMP_FRACTION) / self.tick

    def limit_codes(self) -> tuple[int, int]:
        """Return travel (units of 256 counts) and speed (counts per tick) for the LIMITS command."""
        travel = self.load_travel * self.gear_ratio * self.counts_per_revolution
        speed = self.speed_limit / math.tau * self.counts_per_revolution * self.tick
        return int(travel // TRAVEL_UNIT), int(speed)

    def check(self, hello: HelloReply) -> None:
        """Refuse a rig whose firmware was built for other figures than this file.

        Raises:
            RigInputError: naming the figure that differs.
        """
        pairs = (
            ("counts_per_revolution", hello.counts_per_revolution, self.counts_per_revolution),
            ("tick_us", hello.tick_us, round(self.tick * 1e6)),
            ("dac_full_scale", round(hello.dac_full_scale, 5), round(self.dac_full_scale, 5)),
            ("adc_full_scale", round(hello.adc_full_scale, 5), round(self.adc_full_scale, 5)),
        )
        for name, firmware, expected in pairs:
            if firmware != expected:
                raise RigInputError(f"{self.file}: {name} is {expected}, the rig's firmware has {firmware}")


def _friction(section: Section, content: dict[str, Any]) -> JointFriction | FrictionElement:
    if content["model"] == "lugre":
        element = read_element(section.section("lugre"))
        # A run on the rig lasts minutes, and its joint does not warm in them; temperatures are a robot's.
        held = [part for part in element.parts if part != "temperature"]
        refuse_parts({"lugre": element}, "the emulated rig", section.where("").removesuffix("lugre."), held)
        return element
    return JointFriction(content["coulomb"], content["viscous"])


def _plant(section: Section, content: dict[str, Any], gear: dict[str, Any]) -> PlantParameters:
    motor, amplifier, own = content["motor"], content["amplifier"], content["motor_friction"]
    return PlantParameters(
        gear_ratio=gear["ratio"],
        gear_efficiency=gear["efficiency"],
        **motor,
        **amplifier,
        load_inertia=content["load_inertia"],
        joint_inertia=content["joint_inertia"],
        coulomb=own["coulomb"],
        viscous=own["viscous"],
        joint=_friction(section.section("joint_friction"), content["joint_friction"]),
    )


def load_rig(path: Path) -> Rig:
    """Read a rig file.

    Raises:
        ConfigError: naming file, key, value and what is accepted.
    """
    root = load_yaml(path)
    content = RIG.read(root)
    gear, torque, limits, plant = content["gear"], content["torque"], content["limits"], content.get("emulation")
    return Rig(
        file=path,
        counts_per_revolution=content["counts_per_revolution"],
        counts_down=content["counts_down"],
        tick=content["tick_us"] * 1e-6,
        baud=content["baud"],
        gear_ratio=gear["ratio"],
        gear_efficiency=gear["efficiency"],
        efficiency_uncertainty=gear["efficiency_uncertainty"],
        dac_full_scale=torque["dac_full_scale"],
        adc_full_scale=torque["adc_full_scale"],
        scale_uncertainty=torque["scale_uncertainty"],
        load_travel=limits["load_travel"],
        speed_limit=limits["speed"],
        ramps=RampPlan(**content["ramps"]),
        plant=None if plant is None else _plant(root.section("emulation"), plant, gear),
    )
