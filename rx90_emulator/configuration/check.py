"""What is wrong in a configuration file or a robot folder: all that can be seen at once, each in a line of its own.

A file is checked by the model of its kind, which says what it may hold, and then by the reader of all who use it.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from itertools import islice
from pathlib import Path
from typing import Any, NamedTuple

from pydantic import ValidationError

from friction_bench.rig.rig_file import RigFile, load_rig
from rx90_common.bags.mapping import LogMapping, SignalMapFile
from rx90_common.base.config import read_yaml
from rx90_common.base.errors import ConfigError, Rx90Error
from rx90_common.base.models import (
    FileModel,
    JsonSchema,
    Model,
    fault_lines,
    json_schema,
    read_model,
)
from rx90_common.base.quoting import listed, nearest, one_line, plain, quoted
from rx90_common.description.drives import DriveParameters, load_drives
from rx90_common.description.poses import Poses
from rx90_common.description.robot import Tool, load_robot, load_tool
from rx90_common.description.robot_files import FILES, RobotFiles
from rx90_common.friction.friction_file import FrictionFile
from rx90_controller.law.parameters import CS7BParameters, load_controller
from rx90_controller.lines.task import TaskFile, load_task
from rx90_emulator.correction.file import CorrectionHead, load_correction
from rx90_emulator.identification.experiments.plan import INDEX, ExperimentsFile, read_index
from rx90_emulator.loop.line import plan_path
from rx90_emulator.loop.path_file import PathFile, TrajectoryFile, load_path, load_trajectory
from rx90_emulator.loop.setup import Setup
from rx90_emulator.sweep.plan import SweepPlan, load_sweep_plan


def _read_sweep(path: Path) -> object:
    from rx90_emulator.sweep.sweep import Sweep  # takes a while

    return Sweep(load_sweep_plan(path))


@dataclass(frozen=True)
class FileKind:
    """A kind of YAML file.

    Attributes:
        name: of the kind and of its schema.
        model: of its content.
        read: the reader of all who use the file; raises Rx90Error.
    """

    name: str
    model: type[Model]
    read: Callable[[Path], Any]

    def faults(self, path: Path, content: dict[str, Any]) -> list[ConfigError]:
        """Return what is wrong with single values of a file, and with values together where those are right."""
        try:
            self.model.model_validate(content)
        except ValidationError as error:
            return [
                ConfigError(line) for line in fault_lines(self.model, error, plain(path), content)
            ]
        return []

    def json_schema(self) -> JsonSchema:
        """Return the JSON schema, draft 2020-12, of a file."""
        return json_schema(self.model, f"{self.name.replace('_', ' ')} file of rx90_emulator")


KINDS = (
    FileKind("drives", DriveParameters, load_drives),
    FileKind("tool", Tool, load_tool),
    FileKind("friction", FrictionFile, FrictionFile.read),
    FileKind("controller", CS7BParameters, load_controller),
    FileKind("task", TaskFile, load_task),
    FileKind("path", PathFile, load_path),
    FileKind("poses", Poses, Poses.load),
    FileKind("rig", RigFile, load_rig),
    FileKind("sweep_plan", SweepPlan, _read_sweep),
    FileKind(
        "trajectory",
        TrajectoryFile,
        lambda path: load_trajectory(
            path, read_model(TrajectoryFile, path, first=True).joint_names
        ),
    ),
    FileKind("log_mapping", SignalMapFile, LogMapping.load),
    FileKind("correction", CorrectionHead, load_correction),
    FileKind("experiments", ExperimentsFile, lambda path: read_index(path.parent)),
)
"""All kinds but the nodes' parameter files, which the nodes check when they start.

A bag's metadata.yaml is rosbag2's, and what is only written for the record needs no schema.
"""


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
