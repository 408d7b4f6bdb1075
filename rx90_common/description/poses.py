"""The poses of a robot at which the experiments of an identification take place."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

from pydantic import Field

from rx90_common.base.errors import IdentificationError
from rx90_common.base.models import FileModel, PerJoint, quantity, read_model
from rx90_common.description.robot import RobotModel


class HomePose(FileModel):
    """Where every experiment begins and ends."""

    position: Annotated[PerJoint, quantity("rad", "Joint positions.")]


class PoseList(FileModel):
    """Where experiments take place."""

    positions: Annotated[
        tuple[PerJoint, ...],
        Field(strict=False, min_length=1),
        quantity("rad", "Joint positions of each pose."),
    ]


class Poses(FileModel):
    """Where the experiments of an identification take place."""

    home: HomePose
    sweeps: Annotated[PoseList, Field(description="Where the sweeps take place.")]
    validation: Annotated[PoseList, Field(description="Between which the validation moves.")]

    @classmethod
    def load(cls, file: Path) -> Poses:
        """Read a poses file."""
        return read_model(cls, file)

    def check(self, robot: RobotModel) -> None:
        """Check that an arm reaches the poses."""
        robot.check_position("home", self.home.position, IdentificationError)
        for poses, where in (self.sweeps, ""), (self.validation, " of the validation"):
            for number, pose in enumerate(poses.positions, 1):
                robot.check_position(f"pose {number}{where}", pose, IdentificationError)
