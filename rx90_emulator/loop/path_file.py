"""Files of motions: paths of the tool and trajectories of the joints.

A path is lines, arcs and splines in YAML, or the file of another program that it is read from. A trajectory is the YAML
of a JointTrajectory, as `rx90 line --output` and `ros2 topic echo` write it.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path as FilePath
from typing import Annotated, Any, Literal, TypeAlias

from pydantic import Field, model_validator

from rx90_common.base.config import read_yaml
from rx90_common.base.errors import ConfigError, LineError, located
from rx90_common.base.models import (
    FileModel,
    Model,
    Names,
    OneOf,
    Row,
    Triple,
    quantity,
    read_model,
    refusal,
)
from rx90_common.base.quoting import nearest
from rx90_common.base.share import resolve_config
from rx90_controller.lines.task import Angles, LineTask, Posture, TipMotion, load_task, radians
from rx90_controller.paths.path import Path, Segment
from rx90_controller.trajectory import TrajectoryPoints
from rx90_controller.trajectory.points import points_from_message
from rx90_emulator.loop.drawing import Drawing

_Point: TypeAlias = Annotated[Triple, quantity("m", "A place, in base_link.")]


class LineSegment(FileModel):
    """A straight line."""

    end: _Point


class ArcSegment(OneOf):
    """A circular arc: through `via`, or about `center`, counter-clockwise seen against `normal`.

    A full circle about its centre ends at its start.
    """

    one_of = ("via", "center")

    via: Annotated[Triple | None, quantity("m", "A place between its ends.")] = None
    center: Annotated[Triple | None, quantity("m", "Its centre.")] = None
    normal: Annotated[
        Triple | None, quantity("1", "Of its plane, beside center; up if left out.")
    ] = None
    end: Annotated[Triple, quantity("m", "Its end.")]

    @model_validator(mode="after")
    def _check_normal(self) -> ArcSegment:
        if self.normal is not None and self.center is None:
            raise refusal("normal", self.normal, "beside center")
        return self


class SplineSegment(FileModel):
    """A natural cubic spline through points."""

    points: Annotated[
        tuple[_Point, ...],
        Field(strict=False, min_length=1, description="Points behind its start."),
    ]


class SegmentMotion(OneOf):
    """A segment."""

    one_of = ("line", "arc", "spline")

    line: LineSegment | None = None
    arc: ArcSegment | None = None
    spline: SplineSegment | None = None
    speed: Annotated[
        float | None, quantity("m/s", "Speed along it; that of the path if left out.", gt=0.0)
    ] = None
    zone: Annotated[
        float,
        quantity(
            "m",
            "How far before and behind its end a blend rounds the corner to the next segment; 0: the tool stops at a "
            "corner.",
            ge=0.0,
        ),
    ] = 0.0
    tool_rpy_degrees: Annotated[
        Angles | None,
        quantity(
            "deg",
            "Of an interpolated orientation: roll, pitch and yaw of the tool at its end; as at its start if left out.",
        ),
    ] = None

    def segment(self) -> Segment:
        """Return the part of a path."""
        motion: dict[str, Any] = {"speed": self.speed, "zone": self.zone}
        if self.tool_rpy_degrees is not None:
            motion["end_rpy"] = radians(self.tool_rpy_degrees)
        if self.line is not None:
            return Segment((self.line.end,), **motion)
        if self.spline is not None:
            return Segment(self.spline.points, "spline", **motion)
        assert self.arc is not None
        if self.arc.via is not None:
            return Segment((self.arc.via, self.arc.end), "arc", **motion)
        if self.arc.normal is not None:
            motion["normal"] = self.arc.normal
        return Segment((self.arc.end,), "arc", self.arc.center, **motion)


class PathMotion(OneOf, TipMotion):
    """The path and the motion along it."""

    one_of = ("segments", "file")

    start: Annotated[Triple | None, quantity("m", "Start, in base_link; of segments.")] = None
    segments: Annotated[
        tuple[SegmentMotion, ...] | None,
        Field(
            strict=False,
            min_length=1,
            description="Lines, arcs and splines, each from the end of the one before it.",
        ),
    ] = None
    file: Drawing | None = None
    jerk: Annotated[
        float | None,
        quantity(
            "m/s^3", "Largest jerk along the path; trapezoids of the speed if left out.", gt=0.0
        ),
    ] = None
    speed_policy: Annotated[
        Literal["lower", "hold"],
        Field(
            description="Where a joint's limit asks for less speed: lower it, or hold it and refuse the path."
        ),
    ] = "lower"
    orientation: Annotated[
        Literal["fixed", "tangent", "interpolated"],
        Field(
            description="Of the tool: fixed; turning about its z axis as the path does; or interpolated from segment "
            "to segment."
        ),
    ] = "fixed"

    @model_validator(mode="after")
    def _check_start(self) -> PathMotion:
        if self.segments is not None and self.start is None:
            raise ValueError("has segments and no start; accepted: start, three numbers, m")
        if self.file is not None and self.start is not None:
            raise refusal("start", self.start, "none beside a file, which has its own")
        return self


class PathFile(FileModel):
    """A path of the tool centre point: lines, arcs and splines."""

    path: PathMotion
    posture: Posture | None = None

    def read(self, file: FilePath) -> Path:
        """Return the path that the file means.

        Raises:
            LineError: if the values do not make a path.
        """
        motion = self.path
        with located(file, LineError):
            start = motion.start
            segments = tuple(part.segment() for part in motion.segments or ())
            if motion.file is not None:
                drawing = motion.file.replaced(name=str(file.parent / motion.file.name))
                start, segments = drawing.read()
            assert start is not None
            return Path(
                start,
                segments,
                jerk=math.inf if motion.jerk is None else motion.jerk,
                orientation=motion.orientation,
                speed_policy=motion.speed_policy,
                **motion.values(self.posture),
            )


def load_path(name: FilePath | str) -> Path:
    """Read a path file, by its path or the name of a shipped one below config/.

    Raises:
        ConfigError: naming file, key, value and what is accepted.
        LineError: if the values do not make a path.
    """
    file = resolve_config(str(name))
    return read_model(PathFile, file).read(file)


def load_motion(name: FilePath | str) -> LineTask | Path:
    """Read a task file or a path file, whichever it is by its keys, misspelt or not.

    Raises:
        LineError: if the values do not make a line or a path.
    """
    file = resolve_config(str(name))
    if _meant(file) == "path":
        return load_path(file)
    return load_task(file)


def is_trajectory(file: FilePath) -> bool:
    """Return whether a motion's file is a trajectory by its keys, misspelt or not."""
    return _meant(file) in ("joint_names", "points")


def _meant(file: FilePath) -> str:
    """Return the key of a motion's file that tells its kind, an empty text if none is like one."""
    keys = read_yaml(file, first=True)
    kinds = ("line", "path", "joint_names", "points")
    return next((near for key in keys if (near := nearest(str(key), kinds))), "")


_ACCEPTED = "the YAML of a trajectory_msgs/JointTrajectory"


class Duration(Model):
    """A time."""

    sec: Annotated[int, quantity("s", "Whole seconds.", ge=-(2**31), le=2**31 - 1)] = 0
    nanosec: Annotated[int, quantity("ns", "The rest.", ge=0, le=2**32 - 1)] = 0


class TrajectoryPoint(Model):
    """A point."""

    positions: Annotated[Row, quantity("rad", "Of each joint.")] = ()
    velocities: Annotated[Row, quantity("rad/s", "Of each joint; may be left out.")] = ()
    accelerations: Annotated[
        Row, quantity("rad/s^2", "Of each joint, with velocities; may be left out.")
    ] = ()
    effort: Annotated[Row, quantity("Nm", "None: the controller follows positions.")] = ()
    time_from_start: Duration


class TrajectoryFile(FileModel):
    """A trajectory_msgs/JointTrajectory; the header is not looked at."""

    header: Annotated[Any, Field(description="Of the message; not looked at.")] = None
    joint_names: Annotated[Names, Field(description="The robot's joints, in any order.")]
    points: Annotated[
        tuple[TrajectoryPoint, ...],
        Field(strict=False, description="Points in the order of their times."),
    ]


def load_trajectory(name: FilePath | str, robot_joints: Sequence[str]) -> TrajectoryPoints:
    """Read the points of a trajectory, joints in any order.

    The header is not looked at: when the trajectory starts is for the run to say.

    Raises:
        ConfigError: naming file and reason, for a file that cannot be read or is no trajectory.
        TrajectoryError: naming file, joint, index of the point and reason.
    """
    file = FilePath(name)
    # `ros2 topic echo` ends each message with a line of dashes.
    try:
        trajectory = read_model(TrajectoryFile, file, _ACCEPTED, first=True)
    except ConfigError as error:
        raise ConfigError(f"{error}, as {_ACCEPTED} has") from error
    with located(file):
        return points_from_message(robot_joints, trajectory)
