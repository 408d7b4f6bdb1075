"""The friction elements of an arm, and their file: one reader and one writer for all users of such files."""

from __future__ import annotations

import math
from collections.abc import Container, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from rx90_common.base.config import ABOUT, PROVENANCE, Section, load_yaml, yaml_text
from rx90_common.base.entries import LEFT_OUT, Number
from rx90_common.base.errors import ConfigError, located
from rx90_common.base.groups import Entries, Group
from rx90_common.base.quoting import conjoined, counted, nearest, question, quoted
from rx90_common.friction.element import ELEMENT, FRICTION_PARAMETERS, PARTS, SIGNS, FrictionElement, legend
from rx90_common.friction.parts.bristles import MaxwellSlip

FRICTION = Group(
    "LuGre friction, joint side, SI units (equations 17 to 19 of the paper).",
    keys={
        "elements": Entries(
            "Elements by joint, and by motors that turn with several joints: joint_5_6 of the RX family turns with "
            "joints 5 and 6 together.",
            of=ELEMENT,
        ),
        "joints": Entries(
            "What torques hold beside links and friction, by joint, where no drives file says it. The simulation takes "
            "nothing of it; rx90_identify --friction adds it to what the URDF predicts.",
            default={},
            of=Group(
                "One joint.",
                keys={
                    "offset": Number("Constant torque, such as a sensor's zero.", "Nm", default=0.0),
                    "rotor_inertia": Number("Rotor through its gear.", "kg m^2", low=0.0, default=0.0),
                    "spring": Number("k of a torque -k sin(q).", "Nm", default=0.0),
                },
            ),
        ),
        "identification": Group(
            "How the values were found and how well they are known; for readers.",
            keys={}, known=False, default=LEFT_OUT,
        ),
    },
)  # fmt: skip
"""What a friction file holds."""

ALL_ELEMENTS = ""
"""Name for the remarks about all elements in `FrictionFile.about`."""


@dataclass(frozen=True)
class FrictionFile:
    """The content of a friction file.

    Attributes:
        elements: by their names.
        provenance: published, derived, assumed or identified; None if the file has none.
        source: the sentence that names the source; None if there is none.
        identification: method and uncertainty of the identification, for readers; None if there is none.
        path: of the file, if it was read from one.
        about: further remarks in the file: provenance, source and note of all elements under
            ALL_ELEMENTS, of single ones under their names, each for the whole or by parameter, unchanged.
        joints: offset, Nm, rotor_inertia, kg m^2, and spring, Nm, of joints, by their names; missing values are 0.
    """

    elements: Mapping[str, FrictionElement]
    provenance: str | None = None
    source: str | None = None
    identification: Mapping[str, Any] | None = None
    path: Path | None = field(default=None, compare=False)
    about: Mapping[str, Mapping[str, Any]] = field(default_factory=dict)
    joints: Mapping[str, Mapping[str, float]] = field(default_factory=dict)

    def __post_init__(self) -> None:
        if self.provenance is not None and self.provenance not in PROVENANCE:
            raise ConfigError(f"provenance is {quoted(self.provenance)}; accepted: one of {', '.join(PROVENANCE)}")

    @classmethod
    def read(cls, path: Path | str) -> FrictionFile:
        """Read a file with any elements.

        Raises:
            ConfigError: naming file, element, value and accepted range.
        """
        path = Path(path)
        root = load_yaml(path)
        content = FRICTION.read(root)
        section = root.section("elements")
        elements = {name: read_element(section.section(name)) for name in section}
        mappings = {ALL_ELEMENTS: section.content, **{name: section.section(name).content for name in section}}
        about = {name: {key: one[key] for key in ABOUT if key in one} for name, one in mappings.items()}
        about = {name: text for name, text in about.items() if text}
        identification = content.get("identification")
        joints = content["joints"]
        return cls(elements, root.provenance, root.source, identification, path, about, joints)

    def select(self, names: Sequence[str]) -> tuple[FrictionElement, ...]:
        """Return the elements of these names.

        Raises:
            ConfigError: naming file and the element that is missing.
        """
        missing = [name for name in names if name not in self.elements]
        if missing:
            raise ConfigError(
                f"{self.path}: elements.{missing[0]} is missing; accepted: one element for each of {', '.join(names)}"
            )
        return tuple(self.elements[name] for name in names)

    def text(self, remarks: str = "") -> str:
        """Return the file's text, which `read` gives back to the same bits.

        Args:
            remarks: lines of comment to put below the legend of the parameters.
        """
        content = {
            "provenance": self.provenance,
            "source": self.source,
            "elements": {
                **self.about.get(ALL_ELEMENTS, {}),
                **{name: {**self.about.get(name, {}), **_values(one)} for name, one in self.elements.items()},
            },
            "joints": {name: dict(values) for name, values in self.joints.items()} or None,
            "identification": self.identification,
        }
        head = "# LuGre friction, joint side, SI units (equations 17 to 19 of the paper).\n#\n"
        present = {key: value for key, value in content.items() if value is not None}
        parts = {part for element in self.elements.values() for part in element.parts}
        return head + legend(parts) + remarks + yaml_text(present)


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
            counts = f"{counted(len(self.elements), 'element')} and {counted(len(self.names), 'name')}"
            raise ConfigError(f"a friction set of {counts}; accepted: as many of each")

    def __getitem__(self, name: str) -> FrictionElement:
        """Return the element of this name.

        Raises:
            ConfigError: if there is none.
        """
        if name not in self.names:
            raise ConfigError(f"no friction element {quoted(name)}; accepted: {', '.join(self.names)}")
        return self.elements[self.names.index(name)]

    def passivity_warnings(self, reach: Sequence[float]) -> list[str]:
        """Return a line for each element that is not passive up to the speed, rad/s, that it reaches, shape (e,)."""
        where = "" if self.file is None else f"{self.file}: "
        warnings = [_passivity_warning(*each) for each in zip(self.names, self.elements, reach, strict=True)]
        return [f"{where}{warning}" for warning in warnings if warning]


def _passivity_warning(name: str, element: FrictionElement, speed: float) -> str:
    """Return a line for an element that is not passive up to a speed, rad/s; "" for one that is."""
    limit = element.passivity_limit(speed)
    if math.isinf(limit):
        return ""
    reducing = [part_name for part_name, part in element.parts.items() if part.lowers_friction]
    leave = "leaves" if len(reducing) == 1 else "leave"
    least = f", where {conjoined(reducing)} {leave} least friction" if reducing else ""
    blocks = isinstance(element.bristles, MaxwellSlip)
    bound = "the bound of its blocks, docs/explanation/bristles.md," if blocks else "c1 < 4 c0 g / |v|"
    return (
        f"elements.{name}.c1 is {element.c1:g} Nm s/rad, not passive from {limit:.3g} rad/s on; "
        f"accepted: below {element.passive_damping(speed):.3g} ({bound} up to {speed:.3g} rad/s{least}), "
        "or a c1 that fades with omega_d"
    )


def refuse_parts(
    elements: Mapping[str, FrictionElement], what: str, where: str = "friction.", held: Container[str] = ()
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
                raise ConfigError(f"{where}{name}.{part}: {what} cannot hold this part; accepted: left out")


def load_friction(path: Path, names: Sequence[str]) -> FrictionSet:
    """Read the friction file of a robot, with its elements by their names (`Coupling.element_names`)."""
    file = FrictionFile.read(path)
    missing = [name for name in names if name not in file.elements]
    for name in file.elements:
        if name not in names:
            asked = question(nearest(name, missing))
            raise ConfigError(f"{path}: elements.{name} is not a known key{asked}; accepted: {', '.join(names)}")
    elements = file.select(names)
    return FrictionSet(tuple(names), elements, path)


def read_element(section: Section) -> FrictionElement:
    """Read one element."""
    content = ELEMENT.read(section)
    values: dict[str, Any] = {}
    for parameter in FRICTION_PARAMETERS:
        given = content[parameter.name]
        numbers = [given[sign] for sign in SIGNS] if isinstance(given, dict) else [given] * len(parameter.attributes)
        values |= zip(parameter.attributes, numbers, strict=True)
    with located(section.where("")[:-1]):
        values |= {name: part.read(content[name]) for name, part in PARTS.items() if name in content}
        return FrictionElement(**values)


def _values(element: FrictionElement) -> dict[str, Any]:
    """Return an element as `read_element` takes it."""
    values: dict[str, Any] = {}
    for parameter in FRICTION_PARAMETERS:
        numbers = [float(getattr(element, name)) for name in parameter.attributes]
        if len(set(numbers)) > 1:
            values[parameter.name] = dict(zip(SIGNS, numbers, strict=True))
        elif numbers[0] != parameter.default:
            values[parameter.name] = numbers[0]
    return values | {name: part.values() for name, part in element.parts.items()}
