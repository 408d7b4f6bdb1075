"""The simulation node's parameters."""

from __future__ import annotations

from dataclasses import dataclass, field, fields, replace
from typing import Any

import numpy as np
from rclpy.node import Node

from rx90_common.base.arrays import Array
from rx90_common.base.errors import ConfigError
from rx90_common.base.quoting import counted, one_line, quoted
from rx90_common.base.rates import Rates
from rx90_common.description.drives import load_drives
from rx90_common.description.robot import RobotModel, load_robot
from rx90_common.description.robot_files import RobotFiles
from rx90_common.exchange.parameters import declare, declare_rates
from rx90_common.exchange.topics import LOCK_STEP, TEMPERATURE_RATE, TIME_MODES
from rx90_common.friction import load_friction
from rx90_common.friction.parts.scatter import LARGEST_SEED
from rx90_sim.plant import Plant
from rx90_sim.plant_steps import MOST_STEPS

FILE_PARAMETERS = ("urdf", "tool", "drives", "friction")
"""Files of the robot that the node can be given."""


def _as(default: Any, description: str, low: float | None = None, high: float | None = None) -> dict[str, Any]:
    """Return how a field is declared, as a parameter of its name."""
    return {"default": default, "description": description, "low": low, "high": high}


@dataclass(frozen=True)
class SimulationParameters:
    """What the node was asked for; fields other than the rates are declared here.

    Raises:
        ConfigError: naming parameter, value and what is accepted.
    """

    rates: Rates
    joint_state_rate: int = field(metadata=_as(1000, "rate of joint_states and friction_states, Hz", 1, 20000))
    clock_rate: int = field(metadata=_as(50, "rate of /clock, Hz", 1, 20000))
    tf_rate: int = field(
        metadata=_as(0, "rate of /tf, Hz; 0: neither /tf nor /tf_static, for robot_state_publisher has them", 0, 20000)
    )
    time_mode: str = field(
        metadata=_as(LOCK_STEP, "lock_step: wait for the controller in every tick; free_running: wall clock")
    )
    real_time_factor: float = field(metadata=_as(1.0, "pace in lock_step, 0 for as fast as it goes", 0.0, 1000.0))
    command_timeout: float = field(
        metadata=_as(0.5, "free_running: wait for a late command before the brakes close, s", 0.0, 10.0)
    )
    initial_position: list[float] = field(
        metadata=_as(
            [0.0],
            "joint positions at the start and after a reset, rad; a single number is for all joints, or the end of a "
            "joint's range that is nearest to it",
        )
    )
    duration: float = field(metadata=_as(0.0, "simulated time after which the node ends, s; 0: never", 0.0, 1e9))
    paused: bool = field(metadata=_as(False, "begin with time standing still"))
    substeps: int = field(
        metadata=_as(0, "steps of the plant in a tick; 0: as many as friction, mass and gears need", 0, MOST_STEPS)
    )
    seed: int = field(
        metadata=_as(
            0,
            "of all that is random in the arm, such as the scatter of its friction; a reset begins with it again",
            0,
            LARGEST_SEED,
        )
    )

    def __post_init__(self) -> None:
        if self.time_mode not in TIME_MODES:
            raise ConfigError(f"parameter time_mode is {quoted(self.time_mode)}; accepted: {', '.join(TIME_MODES)}")

    def start(self, robot: RobotModel) -> Array:
        """Return the initial position, rad, shape (n,).

        Raises:
            ConfigError: for another number of values than one, or one for each joint.
        """
        given, joints = np.array(self.initial_position, np.float64), len(robot.joint_names)
        if len(given) not in (1, joints):
            raise ConfigError(
                f"parameter initial_position has {counted(len(given), 'number')}; accepted: {joints}, one for each "
                "joint, or one for all, rad"
            )
        return np.clip(given, robot.lower, robot.upper) if len(given) < joints else given

    @property
    def last_tick(self) -> int | None:
        """Return the tick at which the run ends, None for a run without end."""
        return round(self.duration * self.rates.base_hz) if self.duration > 0 else None


def read_parameters(node: Node) -> SimulationParameters:
    """Declare the node's parameters, if they are not, and read them.

    Raises:
        ConfigError: naming parameter, value and accepted range.
    """
    about = "rate of temperatures, of joints and windings that get warm, Hz"
    rates = declare_rates(node)
    rates = replace(rates, temperature_hz=declare(node, TEMPERATURE_RATE, 1, about, low=1, high=20000))
    own: Any = {one.name: declare(node, one.name, **one.metadata) for one in fields(SimulationParameters)[1:]}
    return SimulationParameters(rates, **own)


def declare_step_ticks(node: Node) -> int:
    """Declare, unless it is, and return how many ticks a call of ~/step runs."""
    return declare(node, "step_ticks", 1, "ticks of one call of ~/step", low=1, high=100_000_000)


def build_plant(node: Node, files: RobotFiles, parameters: SimulationParameters) -> tuple[RobotModel, Plant]:
    """Read the robot's files and put the arm at its initial position.

    Raises:
        ConfigError: naming file, key, value and accepted range.
    """
    robot = load_robot(files.urdf, files.tool)
    drives, substeps = load_drives(files.drives), parameters.substeps or None
    robot.check_count(files.drives, "gear", drives.gear)
    friction = load_friction(files.friction, drives.turning.element_names(robot.joint_names))
    for line in friction.passivity_warnings(drives.turning.reach(robot.max_velocity)):
        node.get_logger().warning(one_line(line))
    plant = Plant(robot, drives, friction, parameters.rates, substeps, parameters.seed)
    plant.reset(parameters.start(robot))
    plant.warm_up()
    return robot, plant
