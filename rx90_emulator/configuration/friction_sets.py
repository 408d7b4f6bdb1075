"""Friction files by name, beside each other, and element by element into a new one."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from rx90_common.base.errors import ConfigError
from rx90_common.base.quoting import listed, plain, quoted
from rx90_common.base.share import config_path, resolve_config
from rx90_common.description.robot_files import FILES, ROBOTS, shipped_robots
from rx90_common.friction.element import FrictionElement
from rx90_common.friction.friction_file import FrictionFile
from rx90_emulator.configuration.origins import OF_CODE, ShownValue, file_values, place_of

PUBLISHED = "friction"
"""The folder below config/ with published friction of other machines."""

_ABOUT = ("provenance", "source")
_OTHERS = "others"


@dataclass(frozen=True)
class FrictionChoice:
    """A friction file that a user names, or one element of it.

    Attributes:
        name: as the user wrote it, without the element.
        file: its content.
        elements: the names of those that are meant.
        single: whether the user named one.
    """

    name: str
    file: FrictionFile
    elements: tuple[str, ...]
    single: bool

    @classmethod
    def named(cls, text: str) -> FrictionChoice:
        """Return what FRICTION[:ELEMENT] names; FRICTION is a shipped robot or set, a file or a robot folder.

        Raises:
            ConfigError: if there is no such file or element, or the file is not acceptable.
        """
        name, sign, element = text, "", ""
        path = _found(name)
        if path is None:
            name, sign, element = text.rpartition(":")
            path = _found(name) if sign else None
        if path is None:
            accepted = f"{listed(shipped_friction())}, a friction file or a robot folder, and :ELEMENT for one of it"
            raise ConfigError(f"friction {quoted(text)}: no such file; accepted: {accepted}")
        file = FrictionFile.read(path)
        if sign and element not in file.elements:
            raise ConfigError(f"friction {quoted(text)}: no such element; accepted: {listed(file.elements)}")
        return cls(name, file, (element,) if sign else tuple(file.elements), bool(sign))

    @property
    def path(self) -> Path:
        """Return the file's path."""
        assert self.file.path is not None
        return self.file.path

    def label(self, element: str) -> str:
        """Return what names one of its elements."""
        return f"{self.name}:{element}"

    def values(self) -> list[ShownValue]:
        """Return each value of the elements that are meant, with where it comes from."""
        values = file_values("friction", self.path)
        return [one for one in values if _place(one)[0] in self.elements]


@dataclass(frozen=True)
class TakenElement:
    """An element of another file that takes the place of one of a set."""

    choice: FrictionChoice
    element: str

    @property
    def law(self) -> FrictionElement:
        """Return its parameters."""
        return self.choice.file.elements[self.element]

    def about(self) -> dict[str, Any]:
        """Return provenance and source of its values, as they stand in a file, and where it was taken from."""
        values = replace(self.choice, elements=(self.element,)).values()
        given = [one for one in values if one.origin != OF_CODE]
        said = {word: _said({_place(one)[1]: getattr(one, word) for one in given}) for word in _ABOUT}
        note = f"taken from {place_of(self.choice.path)}, {self.element}"
        return {**{word: text for word, text in said.items() if text}, "note": note}


def shipped_friction() -> tuple[str, ...]:
    """Return the names of the friction that the package ships: those of its robots, and the published ones."""
    return (*shipped_robots(), *sorted(path.stem for path in config_path(PUBLISHED).glob("*.yaml")))


def with_taken(base: FrictionChoice, rules: Iterable[str]) -> FrictionFile:
    """Return a file in which elements of others have taken the place of its own.

    Args:
        base: the file.
        rules: each [ELEMENT=]FRICTION[:ELEMENT]; the second element is by default that of the same name, and without
            either all elements that both files have.

    Raises:
        ConfigError: naming the rule and what is accepted.
    """
    taken: dict[str, TakenElement] = {}
    for rule in rules:
        taken.update(_taken(base, rule))
    kept = base.file.identification
    if kept is not None and "parameters" in kept:
        parameters = {name: one for name, one in kept["parameters"].items() if name not in taken}
        kept = {**kept, "parameters": parameters}
    return replace(
        base.file,
        elements={**base.file.elements, **{name: one.law for name, one in taken.items()}},
        identification=kept,
        about={**base.file.about, **{name: one.about() for name, one in taken.items()}},
    )


def _taken(base: FrictionChoice, rule: str) -> Mapping[str, TakenElement]:
    own, sign, text = rule.partition("=")
    choice = FrictionChoice.named(text if sign else rule)
    names = [own] if sign else list(choice.elements) if choice.single else [*base.file.elements]
    unknown = [name for name in names if name not in base.file.elements]
    if unknown:
        told = f"{quoted(unknown[0])} is no element of {plain(base.name)}"
        raise ConfigError(f"--take {quoted(rule)}: {told}; accepted: {listed(base.file.elements)}, before =")
    if choice.single:
        return {names[0]: TakenElement(choice, choice.elements[0])}
    common = [name for name in names if name in choice.elements]
    if not common:
        told = f"{plain(choice.name)} has no element of that name"
        raise ConfigError(f"--take {quoted(rule)}: {told}; accepted: one of {listed(choice.elements)}, behind :")
    return {name: TakenElement(choice, name) for name in common}


def _found(name: str) -> Path | None:
    if name in shipped_robots():
        return config_path(ROBOTS) / name / FILES["friction"]
    if name in shipped_friction():
        return config_path(PUBLISHED) / f"{name}.yaml"
    try:
        folder = Path(name).expanduser() / FILES["friction"]
        return folder if name and folder.is_file() else resolve_config(name)
    except (ConfigError, OSError, RuntimeError):
        return None


def _place(value: ShownValue) -> Sequence[str]:
    """Return element and parameter of a value of a friction file; empty texts for one of none."""
    _, block, *place = value.name.split(".")
    return place if block == "elements" else ("", "")


def _said(by_parameter: Mapping[str, str]) -> Any:
    """Return what is said by parameter, the most frequent under `others`; one word where it is the same for all."""
    counted = Counter(by_parameter.values()).most_common(1)
    if not counted or counted[0][1] == len(by_parameter):
        return counted[0][0] if counted else ""
    usual = counted[0][0]
    return {**{name: said for name, said in by_parameter.items() if said != usual}, _OTHERS: usual}
