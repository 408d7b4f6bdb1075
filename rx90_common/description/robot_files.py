"""The files that describe a robot: the shipped ones, and those that a user names instead."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path

from rx90_common.base.share import config_path, resolve_config

SHIPPED = {
    "urdf": "robot/rx90b.urdf",
    "tool": "robot/tool_laser_head.yaml",
    "drives": "robot/drives.yaml",
    "friction": "robot/friction.yaml",
    "controller": "controller/cs7b.yaml",
}
"""What each file is called below config/."""

NO_TOOL = "none"

DESCRIPTIONS = {
    "urdf": "URDF of the arm",
    "tool": f"tool file, or {NO_TOOL}",
    "drives": "drives file",
    "friction": "friction file",
    "controller": "controller file: gains, limits and switches",
}
"""What each file is, in words for a user."""


def _shipped(name: str) -> Path:
    return config_path(SHIPPED[name])


@dataclass(frozen=True)
class RobotFiles:
    """Paths of the files that describe a robot; by default the shipped ones. A tool of None: no tool."""

    urdf: Path = field(default_factory=lambda: _shipped("urdf"))
    tool: Path | None = field(default_factory=lambda: _shipped("tool"))
    drives: Path = field(default_factory=lambda: _shipped("drives"))
    friction: Path = field(default_factory=lambda: _shipped("friction"))
    controller: Path = field(default_factory=lambda: _shipped("controller"))

    @classmethod
    def of_options(cls, options: object) -> RobotFiles:
        """Return the files that a command's options of these names say; see `named`."""
        return cls.named(**{key: getattr(options, key, None) for key in SHIPPED})

    @classmethod
    def named(cls, **names: str | None) -> RobotFiles:
        """Return the files that a user names, the shipped one for each that is None or left out.

        Args:
            names: by the keys of SHIPPED, a path or the name of a shipped file; for `tool` also "none".

        Raises:
            ConfigError: for a file that is not there.
        """
        given = {key: name for key, name in names.items() if name is not None}
        without_tool = given.get("tool") == NO_TOOL
        if without_tool:
            del given["tool"]
        files: dict[str, Path | None] = {key: resolve_config(name) for key, name in given.items()}
        return cls(**files, **({"tool": None} if without_tool else {}))  # type: ignore[arg-type]  # checked by key
