"""The simulation node's parameters."""

from __future__ import annotations

from typing import Annotated, Literal

import numpy as np
from pydantic import Field, model_validator

from rx90_common.base.arrays import Array
from rx90_common.base.errors import ConfigError
from rx90_common.base.models import NotNegative, RowOf, as_refusal, quantity, refusal
from rx90_common.base.quoting import counted
from rx90_common.base.rates import ticks_per
from rx90_common.description.robot import RobotModel, load_robot
from rx90_common.exchange.parameters import RobotParameters, robots_file
from rx90_common.exchange.topics import FREE_RUNNING, JOINT_INTERFACE, MOTOR_INTERFACE
from rx90_common.friction.parts.scatter import LARGEST_SEED
from rx90_sim.plant_steps import MAX_STEPS

FILE_PARAMETERS = ("urdf", "tool", "drives", "friction")
"""Files of the robot that the node can be given."""


class SimulationParameters(RobotParameters):
    """The node's parameters."""

    tool: Annotated[str, robots_file("tool")] = ""
    friction: Annotated[str, robots_file("friction")] = ""
    step_ticks: Annotated[
        int, Field(ge=1, le=100_000_000, description="Ticks of one call of ~/step.")
    ] = 1
    joint_state_rate: Annotated[
        int, quantity("Hz", "Rate of joint_states and friction_states.", ge=1, le=20000)
    ] = 1000
    clock_rate: Annotated[int, quantity("Hz", "Rate of /clock.", ge=1, le=20000)] = 50
    tf_rate: Annotated[
        int,
        quantity(
            "Hz",
            "Rate of /tf; 0: neither /tf nor /tf_static, for robot_state_publisher has them.",
            ge=0,
            le=20000,
        ),
    ] = 0
    time_mode: Annotated[
        Literal["lock_step", "free_running"],
        Field(
            description="lock_step: wait for the controller in every tick; free_running: wall clock."
        ),
    ] = "lock_step"
    real_time_factor: Annotated[
        NotNegative, quantity("1", "Pace in lock_step, 0 for as fast as it goes.", le=1000.0)
    ] = 1.0
    command_timeout: Annotated[
        NotNegative,
        quantity(
            "s",
            "free_running: wait for a late motor command before the brakes close.",
            le=10.0,
        ),
    ] = 0.5
    command_interface: Annotated[
        Literal["motor", "joint"],
        Field(
            description="motor: motor_commands answer motor_states; joint: joint_commands, efforts, drive the arm."
        ),
    ] = "motor"
    command_rate: Annotated[
        int,
        quantity(
            "Hz",
            "Rate of joint_commands, which are held in between; 0: position_rate.",
            ge=0,
            le=20000,
        ),
    ] = 0
    command_age_limit: Annotated[
        float,
        quantity(
            "s",
            "free_running: age of the newest joint command at which the brakes close.",
            ge=0.001,
            le=10.0,
        ),
    ] = 0.1
    initial_position: Annotated[
        RowOf[float],
        quantity(
            "rad",
            "Joint positions at the start and after a reset; a single number is for all joints, or the end of a "
            "joint's range that is nearest to it.",
        ),
    ] = (0.0,)
    duration: Annotated[
        NotNegative, quantity("s", "Simulated time after which the node ends; 0: never.", le=1e9)
    ] = 0.0
    paused: Annotated[bool, Field(description="Begin with time standing still.")] = False
    substeps: Annotated[
        int,
        Field(
            ge=0,
            le=MAX_STEPS,
            description="Steps of the plant in a tick; 0: as many as friction, mass and gears need.",
        ),
    ] = 0
    seed: Annotated[
        int,
        Field(
            ge=0,
            le=LARGEST_SEED,
            description="Of all that is random in the arm, such as the scatter of its friction; a reset begins with "
            "it again.",
        ),
    ] = 0

    @model_validator(mode="after")
    def _check_commands(self) -> SimulationParameters:
        if self.command_interface == MOTOR_INTERFACE and self.command_rate:
            accepted = (
                "0 with command_interface motor, whose rate is base_rate, "
                f"or command_interface {JOINT_INTERFACE}"
            )
            raise refusal("command_rate", self.command_rate, accepted)
        with as_refusal():
            ticks_per("command_rate", self.base_rate, self.command_hz)
        least = 2.0 / self.command_hz
        joint = self.command_interface == JOINT_INTERFACE
        if joint and self.time_mode == FREE_RUNNING and self.command_age_limit < least:
            accepted = f"at least two periods of the commands, {least:g} s"
            raise refusal("command_age_limit", self.command_age_limit, accepted)
        return self

    def check_files(self) -> None:
        """Check the initial position by the robot."""
        files = self.files()
        self.start(load_robot(files.urdf, files.tool))

    def start(self, robot: RobotModel) -> Array:
        """Return the initial position, rad, shape (n,)."""
        given = np.array(self.initial_position, np.float64)
        joints = len(robot.joint_names)
        if len(given) not in (1, joints):
            raise ConfigError(
                f"parameter initial_position has {counted(len(given), 'number')}; accepted: {joints}, one for each "
                "joint, or one for all, rad"
            )
        return np.clip(given, robot.lower, robot.upper) if len(given) < joints else given

    @property
    def command_hz(self) -> int:
        """Return the rate of commands, Hz."""
        if self.command_interface == MOTOR_INTERFACE:
            return self.base_rate
        return self.command_rate or self.position_rate

    @property
    def last_tick(self) -> int | None:
        """Return the tick at which the run ends, None for a run without end."""
        return round(self.duration * self.base_rate) if self.duration > 0 else None
