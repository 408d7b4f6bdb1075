"""The friction elements of an arm, and their file: one reader and one writer for all users of such files."""

from __future__ import annotations

import math
from collections.abc import Container, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

from pydantic import Field

from rx90_common.base.errors import ConfigError
from rx90_common.base.models import (
    FileModel,
    Named,
    NotNegative,
    model_text,
    quantity,
    read_model,
    refusals,
)
from rx90_common.base.quoting import counted, nearest, question, quoted
from rx90_common.friction.element import FrictionElement, legend


class JointTorques(FileModel):
    """What the torque of a joint holds beside links and friction."""

    offset: Annotated[float, quantity("Nm", "Constant torque, such as a sensor's zero.")] = 0.0
    rotor_inertia: Annotated[NotNegative, quantity("kg m^2", "Rotor through its gear.")] = 0.0
    spring: Annotated[float, quantity("Nm", "k of a torque -k sin(q).")] = 0.0


class Elements(Named[FrictionElement]):
    """Elements by their names."""


class Joints(Named[JointTorques]):
    """Torques of joints by their names."""


class FrictionFile(FileModel):
    """LuGre friction, joint side, SI units (equations 17 to 19 of the paper)."""

    elements: Annotated[
        Elements,
        Field(
            description="Elements by joint, and by motors that turn with several joints: joint_5_6 of the RX family "
            "turns with joints 5 and 6 together."
        ),
    ]
    joints: Annotated[
        Joints,
        Field(
            description="What torques hold beside links and friction, by joint, where no drives file says it. The "
            "simulation takes nothing of it; rx90 identify check adds it to what the URDF predicts."
        ),
    ] = Joints()
    identification: Annotated[
        dict[str, Any] | None,
        Field(description="How the values were found and how well they are known; for readers."),
    ] = None

    @classmethod
    def of(cls, elements: Mapping[str, Any], **fields: Any) -> FrictionFile:
        """Return the file with these elements, by their names, and other fields.

        Raises:
            ConfigError: naming the value and what is accepted.
        """
        content = {"elements": dict(elements), **fields}
        with refusals(cls, content=content):
            return cls.model_validate(content)

    @classmethod
    def read(cls, path: Path | str) -> FrictionFile:
        """Read a file with any elements.

        Raises:
            ConfigError: naming file, element, value and accepted range.
        """
        return read_model(cls, Path(path))

    def select(
        self, names: Sequence[str], where: Path | str = "friction"
    ) -> tuple[FrictionElement, ...]:
        """Return the elements of these names.

        Args:
            names: of the elements.
            where: the file, for messages.

        Raises:
            ConfigError: naming file and the element that is missing.
        """
        elements = self.elements.entries
        missing = [name for name in names if name not in elements]
        if missing:
            accepted = f"one element for each of {', '.join(names)}"
            raise ConfigError(f"{where}: elements.{missing[0]} is missing; accepted: {accepted}")
        return tuple(elements[name] for name in names)

    def text(self, remarks: str = "") -> str:
        """Return the file's text, which `read` gives back to the same bits.

        Args:
            remarks: lines of comment to put below the legend of the parameters.
        """
        head = "# LuGre friction, joint side, SI units (equations 17 to 19 of the paper).\n#\n"
        parts = {part for element in self.elements.entries.values() for part in element.parts}
        return head + legend(parts) + remarks + model_text(self)


@dataclass(frozen=True)
class FrictionSet:
    """LuGre elements.

    The first n have the joint velocities as input. The others turn with several joints, as the motors do that have a
    coupling: element 7 of the RX family with joints 5 and 6, and its torque acts on both (section 4 of the paper).

    Attributes:
        names: names of the elements, as `Coupling.element_names` has them.
        elements: their parameters.
        file: where they were read, if they were.
    """

    names: tuple[str, ...]
    elements: tuple[FrictionElement, ...]
    file: Path | None = None

    def __post_init__(self) -> None:
        if len(self.names) != len(self.elements):
            counts = (
                f"{counted(len(self.elements), 'element')} and {counted(len(self.names), 'name')}"
            )
            raise ConfigError(f"a friction set of {counts}; accepted: as many of each")

    def __getitem__(self, name: str) -> FrictionElement:
        """Return the element of this name.

        Raises:
            ConfigError: if there is none.
        """
        if name not in self.names:
            raise ConfigError(
                f"no friction element {quoted(name)}; accepted: {', '.join(self.names)}"
            )
        return self.elements[self.names.index(name)]

    def passivity_warnings(self, reach: Sequence[float]) -> list[str]:
        """Return a line for each element that is not passive up to the speed, rad/s, that it reaches, shape (e,)."""
        where = "" if self.file is None else f"{self.file}: "
        warnings = []
        for name, element, speed in zip(self.names, self.elements, reach, strict=True):
            limit = element.passivity_limit(speed)
            if math.isfinite(limit):
                most = element.passive_damping(speed)
                warnings.append(
                    f"{where}elements.{name}.c1 is {element.c1:g} Nm s/rad, not passive from {limit:.3g} rad/s on; "
                    f"accepted: below {most:.3g} up to {speed:.3g} rad/s, or a c1 that fades with omega_d"
                )
        return warnings


def refuse_parts(
    elements: Mapping[str, FrictionElement],
    what: str,
    where: str = "friction.",
    held: Container[str] = (),
) -> None:
    """Refuse elements with parts that are not supported.

    Args:
        elements: by their names.
        what: that does not support them, such as "the emulated rig".
        where: prefix of their names in the message: the file and the path in it.
        held: the supported parts.
    """
    for name, element in elements.items():
        for part in element.parts:
            if part not in held:
                raise ConfigError(
                    f"{where}{name}.{part}: {what} cannot hold this part; accepted: left out"
                )


def load_friction(path: Path, names: Sequence[str]) -> FrictionSet:
    """Read the friction file of a robot, with its elements by their names (`Coupling.element_names`)."""
    file = FrictionFile.read(path)
    present = file.elements.entries
    missing = [name for name in names if name not in present]
    for name in present:
        if name not in names:
            asked = question(nearest(name, missing))
            raise ConfigError(
                f"{path}: elements.{name} is not a known key{asked}; accepted: {', '.join(names)}"
            )
    return FrictionSet(tuple(names), file.select(names, path), path)
