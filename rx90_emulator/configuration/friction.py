"""Friction elements of any files beside each other, as table, JSON and plot, and element by element into a new file."""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from rx90_common.base.errors import ConfigError
from rx90_common.base.quoting import listed, one_line, plain, quoted
from rx90_common.base.share import config_path, resolve_config
from rx90_common.description.robot_files import FILES, ROBOTS, shipped_robots
from rx90_common.friction.element import FRICTION_PARAMETERS, FrictionElement
from rx90_common.friction.friction_file import FrictionFile
from rx90_common.report.plot import COLOURS, Curve, Dash, Panel, Plot
from rx90_emulator.configuration.origins import ASSUMED, OF_CODE, OTHERS, ShownValue, file_values, place_of

PUBLISHED = "friction"
"""The folder below config/ with published friction of other machines."""

_SPEEDS = (0.01, 0.1, 1.0)
"""Shares of the highest speed at which the table has the torque."""
_DASHES: tuple[Dash, ...] = ("solid", "dashed", "dotted", "dashdot")
_DECADES = 3  # of speed that are drawn on either side
_POINTS = 400  # on either side
_COLUMNS = 2
_LEGEND = (
    "* assumed; a/b: for positive/negative velocity; at v rad/s: the torque at constant velocity, without load, "
    "at the reference temperature"
)
_UNKNOWN = "of unknown provenance"


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
        path = _path_of(name)
        if path is None:
            name, sign, element = text.rpartition(":")
            path = _path_of(name) if sign else None
        if path is None:
            accepted = f"{listed(shipped_friction())}, a friction file or a robot folder, and :ELEMENT for one of it"
            raise ConfigError(f"friction {quoted(text)}: no such file; accepted: {accepted}")
        file = FrictionFile.read(path)
        if sign and element not in file.elements:
            raise ConfigError(f"friction {quoted(text)}: no such element; accepted: {listed(file.elements)}")
        return cls(name, file, (element,) if sign else tuple(file.elements), bool(sign))

    @property
    def place(self) -> str:
        """Return the file's path in short."""
        assert self.file.path is not None
        return place_of(self.file.path)

    def laws(self) -> list[tuple[str, str, FrictionElement]]:
        """Return name, label and law of each element that is meant."""
        return [(name, f"{self.name}:{name}", self.file.elements[name]) for name in self.elements]

    def values(self) -> list[tuple[str, str, ShownValue]]:
        """Return each value of the elements that are meant, with the element and the path of the parameter in it."""
        assert self.file.path is not None
        found = []
        for one in file_values("friction", self.file.path):
            _, block, *names = one.name.split(".")
            if block == "elements" and names[0] in self.elements:
                found.append((names[0], ".".join(names[1:]), one))
        return found


def shipped_friction() -> tuple[str, ...]:
    """Return the names of the friction that the package ships: those of its robots, and the published ones."""
    return (*shipped_robots(), *sorted(path.stem for path in config_path(PUBLISHED).glob("*.yaml")))


def _path_of(name: str) -> Path | None:
    if name in shipped_robots():
        return config_path(ROBOTS) / name / FILES["friction"]
    if name in shipped_friction():
        return config_path(PUBLISHED) / f"{name}.yaml"
    try:
        folder = Path(name).expanduser() / FILES["friction"]
        return folder if name and folder.is_file() else resolve_config(name)
    except (ConfigError, OSError, RuntimeError):
        return None


def replace_elements(base: FrictionChoice, rules: Iterable[str]) -> FrictionFile:
    """Return a file in which elements of others stand in place of its own, with their provenance and source.

    Args:
        base: the file.
        rules: each [ELEMENT=]FRICTION[:ELEMENT]; the second element is by default that of the same name, and without
            either all elements that both files have.

    Raises:
        ConfigError: naming the rule and what is accepted.
    """
    substitutes: dict[str, FrictionChoice] = {}
    for rule in rules:
        substitutes.update(_substitutes(base, rule))
    kept = base.file.identification
    if kept is not None and "parameters" in kept:
        own = {name: one for name, one in kept["parameters"].items() if name not in substitutes}
        kept = {**kept, "parameters": own}
    elements, about = dict(base.file.elements), dict(base.file.about)
    for name, one in substitutes.items():
        ((original, _, elements[name]),) = one.laws()
        given = [(path.partition(".")[0], value) for _, path, value in one.values() if value.origin != OF_CODE]
        stated = {word: _by_parameter({key: getattr(v, word) for key, v in given}) for word in ("provenance", "source")}
        note = f"taken from {one.place}, {original}"
        about[name] = {**{word: text for word, text in stated.items() if text}, "note": note}
    return replace(base.file, elements=elements, identification=kept, about=about)


def _substitutes(base: FrictionChoice, rule: str) -> dict[str, FrictionChoice]:
    """Return by the name of each element that a rule replaces the single element that replaces it."""
    own, sign, text = rule.partition("=")
    choice = FrictionChoice.named(text if sign else rule)
    names = [own] if sign else list(choice.elements) if choice.single else list(base.file.elements)
    unknown = [name for name in names if name not in base.file.elements]
    if unknown:
        fault = f"{quoted(unknown[0])} is no element of {plain(base.name)}"
        accepted = f"{listed(base.file.elements)}, before ="
        raise ConfigError(f"--take {quoted(rule)}: {fault}; accepted: {accepted}")
    if choice.single:
        return {names[0]: choice}
    common = [name for name in names if name in choice.elements]
    if not common:
        fault = f"{plain(choice.name)} has no element of that name"
        accepted = f"one of {listed(choice.elements)}, behind :"
        raise ConfigError(f"--take {quoted(rule)}: {fault}; accepted: {accepted}")
    return {name: replace(choice, elements=(name,)) for name in common}


def _by_parameter(stated: Mapping[str, str]) -> Any:
    """Return what is stated by parameter, the most frequent under `others`; one text where all are the same."""
    if not stated:
        return ""
    ((usual, count),) = Counter(stated.values()).most_common(1)
    if count == len(stated):
        return usual
    return {**{name: text for name, text in stated.items() if text != usual}, OTHERS: usual}


def comparison_table(choices: Sequence[FrictionChoice], speed: float) -> str:
    """Return a line for each element, what is assumed marked, and below them the sources.

    Args:
        choices: the elements.
        speed: the highest at which the table has the torque, rad/s.
    """
    speeds = [share * speed for share in _SPEEDS]
    rows = [("element", *(one.name for one in FRICTION_PARAMETERS), *(f"at {v:.3g}" for v in speeds), "parts")]
    rows.append(("", *(one.unit for one in FRICTION_PARAMETERS), *("Nm" for _ in speeds), ""))
    for choice in choices:
        assumed = {(name, path.partition(".")[0]) for name, path, one in choice.values() if one.provenance == ASSUMED}
        for name, label, law in choice.laws():
            parts = [
                _both(*(getattr(law, each) for each in one.attributes)) + "*" * ((name, one.name) in assumed)
                for one in FRICTION_PARAMETERS
            ]
            torques = [_both(*_torques(law, v)) for v in speeds]
            rows.append((label, *parts, *torques, ", ".join(law.parts) or "-"))
    widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
    lines = ["  ".join((row[0].ljust(widths[0]), *map(str.rjust, row[1:], widths[1:]))).rstrip() for row in rows]
    return "\n".join(map(one_line, [*lines, "", _LEGEND, *_sources(choices)]))


def _sources(choices: Sequence[FrictionChoice]) -> list[str]:
    """Return for each file which parameters of which elements have which source."""
    shown: dict[str, dict[str, tuple[str, str, ShownValue]]] = {}
    for choice in choices:
        given = {each[2].name: each for each in choice.values() if each[2].origin != OF_CODE}
        shown.setdefault(f"{choice.name} ({choice.place})", {}).update(given)
    lines: list[str] = []
    for heading, values in shown.items():
        lines.append(heading)
        # By what is stated: the parameters of each element, in the order of the file.
        groups: dict[tuple[str, str], dict[str, dict[str, None]]] = {}
        for element, path, one in values.values():
            parameters = groups.setdefault((one.provenance, one.source), {}).setdefault(element, {})
            parameters[path.partition(".")[0]] = None
        count = len({element for element, _, _ in values.values()})
        for (provenance, source), by_element in groups.items():
            alike: dict[str, list[str]] = {}
            for element, names in by_element.items():
                alike.setdefault(", ".join(names), []).append(element)
            whose = "; ".join(
                names if len(of) == count else f"{names} of {', '.join(of)}" for names, of in alike.items()
            )
            stated = "; ".join(filter(None, (provenance or _UNKNOWN, " ".join(source.split()))))
            lines.append(f"  {whose}: {stated}")
    return lines


def _torques(law: FrictionElement, speed: float) -> tuple[float, float]:
    """Return the sizes of the torque at constant positive and negative velocity."""
    return float(law.steady_torque(speed)), -float(law.steady_torque(-speed))


def _both(*values: float) -> str:
    return "/".join(f"{value:.4g}" for value in dict.fromkeys(values))


def comparison_json(choices: Sequence[FrictionChoice], speed: float) -> str:
    """Return a list of objects, one for each element: parameters with provenance and source, and the torque."""
    content = []
    for choice in choices:
        values = choice.values()
        for name, label, law in choice.laws():
            content.append({
                "element": label,
                "file": choice.place,
                "parameters": {
                    path: {
                        "value": None if one.value == np.inf else one.value, "unit": one.unit,
                        "provenance": one.provenance, "source": one.source, "assumed": one.provenance == ASSUMED,
                    }
                    for element, path, one in values if element == name
                },
                "torque": [
                    {"speed": v, **dict(zip(("positive", "negative"), _torques(law, v), strict=True))}
                    for v in (share * speed for share in _SPEEDS)
                ],
            })  # fmt: skip
    return json.dumps(content, indent=1, ensure_ascii=False)


def comparison_plot(choices: Sequence[FrictionChoice], speed: float) -> Plot:
    """Return the torque at constant velocity up to `speed`, rad/s, over a logarithmic velocity.

    It is that without load, at the reference temperature, in the mean over angle and scatter.

    A panel for each name of an element, a colour for each file; one panel for single elements, and for those of one
    file.
    """
    smallest = 2.0 * 10.0 ** (np.floor(np.log10(speed)) - _DECADES)  # away from a decade, whose number needs room
    up = np.geomspace(smallest, speed, _POINTS)
    velocity = np.concatenate([-up[::-1], [np.nan], up])
    shown: dict[str, list[Curve]] = {}
    together = len(choices) == 1 or all(choice.single for choice in choices)
    every = [(k, choice, *law) for k, choice in enumerate(choices) for law in choice.laws()]
    for count, (number, choice, name, label, law) in enumerate(every):
        k = count if together else number
        torque, colour = law.steady_torque(velocity), COLOURS[k % len(COLOURS)]
        curve = Curve(
            velocity, torque, label if together else choice.name, colour, dash=_DASHES[k // len(COLOURS) % len(_DASHES)]
        )
        shown.setdefault("" if together else f"{name}: ", []).append(curve)
    panels = [
        Panel(one, "", "velocity, rad/s", f"{element}torque, Nm", x_scale="symlog", smallest=smallest)
        for element, one in shown.items()
    ]
    return Plot(panels, columns=min(_COLUMNS, len(panels)), height=4.0 if len(panels) == 1 else 2.4)
