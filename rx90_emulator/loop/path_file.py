"""Path files: lines, arcs and splines in YAML, or the file of another program that the path is read from."""

from __future__ import annotations

from pathlib import Path as FilePath
from typing import Any

from rx90_common.base.config import Section, load_yaml
from rx90_common.base.entries import LEFT_OUT, ListOf, Number, Numbers, Text
from rx90_common.base.errors import LineError
from rx90_common.base.groups import Group
from rx90_common.base.share import resolve_config
from rx90_common.description.branch import Branch
from rx90_controller.lines.task import TASK, LineTask, radians, task_of
from rx90_controller.paths.path import ORIENTATIONS, Path, Segment
from rx90_emulator.loop.drawing import UNITS, Drawing

_point = Numbers("", "m", count=3)
_speed = Number("Speed along it; that of the path if left out.", "m/s", low=0.0, above=True, default=LEFT_OUT)
_LINE = TASK.keys["line"].keys  # type: ignore[attr-defined]

PATH = Group(
    "A path of the tool centre point: lines, arcs and splines.",
    keys={
        "path": Group(
            "The path and the motion along it.",
            one_of=("segments", "file"),
            needed_by={"segments": "start"},
            keys={
                "start": Numbers("Start, in base_link.", "m", count=3, default=LEFT_OUT),
                "segments": ListOf(
                    "Lines, arcs and splines, each from the end of the one before it.",
                    item=Group(
                        "A segment.",
                        one_of=("line", "arc", "spline"),
                        keys={
                            "line": Group("A straight line.", default=LEFT_OUT,
                                          keys={"end": Numbers("Its end.", "m", count=3)}),
                            "arc": Group(
                                "A circular arc: through `via`, or about `center`, counter-clockwise seen against "
                                "`normal`. A full circle about its centre ends at its start.",
                                one_of=("via", "center"), needed_by={"normal": "center"}, default=LEFT_OUT,
                                keys={
                                    "via": Numbers("A place between its ends.", "m", count=3, default=LEFT_OUT),
                                    "center": Numbers("Its centre.", "m", count=3, default=LEFT_OUT),
                                    "normal": Numbers("Of its plane; up if left out.", "1", count=3, default=LEFT_OUT),
                                    "end": Numbers("Its end.", "m", count=3),
                                },
                            ),
                            "spline": Group(
                                "A natural cubic spline through points.", default=LEFT_OUT,
                                keys={"points": ListOf("Points behind its start.", "m", item=_point, least=1,
                                                       accepted="a list of points, one or more")},
                            ),
                            "speed": _speed,
                            "zone": Number(
                                "How far before and behind its end a blend rounds the corner to the next segment; "
                                "0 if left out: the tool stops at a corner.", "m", low=0.0, default=LEFT_OUT),
                            "tool_rpy_degrees": Numbers(
                                "Of an interpolated orientation: roll, pitch and yaw of the tool at its end; as at its "
                                "start if left out.", "deg", count=3, low=-360.0, high=360.0, default=LEFT_OUT),
                        },
                    ),
                    accepted="a list of segments, one or more", least=1, default=LEFT_OUT,
                ),
                "file": Group(
                    "A file with the path: points (.csv), G-code (.nc, .ngc, .gcode, .tap) or a drawing (.dxf).",
                    default=LEFT_OUT,
                    keys={
                        "name": Text("The file, beside this one."),
                        "unit": Text("Unit of its numbers; of G-code, mm unless it says G20.", choices=tuple(UNITS),
                                     default=LEFT_OUT),
                        "origin": Numbers("Where its origin lies, in base_link; base_link's if left out.", "m",
                                          count=3, default=LEFT_OUT),
                        "rpy_degrees": Numbers("Roll, pitch and yaw of its axes.", "deg", count=3, low=-360.0,
                                               high=360.0, default=LEFT_OUT),
                        "points": Text("Points of a CSV file as the corners of lines, or on a spline; spline if left "
                                       "out.", choices=("lines", "spline"), default=LEFT_OUT),
                        "layer": Text("Layer of the drawing; all if left out.", default=LEFT_OUT),
                        "zone": Number("Zone at each corner; 0 if left out.", "m", low=0.0, default=LEFT_OUT),
                    },
                ),
                "speed": Number("Speed along the path.", "m/s", low=0.0, above=True),
                "acceleration": Number("Largest acceleration along the path.", "m/s^2", low=0.0, above=True),
                "jerk": Number("Largest jerk along the path; trapezoids of the speed if left out.", "m/s^3", low=0.0,
                               above=True, default=LEFT_OUT),
                "orientation": Text(
                    "Of the tool: fixed; turning about its z axis as the path does; or interpolated from segment to "
                    "segment. Fixed if left out.", choices=ORIENTATIONS, default=LEFT_OUT),
                "tool_rpy_degrees": Numbers("Roll, pitch and yaw of the tool at the start, about fixed axes of "
                                            "base_link.", "deg", count=3, low=-360.0, high=360.0),
                **{key: _LINE[key] for key in ("rest_before", "rest_after", "singularity_margin", "start_posture")},
            },
        ),
        "posture": TASK.keys["posture"],
    },
)  # fmt: skip
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
        ConfigError: naming file, key, value and what is accepted.
        LineError: if the values do not make a line or a path.
    """
    file = resolve_config(str(name))
    root = load_yaml(file)
    return _path(file, root) if "path" in root else task_of(file, root)


def _path(file: FilePath, root: Section) -> Path:
    content = PATH.read(root)
    values: dict[str, Any] = content["path"]
    drawn = values.pop("file", None)
    start, segments = values.pop("start", None), values.pop("segments", ())
    values["start_rpy"] = radians(values.pop("tool_rpy_degrees"))
    try:
        if drawn is not None:
            if start is not None:
                raise LineError("a start beside a file, which has its own; accepted: one of them")
            turn = radians(drawn.pop("rpy_degrees", (0.0, 0.0, 0.0)))
            start, parts = Drawing(file.parent / drawn.pop("name"), rpy=turn, **drawn).read()
        else:
            parts = tuple(_segment(one) for one in segments)
        return Path(start, parts, **values, branch=Branch(**content.get("posture", {})))
    except LineError as error:
        raise LineError(f"{file}: {error}") from error


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
