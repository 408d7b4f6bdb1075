"""The files that describe a robot, from a folder or named by a user, and the sources of their numbers."""

from __future__ import annotations

import re
from dataclasses import dataclass, field
from pathlib import Path

from rx90_common.base.config import read_yaml
from rx90_common.base.errors import ConfigError
from rx90_common.base.quoting import listed, quoted
from rx90_common.base.share import config_path, resolve_config

DEFAULT_ROBOT = "rx90b"
PAPER = "rx90b/paper"
"""The variant of the RX90B that is to the letter of the first source: docs/explanation/models.md."""
ROBOTS = "robots"
"""The folder below config/ with a folder for each shipped robot, and in it one for each variant of that robot."""

FILES = {
    "urdf": "robot.urdf",
    "tool": "tool.yaml",
    "drives": "drives.yaml",
    "friction": "friction.yaml",
    "controller": "controller.yaml",
    "task": "task.yaml",
    "poses": "poses.yaml",
}
"""What each file is called in a robot folder. The arm carries no tool where there is no such file."""

MODEL_FILES = ("urdf", "tool", "drives", "friction", "controller")
"""The files that a run reads whatever the motion."""

NO_TOOL = "none"
_OPTIONAL = ("tool", "task", "poses")
_SCHEMA_LINE = r"(?m)^# yaml-language-server: \$schema=.*\n"

DESCRIPTIONS = {
    "urdf": "URDF of the arm",
    "tool": f"tool file, or {NO_TOOL}",
    "drives": "drives file",
    "friction": "friction file",
    "controller": "controller file: gains, limits and switches",
    "task": "task file: a straight line",
    "poses": "poses file: where experiments take place",
}
"""What each file is, in words for a user."""


def shipped_robots() -> tuple[str, ...]:
    """Return the names of the robots and of their variants, ROBOT/VARIANT, that the package ships, sorted."""
    robots = config_path(ROBOTS)
    return tuple(
        sorted(
            path.parent.relative_to(robots).as_posix() for path in robots.rglob(FILES["friction"])
        )
    )


def robot_folder(name: str) -> Path:
    """Return the folder of a robot: of a shipped one by its name, or the user's own by its path."""
    shipped = shipped_robots()
    if name in shipped:
        return config_path(ROBOTS) / name
    try:
        own = Path(name).expanduser()
        there = own.is_dir() and bool(name)
    # a name longer than the system takes, a home folder that there is not
    except (OSError, RuntimeError):
        there = False
    if there:
        if not any((own / file).is_file() for file in FILES.values()):
            files = listed(FILES.values())
            raise ConfigError(
                f"robot {quoted(name)}: none of a robot's files; accepted: a folder with {files}"
            )
        return own
    raise ConfigError(
        f"robot {quoted(name)}: no such folder; accepted: {', '.join(shipped)}, or a robot folder's path"
    )


def _default(role: str) -> Path:
    return config_path(ROBOTS) / DEFAULT_ROBOT / FILES[role]


@dataclass(frozen=True)
class RobotFiles:
    """Paths of the files that describe a robot; by default those of the RX90B.

    A tool of None: no tool. A task or poses of None: the robot has none of its own.
    """

    urdf: Path = field(default_factory=lambda: _default("urdf"))
    tool: Path | None = field(default_factory=lambda: _default("tool"))
    drives: Path = field(default_factory=lambda: _default("drives"))
    friction: Path = field(default_factory=lambda: _default("friction"))
    controller: Path = field(default_factory=lambda: _default("controller"))
    task: Path | None = field(default_factory=lambda: _default("task"))
    poses: Path | None = field(default_factory=lambda: _default("poses"))

    @classmethod
    def of_options(cls, options: object) -> RobotFiles:
        """Return the files given by a command's options, `robot` and the keys of FILES; see `named`."""
        return cls.named(
            getattr(options, "robot", None), **{key: getattr(options, key, None) for key in FILES}
        )

    @classmethod
    def named(cls, robot: Path | str | None = None, /, **names: Path | str | None) -> RobotFiles:
        """Return a robot's files, replaced by those that a user names.

        A folder without a URDF inside a robot folder is a variant: files that it lacks are that robot's.

        Args:
            robot: name of a shipped robot, or the path of a robot folder; None for the RX90B.
            names: by the keys of FILES, a path or the name of a file below config/, None for the robot's; for `tool`
                also "none".

        Raises:
            ConfigError: for a robot or a file that does not exist.
        """
        folder = robot_folder(DEFAULT_ROBOT if robot is None else str(robot))
        above = folder.parent
        variant = (above / FILES["urdf"]).is_file() and not (folder / FILES["urdf"]).is_file()
        files: dict[str, Path | None] = {}
        for role, name in FILES.items():
            given = names.get(role)
            own = folder / name
            if variant and not own.is_file():
                own = above / name
            if role == "tool" and str(given) == NO_TOOL:
                files[role] = None
            elif given is not None:
                files[role] = resolve_config(str(given))
            else:
                files[role] = None if role in _OPTIONAL and not own.is_file() else own
        return cls(**files)  # type: ignore[arg-type]  # None only for optional files

    def required(self, role: str) -> Path:
        """Return the path of a file that not every robot folder has.

        Raises:
            ConfigError: if this one has none.
        """
        path: Path | None = getattr(self, role)
        if path is None:
            raise ConfigError(
                f"{self.urdf.parent}: no {FILES[role]}; accepted: a {role} file, in the folder or named"
            )
        return path

    def optional_texts(self) -> dict[str, str]:
        """Return tool, task and poses, where they are there, by the names of these files, for another robot folder.

        Without the line that names a JSON schema for editors: its path begins at the file's own folder.
        """
        paths = {FILES[role]: getattr(self, role) for role in _OPTIONAL}
        return {
            name: re.sub(_SCHEMA_LINE, "", path.read_text(encoding="utf-8"))
            for name, path in paths.items()
            if path is not None
        }

    def text(self, role: str) -> str:
        """Return the name of a file: its path below config/ if it is there, "none" for no tool."""
        path: Path | None = getattr(self, role)
        if path is None:
            return NO_TOOL
        shipped = config_path("")
        return path.relative_to(shipped).as_posix() if path.is_relative_to(shipped) else str(path)


def provenance_of(files: RobotFiles) -> dict[str, list[str]]:
    """Return the provenance of each file's blocks, such as `motor assumed`, by role; a URDF has it in comments."""
    found: dict[str, list[str]] = {}
    for role in MODEL_FILES:
        path: Path | None = getattr(files, role)
        if path is None or role == "urdf":
            continue
        content = read_yaml(path)
        texts = [
            f"{name} {block['provenance']}"
            for name, block in content.items()
            if isinstance(block, dict) and block.get("provenance")
        ]
        found[role] = texts or [str(content.get("provenance") or "not said")]
    return found
