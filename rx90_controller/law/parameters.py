"""Gains, limits and switches of the servo controllers."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from functools import cache, partial
from pathlib import Path
from typing import Annotated, Any, Final

import numpy as np

from rx90_common.base.arrays import Array
from rx90_common.base.config import Section, load_yaml
from rx90_common.base.declared import Declared
from rx90_common.base.entries import PER_JOINT, REQUIRED, Number, Numbers, Switch
from rx90_common.base.errors import ConfigError, located
from rx90_common.base.quoting import plain
from rx90_common.base.rates import Rates
from rx90_common.description.coupling import ArmSize, gear_field
from rx90_common.description.drives import DriveParameters
from rx90_common.description.robot import RobotModel
from rx90_common.friction.element import ALPHA_BOUNDS
from rx90_common.kernels.elementary import exponential_less_one_of, powers
from rx90_controller.law.model import FRICTION, INVERSE_DYNAMICS, MODEL, ModelFiles, model_dtype
from rx90_controller.trajectory import JointLimits


@cache
def controller_dtype(arm: ArmSize) -> np.dtype[np.void]:
    """Return the type of the constants of a control law."""
    n = arm.joints
    return np.dtype(
        [
            gear_field("gear", arm),
            ("proportional", np.float64, (n,)),  # motor side, Nm/rad
            ("integral", np.float64, (n,)),  # motor side, Nm/rad per position tick
            ("integrator_limit", np.float64, (n,)),  # motor side, Nm
            ("derivative", np.float64, (n,)),  # motor side, Nm s/rad
            ("inertia", np.float64, (n,)),  # motor side, kg m^2; 0 where acceleration feed-forward is off
            ("velocity_weight", np.float64, (n,)),  # of the velocity set-point in D; 0 where it is off
            ("coulomb", np.float64, (n,)),  # motor side, Nm; 0 where the compensation is off
            ("coulomb_velocity", np.float64, (n,)),  # motor side, rad/s
            ("viscous", np.float64, (n,)),  # motor side, Nm (s/rad)^exponent; 0 where the compensation is off
            ("torque_constant", np.float64, (n,)),
            ("peak_current", np.float64, (n,)),
            ("current_step", np.float64, (n,)),  # largest change of the amplifier's current in a tick, A
            ("current_gain", np.float64),  # of the current loop per tick
            ("following_error", np.float64, (n,)),  # supervised, motor side, rad
            ("over_speed", np.float64, (n,)),  # supervised, motor side, rad/s
            ("viscous_exponent", np.float64, (n,)),
            ("model", model_dtype(arm)),  # feed-forward by a model of arm and friction
        ],
        align=True,
    )


MODEL_PARTS: Final = {"inverse_dynamics": INVERSE_DYNAMICS, "friction_model": FRICTION}
"""Switches of the feed-forward by a model of arm and friction, and their bits in `parts` of `model_dtype`."""

_each = partial(Numbers, count=PER_JOINT, low=0.0)
_positive_each = partial(_each, above=True)
_positive = partial(Number, low=0.0, above=True)
_any_each = _each("")
_any_positive_each = _positive_each("")
_any_positive = _positive("")


@dataclass(frozen=True)
class FeedForward(Declared):
    """Terms that the set-points add to PI, each with its own switch.

    The paper's D block has the measured velocity alone (section 5, figure 4): that is `velocity=False`.
    """

    name = "feed_forward"

    velocity: Annotated[
        bool, Switch("The velocity set-point in the D block; the paper has the measured velocity alone."), REQUIRED
    ] = True
    acceleration: Annotated[bool, Switch("Inertia times acceleration of the set-point."), REQUIRED] = True
    coulomb: Annotated[bool, Switch("Coulomb friction compensation."), REQUIRED] = True
    viscous: Annotated[bool, Switch("Viscous friction compensation."), REQUIRED] = True
    inverse_dynamics: Annotated[
        bool,
        Switch("Inverse dynamics of the model, weight included, in place of inertia times acceleration."),
    ] = False
    friction_model: Annotated[
        bool, Switch("Friction of the model, in place of Coulomb and viscous friction compensation.")
    ] = False

    @property
    def model_parts(self) -> int:
        """Return which of MODEL_PARTS are on, as `parts` of `model_dtype`."""
        return sum(bit * getattr(self, name) for name, bit in MODEL_PARTS.items())

    @classmethod
    def off(cls) -> FeedForward:
        """Return the block with every part switched off."""
        return cls(velocity=False, acceleration=False, coulomb=False, viscous=False)


@dataclass(frozen=True, kw_only=True)
class CS7BParameters(Declared):
    """SISO controllers; every array has a value for each motor, shape (n,), and joint-side units.

    The law, joint side: torque = Mn [kv (kp e + dq_r - dq) + ki integral(e)] + feed-forward; see
    docs/explanation/closed_loop.md.
    """

    name = "controller"
    about = (
        "Gains, limits and switches of servo controllers: lists of one value for each motor, seen from its joint. "
        "The law: torque = inertia [kv (kp e + dq_r - dq) + ki integral(e)] + feed-forward."
    )
    blocks = {  # noqa: RUF012 - a ClassVar of Declared
        "servo": "Gains of the loops.",
        "feed_forward": "What the set-points add beside PI.",
        "current_loop": "Amplifiers.",
        "supervision": "What cuts the power, joint by joint.",
        "trajectory": "What is asked of set-points.",
    }

    inertia: Annotated[
        Array,
        _positive_each("Nominal inertia, rotors included.", "kg m^2", high=1e5),
        _any_positive_each,
        "servo.inertia",
    ]
    kp: Annotated[Array, _each("Proportional gain of the position loop.", "1/s", high=1e4), _any_each, "servo.kp"]
    kv: Annotated[Array, _each("Gain of the velocity loop.", "1/s", high=1e5), _any_each, "servo.kv"]
    ki: Annotated[Array, _each("Integral gain.", "1/s^3", high=1e9), _any_each, "servo.ki"]
    integrator_limit: Annotated[
        Array, _each("The most that the integrator gives.", "Nm", high=1e6), _any_each, "servo.integrator_limit"
    ]
    feed_forward: FeedForward
    coulomb: Annotated[
        Array, _each("Coulomb friction to compensate.", "Nm", high=1e6), _any_each, "feed_forward.coulomb_torque"
    ]
    coulomb_velocity: Annotated[
        float,
        _positive("Velocity of the set-point at which the Coulomb compensation is complete.", "rad/s", high=10.0),
        _any_positive,
        "feed_forward.coulomb_velocity",
    ]
    viscous: Annotated[
        Array,
        _each("Viscous friction to compensate.", "Nm (s/rad)^viscous_exponent", high=1e6),
        _any_each,
        "feed_forward.viscous_friction",
    ]
    viscous_exponent: Annotated[
        Array,
        Numbers(
            "Exponent of the viscous friction to compensate.", "1",
            count=PER_JOINT, low=ALPHA_BOUNDS[0], high=ALPHA_BOUNDS[1],
        ),
        "feed_forward.viscous_exponent",
    ] = field(default_factory=lambda: np.ones(1))  # fmt: skip
    model: Annotated[ModelFiles | None, MODEL] = None
    current_bandwidth: Annotated[float, _positive("Bandwidth of the current loop.", "Hz"), "current_loop.bandwidth"]
    current_slew: Annotated[
        Array, _positive_each("The amplifier's fastest change of current.", "A/s"), "current_loop.slew_rate"
    ]
    following_error: Annotated[
        Array,
        _positive_each("Position error at which the power is cut.", "rad", high=1.0),
        _any_positive_each,
        "supervision.following_error",
    ]
    over_speed: Annotated[
        float,
        _positive("Speed at which the power is cut, times the nominal speed of the joint.", high=10.0),
        _any_positive,
        "supervision.over_speed",
    ]
    start_tolerance: Annotated[
        float,
        Number("How far a trajectory may start from the held set-point.", "rad", low=0.0),
        "trajectory.start_tolerance",
    ]
    max_acceleration: Annotated[
        Array,
        _positive_each("The most that a set-point may ask of each joint.", "rad/s^2"),
        "trajectory.max_acceleration",
    ]

    def __post_init__(self) -> None:
        super().__post_init__()
        self.__dict__.update(self.fitted(len(self.inertia), "inertia").__dict__)
        for name in MODEL_PARTS:
            if getattr(self.feed_forward, name) and self.model is None:
                raise ConfigError(f"{name} is true without a model; accepted: with one, or false")

    def limits(self, robot: RobotModel) -> JointLimits:
        """Return the limits that the set-points of an arm must keep."""
        return JointLimits(
            robot.joint_names,
            robot.lower,
            robot.upper,
            robot.max_velocity,
            self.max_acceleration,
            self.start_tolerance,
        )

    def record(self, robot: RobotModel, drives: DriveParameters, rates: Rates) -> np.ndarray[Any, Any]:
        """Return the law's constants, shape (1,), of `controller_dtype`."""
        sensor = drives.current_sensor
        if sensor.used and sensor.bandwidth != self.current_bandwidth:
            raise ConfigError(
                f"the current loop's bandwidth is {self.current_bandwidth:g} Hz for the controller; accepted: "
                f"{sensor.bandwidth:g} Hz, as current_sensor of the drives has it, for it is one loop"
            )
        record = np.zeros(1, controller_dtype(drives.turning.size))
        law = record[0]
        gear_squared = drives.gear * drives.gear
        gear = np.abs(drives.gear)  # limits and friction are the same in both directions of a motor
        switch = self.feed_forward
        drives.turning.fill(law, "gear", drives.gear)
        law["derivative"] = self.inertia * self.kv / gear_squared
        law["proportional"] = self.inertia * self.kv * self.kp / gear_squared
        law["integral"] = self.inertia * self.ki / gear_squared * rates.position_period
        law["integrator_limit"] = self.integrator_limit / gear
        law["velocity_weight"] = float(switch.velocity)
        law["inertia"] = self.inertia / gear_squared * (switch.acceleration and not switch.inverse_dynamics)
        law["coulomb"] = self.coulomb / gear * (switch.coulomb and not switch.friction_model)
        law["coulomb_velocity"] = self.coulomb_velocity * gear
        # A torque tau_v |v|^a of the joint, at the motor: 1/n of it, at a velocity n times as fast.
        viscous = switch.viscous and not switch.friction_model
        law["viscous"] = self.viscous / powers(np.abs(gear), 1.0 + self.viscous_exponent) * viscous
        law["viscous_exponent"] = self.viscous_exponent
        law["torque_constant"] = drives.torque_constant
        law["peak_current"] = drives.peak_current
        law["current_step"] = self.current_slew * rates.period
        law["current_gain"] = -exponential_less_one_of(-2.0 * math.pi * self.current_bandwidth * rates.period)
        law["following_error"] = self.following_error * gear
        law["over_speed"] = self.over_speed * robot.max_velocity * gear
        if switch.model_parts:
            assert self.model is not None
            model = law["model"]
            model["parts"] = switch.model_parts
            self.model.constants.fill(model, rates.position_period)
            model["period"] = rates.position_period
            # The current follows by (1 - gain) of the difference, tick by tick: in the mean so many ticks later.
            late = rates.period * (1.0 - law["current_gain"]) / law["current_gain"]
            model["lead"] = 0.5 * rates.position_period + late
        return record


CONTROLLER = CS7BParameters.group()
"""What a controller file holds."""


def load_controller(path: Path) -> CS7BParameters:
    """Read a controller file."""
    return read_controller(load_yaml(path))


def read_controller(root: Section, model: ModelFiles | None = None) -> CS7BParameters:
    """Check and return the content of a controller file.

    Args:
        root: the file's content.
        model: replaces the file's entry for the model.
    """
    content = CONTROLLER.read(root)
    model = model or ModelFiles.of(root)
    if "model" in root or any(content["feed_forward"][name] for name in MODEL_PARTS):
        with located(plain(root.file)):
            _ = model.constants  # read once
    return CS7BParameters.of_file(content, model=model)
