"""What the controller knows of the arm and its friction, for the feed-forward by a model: its own files."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any, Final, NamedTuple

import numpy as np

from rx90_common.base.entries import LEFT_OUT, Text
from rx90_common.base.errors import ConfigError
from rx90_common.base.groups import Group
from rx90_common.base.quoting import plain
from rx90_common.base.section import Section
from rx90_common.base.share import resolve_config
from rx90_common.description.drives import load_drives
from rx90_common.description.robot import load_robot
from rx90_common.description.robot_files import DESCRIPTIONS, FILES, NO_TOOL
from rx90_common.dynamics import manipulator_record
from rx90_common.friction import load_friction
from rx90_common.friction.element import element_arrays
from rx90_common.friction.friction_set import refuse_parts

ROLES: Final = ("urdf", "tool", "drives", "friction")
"""The files of a model, by their names in the block `model` and in ModelFiles."""

MODEL = Group(
    "What the controller knows of the arm, for inverse_dynamics and friction_model; it may be wrong. A file is looked "
    "for beside this one, then as everywhere: a path, or a name below config/. One that is left out is the robot "
    "folder's own, beside this file.",
    keys={role: Text(f"The {DESCRIPTIONS[role]}.", default=LEFT_OUT) for role in ROLES},
    default=LEFT_OUT,
)
"""The block `model` of a controller file."""


class ModelConstants(NamedTuple):
    """The model as compiled code reads it: the arm, MANIPULATOR_DTYPE, and seven elements; shape (1,) each."""

    arm: np.ndarray[Any, Any]
    friction: np.ndarray[Any, Any]


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
    def constants(self) -> ModelConstants:
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
        robot = load_robot(self.urdf, self.tool)
        friction = load_friction(self.friction, robot.joint_names)
        elements = dict(zip(friction.names, friction.elements, strict=True))
        refuse_parts(elements, "the controller's friction model", f"{plain(self.friction)}: elements.")
        arm = manipulator_record(robot.chain, load_drives(self.drives))
        return ModelConstants(arm, element_arrays(friction.elements))


def _resolved(named: Section, role: str) -> Path:
    name = named.text(role)
    beside = named.file.parent / name
    try:
        return beside if beside.is_file() else resolve_config(name)
    except (OSError, ConfigError) as error:
        named.refuse(role, name, f"a {DESCRIPTIONS[role]}: beside this file, by a path, or by a name below config/")
        raise AssertionError from error
