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
from rx90_common.friction.element import FRICTION_PARAMETERS, SIGNS, FrictionElement
from rx90_common.friction.friction_file import FrictionFile
from rx90_common.report.plot import COLOURS, Curve, Dash, Panel, Plot
from rx90_emulator.configuration.origins import ASSUMED, OF_CODE, OTHERS, ShownValue, aligned, file_values, place_of

SETS = ("friction", "friction/library")
"""The folders below config/ with friction of other machines: published, and identified from open recordings."""

_SPEED_SHARES = (0.01, 0.1, 1.0)
"""Shares of the highest speed at which the table has the torque."""
_DASHES: tuple[Dash, ...] = ("solid", "dashed", "dotted", "dashdot")
_SPEED_DECADES = 3  # of speed that are drawn on either side
_POINTS = 400  # on either side
_PLOT_COLUMNS = 2
_LEGEND = (
    "* assumed; a/b: for positive/negative velocity; +- standard deviation; at v rad/s: torque at constant velocity, "
    "without load, at the reference temperature"
)


@dataclass(frozen=True)
class FrictionChoice:
    """A friction file that a user names, or one element of it.

    Attributes:
        name: as the user wrote it, without the element.
        file: its content.
        values: of the elements that are meant, by the path of the parameter in the element.
        single: whether the user named one.
        place: the file's path in short.
    """

    name: str
    file: FrictionFile
    values: Mapping[str, Mapping[str, ShownValue]]
    single: bool
    place: str

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
        values: dict[str, dict[str, ShownValue]] = {one: {} for one in ([element] if sign else file.elements)}
        for one in file_values("friction", path):
            _, block, *names = one.name.split(".")
            if block == "elements" and names[0] in values:
                values[names[0]][".".join(names[1:])] = one
        return cls(name, file, values, bool(sign), place_of(path))

    def deviations(self, element: str) -> dict[str, float]:
        """Return the standard deviations that the file states of what was identified, by the element's attributes."""
        stated = (self.file.identification or {}).get("parameters", {}).get(element, {})
        return {name: one["deviation"] for name, one in stated.items() if "deviation" in one}


def shipped_friction() -> tuple[str, ...]:
    """Return the names of the friction that the package ships: of its robots, the published ones, the library's."""
    return (*shipped_robots(), *_shipped_sets())


def _shipped_sets() -> dict[str, Path]:
    return {path.stem: path for folder in SETS for path in sorted(config_path(folder).glob("*.yaml"))}


def _path_of(name: str) -> Path | None:
    if name in shipped_robots():
        return config_path(ROBOTS) / name / FILES["friction"]
    if name in (sets := _shipped_sets()):
        return sets[name]
    try:
        folder = Path(name).expanduser() / FILES["friction"]
        return folder if name and folder.is_file() else resolve_config(name)
    except (ConfigError, OSError, RuntimeError):
        return None


def replace_elements(base: FrictionChoice, rules: Iterable[str]) -> FrictionFile:
    """Return a file with some elements replaced by those of other files, with their provenance and source.

    Args:
        base: the file.
        rules: each [ELEMENT=]FRICTION[:ELEMENT]; the second element is by default that of the same name, and without
            either all elements that both files have.

    Raises:
        ConfigError: naming the rule and what is accepted.
    """
    elements = dict(base.file.elements)
    about: dict[str, dict[str, Any]] = {name: dict(stated) for name, stated in base.file.about.items()}
    replaced = set()
    for rule in rules:
        own, sign, text = rule.partition("=")
        choice = FrictionChoice.named(text if sign else rule)
        names = [own] if sign else list(choice.values if choice.single else base.file.elements)
        if unknown := [name for name in names if name not in base.file.elements]:
            fault = f"{quoted(unknown[0])} is no element of {plain(base.name)}"
            raise ConfigError(f"--take {quoted(rule)}: {fault}; accepted: {listed(base.file.elements)}, before =")
        originals = {name: name for name in names if name in choice.values}
        if choice.single:
            originals = {names[0]: next(iter(choice.values))}
        if not originals:
            fault = f"{plain(choice.name)} has no element of that name"
            raise ConfigError(f"--take {quoted(rule)}: {fault}; accepted: one of {listed(choice.values)}, behind :")
        for name, original in originals.items():
            elements[name] = choice.file.elements[original]
            about[name], given = {}, {p: one for p, one in choice.values[original].items() if one.origin != OF_CODE}
            for word in ("provenance", "source"):
                stated = {path.partition(".")[0]: getattr(one, word) for path, one in given.items()}
                (usual, count), *_ = Counter(stated.values()).most_common(1) or [("", 0)]
                if count < len(stated):  # the most frequent stands under `others`
                    about[name][word] = {key: said for key, said in stated.items() if said != usual} | {OTHERS: usual}
                elif usual:
                    about[name][word] = usual
            about[name]["note"] = f"taken from {choice.place}, {original}"
        replaced |= {*originals}
    kept = base.file.identification
    if kept is not None and "parameters" in kept:
        kept = {**kept, "parameters": {n: one for n, one in kept["parameters"].items() if n not in replaced}}
    return replace(base.file, elements=elements, identification=kept, about=about)


def comparison_table(choices: Sequence[FrictionChoice], speed: float) -> str:
    """Return a line for each element, what is assumed marked, and below them the sources.

    Args:
        choices: the elements.
        speed: the highest at which the table has the torque, rad/s.
    """
    speeds = [share * speed for share in _SPEED_SHARES]
    rows = [("element", *(one.name for one in FRICTION_PARAMETERS), *(f"at {v:.3g}" for v in speeds), "parts")]
    rows.append(("", *(one.unit for one in FRICTION_PARAMETERS), *("Nm" for _ in speeds), ""))
    for choice in choices:
        for name, values in choice.values.items():
            law = choice.file.elements[name]
            assumed = {path.partition(".")[0] for path, one in values.items() if one.provenance == ASSUMED}
            spreads = choice.deviations(name)
            numbers = [
                _both(getattr(law, each) for each in one.attributes)
                + _spread(spreads[each] for each in one.attributes if each in spreads)
                + "*" * (one.name in assumed)
                for one in FRICTION_PARAMETERS
            ]
            torques = [_both(_torques(law, v)) for v in speeds]
            rows.append((f"{choice.name}:{name}", *numbers, *torques, ", ".join(law.parts) or "-"))
    lines = aligned(rows, right=range(1, len(rows[0])))
    return "\n".join(map(one_line, [*lines, "", _LEGEND, *_sources(choices)]))


def _sources(choices: Sequence[FrictionChoice]) -> list[str]:
    """Return for each file which parameters of which elements have which source."""
    shown: dict[str, dict[str, Mapping[str, ShownValue]]] = {}
    for choice in choices:
        shown.setdefault(f"{choice.name} ({choice.place})", {}).update(choice.values)
    lines: list[str] = []
    for heading, elements in shown.items():
        lines.append(heading)
        # By what is stated: the parameters of each element, in the order of the file.
        groups: dict[str, dict[str, dict[str, None]]] = {}
        for element, values in elements.items():
            for path, one in values.items():
                if one.origin != OF_CODE:
                    words = one.provenance or "of unknown provenance", " ".join(one.source.split())
                    parameters = groups.setdefault("; ".join(filter(None, words)), {}).setdefault(element, {})
                    parameters[path.partition(".")[0]] = None
        for stated, by_element in groups.items():
            alike: dict[str, list[str]] = {}
            for element, names in by_element.items():
                alike.setdefault(", ".join(names), []).append(element)
            every = len(elements)
            whose = [f"{names} of {', '.join(of)}" if len(of) < every else names for names, of in alike.items()]
            lines.append(f"  {'; '.join(whose)}: {stated}")
    return lines


def _torques(law: FrictionElement, speed: float) -> tuple[float, float]:
    """Return the sizes of the torque at constant positive and negative velocity."""
    return float(law.steady_torque(speed)), -float(law.steady_torque(-speed))


def _both(values: Iterable[float], digits: int = 4) -> str:
    return "/".join(f"{value:.{digits}g}" for value in dict.fromkeys(values))


def _spread(deviations: Iterable[float]) -> str:
    text = _both(deviations, 2)
    return f" +- {text}" if text else ""


def comparison_json(choices: Sequence[FrictionChoice], speed: float) -> str:
    """Return a list of objects, one for each element: parameters with provenance and source, and the torque."""
    content: list[dict[str, Any]] = []
    for choice in choices:
        for name, values in choice.values.items():
            parameters, spreads = {}, choice.deviations(name)
            for path, one in values.items():
                value = None if one.value == np.inf else one.value
                stated: dict[str, Any] = {"unit": one.unit, "provenance": one.provenance, "source": one.source}
                known = spreads.get(path.replace(".", "_"), spreads.get(f"{path}_{SIGNS[0]}"))
                stated |= {} if known is None else {"deviation": known}
                parameters[path] = {"value": value, **stated, "assumed": one.provenance == ASSUMED}
            speeds = [share * speed for share in _SPEED_SHARES]
            torques = [_torques(choice.file.elements[name], v) for v in speeds]
            content.append({
                "element": f"{choice.name}:{name}",
                "file": choice.place,
                "parameters": parameters,
                "torque": [{"speed": v, "positive": up, "negative": down}
                           for v, (up, down) in zip(speeds, torques, strict=True)],
            })  # fmt: skip
    return json.dumps(content, indent=1, ensure_ascii=False)


def comparison_plot(choices: Sequence[FrictionChoice], speed: float) -> Plot:
    """Return the torque at constant velocity up to `speed`, rad/s, over a logarithmic velocity.

    It is that without load, at the reference temperature, in the mean over angle and scatter.

    A panel for each name of an element, a colour for each file; one panel for single elements, and for those of one
    file.
    """
    smallest = 2.0 * 10.0 ** (np.floor(np.log10(speed)) - _SPEED_DECADES)  # away from a decade, whose number needs room
    up = np.geomspace(smallest, speed, _POINTS)
    velocity = np.concatenate([-up[::-1], [np.nan], up])
    shown: dict[str, list[Curve]] = {}
    together = len(choices) == 1 or all(choice.single for choice in choices)
    every = [(number, choice, name) for number, choice in enumerate(choices) for name in choice.values]
    for count, (number, choice, name) in enumerate(every):
        row, k = divmod(count if together else number, len(COLOURS))
        torque, label = choice.file.elements[name].steady_torque(velocity), choice.name + f":{name}" * together
        curve = Curve(velocity, torque, label, COLOURS[k], dash=_DASHES[row % len(_DASHES)])
        shown.setdefault("" if together else f"{name}: ", []).append(curve)
    panels = [
        Panel(one, "", "velocity, rad/s", f"{element}torque, Nm", x_scale="symlog", smallest=smallest)
        for element, one in shown.items()
    ]
    return Plot(panels, columns=min(_PLOT_COLUMNS, len(panels)), height=4.0 if len(panels) == 1 else 2.4)
