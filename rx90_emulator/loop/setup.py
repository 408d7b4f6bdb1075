"""Everything a run needs, read from files: robot, drives, friction, controller, rates."""

from __future__ import annotations

from dataclasses import dataclass

from rx90_common.base.rates import Rates
from rx90_common.description.drives import DriveParameters, load_drives
from rx90_common.description.robot import RobotModel, load_robot
from rx90_common.description.robot_files import RobotFiles
from rx90_common.friction import FrictionSet, load_friction
from rx90_controller.law.cs7b import CS7B
from rx90_controller.law.parameters import CS7BParameters, load_controller
from rx90_sim.plant import Plant


@dataclass(frozen=True)
class Setup:
    """The parameters of a run, checked."""

    robot: RobotModel
    drives: DriveParameters
    friction: FrictionSet
    controller: CS7BParameters
    rates: Rates

    @classmethod
    def load(cls, files: RobotFiles | None = None, rates: Rates | None = None) -> Setup:
        """Read the files.

        Raises:
            ConfigError: naming file, key, value and accepted range.
        """
        files = files or RobotFiles()
        robot = load_robot(files.urdf, files.tool)
        return cls(
            robot,
            load_drives(files.drives),
            load_friction(files.friction, robot.joint_names),
            load_controller(files.controller),
            rates or Rates(),
        )

    def plant(self, substeps: int = 1) -> Plant:
        """Return a new plant, at rest in the zero pose."""
        return Plant(self.robot, self.drives, self.friction, self.rates, substeps)

    def cs7b(self) -> CS7B:
        """Return a new controller."""
        return CS7B(self.robot, self.drives, self.controller, self.rates)
