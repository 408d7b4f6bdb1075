"""The values of a setup, each with its unit, where it comes from, and whether it is assumed; as a table or as JSON."""

from __future__ import annotations

import json
import math
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, Final, NamedTuple

from rx90_common.base.config import read_yaml
from rx90_common.base.models import FileModel, Model, unit_at
from rx90_common.base.quoting import aligned, one_line
from rx90_common.base.share import config_path, resolve_config
from rx90_common.description.robot_files import FILES, NO_TOOL, RobotFiles
from rx90_common.friction.signs import SIGNS
from rx90_controller.law.model import ROLES, ModelFiles
from rx90_controller.law.parameters import load_controller
from rx90_emulator.configuration.kinds import KINDS
from rx90_emulator.loop.setup import Setup

OF_CODE = "default of the code"
COMMAND_LINE = "command line"
ASSUMED = "assumed"
OTHERS = "others"
"""The key under which a file says something of all values that it does not name."""
_MAX_ALIGNED_WIDTH = 64  # characters; a longer value moves the rest of its line to the right

_LEFT_OUT: Final = object()
_FOR_READERS: Final = (*FileModel.about_keys, "identification")
"""Keys that hold no values of a setup."""

Around = tuple[tuple[Mapping[str, Any], str], ...]
"""The mappings around a value, from the file on, each with the key that leads on from it."""


class ShownValue(NamedTuple):
    """A value of a setup.

    Attributes:
        name: role of the file and path of the key in it, or node and parameter.
        value: plain data.
        unit: of it; empty where it has none.
        origin: the file with the line, the command line, or the code's default.
        provenance: published, derived, assumed or identified; empty where nothing says so.
        source: the sentence that names the source.
    """

    name: str
    value: Any
    unit: str
    origin: str
    provenance: str = ""
    source: str = ""


def place_of(path: Path) -> str:
    """Return what names a file in short: its path below config/ or below the working folder, or the path itself."""
    for folder in (config_path(""), Path.cwd()):
        if path.is_absolute() and path.is_relative_to(folder):
            return path.relative_to(folder).as_posix()
    return str(path)


def file_values(role: str, path: Path) -> list[ShownValue]:
    """Return the values of a robot's file, checked."""
    kind = next(kind for kind in KINDS if kind.name == role)
    kind.read(path)
    lines: dict[str, int] = {}
    content = read_yaml(path, lines=lines)
    schema = kind.json_schema()
    name = place_of(path)
    identified = (
        content.get("identification", {}).get("parameters", {}) if role == "friction" else {}
    )
    shown: list[ShownValue] = []
    for place, value, around in _values(kind.model.model_validate(content), content, (), ()):
        key = ".".join(place)
        line = ShownValue(f"{role}.{key}", value, unit_at(schema, place, content), OF_CODE)
        if key in lines:
            line = line._replace(
                origin=f"{name}:{lines[key]}",
                provenance=_stated("provenance", around),
                source=_stated("source", around),
            )
        shown.append(_as_identified(line, identified))
    return shown


def _values(
    value: Any, content: Any, place: tuple[str, ...], around: Around
) -> Iterator[tuple[tuple[str, ...], Any, Around]]:
    """Yield place and value of what is no mapping, as the file has it or, where that leaves it out, by default."""
    if content is _LEFT_OUT:
        content = {} if isinstance(value, Model) else value
    if not isinstance(content, Mapping):
        if content is not None:
            yield place, content, around
        return
    inner = dict(value) if isinstance(value, Model | Mapping) else {}
    for key in dict.fromkeys((*content, *inner)):
        if key not in _FOR_READERS:
            further = (*around, (content, key))
            yield from _values(inner.get(key), content.get(key, _LEFT_OUT), (*place, key), further)


def _stated(word: str, around: Around) -> str:
    """Return what the innermost mapping that has a `word`, provenance or source, states of a value.

    Where it states something for each key, that may be any key from there to the value, the last one first.
    """
    keys: list[str] = []
    for content, key in reversed(around):
        keys.append(key)
        given = content.get(word)
        if isinstance(given, dict):
            given = next((given[each] for each in (*keys, OTHERS) if each in given), None)
        if given is not None:
            return str(given)
    return ""


def _as_identified(one: ShownValue, identified: Mapping[str, Any]) -> ShownValue:
    """Return a value with what the block `identification` of a friction file states of it, if it states anything."""
    _, block, *names = one.name.split(".")
    if block != "elements" or not names or names[0] not in identified:
        return one
    parameter, *sign = names[1:]
    wanted = (parameter, *(f"{parameter}_{each}" for each in sign or SIGNS))
    entries = [entry for name in wanted if (entry := identified[names[0]].get(name)) is not None]
    if not entries:
        return one
    first = next((entry for entry in entries if entry["provenance"] == ASSUMED), entries[0])
    origin = first.get("taken_from")
    reasons = [first.get("reason"), None if origin is None else f"taken from {origin}"]
    return one._replace(
        provenance=first["provenance"], source="; ".join(filter(None, reasons)) or one.source
    )


def setup_values(files: RobotFiles, chosen: Mapping[str, str]) -> list[ShownValue]:
    """Return the files of a robot and the values in them, and the files of the controller's own model.

    Args:
        files: of the robot.
        chosen: where the choice of a file comes from, by its role.
    """
    found = [
        ShownValue(f"file.{role}", files.text(role), "", chosen[role])
        for role in FILES
        if role in chosen
    ]
    for role in FILES:
        if role != "urdf" and (path := getattr(files, role)) is not None:
            found += file_values(role, path)
    model = load_controller(files.controller).model or ModelFiles()
    origin = f"beside {place_of(files.controller)}"
    named = {one.name for one in found}
    for role in ROLES:
        name = f"controller.model.{role}"
        own = model.path(role)
        if name not in named and (own is None or own.is_file()):
            found.append(ShownValue(name, NO_TOOL if own is None else place_of(own), "", origin))
    return found


def steps_value(setup: Setup) -> ShownValue:
    """Return the steps that the plant of a setup takes in a tick; a ConfigError for too many unasked."""
    return ShownValue(
        "plant steps in a tick", setup.plant().substeps, "1", "by friction, mass and gears"
    )


def rig_values(rig: str, chosen: str) -> list[ShownValue]:
    """Return the file of a friction rig and the values in it.

    Args:
        rig: path of the file, or the name of a shipped one.
        chosen: where the choice of it comes from.
    """
    return [ShownValue("file.rig", rig, "", chosen), *file_values("rig", resolve_config(rig))]


def values_table(values: Sequence[ShownValue]) -> str:
    """Return a line for each value, and below them the sources by their numbers."""
    sources: dict[str, int] = {}
    rows = [("value", "", "", "from", "")]
    for one in values:
        mark = one.provenance.upper() if one.provenance == ASSUMED else one.provenance
        if one.source:
            mark += f" [{sources.setdefault(one.source, len(sources) + 1)}]"
        rows.append((one.name, _text(one.value), one.unit, one.origin, mark.strip()))
    assumed = sum(one.provenance == ASSUMED for one in values)
    lines = [
        *aligned(rows, widest=_MAX_ALIGNED_WIDTH),
        "",
        f"{assumed} of {len(values)} values are assumed",
    ]
    lines += [f"[{number}] {' '.join(source.split())}" for source, number in sources.items()]
    return "\n".join(map(one_line, lines))


def values_json(values: Sequence[ShownValue]) -> str:
    """Return a list of objects, one for each value."""
    content = [
        {**one._asdict(), "value": _plain(one.value), "assumed": one.provenance == ASSUMED}
        for one in values
    ]
    return json.dumps(content, indent=1, ensure_ascii=False)


def _text(value: Any) -> str:
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, list | tuple):
        return f"[{', '.join(map(_text, value))}]"
    return f"{value:g}" if isinstance(value, float) and float(f"{value:g}") == value else str(value)


def _plain(value: Any) -> Any:
    if isinstance(value, list | tuple):
        return [_plain(one) for one in value]
    return "inf" if value == math.inf else value
