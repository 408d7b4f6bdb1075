"""The rig file: scales, limits and default ramps of a rig, and the plant of an emulated one."""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path

from friction_bench.protocol.errors import RigInputError
from friction_bench.protocol.messages import HelloReply
from friction_bench.rig.plant import JointFriction, PlantParameters
from rx90_common.base.config import Section, load_yaml
from rx90_common.friction.friction_file import read_element
from rx90_common.friction.lugre import LuGreElement

CODES = 255
"""Highest code of both converters."""
RAMP_FRACTION = 256
"""The firmware's ramp counts in 1/256 of a DAC code per tick."""
MAX_RAMP_STEP = 0x1000
TRAVEL_UNIT = 256


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
        tick: period of the reports, s.
        efficiency_uncertainty: standard uncertainty of the gear's efficiency.
        scale_uncertainty: relative standard uncertainty of the torque scale.
        load_travel: turns of the load shaft that one arming allows.
        ramps: those to run by default.
        plant: of an emulated rig, None without one.
    """

    file: Path
    counts_per_revolution: int
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


def _friction(section: Section) -> JointFriction | LuGreElement:
    if section.text("model", ("coulomb_viscous", "lugre")) == "lugre":
        element = read_element(section.section("lugre"))
        section.finish()
        return element
    friction = JointFriction(section.number("coulomb", 0.0), section.number("viscous", 0.0))
    section.finish()
    return friction


def _plant(section: Section, gear_ratio: float, efficiency: float) -> PlantParameters:
    motor = section.section("motor")
    amplifier = section.section("amplifier")
    own = section.section("motor_friction")
    plant = PlantParameters(
        gear_ratio=gear_ratio,
        gear_efficiency=efficiency,
        torque_constant=motor.number("torque_constant", 0.0, above=True),
        resistance=motor.number("resistance", 0.0, above=True),
        supply=motor.number("supply", 0.0, above=True),
        rotor_inertia=motor.number("rotor_inertia", 0.0, above=True),
        gain_error=amplifier.number("gain_error", 0.0, 0.2),
        torque_noise=amplifier.number("torque_noise", 0.0),
        adc_noise=amplifier.number("adc_noise", 0.0),
        load_inertia=section.number("load_inertia", 0.0),
        joint_inertia=section.number("joint_inertia", 0.0),
        coulomb=own.number("coulomb", 0.0),
        viscous=own.number("viscous", 0.0, above=True),
        joint=_friction(section.section("joint_friction")),
    )
    for part in (motor, amplifier, own, section):
        part.finish()
    return plant


def _ramps(section: Section) -> RampPlan:
    plan = RampPlan(
        slopes=section.numbers("slopes", 2, 0.0, 10.0, above=True),
        end_torque=section.number("end_torque", 0.0, above=True),
        end_torque_loaded=section.number("end_torque_loaded", 0.0, above=True),
        repeats=section.integer("repeats", 1, 1000),
    )
    section.finish()
    return plan


def load_rig(path: Path) -> Rig:
    """Read a rig file.

    Raises:
        ConfigError: naming file, key, value and what is accepted.
    """
    root = load_yaml(path)
    gear = root.section("gear")
    torque = root.section("torque")
    limits = root.section("limits")
    ratio = gear.number("ratio", 0.0, above=True)
    efficiency = gear.number("efficiency", 0.0, 1.0, above=True)
    rig = Rig(
        file=path,
        counts_per_revolution=root.integer("counts_per_revolution", 1, 65535),
        tick=root.integer("tick_us", 1000, 65535) * 1e-6,
        baud=root.integer("baud", 1200, 1_000_000),
        gear_ratio=ratio,
        gear_efficiency=efficiency,
        efficiency_uncertainty=gear.number("efficiency_uncertainty", 0.0, 0.5),
        dac_full_scale=torque.number("dac_full_scale", 0.0, above=True),
        adc_full_scale=torque.number("adc_full_scale", 0.0, above=True),
        scale_uncertainty=torque.number("scale_uncertainty", 0.0, 0.5),
        load_travel=limits.number("load_travel", 0.0, above=True),
        speed_limit=limits.number("speed", 0.0, above=True),
        ramps=_ramps(root.section("ramps")),
        plant=_plant(root.section("emulation"), ratio, efficiency) if "emulation" in root else None,
    )
    for section in (gear, torque, limits, root):
        section.finish()
    return rig
