"""The simulation node's parameters."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from rclpy.node import Node

from rx90_common.base.arrays import Array
from rx90_common.base.declared import option
from rx90_common.base.errors import ConfigError
from rx90_common.base.quoting import counted, one_line, quoted
from rx90_common.base.rates import Rates, ticks_per
from rx90_common.description.drives import load_drives
from rx90_common.description.robot import RobotModel, load_robot
from rx90_common.description.robot_files import RobotFiles
from rx90_common.exchange.parameters import declare, declare_options, declare_rates
from rx90_common.exchange.topics import (
    COMMAND_INTERFACES,
    FREE_RUNNING,
    JOINT_INTERFACE,
    LOCK_STEP,
    MOTOR_INTERFACE,
    TIME_MODES,
)
from rx90_common.friction import load_friction
from rx90_common.friction.parts.scatter import LARGEST_SEED
from rx90_sim.plant import Plant
from rx90_sim.plant_steps import MAX_STEPS

FILE_PARAMETERS = ("urdf", "tool", "drives", "friction")
"""Files of the robot that the node can be given."""


@dataclass(frozen=True)
class SimulationParameters:
    """The node's parameters; fields other than the rates are declared here."""

    rates: Rates
    joint_state_rate: int = option(1000, "rate of joint_states and friction_states, Hz", 1, 20000)
    clock_rate: int = option(50, "rate of /clock, Hz", 1, 20000)
    tf_rate: int = option(
        0, "rate of /tf, Hz; 0: neither /tf nor /tf_static, for robot_state_publisher has them", 0, 20000
    )
    time_mode: str = option(LOCK_STEP, "lock_step: wait for the controller in every tick; free_running: wall clock")
    real_time_factor: float = option(1.0, "pace in lock_step, 0 for as fast as it goes", 0.0, 1000.0)
    command_timeout: float = option(
        0.5, "free_running: wait for a late motor command before the brakes close, s", 0.0, 10.0
    )
    command_interface: str = option(
        MOTOR_INTERFACE, "motor: motor_commands answer motor_states; joint: joint_commands, efforts, drive the arm"
    )
    command_rate: int = option(0, "rate of joint_commands, which are held in between, Hz; 0: position_rate", 0, 20000)
    command_age_limit: float = option(
        0.1, "free_running: age of the newest joint command at which the brakes close, s", 0.001, 10.0
    )
    initial_position: list[float] = option(  # noqa: RUF009 - it gives each a list of its own
        [0.0],
        "joint positions at the start and after a reset, rad; a single number is for all joints, or the end of a "
        "joint's range that is nearest to it",
    )
    duration: float = option(0.0, "simulated time after which the node ends, s; 0: never", 0.0, 1e9)
    paused: bool = option(False, "begin with time standing still")
    substeps: int = option(0, "steps of the plant in a tick; 0: as many as friction, mass and gears need", 0, MAX_STEPS)
    seed: int = option(
        0,
        "of all that is random in the arm, such as the scatter of its friction; a reset begins with it again",
        0,
        LARGEST_SEED,
    )

    def __post_init__(self) -> None:
        if self.time_mode not in TIME_MODES:
            raise ConfigError(f"parameter time_mode is {quoted(self.time_mode)}; accepted: {', '.join(TIME_MODES)}")
        if self.command_interface not in COMMAND_INTERFACES:
            raise ConfigError(
                f"parameter command_interface is {quoted(self.command_interface)}; accepted: "
                f"{', '.join(COMMAND_INTERFACES)}"
            )
        if self.command_interface == MOTOR_INTERFACE and self.command_rate:
            raise ConfigError(
                f"parameter command_rate is {self.command_rate} with command_interface motor, whose rate is base_rate; "
                f"accepted: 0, or command_interface {JOINT_INTERFACE}"
            )
        ticks_per("command_rate", self.rates.base_hz, self.command_hz)
        self.check_age_limit(self.command_age_limit)

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

    def check_age_limit(self, limit: float) -> float:
        """Return an age limit of joint commands, s, that leaves time to answer."""
        least = 2.0 / self.command_hz
        if self.command_interface == JOINT_INTERFACE and self.time_mode == FREE_RUNNING and limit < least:
            raise ConfigError(
                f"parameter command_age_limit is {limit:g} s; accepted: at least two periods of the commands, "
                f"{least:g} s"
            )
        return limit

    @property
    def command_hz(self) -> int:
        """Return the rate of commands, Hz."""
        if self.command_interface == MOTOR_INTERFACE:
            return self.rates.base_hz
        return self.command_rate or self.rates.position_hz

    @property
    def last_tick(self) -> int | None:
        """Return the tick at which the run ends, None for a run without end."""
        return round(self.duration * self.rates.base_hz) if self.duration > 0 else None


def read_parameters(node: Node) -> SimulationParameters:
    """Declare the node's parameters, if they are not, and read them."""
    return SimulationParameters(declare_rates(node), **declare_options(node, SimulationParameters))


def declare_step_ticks(node: Node) -> int:
    """Declare, unless it is, and return how many ticks a call of ~/step runs."""
    return declare(node, "step_ticks", 1, "ticks of one call of ~/step", low=1, high=100_000_000)


def build_plant(node: Node, files: RobotFiles, parameters: SimulationParameters) -> tuple[RobotModel, Plant]:
    """Read the robot's files and put the arm at its initial position."""
    robot = load_robot(files.urdf, files.tool)
    drives = load_drives(files.drives)
    substeps = parameters.substeps or None
    robot.check_count(files.drives, "gear", drives.gear)
    friction = load_friction(files.friction, drives.turning.element_names(robot.joint_names))
    for line in friction.passivity_warnings(drives.turning.reach(robot.max_velocity)):
        node.get_logger().warning(one_line(line))
    plant = Plant(robot, drives, friction, parameters.rates, substeps, parameters.seed)
    plant.reset(parameters.start(robot))
    plant.warm_up()
    return robot, plant
