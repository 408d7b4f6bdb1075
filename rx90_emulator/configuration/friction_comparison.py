"""Friction elements beside each other: a table with the source of each number, and their torque over velocity."""

from __future__ import annotations

import json
from collections.abc import Collection, Mapping, Sequence

import numpy as np

from rx90_common.base.quoting import one_line
from rx90_common.friction.element import FRICTION_PARAMETERS, FrictionElement, FrictionParameter
from rx90_common.report.plot import COLOURS, Curve, Dash, Panel, Plot
from rx90_emulator.configuration.friction_sets import FrictionChoice
from rx90_emulator.configuration.origins import ASSUMED, OF_CODE, ShownValue, place_of

_SPEEDS = (0.01, 0.1, 1.0)
"""Of the highest speed, at which the table has the torque."""
_DASHES: tuple[Dash, ...] = ("solid", "dashed", "dotted", "dashdot")
_DECADES = 3  # of speed that are drawn on either side
_POINTS = 400  # on either side
_COLUMNS = 2
_LEGEND = (
    "* assumed; a/b: for positive/negative velocity; at v rad/s: the torque at constant velocity, without load, "
    "at the reference temperature"
)
_UNKNOWN = "of unknown provenance"


def comparison_table(choices: Sequence[FrictionChoice], speed: float) -> str:
    """Return a line for each element, what is assumed marked, and below them the sources.

    Args:
        choices: the elements.
        speed: the highest at which the torque is told, rad/s.
    """
    speeds = [share * speed for share in _SPEEDS]
    rows = [("element", *(one.name for one in FRICTION_PARAMETERS), *(f"at {v:.3g}" for v in speeds), "parts")]
    rows.append(("", *(one.unit for one in FRICTION_PARAMETERS), *("Nm" for _ in speeds), ""))
    for choice in choices:
        assumed = _assumed(choice)
        for name in choice.elements:
            law = choice.file.elements[name]
            marks = ["*" if (name, one.name) in assumed else "" for one in FRICTION_PARAMETERS]
            parts = [_signed(law, one) + mark for one, mark in zip(FRICTION_PARAMETERS, marks, strict=True)]
            torques = [_both(*_torques(law, v)) for v in speeds]
            rows.append((choice.label(name), *parts, *torques, ", ".join(law.parts) or "-"))
    widths = [max(len(row[k]) for row in rows) for k in range(len(rows[0]))]
    lines = ["  ".join((row[0].ljust(widths[0]), *map(str.rjust, row[1:], widths[1:]))).rstrip() for row in rows]
    lines += ["", _LEGEND]
    return "\n".join(one_line(line) for line in [*lines, *_sources(choices)])


def comparison_json(choices: Sequence[FrictionChoice], speed: float) -> str:
    """Return a list of objects, one for each element: parameters with provenance and source, and the torque."""
    content = []
    for choice in choices:
        values = choice.values()
        for name in choice.elements:
            law = choice.file.elements[name]
            told = [one for one in values if one.name.split(".")[2] == name]
            content.append({
                "element": choice.label(name),
                "file": place_of(choice.path),
                "parameters": {
                    ".".join(one.name.split(".")[3:]): {
                        "value": None if one.value == np.inf else one.value, "unit": one.unit,
                        "provenance": one.provenance, "source": one.source, "assumed": one.provenance == ASSUMED,
                    }
                    for one in told
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

    A panel for each name of an element; one panel for single elements, and for those of one file.
    """
    names = list(dict.fromkeys(name for choice in choices for name in choice.elements))
    if len(choices) == 1 or all(choice.single for choice in choices):
        every = [(choice, name, choice.label(name)) for choice in choices for name in choice.elements]
        panels = [_panel("", every, speed)]
    else:
        panels = [
            _panel(f"{name}: ", [(one, name if name in one.elements else "", one.name) for one in choices], speed)
            for name in names
        ]
    return Plot(panels, columns=min(_COLUMNS, len(panels)), height=4.0 if len(panels) == 1 else 2.4)


def _panel(element: str, shown: Sequence[tuple[FrictionChoice, str, str]], speed: float) -> Panel:
    """Return the curves of elements, each with its file and its label; a colour is left out for one without a name."""
    smallest = 2.0 * 10.0 ** (np.floor(np.log10(speed)) - _DECADES)  # away from a decade, whose number needs room
    up = np.geomspace(smallest, speed, _POINTS)
    velocity = np.concatenate([-up[::-1], [np.nan], up])
    curves = [
        Curve(
            velocity,
            choice.file.elements[name].steady_torque(velocity),
            label,
            COLOURS[k % len(COLOURS)],
            dash=_DASHES[k // len(COLOURS) % len(_DASHES)],
        )
        for k, (choice, name, label) in enumerate(shown)
        if name
    ]
    return Panel(curves, "", "velocity, rad/s", f"{element}torque, Nm", x_scale="symlog", smallest=smallest)


def _assumed(choice: FrictionChoice) -> set[tuple[str, str]]:
    found = [one.name.split(".") for one in choice.values() if one.provenance == ASSUMED]
    return {(place[2], place[3]) for place in found}


def _sources(choices: Sequence[FrictionChoice]) -> list[str]:
    """Return for each file which parameters of which elements have which source."""
    shown: dict[str, dict[str, ShownValue]] = {}
    for choice in choices:
        heading = f"{choice.name} ({place_of(choice.path)})"
        shown.setdefault(heading, {}).update({one.name: one for one in choice.values() if one.origin != OF_CODE})
    lines: list[str] = []
    for heading, values in shown.items():
        groups: dict[tuple[str, str], dict[str, list[str]]] = {}  # by what is said: elements by their parameters
        for one in values.values():
            element, parameter = one.name.split(".")[2:4]
            parameters = groups.setdefault((one.provenance, one.source), {}).setdefault(element, [])
            parameters += [parameter] if parameter not in parameters else []
        every = {name.split(".")[2] for name in values}
        lines += [heading, *(f"  {_whose(by, every)}: {_said(*said)}" for said, by in groups.items())]
    return lines


def _whose(parameters: Mapping[str, Sequence[str]], every: Collection[str]) -> str:
    """Return the parameters of the elements, and these where they are not all that are shown."""
    elements: dict[str, list[str]] = {}
    for element, names in parameters.items():
        elements.setdefault(", ".join(names), []).append(element)
    return "; ".join(
        names if len(of) == len(every) else f"{names} of {', '.join(of)}" for names, of in elements.items()
    )


def _said(provenance: str, source: str) -> str:
    return "; ".join(filter(None, (provenance or _UNKNOWN, " ".join(source.split()))))


def _torques(law: FrictionElement, speed: float) -> tuple[float, float]:
    """Return the sizes of the torque at constant positive and negative velocity."""
    return float(law.steady_torque(speed)), -float(law.steady_torque(-speed))


def _signed(law: FrictionElement, parameter: FrictionParameter) -> str:
    return _both(*(getattr(law, name) for name in parameter.attributes))


def _both(*values: float) -> str:
    return "/".join(f"{value:.4g}" for value in dict.fromkeys(values))
