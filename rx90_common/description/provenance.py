"""What the files of a robot say of where their numbers come from."""

from __future__ import annotations

from pathlib import Path

from rx90_common.base.config import load_yaml
from rx90_common.description.robot_files import MODEL_FILES, RobotFiles


def provenance_of(files: RobotFiles) -> dict[str, list[str]]:
    """Return for each file by its role what its blocks say, such as `motor assumed`; a URDF says it in comments.

    Raises:
        ConfigError: if a file cannot be read.
    """
    found: dict[str, list[str]] = {}
    for role in MODEL_FILES:
        path: Path | None = getattr(files, role)
        if path is None or role == "urdf":
            continue
        root = load_yaml(path)
        blocks = {name: root.section(name).provenance for name in root if root.holds_mapping(name)}
        said = [f"{name} {provenance}" for name, provenance in blocks.items() if provenance]
        found[role] = said or [root.provenance or "not said"]
    return found
