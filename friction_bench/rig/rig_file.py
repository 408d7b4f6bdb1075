"""The rig file: scales, limits and default ramps of a rig, and the plant of an emulated one."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Annotated, Literal, TypeVar

from pydantic import Field, model_validator

from friction_bench.rig.messages import HelloReply, RigInputError
from rx90_common.base.arrays import Array
from rx90_common.base.models import FileModel, NotNegative, Positive, quantity, read_model, refusal
from rx90_common.friction.element import FrictionElement

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


class JointFriction(FileModel):
    """Coulomb and viscous friction of the revolute joint at the load."""

    model: Literal["coulomb_viscous"]
    coulomb: Annotated[NotNegative, quantity("Nm", "Coulomb friction.")]
    viscous: Annotated[NotNegative, quantity("Nm s/rad", "Viscous friction.")]


class LuGreJoint(FileModel):
    """A LuGre element of the revolute joint at the load."""

    model: Literal["lugre"]
    lugre: FrictionElement

    @model_validator(mode="after")
    def _check_parts(self) -> LuGreJoint:
        # A run on the rig lasts minutes, and its joint does not warm in them; temperatures are a robot's.
        if self.lugre.temperature is not None:
            raise ValueError(
                "lugre.temperature: the emulated rig cannot hold this part; accepted: left out"
            )
        return self


class Motor(FileModel):
    """The motor."""

    torque_constant: Annotated[Positive, quantity("Nm/A", "Torque per current.")]
    resistance: Annotated[Positive, quantity("ohm", "Resistance of the winding.")]
    supply: Annotated[Positive, quantity("V", "Supply voltage.")]
    rotor_inertia: Annotated[Positive, quantity("kg m^2", "Rotor inertia, motor side.")]


class Amplifier(FileModel):
    """The amplifier."""

    gain_error: Annotated[
        NotNegative,
        quantity("1", "Relative standard deviation of the gain, drawn once per rig.", le=0.2),
    ]
    torque_noise: Annotated[
        NotNegative, quantity("Nm", "Standard deviation of 1 ms means of the torque.")
    ]
    adc_noise: Annotated[NotNegative, quantity("Nm", "Standard deviation of a reading.")]
    ramp_error: Annotated[
        NotNegative,
        quantity("1", "Relative standard deviation of the torque, drawn for each ramp.", le=0.2),
    ] = 0.0
    off_time: Annotated[
        NotNegative,
        quantity(
            "s",
            "For which each tick of a ramp switches the stage off; the firmware is built PULSED.",
            le=1e-3,
        ),
    ] = 0.0


class MotorFriction(FileModel):
    """Friction of motor, brushes, gear and bearings, motor side."""

    coulomb: Annotated[NotNegative, quantity("Nm", "Coulomb friction.")]
    viscous: Annotated[Positive, quantity("Nm s/rad", "Viscous friction.")]
    warming: Annotated[
        float,
        quantity(
            "1",
            "Relative change of the viscous friction with the joint coupled: a warm motor.",
            ge=-0.5,
            le=0.5,
        ),
    ] = 0.0


class Emulation(FileModel):
    """The plant of an emulated rig; a rig without it cannot be emulated."""

    motor: Motor
    amplifier: Amplifier
    load_inertia: Annotated[
        NotNegative, quantity("kg m^2", "Inertia of the load shaft alone, load side.")
    ]
    joint_inertia: Annotated[
        NotNegative, quantity("kg m^2", "Inertia that the joint adds, load side.")
    ]
    motor_friction: MotorFriction
    joint_friction: Annotated[
        JointFriction | LuGreJoint,
        Field(discriminator="model", description="Friction of the joint, load side."),
    ]
    joint_spread: Annotated[
        NotNegative,
        quantity(
            "1",
            "Relative standard deviation of the joint's Coulomb friction, drawn for each ramp.",
            le=0.3,
        ),
    ] = 0.0

    @model_validator(mode="after")
    def _check_spread(self) -> Emulation:
        if isinstance(self.joint_friction, LuGreJoint) and self.joint_spread:
            raise refusal(
                "joint_spread",
                self.joint_spread,
                "0, because a LuGre element has a scatter of its own",
            )
        return self

    @property
    def joint(self) -> JointFriction | FrictionElement:
        """Return the friction of the joint, load side."""
        if isinstance(self.joint_friction, LuGreJoint):
            return self.joint_friction.lugre
        return self.joint_friction


class RampPlan(FileModel):
    """The ramps that are run, by default those of the file."""

    slopes: Annotated[
        tuple[Annotated[float, Field(gt=0.0, le=10.0)], ...],
        Field(strict=False),
        quantity("Nm/s", "Slopes; a file has two."),
    ]
    end_torque: Annotated[Positive, quantity("Nm", "End torque without the joint.")]
    end_torque_loaded: Annotated[Positive, quantity("Nm", "End torque with the joint.")]
    repeats: Annotated[int, Field(ge=1, le=1000, description="Ramps of each slope.")]
    hold: Annotated[
        NotNegative, quantity("s", "How long the firmware holds the end torque.", le=5.0)
    ] = 0.0

    def end(self, loaded: bool) -> float:
        """Return the end torque under this load, Nm."""
        return self.end_torque_loaded if loaded else self.end_torque

    def duration(self, loaded: bool) -> float:
        """Return the time of all ramps under this load, s."""
        return self.repeats * sum(self.end(loaded) / slope + self.hold for slope in self.slopes)


class Gear(FileModel):
    """The gear."""

    ratio: Annotated[Positive, quantity("1", "Motor turns per turn of the load shaft.")]
    efficiency: Annotated[Positive, quantity("1", "Efficiency.", le=1.0)]
    efficiency_uncertainty: Annotated[
        NotNegative, quantity("1", "Standard uncertainty of the efficiency.", le=0.5)
    ]


class TorqueScales(FileModel):
    """Scales of the torque; those of the converters are built into the firmware, too."""

    dac_full_scale: Annotated[Positive, quantity("Nm", "Commanded torque at code 255.")]
    adc_full_scale: Annotated[Positive, quantity("Nm", "Measured torque at code 255.")]
    scale_uncertainty: Annotated[
        NotNegative, quantity("1", "Relative standard uncertainty of the torque scale.", le=0.5)
    ]
    limit_lifted: Annotated[
        bool,
        Field(
            description=f"Whether the firmware is built for this file's scales and ramps up to code {HIGHEST_END}; "
            "torques above 0.18 Nm may damage the motor."
        ),
    ] = False

    @model_validator(mode="after")
    def _check_scales(self) -> TorqueScales:
        scales = {"dac_full_scale": self.dac_full_scale, "adc_full_scale": self.adc_full_scale}
        for name, scale in scales.items():
            if self.limit_lifted and scale > LARGEST_SCALE:
                raise refusal(name, scale, f"with limit_lifted at most {LARGEST_SCALE} Nm")
        return self


class Limits(FileModel):
    """What stops the rig."""

    load_travel: Annotated[
        Positive, quantity("1", "Turns of the load shaft that one arming allows.")
    ]
    speed: Annotated[Positive, quantity("rad/s", "Highest speed of the motor.")]


class RigFile(FileModel):
    """A friction rig: scales, limits and default ramps; motor side unless a key says load."""

    counts_per_revolution: Annotated[
        int, Field(ge=1, le=65535, description="Encoder counts per turn of the motor.")
    ]
    tick_us: Annotated[int, quantity("us", "Period of the firmware's reports.", ge=1000, le=65535)]
    baud: Annotated[int, quantity("baud", "Rate of the serial line.", ge=1200, le=1_000_000)]
    gear: Gear
    torque: TorqueScales
    limits: Limits
    ramps: RampPlan
    emulation: Emulation | None = None

    @model_validator(mode="after")
    def _check_slopes(self) -> RigFile:
        if len(self.ramps.slopes) != 2:
            raise refusal("ramps.slopes", self.ramps.slopes, "a list of 2 numbers")
        return self


class Rig(RigFile):
    """A rig as its file describes it; torques in Nm and speeds in rad/s on the motor's side."""

    file: Path

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
        if self.torque.limit_lifted:
            figures = {
                "DAC_FULL_SCALE": round(self.torque.dac_full_scale * 1e4),
                "ADC_FULL_SCALE": round(self.torque.adc_full_scale * 1e4),
                "SCALE_UNIT": 100,
                "TORQUE_LIMIT_CODE": HIGHEST_END,
                "CURRENT_LIMIT_CODE": CODES - 1,
            }
        if self.ramps.hold:
            figures["HOLD_TICKS"] = self.hold_ticks
        if self.emulation is not None and self.emulation.amplifier.off_time:
            figures["PULSED"] = 1
        return figures

    @property
    def angle_step(self) -> float:
        """Return the motor angle of one count, rad."""
        return math.tau / self.counts_per_revolution

    @property
    def joint_scale(self) -> float:
        """Return the torque at the joint for 1 Nm of the motor that drives it."""
        return self.gear.ratio * self.gear.efficiency

    @property
    def joint_scale_uncertainty(self) -> float:
        """Return the relative standard uncertainty of all torques at the joint: calibrated scale and efficiency."""
        return math.hypot(
            self.torque.scale_uncertainty, self.gear.efficiency_uncertainty / self.gear.efficiency
        )

    @property
    def joint_side_reason(self) -> str:
        """Return in words why intervals are wider on the joint's side of the gear."""
        efficiency = self.gear.efficiency
        error = self.gear.efficiency_uncertainty
        share = 100.0 * NORMAL_95 * error / efficiency
        return (
            f"torques are carried over by the gear's efficiency, {efficiency:g} ± {error:g} (standard uncertainty, of "
            f"the rig file), which alone makes 95 % intervals of ± {share:.2g} %"
        )

    def commanded_torque(self, dac_code: Value) -> Value:
        """Return the commanded torque, Nm, of a DAC code or an array of them."""
        return dac_code * self.torque.dac_full_scale / CODES

    def measured_torque(self, adc_code: Value) -> Value:
        """Return the torque, Nm, for an ADC code or an array of them."""
        return adc_code * self.torque.adc_full_scale / CODES

    def end_code(self, torque: float) -> int:
        """Return the DAC code nearest to `torque`, Nm."""
        return round(torque / self.torque.dac_full_scale * CODES)

    def ramp_step(self, slope: float) -> int:
        """Return the firmware's ramp step nearest to `slope`, Nm/s."""
        unit = self.slope_of_step(1)
        step = round(slope / unit) if math.isfinite(slope) else 0
        if not 1 <= step <= MAX_RAMP_STEP:
            raise RigInputError(
                f"slope {slope:g} Nm/s; accepted: {unit:.2g} to {MAX_RAMP_STEP * unit:.3g} Nm/s"
            )
        return step

    def slope_of_step(self, step: int) -> float:
        """Return the slope, Nm/s, that the firmware runs for a ramp step."""
        return self.commanded_torque(step / RAMP_FRACTION) / self.tick

    def limit_codes(self) -> tuple[int, int]:
        """Return travel (units of 256 counts) and speed (counts per tick) for the LIMITS command."""
        travel = self.limits.load_travel * self.gear.ratio * self.counts_per_revolution
        speed = self.limits.speed / math.tau * self.counts_per_revolution * self.tick
        return int(travel // TRAVEL_UNIT), int(speed)

    def check(self, hello: HelloReply) -> None:
        """Refuse a rig whose firmware was built for other figures than this file."""
        pairs: list[tuple[str, float, float]] = [
            ("counts_per_revolution", self.counts_per_revolution, hello.counts_per_revolution),
            ("tick_us", self.tick_us, hello.tick_us),
            (
                "dac_full_scale",
                round(self.torque.dac_full_scale, 5),
                round(hello.dac_full_scale, 5),
            ),
            (
                "adc_full_scale",
                round(self.torque.adc_full_scale, 5),
                round(hello.adc_full_scale, 5),
            ),
            ("ramps.hold, in ticks,", self.hold_ticks, hello.hold_ticks),
        ]
        # the file of a rig that cannot be emulated does not contain it
        if self.emulation is not None:
            pairs.append(
                (
                    "emulation.amplifier.off_time > 0",
                    self.emulation.amplifier.off_time > 0.0,
                    hello.pulsed,
                )
            )
        for name, expected, firmware in pairs:
            if firmware != expected:
                raise RigInputError(
                    f"{self.file}: {name} is {expected}, the rig's firmware has {firmware}"
                )


def load_rig(path: Path) -> Rig:
    """Read a rig file."""
    return Rig(file=path, **dict(read_model(RigFile, path)))
