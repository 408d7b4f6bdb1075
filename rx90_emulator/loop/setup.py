"""Everything a run needs, read from files: robot, drives, friction, controller, rates."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from pathlib import Path

from rx90_common.base.rates import Rates
from rx90_common.base.share import config_path, resolve_config
from rx90_common.description.drives import DriveParameters, load_drives
from rx90_common.description.robot import RobotModel, load_robot
from rx90_common.friction import FrictionSet, load_friction
from rx90_controller.law.cs7b import CS7B
from rx90_controller.law.parameters import CS7BParameters, load_controller
from rx90_sim.plant import Plant


@dataclass(frozen=True)
class SetupFiles:
    """Paths of the files that describe a run; the shipped ones unless told otherwise."""

    urdf: Path = field(default_factory=lambda: config_path("robot/rx90b.urdf"))
    tool: Path | None = field(default_factory=lambda: config_path("robot/tool_laser_head.yaml"))
    drives: Path = field(default_factory=lambda: config_path("robot/drives.yaml"))
    friction: Path = field(default_factory=lambda: config_path("robot/friction.yaml"))
    controller: Path = field(default_factory=lambda: config_path("controller/cs7b.yaml"))

    @classmethod
    def named(cls, tool: str | None = None, **others: str | None) -> SetupFiles:
        """Return the files that a command line names, the shipped one for each that it does not.

        Args:
            tool: its file, or "none" for no tool.
            others: urdf, drives, friction, controller.

        Raises:
            ConfigError: for a file that is not there.
        """
        files = {key: resolve_config(name) for key, name in others.items() if name is not None}
        chosen = cls(**files)
        if tool is None:
            return chosen
        return replace(chosen, tool=None if tool == "none" else resolve_config(tool))


@dataclass(frozen=True)
class Setup:
    """The parameters of a run, checked."""

    robot: RobotModel
    drives: DriveParameters
    friction: FrictionSet
    controller: CS7BParameters
    rates: Rates

    @classmethod
    def load(cls, files: SetupFiles | None = None, rates: Rates | None = None) -> Setup:
        """Read the files.

        Raises:
            ConfigError: naming file, key, value and accepted range.
        """
        files = files or SetupFiles()
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
