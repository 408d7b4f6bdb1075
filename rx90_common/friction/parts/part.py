"""What a part of a friction element consists of: a block of the friction file, and code for the compiled steps.

A new part is a file beside this one with a `FrictionPart` and a `Part`, and one field in `FrictionElement`.
"""

from __future__ import annotations

from collections.abc import Callable, Container, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

from rx90_common.base.arrays import Array, RecordType
from rx90_common.base.models import FileModel, accepted_values, schema_of
from rx90_common.kernels.compiled import inlined
from rx90_common.kernels.lanes import Lanes

MIN_SPEED = 1e-9
"""Least Stribeck and fading velocity, rad/s: rest for all practical purposes, while 1 / v is still a number."""
LINEAR_SPEED = 1e-3
"""The speed, rad/s, below which the viscous part is linear whatever its exponent: motion this slow is presliding."""


class FrictionPart(FileModel):
    """A block of a friction element, under its name in a friction file and as an attribute of FrictionElement."""

    @property
    def least_factor(self) -> float:
        """Return the least number that the part may multiply Coulomb and static torque with; 1 if it only adds."""
        return 1.0

    @property
    def steepest(self) -> float:
        """Return the largest growth of the sliding torque with the speed that the part may give, Nm s/rad."""
        return 0.0

    def weakest(self, element: Any) -> Any:
        """Return an element that has nowhere more friction than this FrictionElement may have by the part."""
        return element

    def sliding_torque(self, velocity: Array, torque: Array) -> Array:  # noqa: ARG002 - of other parts
        """Return the sliding torque, Nm, by the torque without the part, at velocities in rad/s, all of one shape."""
        return torque

    def numbers(self) -> dict[str, float]:
        """Return its numbers by their names, those of a list one by one: share[0]."""
        numbers: dict[str, float] = {}
        for name, value in self:
            if isinstance(value, float):
                numbers[name] = value
            elif isinstance(value, tuple):
                numbers |= {f"{name}[{i}]": number for i, number in enumerate(value)}
        return numbers


class Present(NamedTuple):
    """What the elements are at a moment, a lane for each.

    Attributes:
        tau_c: Coulomb torque of both signs, Nm.
        tau_s: static torque of both signs, Nm.
        inverse_omega_s: s/rad.
        c2: viscous friction.
        scale: number that both torques are multiplied with.
        coulomb: torque that is added to the Coulomb torque after that, Nm.
        static: the same of the static torque, Nm.
    """

    tau_c: tuple[Lanes, Lanes]
    tau_s: tuple[Lanes, Lanes]
    inverse_omega_s: Lanes
    c2: Lanes
    scale: Lanes
    coulomb: Lanes
    static: Lanes


class Moment(NamedTuple):
    """Angles, rad, velocities, rad/s, and Stribeck exponents of the elements, so many seconds after the last step."""

    angle: Lanes
    velocity: Lanes
    delta: Lanes
    ahead: float


@inlined
def scaled(present: Present, factor: Lanes) -> Present:
    """Return elements whose Coulomb and static torque are multiplied once more."""
    return Present(
        present.tau_c,
        present.tau_s,
        present.inverse_omega_s,
        present.c2,
        present.scale * factor,
        present.coulomb,
        present.static,
    )


class Surroundings(NamedTuple):
    """What constants of parts depend on beside the file.

    Attributes:
        gear: turns of the motor for a turn of each element.
        period: of a tick, s.
        seed: of the scatter.
        motor_heat: of the motor that drives each element, W for the square of the torque in Nm, winding at its
            reference temperature.
    """

    gear: Sequence[float]
    period: float
    seed: int
    motor_heat: Sequence[float]


@dataclass(frozen=True)
class Part:
    """The registration of a part: its models, and what compiled code needs for it.

    The records of all parts are the fields of `parts` and `state`, by the parts' names. Functions in compiled code are
    `inlined`; those that change states have the arguments (parts, state, transmitted torque, step, width), and return
    the torque.

    Attributes:
        models: of its block in a file, one for each kind.
        constants: type of its constants for so many elements; zeros where the part is off.
        fill: writes the constants of an element that has the part; (record, its number, part, surroundings).
        state: type of its state, if it has one.
        present: returns the changed `Present`; (parts, state, present, `Moment`, width).
        settle: begins anew, but for temperatures.
        advance: advances the state by a step of the plant.
        tick: advances the state by a tick.
    """

    models: Sequence[type[FileModel]]
    constants: Callable[[int], RecordType]
    fill: Callable[[Any, int, Any, Surroundings], None]
    state: Callable[[int], RecordType] | None = None
    present: Any = None
    settle: Any = None
    advance: Any = None
    tick: Any = None

    def legend(self, name: str) -> str:
        """Return the block as lines of comment, for the head of friction files."""
        lines = ""
        for model in self.models:
            sentence = (model.__doc__ or "").partition(".")[0]
            lines += f"# {name:<8} {in_words(sentence)}:\n" + legend_of(model, "   ", 18)
        return lines


def legend_of(model: type[FileModel], indent: str, width: int, without: Container[str] = ()) -> str:
    """Return the keys of a model as lines of comment."""
    schema = schema_of(model)
    lines = ""
    for key, value in schema["properties"].items():
        if key in FileModel.about_keys or key in without:
            continue
        if "const" in value:
            lines += f"#{indent}{key}: {value['const']}\n"
            continue
        unit = f", {value['unit']}" if "unit" in value else ""
        accepted = accepted_values(value, schema).rpartition("a number ")[2]
        optional = f"; {_default(value['default'])} if it is left out" if "default" in value else ""
        lines += f"#{indent}{key:<{width}} {in_words(value['description'])}{unit}, {accepted}{optional}\n"
    return lines


def in_words(about: str) -> str:
    """Return a sentence as words within another one; names of people keep their capital."""
    start = about if about.startswith(("Coulomb", "Stribeck")) else about[0].lower() + about[1:]
    return start.removesuffix(".")


def _default(value: Any) -> str:
    return f"{value:g}" if isinstance(value, int | float) else "none"
