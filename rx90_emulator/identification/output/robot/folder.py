"""The files of a robot whose inertias, drives and friction were identified."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from datetime import datetime
from pathlib import Path
from typing import Any

import numpy as np

from rx90_common.base.arrays import Array
from rx90_common.base.config import load_yaml, without_schema_line, yaml_text
from rx90_common.base.errors import ConfigError, IdentificationError
from rx90_common.base.quoting import listed
from rx90_common.description.robot import load_robot
from rx90_common.description.robot_files import FILES, RobotFiles
from rx90_common.description.wrist import element_matrix
from rx90_common.friction import FrictionElement
from rx90_common.friction.friction_set import element_names
from rx90_common.friction.parameters import ALPHA_BOUNDS
from rx90_emulator.identification.excitation.consistency import ConsistentInertias
from rx90_emulator.identification.model.rigid_arm import RigidArm
from rx90_emulator.identification.output.friction_file import elements_text
from rx90_emulator.identification.output.robot.inertials import with_inertials
from rx90_emulator.identification.output.robot.marking import Identified, marked
from rx90_emulator.identification.records.record import BagSource
from rx90_emulator.identification.result.identification import IdentifiedElement

_DRIVES_HEAD = """\
# Drives, with what was identified. "joint side" values are seen through the gear; rotor_inertia, spring, brake and
# end_stops are joint side, torque_constant and peak_current motor side. SI units and A. `provenance` and `source` hold
# for the whole block, or name each value. Names of bags are those of the friction file.
"""
_CONTROLLER_HEAD = """\
# The controller, with the identified friction in its feed-forward; everything else is as it was before.
# Joint-side units, one value per motor (docs/explanation/closed_loop.md).
"""
_SLOW = 0.25  # of the nominal speed: where the compensation of two viscous parts meets their sum a second time


@dataclass(frozen=True, eq=False)
class IdentifiedRobot:
    """What runs told of a robot, as far as its files hold it.

    Attributes:
        arm: n joints and the friction elements.
        inertias: of links, rotors and springs.
        standard: names of the P standard parameters of `inertias`, as `StandardColumns.names` has them.
        elements: of the friction, in the arm's order.
        fallback_name: file of the values that the runs do not identify, if any.
        sources: the bags that inertias and drives rest on.
        drives: other values for the drives file, by block and key, such as ("motor", "torque_constant").

    Raises:
        IdentificationError: for a value that no file may hold.
    """

    arm: RigidArm
    inertias: ConsistentInertias
    standard: tuple[str, ...]
    elements: tuple[IdentifiedElement, ...]
    fallback_name: str | None
    sources: tuple[BagSource, ...]
    drives: Mapping[tuple[str, str], Identified] = field(default_factory=dict)

    def __post_init__(self) -> None:
        if not np.isfinite(self.inertias.parameters).all():
            raise IdentificationError("inertial parameters that are not finite; nothing is written")
        for name, value in zip(self.arm.names, self._amounts("k")[0].tolist(), strict=True):
            if value < 0.0:
                raise IdentificationError(f"the spring of {name} was identified as {value:.3g} Nm; accepted: >= 0")

    def _amounts(self, kind: str) -> tuple[Array, list[str]]:
        """Return the parameters of a kind at each joint, 0 where there is none, and the joints where it is in a sum."""
        amount, shared = np.zeros(len(self.arm.names)), []
        for joint, name in enumerate(self.arm.names):
            if (column := f"{kind}_{joint + 1}") in self.standard:
                k = self.standard.index(column)
                amount[joint] = self.inertias.parameters[k]
                shared += [] if self.inertias.alone[k] else [name]
        return amount, shared

    def identified_drives(self) -> dict[tuple[str, str], Identified]:
        """Return rotors and springs as values for the drives file, by block and key."""
        found = {}
        for kind, block, key in (("Ia", "transmission", "rotor_inertia"), ("k", "spring", "torque")):
            amount, shared = self._amounts(kind)
            if any(name.startswith(f"{kind}_") for name in self.standard):
                how = (
                    f"; of {listed(shared)} only the sum with the links, divided near to what was known"
                    if shared
                    else ""
                )
                found[block, key] = Identified(_list(amount), "identified", self.origin + how)
        return found

    @property
    def origin(self) -> str:
        """Return the bags with the dates of recording, in words."""
        return "identified from " + listed(f"{bag.path.name} (recorded {bag.recorded})" for bag in self.sources)


def folder_base(arm: RigidArm, urdf: Path) -> tuple[RobotFiles | None, str]:
    """Return the files that another robot's folder begins with, or None, and in one line what follows from that."""
    if arm.element_matrix.shape != element_matrix().shape or (arm.element_matrix != element_matrix()).any():
        kind = "arms of six joints whose sixth motor turns with joints 5 and 6"
        return None, f"URDF and friction file alone, no robot folder: the simulation has {kind}"
    try:
        load_robot(urdf)
    except ConfigError as error:
        return None, f"URDF and friction file alone, no robot folder: {error}"
    files = RobotFiles(urdf=urdf, tool=None, task=None, poses=None)
    return files, f"drives and controller are those of {files.drives.parent.name} but for what was identified or given"


def robot_texts(
    robot: IdentifiedRobot, urdf: Path, base: RobotFiles | None, now: datetime | None = None
) -> dict[str, str]:
    """Return the text of each file by its name.

    Args:
        robot: what was identified.
        urdf: the description that is given other inertials.
        base: files of the robot that a whole folder is made from; None for URDF and friction file alone.
        now: date of the identification; by default the present.

    Raises:
        IdentificationError: for a body that no link can be.
        ConfigError: for a file of the base that cannot be used.
    """
    names = robot.arm.element_names if base is None else element_names(robot.arm.names)
    texts = {
        FILES["urdf"]: _urdf(robot, urdf.read_text(encoding="utf-8")),
        FILES["friction"]: elements_text(names, robot.elements, robot.fallback_name, now),
    }
    if base is not None:
        texts[FILES["drives"]] = _DRIVES_HEAD + yaml_text(_drives(robot, base.drives))
        limits = load_robot(base.urdf, base.tool).max_velocity
        texts[FILES["controller"]] = _CONTROLLER_HEAD + yaml_text(_controller(robot, base.controller, limits))
        for role in ("tool", "task", "poses"):
            path: Path | None = getattr(base, role)
            if path is not None:
                texts[FILES[role]] = without_schema_line(path.read_text(encoding="utf-8"))
    return texts


def _urdf(robot: IdentifiedRobot, text: str) -> str:
    inertias, prior = robot.inertias, robot.inertias.prior
    new: dict[str, Array | None] = dict.fromkeys(prior.dropped)
    for body, pseudo in zip(prior.bodies, inertias.pseudo, strict=True):
        inverse = np.linalg.inv(body.frame)
        new[body.link] = inverse @ pseudo @ inverse.T
    rotors = ", ".join(f"{value:.6g}" for value in inertias.rotors)
    remark = f" The inertials of {listed(new, 100)} are {robot.origin}; other comments on masses are older. "
    remark += f"Rotors are no part of them: {rotors} kg m^2 at the joints. " if rotors else ""
    return with_inertials(text, new, remark)


def _drives(robot: IdentifiedRobot, path: Path) -> dict[str, Any]:
    new = {**robot.identified_drives(), **robot.drives}
    content = dict(load_yaml(path).content)
    for block in dict.fromkeys(block for block, _ in new):
        content[block] = marked(content[block], {key: one for (there, key), one in new.items() if there == block})
    return content


def _controller(robot: IdentifiedRobot, path: Path, speed: Array) -> dict[str, Any]:
    """Return the controller with the friction that each motor turns against, at speeds up to the nominal ones."""
    elements = [one.element for one in robot.elements]
    turned = [[element] for element in elements[:6]]
    turned[5].append(elements[6])
    viscous = [viscous_sum(some, float(top)) for some, top in zip(turned, speed, strict=True)]
    source = "the identified friction of each joint; of joint 6 and of element 7, with which motor 6 turns as well"
    coulomb = [sum(0.5 * (one.tau_c_positive + one.tau_c_negative) for one in some) for some in turned]
    new = {
        "coulomb_torque": Identified(_list(coulomb), "derived", source),
        "viscous_friction": Identified(_list([c2 for c2, _ in viscous]), "derived", source),
        "viscous_exponent": Identified(_list([alpha for _, alpha in viscous]), "derived", source),
    }
    # Its model, for the feed-forward by one, is the folder's own arm: not the one that the base names.
    content = {key: value for key, value in load_yaml(path).content.items() if key != "model"}
    return content | {"feed_forward": marked(content["feed_forward"], new)}


def viscous_sum(elements: Sequence[FrictionElement], speed: float) -> tuple[float, float]:
    """Return c2 and alpha of one viscous part that has the sum of several at the speed and at a share of it."""
    if len({one.alpha for one in elements}) == 1:
        return sum(one.c2 for one in elements), elements[0].alpha
    fast, slow = (sum(one.c2 * v**one.alpha for one in elements) for v in (speed, _SLOW * speed))
    alpha = float(np.clip(np.log(slow / fast) / np.log(_SLOW), *ALPHA_BOUNDS)) if slow > 0.0 else 1.0
    return fast / speed**alpha, alpha


def _list(values: Sequence[float] | Array) -> list[float]:
    """Return plain numbers of twelve digits: the others are rounding errors."""
    return [float(f"{value:.12g}") for value in values]
