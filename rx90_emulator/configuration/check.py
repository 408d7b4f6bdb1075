"""What is wrong in a configuration file or a robot folder: all that can be seen at once, each in a line of its own."""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

from rx90_common.base.config import load_yaml, yaml_lines
from rx90_common.base.errors import ConfigError, Rx90Error
from rx90_common.base.groups import Entries, Group
from rx90_common.base.quoting import listed, one_line, plain, quoted
from rx90_common.base.section import ABOUT
from rx90_common.description.robot import load_robot
from rx90_common.description.robot_files import FILES, RobotFiles
from rx90_emulator.configuration.kinds import KINDS, FileKind
from rx90_emulator.identification.experiments.folder import INDEX
from rx90_emulator.identification.experiments.plan import Poses
from rx90_emulator.loop.setup import Setup

_LINE = re.compile(r"\bline (\d+)")
_OF_NODES = "node_parameters"
_LIKE = 0.5  # share of a file's keys that a kind must have
_LIMITS = "moveit/joint_limits.yaml"


class CheckedFile(NamedTuple):
    """What came out for a file.

    Attributes:
        path: of the file.
        kind: what it was taken for.
        problems: a line for each, with the file, the line in it where that is known, key, value and what is accepted.
    """

    path: Path
    kind: str
    problems: tuple[str, ...]


def kind_named(name: str) -> FileKind:
    """Return a kind by its name.

    Raises:
        ConfigError: with those that there are.
    """
    if name == _OF_NODES:
        return _node_file()
    for kind in KINDS:
        if kind.name == name:
            return kind
    raise ConfigError(f"kind {quoted(name)}; accepted: {listed([*(kind.name for kind in KINDS), _OF_NODES])}")


def _node_file() -> FileKind:
    # Here, because it needs ROS and the other kinds do not.
    from rx90_emulator.configuration.node_file import NODE_FILE

    return NODE_FILE


def _is_of_nodes(content: Any) -> bool:
    return isinstance(content, dict) and ("ros__parameters" in content or any(map(_is_of_nodes, content.values())))


def kind_of(path: Path, content: Mapping[str, Any]) -> FileKind:
    """Return the kind of which a file has the most keys.

    Raises:
        ConfigError: if that cannot be told.
    """
    if _is_of_nodes(content):
        return _node_file()
    likeness = {kind.name: _likeness(kind.entry, content) for kind in KINDS}
    best = max(likeness, key=lambda name: likeness[name])
    if not likeness[best]:
        raise ConfigError(
            f"{plain(path)}: of no kind that is checked, as MoveIt's own files; accepted: "
            f"{listed([*likeness, _OF_NODES])}"
        )
    if likeness[best] <= _LIKE or list(likeness.values()).count(likeness[best]) > 1:
        raise ConfigError(
            f"{plain(path)}: its kind cannot be told from its keys; accepted: --kind with one of "
            f"{listed([*likeness, _OF_NODES])}"
        )
    return kind_named(best)


def _likeness(entry: object, content: Mapping[str, Any]) -> float:
    known, every = _known_keys(entry, content)
    return known / every if every else 0.0


def _known_keys(entry: object, content: Any) -> tuple[int, int]:
    """Return how many keys of groups are known, and how many there are, those of groups in a group weighing as much."""
    if not isinstance(content, dict):
        return 0, 0
    counts = [0, 0]
    for key, value in ((key, value) for key, value in content.items() if key not in ABOUT):
        inner = entry.keys.get(key) if isinstance(entry, Group) else entry.of if isinstance(entry, Entries) else None
        if isinstance(entry, Group):
            counts[0] += inner is not None
            counts[1] += 1
        if isinstance(inner, Group | Entries):
            known, every = _known_keys(inner, value)
            counts[0] += known
            counts[1] += every
    return counts[0], counts[1]


def check_path(path: Path, kind: FileKind | None = None) -> list[CheckedFile]:
    """Check a file, by default for the kind that its content shows, or the files of a robot folder.

    Raises:
        ConfigError: if it is not there, or what it is cannot be told.
    """
    if not path.is_dir():
        return [check_file(path, kind)]
    if kind is not None:
        raise ConfigError(f"{plain(path)} is a folder; accepted with a kind: a file")
    if (path / INDEX).is_file():
        return [check_file(path / INDEX, kind_named("experiments"))]
    return check_robot(path)


def check_file(path: Path, kind: FileKind | None = None) -> CheckedFile:
    """Check a file by the table of its kind and, if that finds nothing, by its reader.

    Raises:
        ConfigError: if it cannot be read, or what it is cannot be told.
    """
    if not path.exists():
        raise ConfigError(f"{plain(path)}: no such file; accepted: a file of the project, or a robot folder")
    faults: list[ConfigError] = []
    try:
        root = load_yaml(path, first=True, faults=faults)
    except ConfigError as error:
        return CheckedFile(path, "unreadable" if kind is None else kind.name, (_told(path, error, {}),))
    kind = kind or kind_of(path, root.content)
    kind.entry.read(root)
    found: list[Rx90Error] = list(faults) or _refused(lambda: kind.read(path))
    lines = yaml_lines(path) if found else {}
    return CheckedFile(path, kind.name, tuple(_told(path, error, lines) for error in found))


def _refused(read: Callable[[], object]) -> list[Rx90Error]:
    try:
        read()
    except Rx90Error as error:
        return [error]
    return []


def _told(path: Path, error: Rx90Error, lines: Mapping[str, int]) -> str:
    """Return a refusal with the line of the key that it begins with, or that it names."""
    text = str(error).removeprefix(f"{plain(path)}: ")
    places = [place for place in lines if re.match(rf"{re.escape(plain(place))}(?![\w*])", text)]
    line = lines[max(places, key=len)] if places else None
    if line is None and (named := _LINE.search(text)):
        line = int(named[1])
    return one_line(f"{plain(path)}:{'' if line is None else f'{line}:'} {text}")


def check_robot(folder: Path) -> list[CheckedFile]:
    """Check the files of a robot folder one by one and, if there is nothing wrong in them, together.

    Raises:
        ConfigError: if the folder is none of a robot.
    """
    files = RobotFiles.named(str(folder))
    found = [_check_there(path, kind_named(role)) for role, path in _yaml_files(files)]
    limits = folder / _LIMITS
    if limits.is_file():
        found.append(check_file(limits, kind_named("moveit_limits")))
    faults = _refused(lambda: load_robot(files.urdf))
    found.append(CheckedFile(files.urdf, "URDF", tuple(_told(files.urdf, error, {}) for error in faults)))
    if not any(each.problems for each in found):
        yaml_files = [path for _, path in _yaml_files(files)]
        told = tuple(_told_of(yaml_files, error) for error in _together(files, limits))
        found.append(CheckedFile(folder, "robot folder", told))
    return found


def _check_there(path: Path, kind: FileKind) -> CheckedFile:
    if path.is_file():
        return check_file(path, kind)
    return CheckedFile(path, kind.name, (f"{plain(path)}: is missing; accepted: a {kind.name} file",))


def _told_of(paths: Sequence[Path], error: Rx90Error) -> str:
    """Return a refusal that names one of several files."""
    for path in paths:
        if str(error).startswith(f"{plain(path)}: "):
            return _told(path, error, yaml_lines(path))
    return str(error)


def _yaml_files(files: RobotFiles) -> list[tuple[str, Path]]:
    return [(role, path) for role in FILES if role != "urdf" and (path := getattr(files, role)) is not None]


def _together(files: RobotFiles, limits: Path) -> list[Rx90Error]:
    """Return what does not fit together: names of joints in all files, poses and limits, missing files."""
    faults = _refused(lambda: Setup.load(files).plant())
    if faults:
        return faults
    robot = load_robot(files.urdf, files.tool)
    poses = files.poses
    if poses is not None:
        faults += _refused(lambda: Poses.load(poses).check(robot))
        faults = [ConfigError(f"{plain(poses)}: {error}") for error in faults]
    if limits.is_file():
        section = load_yaml(limits).section("joint_limits")
        for name in robot.joint_names:
            if name not in section:
                faults.append(ConfigError(f"{section.where(name)} is missing; accepted: {listed(robot.joint_names)}"))
        for name in section:
            if name not in robot.joint_names:
                faults.append(ConfigError(f"{section.where(name)} is no joint; accepted: {listed(robot.joint_names)}"))
    return faults
