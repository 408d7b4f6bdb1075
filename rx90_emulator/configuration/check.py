"""What is wrong in a configuration file or a robot folder: all that can be seen at once, each in a line of its own.

A file is checked by the model of its kind, which says what it may hold, and then by the reader of all who use it.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping
from itertools import islice
from pathlib import Path
from typing import Any, NamedTuple

from rx90_common.base.config import read_yaml
from rx90_common.base.errors import ConfigError, Rx90Error
from rx90_common.base.models import FileModel
from rx90_common.base.quoting import listed, nearest, one_line, plain, quoted
from rx90_common.description.poses import Poses
from rx90_common.description.robot import load_robot
from rx90_common.description.robot_files import FILES, RobotFiles
from rx90_controller.lines.task import load_task
from rx90_emulator.configuration.kinds import KINDS, NODE_PARAMETERS, FileKind
from rx90_emulator.identification.experiments.plan import INDEX
from rx90_emulator.loop.line import plan_path
from rx90_emulator.loop.setup import Setup

_MORE_OF_A_KEY = re.compile(r"[\w*]")
_LINE = re.compile(r"\bline (\d+)")
_MAX_KEYS = 100  # by which the kind of a file is told
_NAMES = (*(kind.name for kind in KINDS), NODE_PARAMETERS)


class CheckedFile(NamedTuple):
    """The result of a check.

    Attributes:
        path: of the file.
        kind: by whose model it was checked.
        problems: a line for each, with the file, the line in it where that is known, key, value and what is accepted.
    """

    path: Path
    kind: str
    problems: tuple[str, ...]


def kind_named(name: str) -> FileKind:
    """Return a kind by its name."""
    if name == NODE_PARAMETERS:  # imported here, because it needs ROS and the other kinds do not
        from rx90_emulator.configuration.nodes import NODE_FILE

        return NODE_FILE
    for kind in KINDS:
        if kind.name == name:
            return kind
    raise ConfigError(f"kind {quoted(name)}; accepted: {listed(_NAMES)}")


def kind_of(path: Path, content: Mapping[str, Any]) -> FileKind:
    """Return the kind that knows most keys at the top of a file, misspelt ones with it; of several the best fitting."""
    if _has_node_parameters(content):
        return kind_named(NODE_PARAMETERS)

    def fit(kind: FileKind) -> tuple[int, int]:
        keys = kind.model.model_fields.keys() - set(FileModel.about_keys)
        known = [key for key in islice(content, _MAX_KEYS) if nearest(str(key), keys)]
        return len(known), -len(kind.faults(path, dict(content)))

    best = max(KINDS, key=fit)
    known, faults = fit(best)
    if not known and faults:  # as MoveIt's own files
        raise ConfigError(
            f"{plain(path)}: of no kind that its keys tell; accepted: --kind with {listed(_NAMES)}"
        )
    return best


def _has_node_parameters(content: Any) -> bool:
    return isinstance(content, dict) and (
        "ros__parameters" in content or any(map(_has_node_parameters, content.values()))
    )


def check_path(path: Path, kind: FileKind | None = None) -> list[CheckedFile]:
    """Check a file, by default for the kind that its content shows, or the files of a robot folder."""
    if kind is None and path.is_file() and path.suffix.lower() == ".urdf":
        return [_check_urdf(path)]
    if not path.is_dir():
        return [check_file(path, kind)]
    if kind is not None:
        raise ConfigError(f"{plain(path)} is a folder; accepted with a kind: a file")
    if (path / INDEX).is_file():
        return [check_file(path / INDEX, kind_named("experiments"))]
    return _check_robot(path)


def check_file(path: Path, kind: FileKind | None = None) -> CheckedFile:
    """Check a file by the model of its kind and, if that finds nothing, by its reader."""
    if not path.exists():
        raise ConfigError(
            f"{plain(path)}: no such file; accepted: a file of the project, or a robot folder"
        )
    lines: dict[str, int] = {}
    try:
        content = read_yaml(path, first=True, lines=lines)
    except ConfigError as error:
        return CheckedFile(
            path, "unreadable" if kind is None else kind.name, (_with_line(path, error, {}),)
        )
    kind = kind or kind_of(path, content)
    found: list[Rx90Error] = [*kind.faults(path, content)] or _faults_of(lambda: kind.read(path))
    shown = {plain(place): line for place, line in lines.items()} if found else {}
    return CheckedFile(path, kind.name, tuple(_with_line(path, error, shown) for error in found))


def _faults_of(read: Callable[[], object]) -> list[Rx90Error]:
    try:
        read()
    except Rx90Error as error:
        return [error]
    return []


def _with_line(path: Path, error: Rx90Error, lines: Mapping[str, int]) -> str:
    """Return a refusal with the line of the key that it begins with, or that it names."""
    text = str(error).removeprefix(f"{plain(path)}: ")
    ends = [
        end
        for end in range(1, len(text) + 1)
        if text[:end] in lines and not _MORE_OF_A_KEY.match(text, end)
    ]
    named = _LINE.search(text)
    line = f"{lines[text[: max(ends)]]}:" if ends else f"{named[1]}:" if named else ""
    return one_line(f"{plain(path)}:{line} {text}")


def _check_urdf(path: Path) -> CheckedFile:
    return CheckedFile(
        path,
        "URDF",
        tuple(_with_line(path, error, {}) for error in _faults_of(lambda: load_robot(path))),
    )


def _faults_together(files: RobotFiles) -> list[Rx90Error]:
    """Return what is wrong with files of a robot, each right alone, that others decide."""
    try:
        setup = Setup.load(files)
        setup.plant()
    except Rx90Error as refused:
        return [refused]
    faults: list[Rx90Error] = []
    task = files.task
    if task is not None:
        found = _faults_of(lambda: plan_path(setup, load_task(task)))
        faults += [ConfigError(f"{plain(task)}: {error}") for error in found]
    poses = files.poses
    if poses is not None:
        found = _faults_of(lambda: Poses.load(poses).check(setup.robot))
        faults += [ConfigError(f"{plain(poses)}: {error}") for error in found]
    return faults


def _check_robot(folder: Path) -> list[CheckedFile]:
    """Check the files of a robot folder one by one and, if there is nothing wrong in them, together.

    Together: names of joints in all files, poses, whether the arm can travel the task's line, missing files.
    """
    files = RobotFiles.named(str(folder))
    roles = {
        path: role
        for role in FILES
        if role != "urdf" and (path := getattr(files, role)) is not None
    }
    found = [
        check_file(path, kind_named(role))
        if path.is_file()
        else CheckedFile(path, role, (f"{plain(path)}: is missing; accepted: a {role} file",))
        for path, role in roles.items()
    ]
    found.append(_check_urdf(files.urdf))
    if any(each.problems for each in found):
        return found
    together = []
    for error in _faults_together(files):
        of = next((path for path in roles if str(error).startswith(f"{plain(path)}: ")), None)
        lines: dict[str, int] = {}
        if of is not None:
            read_yaml(of, lines=lines)
        together.append(str(error) if of is None else _with_line(of, error, lines))
    return [*found, CheckedFile(folder, "robot folder", tuple(together))]
