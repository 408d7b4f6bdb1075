"""Where experiments take place: a robot's poses file."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from rx90_common.base.config import load_yaml
from rx90_common.base.entries import Numbers, Rows
from rx90_common.base.errors import IdentificationError
from rx90_common.base.groups import Group
from rx90_common.description.robot import RobotModel
from rx90_common.description.robot_files import RobotFiles

Pose = tuple[float, ...]


def _positions(about: str) -> Group:
    return Group(about, keys={"positions": Rows("Joint positions, six for each pose.", "rad", count=6)})


POSES = Group(
    "Where the experiments of an identification take place.",
    keys={
        "home": Group(
            "Where every experiment begins and ends.",
            keys={"position": Numbers("Six joint positions.", "rad", count=6)},
        ),
        "sweeps": _positions("Where the sweeps take place."),
        "validation": _positions("Between which the validation moves."),
    },
)
"""What a poses file holds."""


@dataclass(frozen=True)
class Poses:
    """Joint positions, rad, each of shape (6,).

    Attributes:
        home: where every experiment begins and ends.
        sweeps: where the sweeps take place, at least one.
        validation: between which the validation moves.
    """

    home: Pose
    sweeps: tuple[Pose, ...]
    validation: tuple[Pose, ...]

    @classmethod
    def load(cls, file: Path) -> Poses:
        """Read a poses file.

        Raises:
            ConfigError: naming file, key, value and what is accepted.
        """
        content = POSES.read(load_yaml(file))
        return cls(content["home"]["position"], content["sweeps"]["positions"], content["validation"]["positions"])

    @classmethod
    def shipped(cls) -> Poses:
        """Return those of the RX90B."""
        return cls.load(RobotFiles().required("poses"))

    def check(self, robot: RobotModel) -> None:
        """Check that an arm reaches the poses.

        Raises:
            IdentificationError: naming pose, joint, value and limits.
        """
        if not self.sweeps:
            raise IdentificationError("no pose; accepted: one or more")
        sweeps = ((f"pose {i + 1}", pose) for i, pose in enumerate(self.sweeps))
        validation = ((f"pose {i + 1} of the validation", pose) for i, pose in enumerate(self.validation))
        for what, pose in (("home", self.home), *sweeps, *validation):
            _check(robot, what, pose)


def _check(robot: RobotModel, what: str, pose: Sequence[float]) -> None:
    if len(pose) != len(robot.joint_names):
        raise IdentificationError(f"{what} has {len(pose)} angles; accepted: {len(robot.joint_names)}")
    for name, value, low, high in zip(robot.joint_names, pose, robot.lower, robot.upper, strict=True):
        if not low <= value <= high:
            raise IdentificationError(
                f"{what}: {name} is {value:g} rad; accepted: [{low:.4g}, {high:.4g}], the joint's limits"
            )
