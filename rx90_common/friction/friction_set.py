"""The seven friction elements of the robot: six joints, and joints 5 and 6 together."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from rx90_common.base.config import Section, load_yaml
from rx90_common.base.errors import ConfigError
from rx90_common.friction.lugre import ELEMENT_DTYPE, LuGreElement

ELEMENT_COUNT = 7


@dataclass(frozen=True)
class FrictionSet:
    """Seven LuGre elements.

    Elements 1 to 6 have the joint velocities as input. Element 7 has the sum of joint velocities 5 and 6,
    and its torque acts on both of these joints (section 4 of the paper).

    Attributes:
        names: names of the elements, the joints' own and `joint_5_6`.
        elements: their parameters.
        file: where they were read, if they were.
    """

    names: tuple[str, ...]
    elements: tuple[LuGreElement, ...]
    file: Path | None = None

    def __post_init__(self) -> None:
        if len(self.names) != ELEMENT_COUNT or len(self.elements) != ELEMENT_COUNT:
            raise ConfigError(
                f"a friction set of {len(self.elements)} elements and {len(self.names)} names; "
                f"accepted: {ELEMENT_COUNT} of each"
            )

    def __getitem__(self, name: str) -> LuGreElement:
        """Return the element of this name.

        Raises:
            ConfigError: if there is none.
        """
        if name not in self.names:
            raise ConfigError(f"no friction element {name!r}; accepted: {', '.join(self.names)}")
        return self.elements[self.names.index(name)]

    def records(self) -> np.ndarray[Any, Any]:
        """Return the elements for compiled code, shape (7,), dtype ELEMENT_DTYPE."""
        return np.array([element.record() for element in self.elements], dtype=ELEMENT_DTYPE)

    def passivity_warnings(self, max_velocity: Sequence[float]) -> list[str]:
        """Return a line for each element that is not passive up to the given speeds, rad/s, shape (6,)."""
        reach = [*max_velocity, max_velocity[4] + max_velocity[5]]
        where = "" if self.file is None else f"{self.file}: "
        lines = []
        for name, element, speed in zip(self.names, self.elements, reach, strict=True):
            limit = element.passivity_limit(speed)
            if math.isfinite(limit):
                accepted = element.passive_damping(speed)
                lines.append(
                    f"{where}elements.{name}.c1 is {element.c1:g} Nm s/rad, "
                    f"not passive from {limit:.3g} rad/s on; accepted: below {accepted:.3g} "
                    f"(c1 < 4 c0 g / |v| up to {speed:.3g} rad/s), or a c1 that fades with omega_d"
                )
        return lines


def element_names(joint_names: Sequence[str]) -> tuple[str, ...]:
    """Return the names of the seven elements for six joints."""
    return (*joint_names, "joint_5_6")


def load_friction(path: Path, joint_names: Sequence[str]) -> FrictionSet:
    """Read a friction file.

    Raises:
        ConfigError: naming file, element, value and accepted range.
    """
    root = load_yaml(path)
    section = root.section("elements")
    names = element_names(joint_names)
    missing = [name for name in names if name not in section]
    if missing:
        raise ConfigError(
            f"{section.where(missing[0])} is missing; accepted: one element for each of {', '.join(names)}"
        )
    elements = tuple(load_element(section.section(name)) for name in names)
    section.finish()
    if "identification" in root:
        root.section("identification")  # how the values were found and how well they are known; for readers
    root.finish()
    return FrictionSet(names, elements, path)


def load_element(section: Section) -> LuGreElement:
    """Read one element.

    Raises:
        ConfigError: naming file, element, value and accepted range.
    """
    coulomb = _signed(section, "tau_c")
    static = _signed(section, "tau_s")
    values = {key: section.number(key) for key in ("omega_s", "delta", "c0", "c1", "c2")}
    omega_d = section.number("omega_d") if "omega_d" in section else math.inf
    section.finish()
    try:
        return LuGreElement(
            tau_c_positive=coulomb[0],
            tau_c_negative=coulomb[1],
            tau_s_positive=static[0],
            tau_s_negative=static[1],
            omega_d=omega_d,
            **values,
        )
    except ConfigError as error:
        raise ConfigError(f"{section.where('')[:-1]}: {error}") from error


def _signed(section: Section, key: str) -> tuple[float, float]:
    """Read one value for both signs of the velocity, or `{positive: x, negative: y}`."""
    if section.holds_mapping(key):
        pair = section.section(key)
        values = pair.number("positive"), pair.number("negative")
        pair.finish()
        return values
    value = section.number(key)
    return value, value
