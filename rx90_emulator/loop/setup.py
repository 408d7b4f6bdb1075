"""Everything a run needs, read from files: robot, drives, friction, controller, rates."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from rx90_common.base.arrays import Array
from rx90_common.base.errors import check_type, warn_caller
from rx90_common.base.rates import Rates
from rx90_common.description.drives import DriveParameters, load_drives
from rx90_common.description.robot import RobotModel, load_robot
from rx90_common.description.robot_files import RobotFiles
from rx90_common.friction import FrictionSet, load_friction
from rx90_common.friction.parts.scatter import check_seed
from rx90_controller.law.cs7b import CS7B
from rx90_controller.law.parameters import CS7BParameters, load_controller
from rx90_sim.plant import Plant, beyond_law


@dataclass(frozen=True)
class Arm:
    """An arm without its controller.

    Attributes:
        robot: the arm with its tool.
        drives: gears, motors, brakes, spring, end stops.
        friction: the elements.
    """

    robot: RobotModel
    drives: DriveParameters
    friction: FrictionSet


def load_arm(files: RobotFiles) -> Arm:
    """Read the files of an arm."""
    robot = load_robot(files.urdf, files.tool)
    drives = load_drives(files.drives)
    robot.check_count(files.drives, "gear", drives.gear)
    return Arm(
        robot,
        drives,
        load_friction(files.friction, drives.turning.element_names(robot.joint_names)),
    )


@dataclass(frozen=True)
class Setup(Arm):
    """The parameters of a run, checked.

    Attributes:
        controller: gains, limits and switches.
        rates: of the loops.
        files: where they were read from, and the robot's own task and poses; None if they were not read.
        seed: of all that is random in the arm, such as the scatter of its friction; the same seed gives the same bits.

    Raises:
        ConfigError: for a seed that is no whole number from 0 to 2^53.
    """

    controller: CS7BParameters
    rates: Rates
    files: RobotFiles | None = None
    seed: int = 0

    def __post_init__(self) -> None:
        check_seed(self.seed)

    @classmethod
    def load(
        cls, files: RobotFiles | None = None, rates: Rates | None = None, seed: int = 0
    ) -> Setup:
        """Read the files, by default the shipped ones.

        Raises:
            ConfigError: naming file, key, value and accepted range.
        """
        files = files or RobotFiles()
        rates = rates or Rates()
        check_type(rates=(rates, Rates))
        arm = load_arm(files)
        controller = load_controller(files.controller)
        arm.robot.check_count(files.controller, "inertia", controller.inertia)
        return cls(arm.robot, arm.drives, arm.friction, controller, rates, files, seed)

    def plant(self, substeps: int | None = None) -> Plant:
        """Return a new plant, at rest in the zero pose, with so many steps in a tick, or as many as the arm needs.

        Raises:
            ConfigError: if that is less than it needs, or more than it takes unasked, saying what asks for it.
        """
        return Plant(self.robot, self.drives, self.friction, self.rates, substeps, self.seed)

    def cs7b(self) -> CS7B:
        """Return a new controller."""
        return CS7B(self.robot, self.drives, self.controller, self.rates)

    def warn_of_friction(self) -> None:
        """Warn of elements that are not passive up to the joints' full speed."""
        warn_caller(
            self.friction.passivity_warnings(self.drives.turning.reach(self.robot.max_velocity))
        )

    def warn_of_heat(self, temperatures: Array) -> None:
        """Warn of joints that got warmer, degrees Celsius, shape (n, e), than the law of their friction holds."""
        hot = beyond_law(self.friction, temperatures.max(axis=0)) if len(temperatures) else ""
        warn_caller([hot] if hot else [])


def load_setup(
    *,
    robot: Path | str | None = None,
    urdf: Path | str | None = None,
    tool: Path | str | None = None,
    drives: Path | str | None = None,
    friction: Path | str | None = None,
    controller: Path | str | None = None,
    rates: Rates | None = None,
    seed: int = 0,
) -> Setup:
    """Read the files of a setup: a robot's, but for those that are named, by a path or a shipped name below config/.

    Args:
        robot: name of a shipped robot, or a robot folder; the RX90B if left out.
        urdf: the arm.
        tool: what its flange carries; "none" for nothing.
        drives: gears, motors, brakes, end stops.
        friction: the elements.
        controller: gains and feed-forward.
        rates: of the loops, 4 kHz and 1 kHz if left out.
        seed: of all that is random in the arm.

    Raises:
        ConfigError: naming file, key, value and accepted range.
    """
    files = RobotFiles.named(
        robot, urdf=urdf, tool=tool, drives=drives, friction=friction, controller=controller
    )
    return Setup.load(files, rates, seed)
