"""The rig file: scales, limits and default ramps of a rig, and the plant of an emulated one."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Annotated, ClassVar, TypeVar

from friction_bench.rig.messages import HelloReply, RigInputError
from rx90_common.base.arrays import Array
from rx90_common.base.config import load_yaml
from rx90_common.base.declared import Declared
from rx90_common.base.entries import LEFT_OUT, Integer, Number, Numbers, Switch
from rx90_common.base.errors import ConfigError
from rx90_common.base.groups import Group, Variants
from rx90_common.base.models import refusals
from rx90_common.friction.element import FrictionElement
from rx90_common.friction.friction_file import refuse_parts

CODES = 255
"""Highest code of both converters."""
HIGHEST_END = 239
"""Up to which code ramps go where the torque limit is lifted."""
LARGEST_SCALE = 6.5535
"""Largest full scale that the greeting of a firmware with the limit lifted can state, Nm."""
RAMP_FRACTION = 256
"""The firmware's ramp counts in 1/256 of a DAC code per tick."""
MAX_RAMP_STEP = 0x1000
TRAVEL_UNIT = 256
NORMAL_95 = 1.96  # standard deviations of half a 95 % interval

Value = TypeVar("Value", float, Array)
_least_0 = partial(Number, low=0.0)
_positive = partial(Number, low=0.0, above=True)


@dataclass(frozen=True)
class JointFriction(Declared):
    """Coulomb and viscous friction of the revolute joint at the load: Nm and Nm s/rad."""

    about: ClassVar[str] = "Coulomb and viscous friction."

    coulomb: Annotated[float, _least_0("Coulomb friction.", "Nm")]
    viscous: Annotated[float, _least_0("Viscous friction.", "Nm s/rad")]


_JOINT_FRICTION = Variants(
    "Friction of the joint, load side.",
    key="model",
    groups={
        "coulomb_viscous": JointFriction.group(),
        "lugre": Group("A LuGre element.", keys={"lugre": Group("LuGre.", keys={}, known=False)}),
    },
)


@dataclass(frozen=True)
class PlantParameters(Declared):
    """The parameters of the emulated rig; motor side, SI, unless a declaration says load side."""

    about: ClassVar[str] = "The plant of an emulated rig; a rig without it cannot be emulated."
    blocks: ClassVar[Mapping[str, str]] = {
        "motor": "The motor.",
        "amplifier": "The amplifier.",
        "motor_friction": "Friction of motor, brushes, gear and bearings, motor side.",
    }

    torque_constant: Annotated[float, _positive("Torque per current.", "Nm/A"), "motor.torque_constant"]
    resistance: Annotated[float, _positive("Resistance of the winding.", "ohm"), "motor.resistance"]
    supply: Annotated[float, _positive("Supply voltage.", "V"), "motor.supply"]
    rotor_inertia: Annotated[float, _positive("Rotor inertia, motor side.", "kg m^2"), "motor.rotor_inertia"]
    gain_error: Annotated[
        float,
        _least_0("Relative standard deviation of the gain, drawn once per rig.", "1", high=0.2),
        "amplifier.gain_error",
    ]
    torque_noise: Annotated[
        float, _least_0("Standard deviation of 1 ms means of the torque.", "Nm"), "amplifier.torque_noise"
    ]
    adc_noise: Annotated[float, _least_0("Standard deviation of a reading.", "Nm"), "amplifier.adc_noise"]
    load_inertia: Annotated[float, _least_0("Inertia of the load shaft alone, load side.", "kg m^2")]
    joint_inertia: Annotated[float, _least_0("Inertia that the joint adds, load side.", "kg m^2")]
    coulomb: Annotated[float, _least_0("Coulomb friction.", "Nm"), "motor_friction.coulomb"]
    viscous: Annotated[float, _positive("Viscous friction.", "Nm s/rad"), "motor_friction.viscous"]
    joint: Annotated[JointFriction | FrictionElement, _JOINT_FRICTION, "joint_friction"]
    warming: Annotated[
        float,
        Number(
            "Relative change of the viscous friction with the joint coupled: a warm motor.", "1", low=-0.5, high=0.5
        ),
        "motor_friction.warming",
    ] = 0.0
    ramp_error: Annotated[
        float,
        _least_0("Relative standard deviation of the torque, drawn for each ramp.", "1", high=0.2),
        "amplifier.ramp_error",
    ] = 0.0
    off_time: Annotated[
        float,
        _least_0("For which each tick of a ramp switches the stage off; the firmware is built PULSED.", "s", high=1e-3),
        "amplifier.off_time",
    ] = 0.0
    joint_spread: Annotated[
        float,
        _least_0("Relative standard deviation of the joint's Coulomb friction, drawn for each ramp.", "1", high=0.3),
    ] = 0.0


@dataclass(frozen=True)
class RampPlan:
    """Ramps to run: slopes Nm/s, end torques Nm (motor side), repeats of each slope, hold of the end torque, s."""

    slopes: tuple[float, ...]
    end_torque: float
    end_torque_loaded: float
    repeats: int
    hold: float = 0.0

    def end(self, loaded: bool) -> float:
        """Return the end torque under this load, Nm."""
        return self.end_torque_loaded if loaded else self.end_torque

    def duration(self, loaded: bool) -> float:
        """Return the time of all ramps under this load, s."""
        return self.repeats * sum(self.end(loaded) / slope + self.hold for slope in self.slopes)


_RAMPS = Group(
    "The ramps that are run by default.",
    keys={
        "slopes": Numbers("Two slopes.", "Nm/s", count=2, low=0.0, high=10.0, above=True),
        "end_torque": _positive("End torque without the joint.", "Nm"),
        "end_torque_loaded": _positive("End torque with the joint.", "Nm"),
        "repeats": Integer("Ramps of each slope.", low=1, high=1000),
        "hold": Number("How long the firmware holds the end torque.", "s", low=0.0, high=5.0, default=0.0),
    },
)


@dataclass(frozen=True, kw_only=True)
class Rig(Declared):
    """A rig as its file describes it; torques in Nm and speeds in rad/s on the motor's side.

    Attributes:
        ramps: those to run by default.
        plant: of an emulated rig, None without one.
    """

    about: ClassVar[str] = "A friction rig: scales, limits and default ramps; motor side unless a key says load."
    blocks: ClassVar[Mapping[str, str]] = {
        "gear": "The gear.",
        "torque": "Scales of the torque; those of the converters are built into the firmware, too.",
        "limits": "What stops the rig.",
    }

    file: Path
    counts_per_revolution: Annotated[int, Integer("Encoder counts per turn of the motor.", low=1, high=65535)]
    tick_us: Annotated[int, Integer("Period of the firmware's reports.", "us", low=1000, high=65535)]
    baud: Annotated[int, Integer("Rate of the serial line.", "baud", low=1200, high=1_000_000)]
    gear_ratio: Annotated[float, _positive("Motor turns per turn of the load shaft.", "1"), "gear.ratio"]
    gear_efficiency: Annotated[float, _positive("Efficiency.", "1", high=1.0), "gear.efficiency"]
    efficiency_uncertainty: Annotated[
        float, _least_0("Standard uncertainty of the efficiency.", "1", high=0.5), "gear.efficiency_uncertainty"
    ]
    dac_full_scale: Annotated[float, _positive("Commanded torque at code 255.", "Nm"), "torque.dac_full_scale"]
    adc_full_scale: Annotated[float, _positive("Measured torque at code 255.", "Nm"), "torque.adc_full_scale"]
    scale_uncertainty: Annotated[
        float,
        _least_0("Relative standard uncertainty of the torque scale.", "1", high=0.5),
        "torque.scale_uncertainty",
    ]
    load_travel: Annotated[
        float, _positive("Turns of the load shaft that one arming allows.", "1"), "limits.load_travel"
    ]
    speed_limit: Annotated[float, _positive("Highest speed of the motor.", "rad/s"), "limits.speed"]
    limit_lifted: Annotated[
        bool,
        Switch(
            f"Whether the firmware is built for this file's scales and ramps up to code {HIGHEST_END}; torques above "
            "0.18 Nm may damage the motor."
        ),
        "torque.limit_lifted",
    ] = False
    ramps: Annotated[RampPlan, _RAMPS]
    plant: Annotated[PlantParameters | None, PlantParameters.group(LEFT_OUT), "emulation"] = None

    @property
    def tick(self) -> float:
        """Return the period of the reports, s."""
        return self.tick_us * 1e-6

    @property
    def hold_ticks(self) -> int:
        """Return for how many ticks the firmware holds the end torque of a ramp."""
        return round(self.ramps.hold / self.tick)

    @property
    def firmware_figures(self) -> dict[str, int]:
        """Return the figures that the firmware of an emulated rig is built for, where they are not the shipped ones."""
        figures: dict[str, int] = {}
        if self.limit_lifted:
            scales = {"DAC_FULL_SCALE": self.dac_full_scale, "ADC_FULL_SCALE": self.adc_full_scale}
            figures |= {name: round(scale * 1e4) for name, scale in scales.items()}
            figures |= {"SCALE_UNIT": 100, "TORQUE_LIMIT_CODE": HIGHEST_END, "CURRENT_LIMIT_CODE": CODES - 1}
        if self.ramps.hold:
            figures["HOLD_TICKS"] = self.hold_ticks
        if self.plant is not None and self.plant.off_time:
            figures["PULSED"] = 1
        return figures

    @property
    def angle_step(self) -> float:
        """Return the motor angle of one count, rad."""
        return math.tau / self.counts_per_revolution

    @property
    def joint_scale(self) -> float:
        """Return the torque at the joint for 1 Nm of the motor that drives it."""
        return self.gear_ratio * self.gear_efficiency

    @property
    def joint_scale_uncertainty(self) -> float:
        """Return the relative standard uncertainty of all torques at the joint: calibrated scale and efficiency."""
        return math.hypot(self.scale_uncertainty, self.efficiency_uncertainty / self.gear_efficiency)

    @property
    def joint_side_reason(self) -> str:
        """Return in words why intervals are wider on the joint's side of the gear."""
        efficiency = self.gear_efficiency
        error = self.efficiency_uncertainty
        share = 100.0 * NORMAL_95 * error / efficiency
        return (
            f"torques are carried over by the gear's efficiency, {efficiency:g} ± {error:g} (standard uncertainty, of "
            f"the rig file), which alone makes 95 % intervals of ± {share:.2g} %"
        )

    def torque(self, dac_code: Value) -> Value:
        """Return the commanded torque, Nm, of a DAC code or an array of them."""
        return dac_code * self.dac_full_scale / CODES

    def measured_torque(self, adc_code: Value) -> Value:
        """Return the torque, Nm, for an ADC code or an array of them."""
        return adc_code * self.adc_full_scale / CODES

    def end_code(self, torque: float) -> int:
        """Return the DAC code nearest to `torque`, Nm."""
        return round(torque / self.dac_full_scale * CODES)

    def ramp_step(self, slope: float) -> int:
        """Return the firmware's ramp step nearest to `slope`, Nm/s."""
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
        """Refuse a rig whose firmware was built for other figures than this file."""
        pairs: list[tuple[str, float, float]] = [
            ("counts_per_revolution", self.counts_per_revolution, hello.counts_per_revolution),
            ("tick_us", self.tick_us, hello.tick_us),
            ("dac_full_scale", round(self.dac_full_scale, 5), round(hello.dac_full_scale, 5)),
            ("adc_full_scale", round(self.adc_full_scale, 5), round(hello.adc_full_scale, 5)),
            ("ramps.hold, in ticks,", self.hold_ticks, hello.hold_ticks),
        ]
        if self.plant is not None:  # the file of a rig that cannot be emulated does not contain it
            pairs.append(("emulation.amplifier.off_time > 0", self.plant.off_time > 0.0, hello.pulsed))
        for name, expected, firmware in pairs:
            if firmware != expected:
                raise RigInputError(f"{self.file}: {name} is {expected}, the rig's firmware has {firmware}")


RIG = Rig.group()
"""What a rig file holds."""


def load_rig(path: Path) -> Rig:
    """Read a rig file."""
    root = load_yaml(path)
    content = RIG.read(root)
    plant = None
    for name in ("dac_full_scale", "adc_full_scale"):
        if content["torque"]["limit_lifted"] and content["torque"][name] > LARGEST_SCALE:
            found = f"{root.where('')}torque.{name} is {content['torque'][name]:g}"
            raise ConfigError(f"{found}; accepted with limit_lifted: at most {LARGEST_SCALE} Nm")
    if "emulation" in content:
        friction = content["emulation"]["joint_friction"]
        if friction["model"] == "lugre" and content["emulation"]["joint_spread"]:
            found = f"{root.where('')}emulation.joint_spread is {content['emulation']['joint_spread']:g}"
            raise ConfigError(f"{found}; accepted: 0, because a LuGre element has a scatter of its own")
        joint: JointFriction | FrictionElement
        if friction["model"] == "lugre":
            section = root.section("emulation").section("joint_friction").section("lugre")
            with refusals(FrictionElement, section.where("")[:-1], section.content):
                joint = FrictionElement.model_validate(section.content)
            # A run on the rig lasts minutes, and its joint does not warm in them; temperatures are a robot's.
            held = [part for part in joint.parts if part != "temperature"]
            refuse_parts({"lugre": joint}, "the emulated rig", section.where("").removesuffix("lugre."), held)
        else:
            joint = JointFriction.of_file({key: value for key, value in friction.items() if key != "model"})
        plant = PlantParameters.of_file(content["emulation"], joint=joint)
    return Rig.of_file(content, file=path, ramps=RampPlan(**content["ramps"]), plant=plant)
