"""The values of a setup, each with its unit, where it comes from, and whether it is assumed."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

from rx90_common.base.config import read_yaml
from rx90_common.base.models import FileModel, Model, unit_at
from rx90_common.base.quoting import aligned, one_line
from rx90_common.base.share import config_path, resolve_config
from rx90_common.description.robot_files import FILES, NO_TOOL, RobotFiles
from rx90_common.friction.signs import SIGNS
from rx90_controller.law.model import ROLES, ModelFiles
from rx90_controller.law.parameters import load_controller
from rx90_emulator.configuration.check import KINDS

OF_CODE = "default of the code"
ASSUMED = "assumed"
OTHERS = "others"
"""The key under which a file says something of all values that it does not name."""
_MAX_ALIGNED_WIDTH = 64  # characters; a longer value moves the rest of its line to the right

_FOR_READERS = (*FileModel.about_keys, "identification")
"""Keys that hold no values of a setup."""

Place = tuple[str, ...]
"""The keys that lead to a value, from the file on."""


class ShownValue(NamedTuple):
    """A value of a setup.

    Attributes:
        name: role of the file and path of the key in it.
        value: plain data.
        unit: of it; empty where it has none.
        origin: the file with the line, the file beside which another is, or the code's default; else empty.
        provenance: published, derived, assumed or identified; empty where nothing says so.
        source: the sentence that names the source.
    """

    name: str
    value: Any
    unit: str = ""
    origin: str = ""
    provenance: str = ""
    source: str = ""


def robot_values(files: RobotFiles) -> list[ShownValue]:
    """Return the files of a robot, the values in them, and the files of the controller's own model."""
    shown = [ShownValue(f"file.{role}", files.text(role)) for role in FILES]
    for role in FILES:
        path: Path | None = getattr(files, role)
        if role != "urdf" and path is not None:
            shown += file_values(role, path)
    model = load_controller(files.controller).model or ModelFiles()
    named = {value.name for value in shown}
    for role in ROLES:
        name = f"controller.model.{role}"
        path = model.path(role)
        if name not in named and (path is None or path.is_file()):
            text = NO_TOOL if path is None else _short(path)
            shown.append(ShownValue(name, text, origin=f"beside {_short(files.controller)}"))
    return shown


def _short(path: Path) -> str:
    """Return the path of a file, of a shipped one that below config/."""
    shipped = config_path("")
    return str(path.relative_to(shipped) if path.is_relative_to(shipped) else path)


def rig_values(rig: str) -> list[ShownValue]:
    """Return the file of a friction rig, a path or the name of a shipped one, and the values in it."""
    return [ShownValue("file.rig", rig), *file_values("rig", resolve_config(rig))]


def file_values(role: str, path: Path) -> list[ShownValue]:
    """Return the values of a file, checked."""
    kind = next(kind for kind in KINDS if kind.name == role)
    kind.read(path)
    lines: dict[str, int] = {}
    content = read_yaml(path, lines=lines)
    schema = kind.json_schema()
    shown = []
    for place, value in _values(kind.model.model_validate(content), content):
        key = ".".join(place)
        one = ShownValue(f"{role}.{key}", value, unit_at(schema, place, content), OF_CODE)
        if key in lines:
            one = one._replace(
                origin=f"{_short(path)}:{lines[key]}",
                provenance=_stated("provenance", content, place),
                source=_stated("source", content, place),
            )
        if estimate := _estimate(content, place):
            reason = estimate.get("reason")
            taken = estimate.get("taken_from")
            reasons = filter(None, (reason, taken and f"taken from {taken}"))
            one = one._replace(
                provenance=estimate["provenance"], source="; ".join(reasons) or one.source
            )
        shown.append(one)
    return shown


def _values(value: Any, content: Any, place: Place = ()) -> Iterator[tuple[Place, Any]]:
    """Yield place and value of what is no mapping, as the file has it or, where that leaves it out, by default."""
    if not isinstance(content, Mapping):
        if content is not None:
            yield place, content
        return
    defaults = dict(value) if isinstance(value, Model | Mapping) else {}
    for key in dict.fromkeys((*content, *defaults)):
        if key not in _FOR_READERS:
            default = defaults.get(key)
            inside = content.get(key, {} if isinstance(default, Model) else default)
            yield from _values(default, inside, (*place, key))


def _stated(word: str, content: Mapping[str, Any], place: Place) -> str:
    """Return what the innermost mapping around a value that has a `word`, provenance or source, states of the value.

    Where it states something for each key, that may be any key from there to the value, the last one first.
    """
    stated = ""
    for depth, key in enumerate(place):
        given = content.get(word)
        if isinstance(given, dict):
            keys = (*reversed(place[depth:]), OTHERS)
            given = next((given[name] for name in keys if name in given), None)
        if given is not None:
            stated = str(given)
        content = content[key]
    return stated


def _estimate(content: Mapping[str, Any], place: Place) -> Mapping[str, Any]:
    """Return what the block `identification` of a friction file says of a parameter; of two signs the assumed one."""
    elements = content.get("identification", {}).get("parameters", {})
    if len(place) < 3 or place[0] != "elements":
        return {}
    _, element, name, *sign = place
    estimates = elements.get(element, {})
    names = (name, *(f"{name}_{one}" for one in sign or SIGNS))
    found = [estimates[one] for one in names if one in estimates]
    return min(found, key=lambda estimate: estimate["provenance"] != ASSUMED, default={})


def values_table(values: Sequence[ShownValue]) -> str:
    """Return a line for each value, and below them the sources by their numbers."""
    sources: dict[str, int] = {}
    rows = [("value", "", "", "from", "")]
    for shown in values:
        mark = shown.provenance.replace(ASSUMED, ASSUMED.upper())
        if shown.source:
            mark += f" [{sources.setdefault(shown.source, len(sources) + 1)}]"
        rows.append((shown.name, _text(shown.value), shown.unit, shown.origin, mark))
    assumed = sum(shown.provenance == ASSUMED for shown in values)
    lines = [
        *aligned(rows, widest=_MAX_ALIGNED_WIDTH),
        "",
        f"{assumed} of {len(values)} values are assumed",
    ]
    lines += [f"[{number}] {' '.join(source.split())}" for source, number in sources.items()]
    return "\n".join(map(one_line, lines))


def _text(value: Any) -> str:
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, list | tuple):
        return f"[{', '.join(map(_text, value))}]"
    return f"{value:g}" if isinstance(value, float) and float(f"{value:g}") == value else str(value)
