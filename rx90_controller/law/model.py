"""What the controller knows of the arm and its friction, for the feed-forward by a model: its own files."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any, Final

import numpy as np

from rx90_common.base.entries import LEFT_OUT, Text
from rx90_common.base.errors import ConfigError
from rx90_common.base.groups import Group
from rx90_common.base.quoting import plain
from rx90_common.base.section import Section
from rx90_common.base.share import config_path
from rx90_common.description.drives import DriveParameters, load_drives
from rx90_common.description.robot import load_robot
from rx90_common.description.robot_files import DESCRIPTIONS, FILES, NO_TOOL
from rx90_common.dynamics import manipulator_record
from rx90_common.friction import FrictionElement, load_friction
from rx90_common.friction.arm_elements import fill_arm_parts
from rx90_common.friction.compiled_elements import element_arrays

ROLES: Final = ("urdf", "tool", "drives", "friction")
"""The files of a model, by their names in the block `model` and in ModelFiles."""

MODEL = Group(
    "What the controller knows of the arm, for inverse_dynamics and friction_model; it may be wrong. A relative path "
    "is looked for in this file's folder, then in config/. A file that is left out is the robot folder's own, beside "
    "this file. Of friction that scatters the mean is taken.",
    keys={role: Text(f"The {DESCRIPTIONS[role]}.", default=LEFT_OUT) for role in ROLES},
    default=LEFT_OUT,
)
"""The block `model` of a controller file."""


@dataclass(frozen=True)
class ArmModel:
    """What the files of a model hold, of use to the compiled law.

    Attributes:
        arm: without friction, shape (1,), MANIPULATOR_DTYPE.
        friction: the seven elements; their scatter counts with its mean, which is nothing.
        drives: gears, and how much heat the motors give.
    """

    arm: np.ndarray[Any, Any]
    friction: tuple[FrictionElement, ...]
    drives: DriveParameters

    def fill(self, model: Any, period: float) -> None:
        """Write arm and friction into a record of MODEL_DTYPE, zero before, for position ticks of `period`, s."""
        model["arm"], model["friction"]["elements"] = self.arm[0], element_arrays(self.friction)[0]
        fill_arm_parts(model["friction"]["parts"], self.friction, self.drives.gear, self.drives.motor_heat, period)


@dataclass(frozen=True)
class ModelFiles:
    """The files of the controller's own model of arm and friction.

    Attributes:
        urdf: of the arm.
        tool: on its flange; None for none.
        drives: rotors and springs count.
        friction: the seven elements.
    """

    urdf: Path
    tool: Path | None
    drives: Path
    friction: Path

    @classmethod
    def of(cls, root: Section) -> ModelFiles:
        """Return the files that a controller file names, or that lie beside it; only named ones must be there.

        Raises:
            ConfigError: for a named one that is not.
        """
        named = root.section("model") if "model" in root else Section({}, root.file, "model")
        found: dict[str, Path | None] = {}
        for role in ROLES:
            if role in named:
                found[role] = None if role == "tool" and named.text(role) == NO_TOOL else _resolved(named, role)
            else:
                beside = root.file.parent / FILES[role]
                found[role] = None if role == "tool" and not beside.is_file() else beside
        return cls(**found)  # type: ignore[arg-type]  # None only for the tool

    @cached_property
    def constants(self) -> ArmModel:
        """Return what they hold, read once.

        Raises:
            ConfigError: naming file, key, value and what is accepted.
        """
        for role in ROLES:
            path: Path | None = getattr(self, role)
            if path is not None and not path.is_file():
                raise ConfigError(
                    f"the feed-forward by a model needs {plain(path)}, which is not there; accepted: {FILES[role]} "
                    f"beside the controller file, or model.{role} in it"
                )
        robot, drives = load_robot(self.urdf, self.tool), load_drives(self.drives)
        friction = load_friction(self.friction, robot.joint_names).elements
        known = tuple(replace(element, scatter=None) for element in friction)
        return ArmModel(manipulator_record(robot.chain, drives), known, drives)


def _resolved(named: Section, role: str) -> Path:
    """Return a file that a controller file names: the same one from whatever folder a program is started."""
    name = named.text(role)
    try:
        own = Path(name).expanduser()
        found = own if own.is_absolute() else named.file.parent / own
        if not found.is_file() and not own.is_absolute():
            found = config_path(name)
        if found.is_file():
            return found
    except (OSError, RuntimeError, ConfigError):  # a name that the system does not take, a home that does not exist
        pass
    accepted = "a path from this file's folder or from config/, or an absolute one"
    named.refuse(role, name, f"a {DESCRIPTIONS[role]}: {accepted}")
    raise AssertionError
