"""Every kind of YAML file that the project reads: what it may hold, and who reads it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from friction_bench.rig.rig_file import RIG, load_rig
from rx90_common.bags.mapping import MAPPING, LogMapping
from rx90_common.bags.tolerance import TOLERANCES, load_rules
from rx90_common.base.config import load_yaml
from rx90_common.base.entries import JsonSchema, Number, Switch
from rx90_common.base.groups import DEFINITIONS, Entries, Group
from rx90_common.description.drives import DRIVES, load_drives
from rx90_common.description.robot import TOOL, load_tool
from rx90_common.friction.friction_file import FRICTION, FrictionFile
from rx90_controller.law.parameters import CONTROLLER, load_controller
from rx90_controller.lines.task import TASK, load_task
from rx90_emulator.correction.file import CORRECTION, load_correction
from rx90_emulator.identification.experiments.plan import EXPERIMENTS, POSES, Poses, read_index
from rx90_emulator.loop.path_file import PATH, TRAJECTORY, load_path, load_trajectory
from rx90_emulator.sweep.plan import PLAN, load_sweep_plan

NODE_PARAMETERS = "node_parameters"
"""The name of the kind of the nodes' parameter files."""

_MOVEIT_LIMITS = Group(
    "Limits of the joints for MoveIt, in its own format; python -m tools.moveit_files writes them.",
    keys={
        "joint_limits": Entries(
            "Limits by joint.",
            of=Group(
                "Limits of a joint.",
                keys={
                    "has_velocity_limits": Switch("Whether max_velocity holds."),
                    "max_velocity": Number("Largest velocity.", "rad/s", low=0.0, above=True),
                    "has_acceleration_limits": Switch("Whether max_acceleration holds."),
                    "max_acceleration": Number("Largest acceleration.", "rad/s^2", low=0.0, above=True),
                },
                known=False,
            ),
        ),
    },
    known=False,
)


def _read_sweep(path: Path) -> object:
    from rx90_emulator.sweep.sweep import Sweep  # takes a while

    return Sweep(load_sweep_plan(path))


@dataclass(frozen=True)
class FileKind:
    """A kind of YAML file.

    Attributes:
        name: of the kind and of its schema.
        entry: what the file may hold; it has `read(section)`, too, which checks a whole file.
        read: the reader of all who use the file; raises Rx90Error.
    """

    name: str
    entry: Any
    read: Callable[[Path], Any]

    def json_schema(self) -> JsonSchema:
        """Return the JSON schema, draft 2020-12, of a file."""
        return {
            "$schema": "https://json-schema.org/draft/2020-12/schema",
            "title": f"{self.name.replace('_', ' ')} file of rx90_emulator",
            **self.entry.schema(),
            "$defs": dict(DEFINITIONS),
        }


KINDS = (
    FileKind("drives", DRIVES, load_drives),
    FileKind("tool", TOOL, load_tool),
    FileKind("friction", FRICTION, FrictionFile.read),
    FileKind("controller", CONTROLLER, load_controller),
    FileKind("task", TASK, load_task),
    FileKind("path", PATH, load_path),
    FileKind("poses", POSES, Poses.load),
    FileKind("moveit_limits", _MOVEIT_LIMITS, lambda path: _MOVEIT_LIMITS.read(load_yaml(path))),
    FileKind("rig", RIG, load_rig),
    FileKind("sweep_plan", PLAN, _read_sweep),
    FileKind(
        "trajectory",
        TRAJECTORY,
        lambda path: load_trajectory(path, TRAJECTORY.read(load_yaml(path, first=True))["joint_names"]),
    ),
    FileKind("log_mapping", MAPPING, LogMapping.load),
    FileKind("tolerances", TOLERANCES, load_rules),
    FileKind("correction", CORRECTION, load_correction),
    FileKind("experiments", EXPERIMENTS, lambda path: read_index(path.parent)),
)
"""All kinds but the nodes' parameter files, which need ROS: see nodes.py.

A bag's metadata.yaml is rosbag2's, and what is only written for the record needs no schema.
"""
