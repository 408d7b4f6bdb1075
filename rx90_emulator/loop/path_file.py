"""Files of motions: paths of the tool and trajectories of the joints.

A path is lines, arcs and splines in YAML, or the file of another program that it is read from. A trajectory is the YAML
of a JointTrajectory, as `rx90_line --output` and `ros2 topic echo` write it.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path as FilePath
from types import SimpleNamespace
from typing import Any

from rx90_common.base.config import Section, load_yaml
from rx90_common.base.entries import LEFT_OUT, Integer, ListOf, Number, Numbers, Text, Texts
from rx90_common.base.errors import ConfigError, LineError, located
from rx90_common.base.groups import Group
from rx90_common.base.share import resolve_config
from rx90_common.description.branch import Branch
from rx90_controller.lines.task import TASK, LineTask, radians, task_of
from rx90_controller.paths.path import ORIENTATIONS, SPEED_POLICIES, Path, Segment
from rx90_controller.trajectory import TrajectoryPoints
from rx90_controller.trajectory.points import points_from_message
from rx90_emulator.loop.drawing import UNITS, Drawing

_TASK_LINE = TASK.keys["line"]
assert isinstance(_TASK_LINE, Group)
_LINE = Group("A straight line.", keys={"end": Numbers("Its end.", "m", count=3)}, default=LEFT_OUT)
_ARC = Group(
    "A circular arc: through `via`, or about `center`, counter-clockwise seen against `normal`. A full circle about "
    "its centre ends at its start.",
    one_of=("via", "center"),
    needed_by={"normal": "center"},
    default=LEFT_OUT,
    keys={
        "via": Numbers("A place between its ends.", "m", count=3, default=LEFT_OUT),
        "center": Numbers("Its centre.", "m", count=3, default=LEFT_OUT),
        "normal": Numbers("Of its plane; up if left out.", "1", count=3, default=LEFT_OUT),
        "end": Numbers("Its end.", "m", count=3),
    },
)
_POINTS = ListOf(
    "Points behind its start.",
    "m",
    item=Numbers("", "m", count=3),
    least=1,
    accepted="a list of points, one or more",
)
_SPLINE = Group("A natural cubic spline through points.", keys={"points": _POINTS}, default=LEFT_OUT)
_SEGMENT = Group(
    "A segment.",
    one_of=("line", "arc", "spline"),
    keys={
        "line": _LINE,
        "arc": _ARC,
        "spline": _SPLINE,
        "speed": Number("Speed along it; that of the path if left out.", "m/s", low=0.0, above=True, default=LEFT_OUT),
        "zone": Number(
            "How far before and behind its end a blend rounds the corner to the next segment; 0 if left out: the tool "
            "stops at a corner.",
            "m",
            low=0.0,
            default=LEFT_OUT,
        ),
        "tool_rpy_degrees": Numbers(
            "Of an interpolated orientation: roll, pitch and yaw of the tool at its end; as at its start if left out.",
            "deg",
            count=3,
            low=-360.0,
            high=360.0,
            default=LEFT_OUT,
        ),
    },
)
_FILE = Group(
    "A file with the path: points (.csv) or a drawing (.dxf).",
    default=LEFT_OUT,
    keys={
        "name": Text("The file, beside this one."),
        "unit": Text("Unit of its numbers.", choices=tuple(UNITS), default=LEFT_OUT),
        "origin": Numbers(
            "Where its origin lies, in base_link; base_link's if left out.", "m", count=3, default=LEFT_OUT
        ),
        "rpy_degrees": Numbers(
            "Roll, pitch and yaw of its axes.", "deg", count=3, low=-360.0, high=360.0, default=LEFT_OUT
        ),
        "points": Text(
            "Points of a CSV file as the corners of lines, or on a spline; spline if left out.",
            choices=("lines", "spline"),
            default=LEFT_OUT,
        ),
        "layer": Text("Layer of the drawing; all if left out.", default=LEFT_OUT),
        "zone": Number("Zone at each corner; 0 if left out.", "m", low=0.0, default=LEFT_OUT),
    },
)
_MOTION = Group(
    "The path and the motion along it.",
    one_of=("segments", "file"),
    needed_by={"segments": "start"},
    keys={
        "start": Numbers("Start, in base_link.", "m", count=3, default=LEFT_OUT),
        "segments": ListOf(
            "Lines, arcs and splines, each from the end of the one before it.",
            item=_SEGMENT,
            accepted="a list of segments, one or more",
            least=1,
            default=LEFT_OUT,
        ),
        "file": _FILE,
        "speed": Number("Speed along the path.", "m/s", low=0.0, above=True),
        "acceleration": Number("Largest acceleration along the path.", "m/s^2", low=0.0, above=True),
        "jerk": Number(
            "Largest jerk along the path; trapezoids of the speed if left out.",
            "m/s^3",
            low=0.0,
            above=True,
            default=LEFT_OUT,
        ),
        "speed_policy": Text(
            "Where a joint's limit asks for less speed: lower it, or hold it and refuse the path. Lower if left out.",
            choices=SPEED_POLICIES,
            default=LEFT_OUT,
        ),
        "orientation": Text(
            "Of the tool: fixed; turning about its z axis as the path does; or interpolated from segment to segment. "
            "Fixed if left out.",
            choices=ORIENTATIONS,
            default=LEFT_OUT,
        ),
        "tool_rpy_degrees": Numbers(
            "Roll, pitch and yaw of the tool at the start, about fixed axes of base_link.",
            "deg",
            count=3,
            low=-360.0,
            high=360.0,
        ),
        **{key: _TASK_LINE.keys[key] for key in ("rest_before", "rest_after", "singularity_margin", "start_posture")},
    },
)
PATH = Group(
    "A path of the tool centre point: lines, arcs and splines.",
    keys={"path": _MOTION, "posture": TASK.keys["posture"]},
)
"""What a path file holds."""


def load_path(name: FilePath | str) -> Path:
    """Read a path file, by its path or the name of a shipped one below config/.

    Raises:
        ConfigError: naming file, key, value and what is accepted.
        LineError: if the values do not make a path.
    """
    file = resolve_config(str(name))
    return _path(file, load_yaml(file))


def load_motion(name: FilePath | str) -> LineTask | Path:
    """Read a task file or a path file, whichever it is.

    Raises:
        LineError: if the values do not make a line or a path.
    """
    file = resolve_config(str(name))
    root = load_yaml(file)
    root.refuse_unknown({*PATH.keys, *TASK.keys})
    return _path(file, root) if "path" in root else task_of(file, root)


def _path(file: FilePath, root: Section) -> Path:
    content = PATH.read(root)
    values: dict[str, Any] = content["path"]
    drawn = values.pop("file", None)
    start = values.pop("start", None)
    segments = values.pop("segments", ())
    values["start_rpy"] = radians(values.pop("tool_rpy_degrees"))
    with located(file, LineError):
        if drawn is not None:
            if start is not None:
                raise LineError("a start beside a file, which has its own; accepted: one of them")
            turn = radians(drawn.pop("rpy_degrees", (0.0, 0.0, 0.0)))
            start, parts = Drawing(file.parent / drawn.pop("name"), rpy=turn, **drawn).read()
        else:
            parts = tuple(_segment(one) for one in segments)
        return Path(start, parts, **values, branch=Branch(**content.get("posture", {})))


def _segment(content: dict[str, Any]) -> Segment:
    motion: dict[str, Any] = {key: content[key] for key in ("speed", "zone") if key in content}
    if "tool_rpy_degrees" in content:
        motion["end_rpy"] = radians(content["tool_rpy_degrees"])
    if "line" in content:
        return Segment((content["line"]["end"],), **motion)
    if "spline" in content:
        return Segment(content["spline"]["points"], "spline", **motion)
    arc = content["arc"]
    if "via" in arc:
        return Segment((arc["via"], arc["end"]), "arc", **motion)
    about = {key: arc[key] for key in ("center", "normal") if key in arc}
    return Segment((arc["end"],), "arc", **about, **motion)


_ACCEPTED = "the YAML of a trajectory_msgs/JointTrajectory"
_TIME = {
    "sec": Integer("Whole seconds.", "s", low=-(2**31), high=2**31 - 1, default=0),
    "nanosec": Integer("The rest.", "ns", low=0, high=2**32 - 1, default=0),
}
_OF_JOINTS = {
    name: ListOf(about, unit, item=Number(""), accepted="a list of numbers", default=())
    for name, about, unit in (
        ("positions", "Of each joint.", "rad"),
        ("velocities", "Of each joint; may be left out.", "rad/s"),
        ("accelerations", "Of each joint, with velocities; may be left out.", "rad/s^2"),
        ("effort", "None: the controller follows positions.", "Nm"),
    )
}
TRAJECTORY = Group(
    "A trajectory_msgs/JointTrajectory; the header is not looked at.",
    keys={
        "joint_names": Texts("The robot's joints, in any order."),
        "points": ListOf(
            "Points in the order of their times.",
            item=Group(
                "A point.",
                keys={
                    **_OF_JOINTS,
                    "time_from_start": Group("Its time.", keys=_TIME, known=False),
                },
                known=False,
            ),
            accepted="a list of points",
        ),
    },
    known=False,
)
"""What a trajectory file holds."""


def load_trajectory(name: FilePath | str, robot_joints: Sequence[str]) -> TrajectoryPoints:
    """Read the points of a trajectory, joints in any order.

    The header is not looked at: when the trajectory starts is for the run to say.

    Raises:
        ConfigError: naming file and reason, for a file that cannot be read or is no trajectory.
        TrajectoryError: naming file, joint, index of the point and reason.
    """
    file = FilePath(name)
    # `ros2 topic echo` ends each message with a line of dashes.
    root = load_yaml(file, _ACCEPTED, first=True)
    try:
        content = TRAJECTORY.read(root)
    except ConfigError as error:
        raise ConfigError(f"{error}, as {_ACCEPTED} has") from error
    points = [
        SimpleNamespace(
            time_from_start=SimpleNamespace(**{key: point["time_from_start"][key] for key in _TIME}),
            **{name: list(point[name] or ()) for name in _OF_JOINTS},
        )
        for point in content["points"]
    ]
    with located(file):
        return points_from_message(
            robot_joints, SimpleNamespace(joint_names=list(content["joint_names"]), points=points)
        )
