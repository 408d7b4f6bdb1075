"""The definition of a straight line, from a file or from a command line."""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, ClassVar, Literal, NamedTuple, Protocol, TypeAlias

import numpy as np
from pydantic import Field

from rx90_common.base.arrays import Array
from rx90_common.base.errors import LineError, located
from rx90_common.base.models import FileModel, Row, Triple, quantity, read_model
from rx90_common.description.branch import Branch
from rx90_common.description.kinematics import PathError, Pose, path_error
from rx90_common.description.robot_files import RobotFiles
from rx90_common.description.rotations import (
    axis_rotation,
    length,
    product,
    rpy_rotation,
    turn_between,
)

MARGIN_RANGE = (1e-3, 1.0)
LONGEST_LINE = 10.0
LONGEST_REST = LONGEST_MOTION = 3600.0
DEFAULT_BRANCH = Branch()
TOOL_DOWN = (0.0, math.radians(180.0), 0.0)
"""Roll, pitch and yaw, rad, with which the beam points down."""
SETTLING = 0.2
"""How long after its end a motion still counts for the path error, s: there the arm comes to rest."""
USUAL_SPEED = 0.1
USUAL_ACCELERATION = 1.0
"""What a line has whose speed and acceleration nobody names, m/s and m/s²."""

Vector: TypeAlias = tuple[float, ...]
"""Some numbers: a place, a posture, angles, times."""
_Rest: TypeAlias = Annotated[
    float, quantity("s", "Time at rest before, or after, the motion.", ge=0.0, le=LONGEST_REST)
]
Angles: TypeAlias = Annotated[
    tuple[Annotated[float, Field(ge=-360.0, le=360.0)], ...],
    Field(strict=False, min_length=3, max_length=3),
]
"""Roll, pitch and yaw about fixed axes, degrees."""


class Posture(FileModel):
    """Which solution of the inverse kinematics; of no meaning to an arm without a spherical wrist."""

    shoulder: Annotated[Literal["front", "back"], Field(description="The side of the shoulder.")]
    elbow: Annotated[Literal["positive", "negative"], Field(description="Sign of joint 3.")]
    wrist: Annotated[Literal["positive", "negative"], Field(description="Sign of joint 5.")]


class TipMotion(FileModel):
    """What the motions along lines and along other paths have alike."""

    speed: Annotated[float, quantity("m/s", "Speed along the path.", gt=0.0)]
    acceleration: Annotated[
        float, quantity("m/s^2", "Largest acceleration along the path.", gt=0.0)
    ]
    tool_rpy_degrees: Annotated[
        Angles,
        quantity(
            "deg", "Roll, pitch and yaw of the tool at the start, about fixed axes of base_link."
        ),
    ]
    rest_before: _Rest = 0.5
    rest_after: _Rest = 0.5
    singularity_margin: Annotated[
        float,
        quantity(
            "1",
            "Smallest accepted distance from a singularity.",
            ge=MARGIN_RANGE[0],
            le=MARGIN_RANGE[1],
        ),
    ] = 0.05
    start_posture: Annotated[
        Row | None,
        quantity(
            "rad",
            "Joint positions near which an arm without a spherical wrist starts; the middle of the joints' ranges if "
            "left out.",
            accepted="a list of numbers, one per joint",
        ),
    ] = None

    def values(self, posture: Posture | None) -> dict[str, Any]:
        """Return them as the fields of a TipTask."""
        branch = DEFAULT_BRANCH
        if posture is not None:
            branch = Branch(posture.shoulder, posture.elbow, posture.wrist)
        values = {name: getattr(self, name) for name in TipMotion.__annotations__}
        return values | {"start_rpy": radians(values.pop("tool_rpy_degrees")), "branch": branch}


class LineMotion(TipMotion):
    """The line and the motion along it."""

    start: Annotated[Triple, quantity("m", "Start, in base_link.")]
    end: Annotated[Triple, quantity("m", "End, in base_link.")]
    end_tool_rpy_degrees: Annotated[
        Angles | None,
        quantity("deg", "tool_rpy_degrees at the end, where the tool turns on the way."),
    ] = None
    speed_policy: Annotated[
        Literal["hold"],
        Field(description="A line holds its speed or is refused; a path may lower it."),
    ] = "hold"


class TaskFile(FileModel):
    """A straight line of the tool centre point."""

    line: LineMotion
    posture: Posture | None = None

    def task(self, file: Path) -> LineTask:
        """Return the line that the file means.

        Raises:
            LineError: if the values do not make a line.
        """
        line = self.line
        end_rpy = radians(line.end_tool_rpy_degrees or line.tool_rpy_degrees)
        with located(file, LineError):
            return LineTask(
                start=line.start, end=line.end, end_rpy=end_rpy, **line.values(self.posture)
            )


class PathMotion(NamedTuple):
    """Distance in m, speed in m/s and acceleration in m/s² along the line, each of the shape of the times."""

    distance: Array
    speed: Array
    acceleration: Array


class Profile(Protocol):
    """A motion along a path from rest to rest, as TrapezoidalProfile is one."""

    @property
    def duration(self) -> float: ...  # noqa: D102
    @property
    def peak_speed(self) -> float: ...  # noqa: D102
    @property
    def corners(self) -> Vector: ...  # noqa: D102
    def sample(self, times: Array) -> PathMotion: ...  # noqa: D102
    def speed_at(self, distance: Array) -> Array: ...  # noqa: D102


@dataclass(frozen=True)
class TrapezoidalProfile:
    """A motion from rest to rest; a triangle if the line is too short to reach the speed.

    Attributes:
        length: m.
        speed: required speed, m/s.
        acceleration: of both ramps, m/s².
    """

    length: float
    speed: float
    acceleration: float

    def __post_init__(self) -> None:
        for name, unit in (("length", "m"), ("speed", "m/s"), ("acceleration", "m/s^2")):
            value = getattr(self, name)
            if not (math.isfinite(value) and value > 0.0):
                raise LineError(f"the line's {name} is {value:g} {unit}; accepted: a number > 0")

    @property
    def peak_speed(self) -> float:
        """Return the highest speed reached, m/s."""
        return min(self.speed, math.sqrt(self.length * self.acceleration))

    @property
    def ramp_time(self) -> float:
        """Return the duration of one ramp, s."""
        return self.peak_speed / self.acceleration

    @property
    def duration(self) -> float:
        """Return the duration from rest to rest, s."""
        return self.length / self.peak_speed + self.ramp_time

    @property
    def corners(self) -> Vector:
        """Return the times at which the acceleration jumps, s."""
        end = self.duration
        ramp = self.ramp_time
        if self.peak_speed < self.speed:
            return (0.0, ramp, end)
        return (0.0, ramp, end - ramp, end)

    def sample(self, times: Array) -> PathMotion:
        """Return the motion at `times`, s, shape (n,): at rest before 0 and after the duration."""
        end = self.duration
        ramp = self.ramp_time
        # The second half is measured back from the end, so that it ends exactly at rest.
        late = times > end / 2.0
        t = np.where(late, end - times, times)
        within = t >= 0.0
        t = np.maximum(t, 0.0)
        ramping = t < ramp
        half = self.acceleration * t * t / 2.0
        distance = np.where(ramping, half, self.peak_speed * (t - ramp / 2.0))
        speed = np.where(ramping, self.acceleration * t, self.peak_speed)
        acceleration = np.where(ramping & within, self.acceleration, 0.0)
        return PathMotion(
            np.where(late, self.length - distance, distance),
            speed,
            np.where(late, -acceleration, acceleration),
        )

    def speed_at(self, distance: Array) -> Array:
        """Return the speed in m/s at `distance` m from the start, shape (n,)."""
        to_end = np.minimum(distance, self.length - distance)
        return np.minimum(
            self.peak_speed, np.sqrt(2.0 * self.acceleration * np.maximum(to_end, 0.0))
        )


class TipTask(Protocol):
    """The task of the tool centre point: a line, or any other path."""

    what: ClassVar[str]

    rest_before: float
    rest_after: float
    speed: float
    acceleration: float
    branch: Branch
    singularity_margin: float
    start_posture: Vector | None

    @property
    def length(self) -> float: ...  # noqa: D102 - as LineTask's, all of them
    def profile(self) -> Profile: ...  # noqa: D102
    def corners(self) -> Vector: ...  # noqa: D102
    def places(self, step: float, least: int) -> Array: ...  # noqa: D102
    def poses(self, distance: Array) -> Pose: ...  # noqa: D102
    def twists(self, distance: Array) -> tuple[Array, Array]: ...  # noqa: D102
    def error(self, tip: Array, near: Array | None = None) -> PathError: ...  # noqa: D102

    def notes(self) -> list[str]:
        """Return additional lines of text for a person; a straight line has none."""
        return []

    @property
    def counted(self) -> tuple[float, float]:
        """Return the part of its trajectory that counts for the path error, s: the motion, until the arm has settled.

        The rest before does not count: the controller may still be taking up the weight of the arm.
        """
        return self.rest_before, self.rest_before + self.profile().duration + min(
            SETTLING, self.rest_after
        )

    def check_rests(self) -> None:
        """Check rests and singularity margin.

        Raises:
            LineError: naming the value and what is accepted.
        """
        rests = (("rest_before", 0.0, LONGEST_REST, " s"), ("rest_after", 0.0, LONGEST_REST, " s"))
        for name, low, high, unit in (*rests, ("singularity_margin", *MARGIN_RANGE, "")):
            value = getattr(self, name)
            if not low <= value <= high:
                raise LineError(
                    f"{name} is {value:g}{unit}; accepted: a number in [{low:g}, {high:g}]"
                )


@dataclass(frozen=True)
class LineTask(TipTask):
    """A straight line of the tool centre point in the base frame.

    Attributes:
        start: m.
        end: m.
        speed: m/s.
        acceleration: of both ramps, m/s².
        start_rpy: roll, pitch and yaw of the tool about fixed axes, rad.
        end_rpy: the same at the end; the tool turns evenly with the distance, the shorter way.
        rest_before: s.
        rest_after: s.
        branch: the solution of the inverse kinematics; without meaning for an arm without a spherical wrist.
        singularity_margin: smallest accepted distance from a singularity, dimensionless (see
            `rx90_common.description.inverse.singularity_margins`).
        start_posture: joint angles, rad, near which the line starts, for an arm without a spherical wrist; None for the
            middle of the joints' ranges.

    Raises:
        LineError: naming the value and what is accepted.
    """

    start: Vector
    end: Vector
    speed: float = USUAL_SPEED
    acceleration: float = USUAL_ACCELERATION
    start_rpy: Vector = TOOL_DOWN
    end_rpy: Vector = TOOL_DOWN
    rest_before: float = 0.5
    rest_after: float = 0.5
    branch: Branch = DEFAULT_BRANCH
    singularity_margin: float = 0.05
    start_posture: Vector | None = None

    what: ClassVar[str] = "line"

    def __post_init__(self) -> None:
        for name in ("start", "end", "start_rpy", "end_rpy"):
            value = getattr(self, name)
            if len(value) != 3 or not all(math.isfinite(x) for x in value):
                raise LineError(f"the line's {name} is {value}; accepted: three finite numbers")
        if self.length == 0.0:
            raise LineError(
                f"the line starts and ends at {self.start} m; accepted: two different points"
            )
        # What no arm does, before the planning fills the memory with points of it.
        if self.length > LONGEST_LINE:
            raise LineError(
                f"the line's length is {self.length:g} m; accepted: up to {LONGEST_LINE:g} m"
            )
        profile = self.profile()
        duration = profile.duration if profile.peak_speed > 0.0 else math.inf
        if duration > LONGEST_MOTION:
            raise LineError(
                f"the line takes {duration:g} s at speed {self.speed:g} m/s and acceleration "
                f"{self.acceleration:g} m/s^2; accepted: up to {LONGEST_MOTION:g} s"
            )
        self.check_rests()

    @property
    def length(self) -> float:
        """Return the length of the line, m."""
        return float(length(np.subtract(self.end, self.start)))

    def profile(self) -> TrapezoidalProfile:
        """Return the speed profile along the line."""
        return TrapezoidalProfile(self.length, self.speed, self.acceleration)

    def corners(self) -> Vector:
        """Return the times of the motion at which an acceleration jumps, s."""
        return self.profile().corners

    def places(self, step: float, least: int) -> Array:
        """Return distances at most `step` m apart, and so many steps at least, at which the line is examined, m."""
        return np.linspace(0.0, self.length, max(least, int(np.ceil(self.length / step))) + 1)

    def poses(self, distance: Array) -> Pose:
        """Return the poses of the tool centre point at `distance` (n,) m from the start."""
        start = np.array(self.start)
        position = start + (np.array(self.end) - start) * (distance / self.length)[:, None]
        turn = turn_between(self.start_rpy, self.end_rpy)
        angle = length(turn)
        axis = turn / angle if angle > 0.0 else turn
        rotation = axis_rotation(axis, angle * (distance / self.length))
        return Pose(position, product(rotation, rpy_rotation(self.start_rpy)))

    def twists(self, distance: Array) -> tuple[Array, Array]:
        """Return first and second derivative of place and orientation by the distance, (n, 6): 1, rad/m; 1/m, rad/m².

        Those of a line are the same everywhere, and 0.
        """
        turn = turn_between(self.start_rpy, self.end_rpy)
        twist = np.concatenate([np.subtract(self.end, self.start), turn]) / self.length
        return np.broadcast_to(twist, (len(distance), 6)), np.zeros((len(distance), 6))

    def error(self, tip: Array, near: Array | None = None) -> PathError:  # noqa: ARG002 - of other paths
        """Return how far positions (n, 3) m of the tool centre point are from the line."""
        return path_error(tip, np.array(self.start), np.array(self.end))


def load_task(name: Path | str | None = None, *, robot: Path | str | None = None) -> LineTask:
    """Read a task file.

    Args:
        name: a path, or the name of a shipped file below config/; the robot's reference line if left out.
        robot: name of a shipped robot, or a robot folder; the RX90B if left out.

    Raises:
        ConfigError: naming file, key, value and what is accepted.
        LineError: if the values do not make a line.
    """
    folder = None if robot is None else str(robot)
    own = None if name is None else str(name)
    file = RobotFiles.named(folder, task=own).required("task")
    return read_model(TaskFile, file).task(file)


def radians(degrees: Vector) -> Vector:
    """Return angles that a file has in degrees."""
    return tuple(math.radians(angle) for angle in degrees)
