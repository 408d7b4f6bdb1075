"""Gains, limits and switches of the servo controllers."""

from __future__ import annotations

import math
from functools import cache, cached_property
from pathlib import Path
from typing import Annotated, TypeAlias

import numpy as np
from pydantic import Field, ValidationInfo, field_validator, model_validator

from rx90_common.base.arrays import Array, Record, record_type
from rx90_common.base.errors import ConfigError, located
from rx90_common.base.models import (
    FileModel,
    Positive,
    Row,
    RowOf,
    check_counts,
    quantity,
    read_model,
)
from rx90_common.base.quoting import plain
from rx90_common.base.rates import Rates
from rx90_common.description.coupling import ArmSize, gear_type
from rx90_common.description.drives import DriveParameters
from rx90_common.description.robot import RobotModel
from rx90_common.friction.element import ALPHA_BOUNDS
from rx90_common.kernels.elementary import exponential_less_one_of, powers
from rx90_controller.law.model import FRICTION, INVERSE_DYNAMICS, ModelFiles, model_dtype
from rx90_controller.trajectory import JointLimits


@cache
def controller_dtype(arm: ArmSize) -> np.dtype[np.void]:
    """Return the type of the constants of a control law."""
    n = arm.joints
    return record_type(
        gear=gear_type(arm),
        model=model_dtype(arm),  # feed-forward by a model of arm and friction
        proportional=n,  # motor side, Nm/rad
        integral=n,  # motor side, Nm/rad per position tick
        integrator_limit=n,  # motor side, Nm
        derivative=n,  # motor side, Nm s/rad
        inertia=n,  # motor side, kg m^2; 0 where acceleration feed-forward is off
        velocity_weight=n,  # of the velocity set-point in D; 0 where it is off
        coulomb=n,  # motor side, Nm; 0 where the compensation is off
        coulomb_velocity=n,  # motor side, rad/s
        viscous=n,  # motor side, Nm (s/rad)^exponent; 0 where the compensation is off
        viscous_exponent=n,
        torque_constant=n,
        peak_current=n,
        current_step=n,  # largest change of the amplifier's current in a tick, A
        current_gain=(),  # of the current loop per tick
        following_error=n,  # supervised, motor side, rad
        over_speed=n,  # supervised, motor side, rad/s
    )


MODEL_PARTS = ("inverse_dynamics", "friction_model")
"""Switches of the feed-forward by a model of arm and friction."""

_Inertia: TypeAlias = Annotated[float, Field(gt=0.0, le=1e5)]
_Rate: TypeAlias = Annotated[float, Field(ge=0.0, le=1e5)]
_IntegralGain: TypeAlias = Annotated[float, Field(ge=0.0, le=1e9)]
_Torque: TypeAlias = Annotated[float, Field(ge=0.0, le=1e6)]
_Exponent: TypeAlias = Annotated[float, Field(ge=ALPHA_BOUNDS[0], le=ALPHA_BOUNDS[1])]


class Servo(FileModel):
    """Gains of the loops."""

    inertia: Annotated[
        RowOf[_Inertia], quantity("kg m^2", "Nominal inertia, rotors included.", path="inertia")
    ]
    kp: Annotated[
        RowOf[_Rate], quantity("1/s", "Proportional gain of the position loop.", path="kp")
    ]
    kv: Annotated[RowOf[_Rate], quantity("1/s", "Gain of the velocity loop.", path="kv")]
    ki: Annotated[RowOf[_IntegralGain], quantity("1/s^3", "Integral gain.", path="ki")]
    integrator_limit: Annotated[
        RowOf[_Torque],
        quantity("Nm", "The most that the integrator gives.", path="integrator_limit"),
    ]


class FeedForward(FileModel):
    """What the set-points add beside PI, each term with its own switch.

    The paper's D block has the measured velocity alone (section 5, figure 4): that is `velocity=False`.
    """

    velocity: Annotated[
        bool,
        Field(
            description="The velocity set-point in the D block; the paper has the measured velocity alone."
        ),
    ]
    acceleration: Annotated[bool, Field(description="Inertia times acceleration of the set-point.")]
    coulomb: Annotated[bool, Field(description="Coulomb friction compensation.")]
    viscous: Annotated[bool, Field(description="Viscous friction compensation.")]
    inverse_dynamics: Annotated[
        bool,
        Field(
            description="Inverse dynamics of the model, weight included, in place of inertia times acceleration."
        ),
    ] = False
    friction_model: Annotated[
        bool,
        Field(
            description="Friction of the model, in place of Coulomb and viscous friction compensation."
        ),
    ] = False
    coulomb_torque: Annotated[
        RowOf[_Torque], quantity("Nm", "Coulomb friction to compensate.", path="coulomb")
    ]
    coulomb_velocity: Annotated[
        float,
        quantity(
            "rad/s",
            "Velocity of the set-point at which the Coulomb compensation is complete.",
            gt=0.0,
            le=10.0,
            path="coulomb_velocity",
        ),
    ]
    viscous_friction: Annotated[
        RowOf[_Torque],
        quantity("Nm (s/rad)^viscous_exponent", "Viscous friction to compensate.", path="viscous"),
    ]
    viscous_exponent: Annotated[
        RowOf[_Exponent],
        quantity("1", "Exponent of the viscous friction to compensate.", path="viscous_exponent"),
        Field(validate_default=True),
    ] = (1.0,)

    @field_validator("viscous_exponent")
    @classmethod
    def _spread(cls, exponents: tuple[float, ...], info: ValidationInfo) -> tuple[float, ...]:
        """Give each joint the single exponent."""
        return (
            exponents * len(info.data.get("coulomb_torque", "1"))
            if len(exponents) == 1
            else exponents
        )

    @property
    def model_parts(self) -> int:
        """Return which of MODEL_PARTS are on, as `parts` of `model_dtype`."""
        return INVERSE_DYNAMICS * self.inverse_dynamics + FRICTION * self.friction_model

    def off(self) -> FeedForward:
        """Return the block with every part switched off."""
        off = dict.fromkeys(("velocity", "acceleration", "coulomb", "viscous", *MODEL_PARTS), False)
        return self.model_copy(update=off)


class CurrentLoop(FileModel):
    """Amplifiers."""

    bandwidth: Annotated[
        float, quantity("Hz", "Bandwidth of the current loop.", gt=0.0, path="current_bandwidth")
    ]
    slew_rate: Annotated[
        RowOf[Positive],
        quantity("A/s", "The amplifier's fastest change of current.", path="current_slew"),
    ]


class Supervision(FileModel):
    """What cuts the power, joint by joint."""

    following_error: Annotated[
        RowOf[Annotated[float, Field(gt=0.0, le=1.0)]],
        quantity("rad", "Position error at which the power is cut.", path="following_error"),
    ]
    over_speed: Annotated[
        float,
        quantity(
            "1",
            "Speed at which the power is cut, times the nominal speed of the joint.",
            gt=0.0,
            le=10.0,
            path="over_speed",
        ),
    ]


class TrajectoryLimits(FileModel):
    """What is asked of set-points."""

    start_tolerance: Annotated[
        float,
        quantity(
            "rad",
            "How far a trajectory may start from the held set-point.",
            ge=0.0,
            path="start_tolerance",
        ),
    ]
    max_acceleration: Annotated[
        RowOf[Positive],
        quantity(
            "rad/s^2", "The most that a set-point may ask of each joint.", path="max_acceleration"
        ),
    ]


class FullSpeeds(FileModel):
    """Full speeds of V+ programs."""

    joint_speed: Annotated[RowOf[Positive], quantity("deg/s", "Of each joint.")]
    joint_acceleration: Annotated[RowOf[Positive], quantity("deg/s^2", "Of each joint.")]
    linear_speed: Annotated[float, quantity("mm/s", "Of the tool along a line.", gt=0.0)]
    linear_acceleration: Annotated[float, quantity("mm/s^2", "Likewise.", gt=0.0)]
    rotary_speed: Annotated[float, quantity("deg/s", "Of the tool's turn along a line.", gt=0.0)]
    rotary_acceleration: Annotated[float, quantity("deg/s^2", "Likewise.", gt=0.0)]
    zero: Annotated[Row, quantity("deg", "Joint values of V+ where the URDF's are 0.")]
    ready: Annotated[Row, quantity("deg", "Joint values of READY.")]
    null_tolerance: Annotated[
        float, quantity("deg", "Position error at which a motion is over, with FINE 100.", gt=0.0)
    ]


class CS7BParameters(FileModel):
    """Gains, limits and switches of servo controllers: lists of one value for each motor, seen from its joint.

    The law, joint side: torque = inertia [kv (kp e + dq_r - dq) + ki integral(e)] + feed-forward; see
    docs/explanation/closed_loop.md.
    """

    servo: Servo
    feed_forward: FeedForward
    current_loop: CurrentLoop
    supervision: Supervision
    trajectory: TrajectoryLimits
    model: ModelFiles | None = None
    vplus: FullSpeeds | None = None

    @model_validator(mode="after")
    def _check_counts(self) -> CS7BParameters:
        check_counts(self, len(self.servo.inertia), "servo.inertia")
        return self

    @cached_property
    def inertia(self) -> Array:
        """Return nominal inertias, rotors included, kg m^2."""
        return np.array(self.servo.inertia)

    @cached_property
    def viscous_exponent(self) -> Array:
        """Return its exponents."""
        return np.array(self.feed_forward.viscous_exponent)

    @cached_property
    def max_acceleration(self) -> Array:
        """Return the most that a set-point may ask of each joint, rad/s^2."""
        return np.array(self.trajectory.max_acceleration)

    def limits(self, robot: RobotModel) -> JointLimits:
        """Return the limits that the set-points of an arm must keep."""
        return JointLimits(
            robot.joint_names,
            robot.lower,
            robot.upper,
            robot.max_velocity,
            self.max_acceleration,
            self.trajectory.start_tolerance,
        )

    def record(self, robot: RobotModel, drives: DriveParameters, rates: Rates) -> Record:
        """Return the law's constants, shape (1,), of `controller_dtype`."""
        sensor = drives.current_sensor
        loop = self.current_loop
        if sensor.used and sensor.bandwidth != loop.bandwidth:
            raise ConfigError(
                f"the current loop's bandwidth is {loop.bandwidth:g} Hz for the controller; accepted: "
                f"{sensor.bandwidth:g} Hz, as current_sensor of the drives has it, for it is one loop"
            )
        record = np.zeros(1, controller_dtype(drives.turning.size))
        law = record[0]
        gear_squared = drives.gear * drives.gear
        gear = np.abs(drives.gear)  # limits and friction are the same in both directions of a motor
        switch = self.feed_forward
        drives.turning.fill(law, "gear", drives.gear)
        law["derivative"] = self.inertia * self.servo.kv / gear_squared
        law["proportional"] = self.inertia * self.servo.kv * self.servo.kp / gear_squared
        law["integral"] = self.inertia * self.servo.ki / gear_squared * rates.position_period
        law["integrator_limit"] = self.servo.integrator_limit / gear
        law["velocity_weight"] = float(switch.velocity)
        law["inertia"] = (
            self.inertia / gear_squared * (switch.acceleration and not switch.inverse_dynamics)
        )
        law["coulomb"] = (
            switch.coulomb_torque / gear * (switch.coulomb and not switch.friction_model)
        )
        law["coulomb_velocity"] = switch.coulomb_velocity * gear
        # A torque tau_v |v|^a of the joint, at the motor: 1/n of it, at a velocity n times as fast.
        viscous = switch.viscous and not switch.friction_model
        law["viscous"] = (
            switch.viscous_friction / powers(np.abs(gear), 1.0 + self.viscous_exponent) * viscous
        )
        law["viscous_exponent"] = self.viscous_exponent
        law["torque_constant"] = drives.torque_constant
        law["peak_current"] = drives.peak_current
        law["current_step"] = np.array(loop.slew_rate) * rates.period
        law["current_gain"] = -exponential_less_one_of(
            -2.0 * math.pi * loop.bandwidth * rates.period
        )
        law["following_error"] = gear * self.supervision.following_error
        law["over_speed"] = self.supervision.over_speed * robot.max_velocity * gear
        if switch.model_parts:
            if self.model is None:
                raise ConfigError(
                    "feed_forward by a model, without one; accepted: with one, or both switches off"
                )
            model = law["model"]
            model["parts"] = switch.model_parts
            self.model.constants.fill(model, rates.position_period)
            model["period"] = rates.position_period
            # The current follows by (1 - gain) of the difference, tick by tick: in the mean so many ticks later.
            late = rates.period * (1.0 - law["current_gain"]) / law["current_gain"]
            model["lead"] = 0.5 * rates.position_period + late
        return record


def load_controller(path: Path) -> CS7BParameters:
    """Read a controller file, and what the files of its model hold, if it names any or needs them."""
    law = read_model(CS7BParameters, path)
    model = (law.model or ModelFiles()).resolved(path)
    if law.model is not None or law.feed_forward.model_parts:
        with located(plain(path)):
            _ = model.constants  # read once
    return law.model_copy(update={"model": model})
