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
from rx90_emulator.configuration.kinds import KINDS, FileKind
from rx90_emulator.identification.experiments.plan import INDEX
from rx90_emulator.loop.line import plan_path
from rx90_emulator.loop.setup import Setup

_MORE_OF_A_KEY = re.compile(r"[\w*]")
_LINE = re.compile(r"\bline (\d+)")
_MAX_KEYS = 100  # by which the kind of a file is told
_NO_LINES: Mapping[str, int] = {}
_NAMES = tuple(kind.name for kind in KINDS)


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
    for kind in KINDS:
        if kind.name == name:
            return kind
    raise ConfigError(f"kind {quoted(name)}; accepted: {listed(_NAMES)}")


def kind_of(path: Path, content: Mapping[str, Any]) -> FileKind:
    """Return the kind that knows most keys at the top of a file, misspelt ones with it; of several the best fitting."""

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


def check_path(path: Path, kind: FileKind | None = None) -> list[CheckedFile]:
    """Check a file, by default for the kind that its content shows, or the files of a robot folder."""
    if kind is None and path.is_file() and path.suffix.lower() == ".urdf":
        return [_check_urdf(path)]
    if kind is not None or not path.is_dir():
        return [check_file(path, kind)]
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
        name = "unreadable" if kind is None else kind.name
        return CheckedFile(path, name, (_with_line(path, error),))
    kind = kind or kind_of(path, content)
    faults: list[Rx90Error] = [*kind.faults(path, content)] or _faults_of(lambda: kind.read(path))
    problems = tuple(_with_line(path, error, lines) for error in faults)
    return CheckedFile(path, kind.name, problems)


def _faults_of(read: Callable[[], object]) -> list[Rx90Error]:
    try:
        read()
    except Rx90Error as error:
        return [error]
    return []


def _with_line(path: Path, error: Rx90Error, lines: Mapping[str, int] = _NO_LINES) -> str:
    """Return a refusal with the line of the key that it begins with, or that it names."""
    text = str(error).removeprefix(f"{plain(path)}: ")
    begins = {
        len(key): line
        for key, line in lines.items()
        if text.startswith(plain(key)) and not _MORE_OF_A_KEY.match(text, len(plain(key)))
    }
    named = _LINE.search(text)
    line = f"{begins[max(begins)]}:" if begins else f"{named[1]}:" if named else ""
    return one_line(f"{plain(path)}:{line} {text}")


def _check_urdf(path: Path) -> CheckedFile:
    faults = _faults_of(lambda: load_robot(path))
    return CheckedFile(path, "URDF", tuple(_with_line(path, error) for error in faults))


def _check_robot(folder: Path) -> list[CheckedFile]:
    """Check the files of a robot folder one by one and, if there is nothing wrong in them, together."""
    files = RobotFiles.named(str(folder))
    checked = [_check_urdf(files.urdf)]
    for role in FILES:
        path: Path | None = getattr(files, role)
        if role == "urdf" or path is None:
            continue
        if path.is_file():
            checked.append(check_file(path, kind_named(role)))
        else:
            missing = f"{plain(path)}: is missing; accepted: a {role} file"
            checked.append(CheckedFile(path, role, (missing,)))
    if not any(file.problems for file in checked):
        checked.append(CheckedFile(folder, "robot folder", tuple(_problems_together(files))))
    return checked


def _problems_together(files: RobotFiles) -> list[str]:
    """Return what is wrong with files of a robot, each right alone, that others decide.

    These are names of joints, poses, and whether the arm can travel the task's line.
    """
    try:
        setup = Setup.load(files)
        setup.plant()
    except Rx90Error as error:
        for path in (files.drives, files.friction, files.controller):
            if str(error).startswith(f"{plain(path)}: "):
                lines: dict[str, int] = {}
                read_yaml(path, lines=lines)
                return [_with_line(path, error, lines)]
        return [str(error)]
    problems = []
    if (task := files.task) is not None:
        faults = _faults_of(lambda: plan_path(setup, load_task(task)))
        problems += [_with_line(task, error) for error in faults]
    if (poses := files.poses) is not None:
        faults = _faults_of(lambda: Poses.load(poses).check(setup.robot))
        problems += [_with_line(poses, error) for error in faults]
    return problems
