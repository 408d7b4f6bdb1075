"""Every kind of YAML file that the project reads: what it may hold, and who reads it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from pydantic import ValidationError

from friction_bench.rig.rig_file import RigFile, load_rig
from rx90_common.bags.mapping import LogMapping, SignalMapFile
from rx90_common.base.errors import ConfigError
from rx90_common.base.models import JsonSchema, Model, fault_lines, json_schema, read_model
from rx90_common.base.quoting import plain
from rx90_common.description.drives import DriveParameters, load_drives
from rx90_common.description.poses import Poses
from rx90_common.description.robot import Tool, load_tool
from rx90_common.friction.friction_file import FrictionFile
from rx90_controller.law.parameters import CS7BParameters, load_controller
from rx90_controller.lines.task import TaskFile, load_task
from rx90_emulator.correction.file import CorrectionHead, load_correction
from rx90_emulator.identification.experiments.plan import ExperimentsFile, read_index
from rx90_emulator.loop.path_file import PathFile, TrajectoryFile, load_path, load_trajectory
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
